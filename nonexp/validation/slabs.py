"""Light reflected and transmitted by slabs, path by path.

A slab lies between two lamps, red above and green below, so wide that no light leaves at its
sides. Paths enter from above; by reciprocity red is the share of the incident light that is
reflected, green that which is transmitted.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..testing.scenes import box, scene
from .study import Effort, Row, estimate, numbers, row

__all__ = ["Light", "compared", "incident", "paths", "shares", "slab"]

_TOGETHER = 2**12
"""Paths of a sequence: their means are the independent samples that errors are computed from."""

Light = Callable[[Any], Any]
"""Directions of the incident paths, from a sampler."""


def slab(
    medium: dict[str, Any],
    thickness: float,
    index: float = 1.0,
    *,
    width: float | None = None,
    **options: Any,
) -> Any:
    """A slab of that thickness between the lamps; of another refractive index than 1 with smooth
    faces. ``options`` are the integrator's."""
    place, half = mi.ScalarTransform4f(), thickness / 2
    width = 200 * max(thickness, 1.0) if width is None else width
    gap = 0.2 * half

    def lamp(z: float, turn: float, colour: list[float]) -> dict[str, Any]:
        to_world = place.translate([0, 0, z]).rotate([1, 0, 0], turn).scale(20 * width)
        emitter = {"type": "area", "radiance": {"type": "rgb", "value": colour}}
        return {"type": "rectangle", "to_world": to_world, "emitter": emitter}

    body = box({**medium, "sample_emitters": False}, [-width, -width, -half], [width, width, half])
    if index != 1:
        body["bsdf"] = {"type": "dielectric", "int_ior": index, "ext_ior": 1.0}
    integrator = {"type": "nonexp_volpath", "rr_depth": 1_000_000, "refractive_nee": "off"}
    return scene(
        {**integrator, **options},
        slab=body,
        above=lamp(half + 2 * gap, 180, [1, 0, 0]),
        below=lamp(-half - 2 * gap, 0, [0, 1, 0]),
    )


def incident(mu: float | None) -> Light:
    """Directions of Lambertian light (None), or of a beam with the cosine ``mu``."""

    def lambertian(sampler: Any) -> Any:
        return -mi.warp.square_to_cosine_hemisphere(sampler.next_2d())

    def beam(sampler: Any) -> Any:
        sampler.next_2d()
        assert mu is not None
        return mi.Vector3f(math.sqrt(1 - mu**2), 0, -mu)

    return lambertian if mu is None else beam


def paths(
    built: Any, thickness: float, light: Light, seed: int, count: int, together: int = 1
) -> Any:
    """What each of ``count`` paths reflects and transmits: shape (2, count).

    ``together`` paths in a row share the points of one scrambled sequence; 1: all are independent.
    A ray's time is the number of its path.
    """
    kind = {"type": "nonexp_sobol", "sample_count": together}
    sampler = mi.load_dict(kind if together > 1 else {"type": "independent"})
    sampler.seed(seed, count)
    d = light(sampler)
    number = mi.Float(dr.arange(mi.UInt32, count))
    ray = mi.RayDifferential3f(mi.Point3f(0, 0, 0.6 * thickness), mi.Vector3f(d), number)
    found, _, _ = built.integrator().sample(built, sampler, ray, None, True)
    return np.array(found, dtype=float)[:2]


def shares(
    case: str,
    medium: dict[str, Any],
    thickness: float,
    mu: float | None,
    effort: Effort,
    index: float = 1.0,
) -> dict[str, tuple[float, float]]:
    """Means and standard errors of what is ``reflected`` and ``transmitted`` of a beam with the
    cosine ``mu``, or of Lambertian light (None)."""
    built, light = slab(medium, thickness, index), incident(mu)

    def run(seed: int) -> dict[str, Any]:
        found = paths(built, thickness, light, seed, effort.count, _TOGETHER)
        means = found.reshape(2, -1, _TOGETHER).mean(axis=2)
        return dict(zip(("reflected", "transmitted"), means, strict=True))

    return estimate(case, run, effort)


def compared(
    package: str | None, effort: Effort, lights: Mapping[str, float | None], quick: str
) -> Iterator[Row]:
    """The rows of a study of exponential slabs, whose quantities are named by their parameters, as
    in ``albedo=0.9 thickness=3 g=0 normal reflected``. A quick one has those whose name begins with
    ``quick``; a slab of more than 400 mean free paths is a half-space."""
    held = numbers(package)
    for case in dict.fromkeys(re.sub(r" \w+$", "", name) for name in held):
        if effort.quick and not case.startswith(quick):
            continue
        *pairs, light = case.split()
        given = {name: float(value) for name, value in (pair.split("=") for pair in pairs)}
        phase = {"type": "hg", "g": given["g"]}
        medium = {"type": "nonexp_homogeneous", "albedo": given["albedo"], "phase": phase}
        thickness, index = min(given["thickness"], 400.0), given.get("index", 1.0)
        found = shares(case, medium, thickness, lights[light], effort, index)
        for name, (mean, error) in found.items():
            if f"{case} {name}" in held:
                yield row(package, held[f"{case} {name}"], mean, error)
