"""Small scenes to test media in, as Mitsuba dictionaries."""

from __future__ import annotations

from typing import Any

import mitsuba as mi

from .. import models

__all__ = [
    "DRAWN",
    "FURNACE",
    "LAMP",
    "NO_ROULETTE",
    "ball",
    "beam",
    "box",
    "isotropic",
    "look_at",
    "medium",
    "orthographic",
    "perspective",
    "scene",
    "square_film",
    "stock",
]


def medium(model: str = "exponential", parameters: dict[str, Any] | None = None, **kw: Any) -> Any:
    """``nonexp_homogeneous`` with one transmittance."""
    law = models.to_dict(models.create(model, **(parameters or {})))
    return {"type": "nonexp_homogeneous", "transmittance": law, **kw}


def stock(**kw: Any) -> Any:
    """Mitsuba's homogeneous medium."""
    return {"type": "homogeneous", **kw}


def look_at(origin: list[float], target: list[float]) -> Any:
    return mi.ScalarTransform4f().look_at(origin, target, [0, 1, 0])


def orthographic(
    width: float = 1.0, distance: float = 5.0, side: tuple[float, float, float] = (0, 0, 1)
) -> dict[str, Any]:
    """Parallel rays from one side over the square of half-width ``width`` around the origin."""
    to_world = look_at([distance * x for x in side], [0, 0, 0])
    near = 0.01 * min(distance, 1)
    return {
        "type": "orthographic",
        "to_world": to_world @ mi.ScalarTransform4f().scale([width, width, 1]),
        "near_clip": near,
        "film": square_film(),
    }


def beam(distance: float = 5.0) -> dict[str, Any]:
    """One ray along -z through the origin, to all intents."""
    return orthographic(1e-4, distance)


def perspective(origin: list[float], target: list[float], fov: float = 45) -> dict[str, Any]:
    return {
        "type": "perspective",
        "fov": fov,
        "to_world": look_at(origin, target),
        "film": square_film(),
    }


def square_film(size: int = 8) -> dict[str, Any]:
    return {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}}


def scene(integrator: str | dict[str, Any] = "nonexp_volpath", **parts: Any) -> Any:
    if isinstance(integrator, str):
        integrator = {"type": integrator}
    return mi.load_dict({"type": "scene", "integrator": integrator, **parts})


def ball(inside: Any, bsdf: str | dict[str, Any] = "null", radius: float = 1.0) -> dict[str, Any]:
    """A sphere at the origin, filled with a medium."""
    bsdf = {"type": bsdf} if isinstance(bsdf, str) else bsdf
    return {"type": "sphere", "radius": radius, "bsdf": bsdf, "interior": inside}


def box(inside: Any, low: list[float], high: list[float]) -> dict[str, Any]:
    """An index-matched cuboid between two corners, filled with a medium."""
    half = [(b - a) / 2 for a, b in zip(low, high, strict=True)]
    middle = [(b + a) / 2 for a, b in zip(low, high, strict=True)]
    to_world = mi.ScalarTransform4f().translate(middle).scale(half)
    return {"type": "cube", "to_world": to_world, "bsdf": {"type": "null"}, "interior": inside}


LAMP = {
    "type": "sphere",
    "center": [0, 3, 0],
    "radius": 0.5,
    "emitter": {"type": "area", "radiance": 4.0},
}
"""A ball of light above the origin."""

FURNACE = {"type": "constant"}
"""Constant environment of radiance 1."""

NO_ROULETTE = {"type": "nonexp_volpath", "rr_depth": 1_000_000}

DRAWN = {"type": "nonexp_volpath", "expected_emission": "off"}
"""Flights collide or do not, as drawn, and nothing is counted by its expected value."""


def isotropic() -> Any:
    """A class of isotropic phase functions, whose ``met(mei, active)`` is told of each collision.

    It belongs to the variant that is set, so that it is made anew in each call.
    """

    class Isotropic(mi.PhaseFunction):
        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.m_flags = mi.PhaseFunctionFlags.Isotropic

        def met(self, mei: Any, active: Any) -> None:
            """A collision."""

        def sample(self, _context: Any, mei: Any, _u: Any, u: Any, active: Any = True) -> Any:
            self.met(mei, active)
            wo = mi.warp.square_to_uniform_sphere(u)
            return wo, mi.Spectrum(1), mi.warp.square_to_uniform_sphere_pdf(wo)

        def eval_pdf(self, _context: Any, _mei: Any, wo: Any, _active: Any = True) -> Any:
            pdf = mi.warp.square_to_uniform_sphere_pdf(wo)
            return mi.Spectrum(pdf), pdf

    return Isotropic
