"""Exponential slabs behind smooth glass by adding and doubling.

S. Prahl, *iadpython* 0.5.3, a Python package on PyPI, 2023: forward radiative transport by the
adding-doubling method. ``numbers.csv`` holds what that version computes, by
``tools/validation.py``, with what is left when the number of its quadrature points doubles as the
error. Slabs of extinction 1 with a refractive index between smooth faces to air,
Henyey-Greenstein scattering, under normal and Lambertian light; specular reflection counts.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from ..slabs import shares
from ..study import Effort, Row, numbers, row

TITLE = "exponential slabs between smooth faces of glass"
SOURCE = "iadpython 0.5.3, an independent program (Prahl 2023)"

LIGHTS = {"normal": 1.0, "Lambertian": None}
QUICK = "albedo=0.9 thickness=3 g=0 index=1.5"


def measure(effort: Effort) -> Iterator[Row]:
    """Shares of incident light that are reflected and transmitted."""
    held = numbers(__package__)
    for case in dict.fromkeys(re.sub(r" \w+$", "", name) for name in held):
        if effort.quick and not case.startswith(QUICK):
            continue
        given = dict(pair.split("=") for pair in case.split()[:-1])
        phase = {"type": "hg", "g": float(given["g"])}
        medium = {"type": "nonexp_homogeneous", "albedo": float(given["albedo"]), "phase": phase}
        mu, index = LIGHTS[case.split()[-1]], float(given["index"])
        found = shares(case, medium, float(given["thickness"]), mu, effort, index)
        for name, (mean, error) in found.items():
            if f"{case} {name}" in held:
                yield row(__package__, held[f"{case} {name}"], mean, error)
