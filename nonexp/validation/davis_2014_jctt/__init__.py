"""How fast transmission falls with the thickness of slabs of clustered particles.

A. B. Davis, F. Xu, *A generalized linear transport model for spatially correlated stochastic
media*, Journal of Computational and Theoretical Transport, 2014, for transmission by power laws:
walks whose steps have the tail tau^-b, b < 2, cross a slab of thickness L with a probability that
falls as L^(-b/2). With the law ``gamma`` flights from particles have b = alpha + 1. So light that
starts at a particle near the lit face crosses as L^(-(alpha+1)/2). Light that *enters* does not
start at a particle: its first flight has the tail tau^-alpha, which is heavier, so that the whole
transmission falls as L^-alpha. The second exponent is our own conclusion.

Both are limits: the errors in ``numbers.csv`` are what we allow for finite thickness. White slabs,
isotropic scattering, Lambertian light; light of a particle are the paths whose first collision is
less than 1 deep.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from typing import Any

import numpy as np

from ... import models
from ..slabs import incident, paths, slab
from ..study import Effort, Row, numbers, row, seed_of
from ..walks import first_depths

TITLE = "exponent of transmission through thick slabs, gamma"
SOURCE = "Davis and Xu 2014 (from a particle), ours (entering)"

THICKNESSES = (30.0, 300.0)


def measure(effort: Effort) -> Iterator[Row]:
    """Exponents between two thicknesses."""
    held = numbers(__package__)
    for alpha in dict.fromkeys(float(re.split(r"[= ]", name)[1]) for name in held):
        law = models.to_dict(models.create("gamma", alpha=alpha))
        medium = {"type": "nonexp_homogeneous", "albedo": 1.0, "transmittance": law}
        found = [_crossing(medium, thickness, effort) for thickness in THICKNESSES]
        span = math.log(THICKNESSES[1] / THICKNESSES[0])
        for kind in ("entering", "from a particle"):
            (one, error), (other, second) = (result[kind] for result in found)
            exponent = math.log(one / other) / span
            relative = math.hypot(error / one, second / other)
            quantity = held[f"alpha={alpha:g} {kind}"]
            yield row(__package__, quantity, exponent, relative / span)


def _crossing(
    medium: dict[str, Any], thickness: float, effort: Effort
) -> dict[str, tuple[float, float]]:
    """Share of light that crosses, of all and of what first collides less than 1 deep."""
    count, light, built = effort.count // 4, incident(None), slab(medium, thickness)
    everything, shallow = [], []
    for batch in range(max(1, effort.batches // 4)):
        seed = seed_of(f"gamma {medium['transmittance']} {thickness}", batch)
        depth = first_depths(medium, thickness, light, seed, count)
        crossed = paths(built, thickness, light, seed, count)[1]
        everything.append(crossed)
        shallow.append(crossed[depth < 1])
    return {
        "entering": _mean(np.concatenate(everything)),
        "from a particle": _mean(np.concatenate(shallow)),
    }


def _mean(values: Any) -> tuple[float, float]:
    return float(values.mean()), float(values.std() / math.sqrt(len(values)))
