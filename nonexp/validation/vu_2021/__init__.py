"""Absorbing binary Markov mixtures in planar layers.

Vu, 2021: transmission of Lambertian light through a slab of thickness 10 of two absorbing
materials in layers whose thicknesses are independent and exponentially distributed. A ray of cosine
mu crosses chords 1/mu as long, so that the transmission is the integral over mu of 2 mu ff(10/mu),
with ``exponential_mixture`` by ``levermore``: quadrature, no random numbers. The numbers came to us
with the author's name, the year, and an error of 1e-4; we do not know the table.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np

from ...models.exponential_mixture import ExponentialMixture
from ..study import Effort, Row, numbers, row

TITLE = "absorbing layers of two materials"
SOURCE = "Vu 2021"

THICKNESS = 10.0

CASES = {
    "extinctions 2/101, 200/101": ((2 / 101, 200 / 101), (7.575, 7.575)),
    "extinctions 10/99, 100/11": ((10 / 99, 100 / 11), (10.0, 1.1111)),
}
"""Extinctions and mean chords across the layers."""


def measure(_effort: Effort) -> Iterator[Row]:
    """Transmission by quadrature over directions."""
    held = numbers(__package__)
    x, weight = np.polynomial.legendre.leggauss(200)
    for case, (sigma, chord) in CASES.items():
        quantity = next(q for name, q in held.items() if re.match(re.escape(case), name))
        total = 0.0
        for mu, w in zip((1 + x) / 2, weight / 2, strict=True):
            law = ExponentialMixture.levermore(*sigma, *(c / mu for c in chord))
            total += w * 2 * mu * float(law.ff(THICKNESS / mu))
        yield row(__package__, quantity, total)
