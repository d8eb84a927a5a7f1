"""The atomic mix of binary Markov mixtures in a slab.

M. L. Adams, E. W. Larsen, G. C. Pomraning, *Benchmark results for particle transport in a binary
Markov statistical medium*, JQSRT 42(4), 1989; P. S. Brantley, *A benchmark comparison of Monte
Carlo particle transport algorithms for binary stochastic mixtures*, JQSRT 112(4), 2011. A slab of
thickness 10 under Lambertian light, isotropic scattering. The sets of materials are theirs; the
numbers of ``numbers.csv`` came to us as a list with five decimals, without their table or their
errors. The atomic mix is the exponential medium of the same mean extinction and scattering, which
PythonicDISORT solves to seven digits: .495464, .478016 and .786093 are reflected in 1a, 1c and 3a.
The list differs from that by up to 4e-4 of the value; the errors of ``numbers.csv`` are these
differences, and at least half a unit of the last digit.
"""

from __future__ import annotations

from collections.abc import Iterator

from ..slabs import shares
from ..study import Effort, Row, numbers, row

TITLE = "atomic mix of two materials in a slab"
SOURCE = "Adams, Larsen and Pomraning 1989; Brantley 2011"

THICKNESS = 10.0

SETS = {
    "1": ((10 / 99, 100 / 11), (0.99, 0.11)),
    "2": ((10 / 99, 100 / 11), (9.9, 1.1)),
    "3": ((2 / 101, 200 / 101), (5.05, 5.05)),
}
"""Extinctions and mean chords of both materials."""

SCATTERING = {"a": (0.0, 1.0), "b": (1.0, 0.0), "c": (0.9, 0.9)}
"""Albedos of both materials."""


def atomic_mix(case: str) -> tuple[float, float]:
    """Mean extinction and albedo of a case, such as 1a."""
    sigma, chord = SETS[case[0]]
    parts = [s * c / sum(chord) for s, c in zip(sigma, chord, strict=True)]
    scattering = sum(p * a for p, a in zip(parts, SCATTERING[case[1]], strict=True))
    return sum(parts), scattering / sum(parts)


def measure(effort: Effort) -> Iterator[Row]:
    """Reflected and transmitted shares."""
    held = numbers(__package__)
    for case in dict.fromkeys(name.split()[0] for name in held):
        sigma_t, albedo = atomic_mix(case)
        medium = {"type": "nonexp_homogeneous", "sigma_t": sigma_t, "albedo": albedo}
        for name, (mean, error) in shares(f"mix {case}", medium, THICKNESS, None, effort).items():
            yield row(__package__, held[f"{case} {name}"], mean, error)
