"""Exponential slabs by discrete ordinates.

D. J. X. Ho, *PythonicDISORT: A Python reimplementation of the Discrete Ordinate Radiative Transfer
package DISORT*, Journal of Open Source Software, 2024 (doi 10.21105/joss.06442). The program solves
the equation of transfer without random numbers; ``numbers.csv`` holds what its version computes,
by ``tools/validation.py``. Slabs of extinction 1 with index-matched faces, Henyey-Greenstein
scattering; beams of cosine 1 (normal) and 0.3 (oblique), and Lambertian light. A half-space is one
of depth 400.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from ..slabs import shares
from ..study import Effort, Row, numbers, row

TITLE = "exponential slabs and half-spaces, index-matched"
SOURCE = "PythonicDISORT, an independent program (Ho 2024)"

LIGHTS = {"normal": 1.0, "oblique": 0.3, "Lambertian": None}
QUICK = "albedo=0.9 thickness=3"


def measure(effort: Effort) -> Iterator[Row]:
    """Shares of incident light that are reflected and transmitted."""
    held = numbers(__package__)
    for case in dict.fromkeys(re.sub(r" \w+$", "", name) for name in held):
        if effort.quick and not case.startswith(QUICK):
            continue
        given = dict(pair.split("=") for pair in case.split()[:-1])
        phase = {"type": "hg", "g": float(given["g"])}
        medium = {"type": "nonexp_homogeneous", "albedo": float(given["albedo"]), "phase": phase}
        thickness = min(float(given["thickness"]), 400.0)
        found = shares(case, medium, thickness, LIGHTS[case.split()[-1]], effort)
        for name, (mean, error) in found.items():
            if f"{case} {name}" in held:
                yield row(__package__, held[f"{case} {name}"], mean, error)
