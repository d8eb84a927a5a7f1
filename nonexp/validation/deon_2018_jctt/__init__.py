"""Collisions around a particle that sends out light, in an infinite medium.

E. d'Eon, *A reciprocal formulation of nonexponential radiative transfer*, Journal of Computational
and Theoretical Transport, 2018: where flights from a particle are the sum of two exponential steps
(``erlang``, k = 2), transport is diffusive. Around an isotropic source that is a particle, with
albedo c, the density of collisions is exp(-r sqrt(1-c)) / (4 pi r), r in units of 1/rate: between
two radii it is the integral of r exp(-r sqrt(1-c)). The formula came to us without its number.

The source is the first collision of a path of ``nonexp_volpath``; the following ones are counted,
each weighted by the power of c that has come so far.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from typing import Any

import numpy as np

from ... import models
from ..study import Effort, Row, estimate, numbers, row
from ..walks import collisions

TITLE = "collisions around a particle in an infinite medium, erlang k = 2"
SOURCE = "d'Eon 2018"

STEPS = {0.5: 32, 0.9: 160}
"""Collisions of a path that count: c^STEPS is below 1e-7."""


def exact(albedo: float, inner: float, outer: float) -> float:
    """Collisions between two radii, per particle of the source."""
    s = math.sqrt(1 - albedo)

    def beyond(r: float) -> float:
        return (r / s + 1 / s**2) * math.exp(-s * r) if r < math.inf else 0.0

    return beyond(inner) - beyond(outer)


def measure(effort: Effort) -> Iterator[Row]:
    """Mean numbers of collisions in shells."""
    held = numbers(__package__)
    law = models.to_dict(models.create("erlang", k=2, rate=1.0))
    medium = {"type": "nonexp_homogeneous", "sigma_t": 1.0, "transmittance": law}
    for albedo, steps in STEPS.items():
        shells = {}
        for name in held:
            given = re.fullmatch(r"albedo=(\S+) radius (\S+) to (\S+)", name)
            if given is not None and float(given[1]) == albedo:
                shells[name] = float(given[2]), float(given[3])

        def run(
            seed: int,
            shells: dict[str, tuple[float, float]] = shells,
            albedo: float = albedo,
            steps: int = steps,
        ) -> dict[str, Any]:
            place = collisions(medium, max(2**8, effort.count // 2**3), steps + 1, seed)
            r = np.linalg.norm(place[:, 1:] - place[:, :1], axis=2)
            weight = albedo ** np.arange(steps)
            return {
                name: ((r >= low) & (r < high)) @ weight for name, (low, high) in shells.items()
            }

        for name, (mean, error) in estimate(f"point source {albedo}", run, effort).items():
            yield row(__package__, held[name], mean, error)
