"""Chord-length sampling of binary Markov mixtures in a slab.

Materials and slab are those of :mod:`..adams_1989_jqsrt`, chords the same in all directions. The
numbers of ``numbers.csv`` are of chord-length sampling, which remembers the material at a collision
(alias the model of Levermore and Pomraning): the medium ``nonexp_binary_mixture``. They came to us
as a list without their table or standard errors; the error is half a unit of the last digit. See
P. S. Brantley, *A benchmark comparison of Monte Carlo particle transport algorithms for binary
stochastic mixtures*, JQSRT 112(4), 2011, for the method.
"""

from __future__ import annotations

from collections.abc import Iterator

from ..slabs import shares
from ..study import Effort, Row, numbers, row

TITLE = "chord-length sampling of two materials in a slab"
SOURCE = "numbers of others for the model of Brantley 2011"

THICKNESS = 10.0

SETS = {
    "1": ((10 / 99, 100 / 11), (0.99, 0.11)),
    "2": ((10 / 99, 100 / 11), (9.9, 1.1)),
}
"""Extinctions and mean chords of both materials."""

SCATTERING = {"a": (0.0, 1.0), "b": (1.0, 0.0), "c": (0.9, 0.9)}
"""Albedos of both materials."""


def _pair(values: tuple[float, float]) -> str:
    return ", ".join(f"{value:.9g}" for value in values)


def measure(effort: Effort) -> Iterator[Row]:
    """Reflected and transmitted shares."""
    held = numbers(__package__)
    for case in dict.fromkeys(name.split()[0] for name in held):
        if effort.quick and case not in ("1a", "2a"):
            continue
        sigma, chord = SETS[case[0]]
        medium = {
            "type": "nonexp_binary_mixture",
            "sigma_t": _pair(sigma),
            "chord": _pair(chord),
            "albedo": _pair(SCATTERING[case[1]]),
        }
        for name, (mean, error) in shares(
            f"binary {case}", medium, THICKNESS, None, effort
        ).items():
            yield row(__package__, held[f"{case} {name}"], mean, error)
