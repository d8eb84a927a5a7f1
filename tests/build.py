"""Small scenes for the tests, as Mitsuba dictionaries."""

from __future__ import annotations

from typing import Any

import mitsuba as mi

import nonexp
from nonexp import models

MODELS: list[tuple[str, dict[str, Any]]]
"""Every model on each of its examples: (key, parameters)."""


def _models() -> list[tuple[str, dict[str, Any]]]:
    return [(key, dict(p)) for key in models.names() for p in models.registry[key].examples]


MODELS = _models()


def model_id(case: tuple[str, dict[str, Any]]) -> str:
    key, parameters = case
    return "-".join([key, *(f"{k}={_brief(v)}" for k, v in parameters.items())])


def _brief(value: Any) -> str:
    if isinstance(value, (int, float)):
        return f"{value:g}"
    if isinstance(value, str):
        return value.rpartition("/")[2]
    if isinstance(value, nonexp.Transmittance):
        return type(value).__name__
    parts = [_brief(item) for item in value]
    return ",".join(parts if len(parts) < 4 else [*parts[:3], f"..{len(parts)}"])


def medium(model: str = "exponential", parameters: dict[str, Any] | None = None, **kw: Any) -> Any:
    """``nonexp_homogeneous`` with one transmittance."""
    law = models.to_dict(models.create(model, **(parameters or {})))
    return {"type": "nonexp_homogeneous", "transmittance": law, **kw}


def stock(**kw: Any) -> Any:
    """Mitsuba's homogeneous medium."""
    return {"type": "homogeneous", **kw}


def look_at(origin: list[float], target: list[float]) -> Any:
    return mi.ScalarTransform4f().look_at(origin, target, [0, 1, 0])


def orthographic(width: float = 1.0, distance: float = 5.0) -> dict[str, Any]:
    """Parallel rays along -z over the square of half-width ``width``."""
    scale = mi.ScalarTransform4f().scale([width, width, 1])
    to_world = look_at([0, 0, distance], [0, 0, 0]) @ scale
    near = 0.01 * min(distance, 1)
    return {
        "type": "orthographic",
        "to_world": to_world,
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


FURNACE = {"type": "constant"}
"""Constant environment of radiance 1."""

NO_ROULETTE = {"type": "nonexp_volpath", "rr_depth": 1_000_000}
