"""Derivatives of images beside those of Mitsuba's ``prbvolpath``: variance, time, efficiency."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..images.moments import Array
from ..rendering.passes import pass_seed
from ..system.files import write_text
from .measure import render_timed
from .scenes import Filling, ball, camera, lit
from .statistics import Estimate, bootstrapped
from .worker import Worker

__all__ = ["LIGHTS", "PARAMETERS", "Row", "Timing", "build", "measure", "run", "table", "write"]

PARAMETERS = ("sigma_t.value.value", "albedo.value.value", "phase_function.g")
"""Of the medium; one backward pass gives the derivatives of the image's mean by all of them."""

LIGHTS: dict[str, Callable[[], dict[str, Any]]] = {
    "white sky": lambda: {"sky": {"type": "constant"}},
    "lamp": lambda: {key: part for key, part in lit().items() if key != "sky"},
}

_LINES = (
    ("nonexp_volpath", "exponential"),
    ("prbvolpath", None),
    ("nonexp_volpath", "gamma"),
    ("nonexp_volpath", "quadratic"),
)
"""Integrators and laws; the second of each light is what the first is compared to."""


@dataclass(frozen=True)
class Timing:
    """Median seconds of a backward pass, and that over the median of a render of as many samples
    (the backward pass begins with one)."""

    seconds: float
    cost: Estimate


@dataclass(frozen=True)
class Row:
    """One derivative by one integrator; ``efficiency`` is 1/(variance * time) relative to
    ``prbvolpath``, where that renders the same."""

    light: str
    plugin: str
    law: str
    parameter: str
    value: float
    stderr: float
    timing: Timing
    efficiency: Estimate | None


@dataclass(frozen=True, eq=False)
class _Passes:
    """Of each pass the derivatives, and the seconds of it and of a render."""

    values: Array
    seconds: Array
    primal: Array


def run(
    *,
    variant: str = "llvm_ad_rgb",
    seed: int = 0,
    quick: bool = False,
    on_pass: Callable[[str], Any] = lambda text: None,
) -> list[Row]:
    """Measure all lines under both lights, each in its own process, one pass after the other.

    Raises ``WorkerError`` if one fails.
    """
    rounds, spp = (16, 16) if quick else (48, 64)
    rows = []
    for light in LIGHTS:
        workers = [Worker(_serve, light, plugin, law, spp, variant) for plugin, law in _LINES]
        done: list[list[Any]] = [[] for _ in workers]
        try:
            for worker in workers:
                worker.__enter__()
            for worker in workers:
                worker.receive()
            order = np.random.default_rng(seed)
            for number in range(rounds):
                on_pass(f"{light}: round {number + 1} of {rounds}")
                for i in order.permutation(len(workers)):
                    workers[i].send(pass_seed(seed + i, number))
                    done[i].append(workers[i].receive())
        finally:
            for worker in workers:
                worker.__exit__()
        rows += _rows(light, [_Passes(*map(np.array, zip(*d, strict=True))) for d in done], seed)
    return rows


def _serve(pipe: Any, light: str, plugin: str, law: str | None, spp: int, variant: str) -> None:
    mi.set_variant(variant)
    mi.set_log_level(mi.LogLevel.Error)
    scene = build(light, plugin, law)
    measure(scene, 1, spp)
    pipe.send(None)
    while True:
        pipe.send(measure(scene, pipe.recv(), spp))


def build(light: str, plugin: str, law: str | None, size: int = 64) -> mi.Scene:
    """An index-matched ball under a light; a law of None is Mitsuba's own medium."""
    phase = {"type": "hg", "g": 0.3}
    medium = Filling(law).medium(sigma_t=2.0, albedo=0.8) | {"phase": phase}
    view = camera((size, size), [0, 0.6, 4.5], 38)
    integrator = {"type": plugin, "max_depth": 64, "rr_depth": 64}
    parts = {"integrator": integrator, "camera": view, "ball": ball(medium), **LIGHTS[light]()}
    return mi.load_dict({"type": "scene", **parts})


def measure(scene: mi.Scene, seed: int, spp: int) -> tuple[list[float], float, float]:
    """Derivatives of the image's mean; the seconds of that, and of a render."""
    parameters = mi.traverse(scene)
    names = [f"ball.interior_medium.{name}" for name in PARAMETERS]
    integrator = scene.integrator()
    primal = render_timed(scene, integrator, seed + 1, spp)

    values = []
    for name in names:
        value = type(parameters[name])(dr.detach(parameters[name]))
        dr.enable_grad(value)
        parameters[name] = value
        values.append(value)
    parameters.update()
    share = dr.full(mi.TensorXf, 1 / primal.image.size, primal.image.shape)
    dr.eval(share)
    dr.sync_thread()
    started = time.perf_counter()
    integrator.render_backward(scene, parameters, share, seed=seed, spp=spp)
    gradients = [dr.grad(value) for value in values]
    dr.eval(gradients)
    dr.sync_thread()
    seconds = time.perf_counter() - started
    found = [float(np.sum(np.array(gradient))) for gradient in gradients]
    for name, value in zip(names, values, strict=True):
        parameters[name] = type(value)(dr.detach(value))
    parameters.update()
    return found, seconds, primal.seconds


def _rows(light: str, done: Sequence[_Passes], seed: int) -> list[Row]:
    rows = []
    for (plugin, law), passes in zip(_LINES, done, strict=True):
        cost = bootstrapped(
            (passes.seconds, passes.primal),
            lambda a, b, axis=-1: np.median(a, axis) / np.median(b, axis),
            seed,
        )
        timing = Timing(float(np.median(passes.seconds)), cost)
        for k, name in enumerate(PARAMETERS):
            own = passes.values[:, k]
            efficiency = None
            if (plugin, law) == _LINES[0]:
                theirs = done[1]
                efficiency = bootstrapped(
                    (own, passes.seconds, theirs.values[:, k], theirs.seconds), _relative, seed
                )
            stderr = float(own.std(ddof=1) / np.sqrt(len(own)))
            label = law or "exponential"
            mean = float(own.mean())
            rows.append(Row(light, plugin, label, name, mean, stderr, timing, efficiency))
    return rows


def _relative(own: Array, seconds: Array, theirs: Array, their: Array, axis: int = -1) -> Array:
    variance = theirs.var(axis, ddof=1) / own.var(axis, ddof=1)
    ratio: Array = variance * np.median(their, axis) / np.median(seconds, axis)
    return ratio


# --------------------------------------------------------------------- telling


def table(rows: Sequence[Row]) -> list[str]:
    """The rows, as a table in Markdown."""
    lines = [
        "| light | integrator | law | by | derivative | ms | backward / render | efficiency |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        cells = (
            row.light,
            row.plugin,
            row.law,
            row.parameter.removesuffix(".value.value"),
            f"{row.value:.5f} ± {row.stderr:.5f}",
            f"{1e3 * row.timing.seconds:.0f}",
            _shown(row.timing.cost),
            _shown(row.efficiency) if row.efficiency else "",
        )
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def _shown(estimate: Estimate) -> str:
    return f"{estimate.value:.2f} ({estimate.low:.2f} to {estimate.high:.2f})"


def write(rows: Sequence[Row], environment: dict[str, Any], folder: Path) -> list[Path]:
    """Write ``gradients.json`` and ``gradients.md``."""
    folder.mkdir(parents=True, exist_ok=True)
    data = {"schema": 1, "environment": environment, "rows": [asdict(row) for row in rows]}
    text = "\n".join(["# Derivatives of images", "", *table(rows)]) + "\n"
    return [
        write_text(folder / "gradients.json", json.dumps(data, indent=1)),
        write_text(folder / "gradients.md", text),
    ]
