"""Exponential slabs by discrete ordinates.

D. J. X. Ho, *PythonicDISORT: A Python reimplementation of the Discrete Ordinate Radiative Transfer
package DISORT*, Journal of Open Source Software, 2024 (doi 10.21105/joss.06442). The program solves
the equation of transfer without random numbers; ``numbers.csv`` holds what its version computes,
by ``tools/validation.py``. Slabs of extinction 1 with index-matched faces, Henyey-Greenstein
scattering; beams of cosine 1 (normal) and 0.3 (oblique), and Lambertian light. A half-space is one
of depth 400.
"""

from __future__ import annotations

from collections.abc import Iterator

from ..slabs import compared
from ..study import Effort, Row

TITLE = "exponential slabs and half-spaces, index-matched"
SOURCE = "PythonicDISORT, an independent program (Ho 2024)"

LIGHTS = {"normal": 1.0, "oblique": 0.3, "Lambertian": None}
QUICK = "albedo=0.9 thickness=3"


def measure(effort: Effort) -> Iterator[Row]:
    """Shares of incident light that are reflected and transmitted."""
    yield from compared(__package__, effort, LIGHTS, QUICK)
