"""Exponential slabs behind smooth glass by adding and doubling.

S. Prahl, *iadpython* 0.5.3, a Python package on PyPI, 2023: forward radiative transport by the
adding-doubling method. ``numbers.csv`` holds what that version computes, by
``tools/validation.py``, with what is left when the number of its quadrature points doubles as the
error. Slabs of extinction 1 with a refractive index between smooth faces to air,
Henyey-Greenstein scattering, under normal and Lambertian light; specular reflection counts.
"""

from __future__ import annotations

from collections.abc import Iterator

from ..slabs import compared
from ..study import Effort, Row

TITLE = "exponential slabs between smooth faces of glass"
SOURCE = "iadpython 0.5.3, an independent program (Prahl 2023)"

LIGHTS = {"normal": 1.0, "Lambertian": None}
QUICK = "albedo=0.9 thickness=3 g=0 index=1.5"


def measure(effort: Effort) -> Iterator[Row]:
    """Shares of incident light that are reflected and transmitted."""
    yield from compared(__package__, effort, LIGHTS, QUICK)
