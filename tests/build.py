"""The models to test, and small scenes from :mod:`nonexp.testing`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi

import nonexp
from nonexp import models
from nonexp.testing.scenes import (
    DRAWN,
    FURNACE,
    LAMP,
    NO_ROULETTE,
    ball,
    beam,
    box,
    isotropic,
    look_at,
    medium,
    orthographic,
    perspective,
    scene,
    square_film,
    stock,
)

__all__ = [
    "DRAWN",
    "FURNACE",
    "LAMP",
    "MODELS",
    "NO_ROULETTE",
    "QUICK",
    "RENDERED",
    "SHUTTER",
    "Case",
    "ball",
    "beam",
    "box",
    "heavy_tailed",
    "law",
    "look_at",
    "medium",
    "model_id",
    "orthographic",
    "perspective",
    "recorder",
    "scene",
    "square_film",
    "stock",
]

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


def recorder(*measures: Callable[[Any], Any]) -> Any:
    """An isotropic phase function that counts collisions and sums ``measures`` of their positions.

    ``sums()`` has shape (1 + measures, batches): paths are in batches by the time at which they
    start, so that a sensor with ``**SHUTTER`` fills all alike. ``clear()`` sets them to zero.
    """
    batches = 64
    base: Any = isotropic()

    class Recorder(base):
        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.clear()

        def clear(self) -> None:
            self.array = dr.zeros(mi.Float64, (1 + len(measures)) * batches)

        def sums(self) -> Any:
            return self.array.numpy().reshape(1 + len(measures), batches)

        def met(self, mei: Any, active: Any) -> None:
            batch = dr.minimum(mi.UInt32(mei.time * batches), batches - 1)
            for i, value in enumerate([1.0, *(measure(mei.p) for measure in measures)]):
                value, index = mi.Float64(value), batch + i * batches
                dr.scatter_reduce(dr.ReduceOp.Add, self.array, value, index, active)

    mi.register_phase("recorder", Recorder)
    return mi.load_dict({"type": "recorder"})


SHUTTER = {"shutter_open": 0.0, "shutter_close": 1.0}
"""Of a sensor: rays start at any time in [0, 1]."""
