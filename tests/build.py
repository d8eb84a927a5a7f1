"""Small scenes for the tests, as Mitsuba dictionaries."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi

import nonexp
from nonexp import models

Case = tuple[str, dict[str, Any]]
"""A model to test: key, parameters."""


def law(case: Case) -> Any:
    key, parameters = case
    return models.create(key, **parameters)


def _examples() -> list[Case]:
    return [(key, dict(p)) for key in models.names() for p in models.registry[key].examples]


def _one_of_each_kind(cases: list[Case]) -> list[Case]:
    """Of each model the first example, the first of another mean extinction than 1 (where forgotten
    factors show), and the first that lets light through for ever."""
    chosen: dict[Any, Case] = {}
    for case in cases:
        model = law(case)
        kind = "clear" if model.ff(dr.inf) > 0 else float(model.sigma_bar) == 1
        chosen.setdefault((case[0], kind), case)
    return list(chosen.values())


def heavy_tailed(model: nonexp.Transmittance) -> bool:
    """The fourth moment of flights is infinite, as far as one can tell."""
    scale = 1e6 / (float(model.sigma_bar) or 1.0)
    return 1e24 * float(model.fp(scale)) * scale > 1e-3


MODELS = _examples()
"""Every model on each of its examples."""

RENDERED = _one_of_each_kind(MODELS)
"""Those that are rendered without --full: each model, and each kind of law that it can be."""


QUICK = list({case[0]: case for case in RENDERED}.values())
"""Those that are rendered with --quick: one of each model, and of each the last kind."""


def model_id(case: Case) -> str:
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


def recorder(*measures: Callable[[Any], Any]) -> Any:
    """An isotropic phase function that counts collisions and sums ``measures`` of their positions.

    ``sums()`` has shape (1 + measures, batches): paths are in batches by the time at which they
    start, so that a sensor with ``**SHUTTER`` fills all alike. ``clear()`` sets them to zero.
    """
    batches = 64

    class Recorder(mi.PhaseFunction):
        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.m_flags = mi.PhaseFunctionFlags.Isotropic
            self.clear()

        def clear(self) -> None:
            self.array = dr.zeros(mi.Float64, (1 + len(measures)) * batches)

        def sums(self) -> Any:
            return self.array.numpy().reshape(1 + len(measures), batches)

        def sample(self, _context: Any, mei: Any, _u: Any, u: Any, active: Any = True) -> Any:
            batch = dr.minimum(mi.UInt32(mei.time * batches), batches - 1)
            for i, value in enumerate([1.0, *(measure(mei.p) for measure in measures)]):
                value, index = mi.Float64(value), batch + i * batches
                dr.scatter_reduce(dr.ReduceOp.Add, self.array, value, index, active)
            wo = mi.warp.square_to_uniform_sphere(u)
            return wo, mi.Spectrum(1), mi.warp.square_to_uniform_sphere_pdf(wo)

        def eval_pdf(self, _context: Any, _mei: Any, wo: Any, _active: Any = True) -> Any:
            pdf = mi.warp.square_to_uniform_sphere_pdf(wo)
            return mi.Spectrum(pdf), pdf

    mi.register_phase("recorder", Recorder)
    return mi.load_dict({"type": "recorder"})


SHUTTER = {"shutter_open": 0.0, "shutter_close": 1.0}
"""Of a sensor: rays start at any time in [0, 1]."""

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
