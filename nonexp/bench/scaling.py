"""How time and memory grow with samples, pixels, media, depth and optical thickness."""

from __future__ import annotations

import gc
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from ..system.files import replacing, write_text
from . import measure, report
from .scenes import Filling, ball, camera, lit
from .worker import Worker

__all__ = ["AXES", "Axis", "Line", "Sample", "run", "sentences", "write"]


@dataclass(frozen=True)
class Axis:
    """One quantity to vary; ``build`` makes the scene from a filling and its value.

    ``spp`` and ``max_depth`` are the same for all values, unless they are what varies.
    """

    name: str
    text: str
    values: tuple[float, ...]
    build: Callable[[Filling, float], Any]
    spp: int = 64
    max_depth: int = 64
    rr_depth: int = 5
    laws: tuple[str, ...] = ("exponential",)


@dataclass(frozen=True)
class Line:
    """One integrator along one axis; ``law`` is None for Mitsuba's own medium."""

    name: str
    plugin: str
    law: str | None


@dataclass(frozen=True)
class Sample:
    """Median seconds per image, and bytes that Dr.Jit allocated in addition to the scene."""

    axis: str
    line: str
    value: float
    seconds: float
    memory: int


def _sphere(size: int, sigma_t: float = 4.0, albedo: float = 0.99) -> Callable[..., Any]:
    def build(filling: Filling, value: float) -> Any:
        return _scene(filling, size, sigma_t, albedo)

    return build


def _scene(filling: Filling, size: int, sigma_t: float, albedo: float) -> Any:
    medium = filling.medium(sigma_t=sigma_t, albedo=albedo)
    view = camera((size, size), [0, 0.6, 4.5], 38)
    return mi.load_dict({"type": "scene", "camera": view, "ball": ball(medium), **lit()})


def _pixels(filling: Filling, value: float) -> Any:
    return _scene(filling, int(value), 4.0, 0.99)


def _thickness(filling: Filling, value: float) -> Any:
    return _scene(filling, 32, value / 2, 0.99)


def _media(filling: Filling, value: float) -> Any:
    """64 balls that share the given number of media."""
    media = {}
    for number in range(int(value)):
        medium = filling.medium(number, sigma_t=4.0 + number / 16, albedo=0.9)
        media[f"medium{number}"] = {**medium, "id": f"medium{number}"}
    balls = {}
    for number in range(64):
        centre = (0.3 * (number % 8 - 3.5), 0.3 * (number // 8 - 3.5), 0.0)
        reference = {"type": "ref", "id": f"medium{number % int(value)}"}
        balls[f"ball{number}"] = ball(reference, centre, 0.13)
    view = camera((48, 48), [0, 0, 4.5], 33)
    return mi.load_dict({"type": "scene", "camera": view, **media, **balls, **lit()})


AXES = (
    Axis("spp", "samples per pixel", tuple(4.0**i for i in range(7)), _sphere(32)),
    Axis("pixels", "pixels on a side", (64, 128, 256, 512, 1024, 2048), _pixels, spp=1),
    Axis(
        "media",
        "media in the scene",
        (1, 2, 4, 8, 16, 32, 64),
        _media,
        laws=("exponential", "mixed"),
    ),
    Axis(
        "depth",
        "longest path",
        (2, 4, 8, 16, 32, 64, 128),
        _sphere(32, 8.0, 1.0),
        rr_depth=1000,
    ),
    Axis(
        "thickness",
        "optical depth across the ball",
        (0.1, 1, 10, 100, 1000),
        _thickness,
        max_depth=512,
    ),
)


def lines(axis: Axis) -> list[Line]:
    """The integrators measured along an axis."""
    ours = [
        Line("nonexp" if law == "exponential" else f"nonexp, {law} laws", "nonexp_volpath", law)
        for law in axis.laws
    ]
    return [*ours, Line("volpath", "volpath", None)]


# --------------------------------------------------------------------- measuring


def run(
    axes: Sequence[Axis] = AXES,
    *,
    variant: str = "llvm_ad_rgb",
    seconds: float = 2.0,
    quick: bool = False,
    on_sample: Callable[[str], Any] = lambda text: None,
) -> list[Sample]:
    """Measure all lines, each in its own process; at least two images per value, and more
    until ``seconds`` are over. ``quick`` takes the lower half of the values.

    Raises ``RuntimeError`` if one fails.
    """
    samples = []
    for axis in axes:
        values = axis.values[: (len(axis.values) + 1) // 2] if quick else axis.values
        for line in lines(axis):
            with Worker(_serve, axis.name, line, values, variant, seconds) as worker:
                for value in values:
                    on_sample(f"{axis.text}: {line.name} at {value:g}")
                    samples.append(worker.receive())
    return samples


def _serve(
    pipe: Any, name: str, line: Line, values: Sequence[float], variant: str, seconds: float
) -> None:
    mi.set_variant(variant)
    mi.set_log_level(mi.LogLevel.Error)
    axis = next(axis for axis in AXES if axis.name == name)
    for value in values:
        pipe.send(_measure(axis, line, value, seconds))


def _measure(axis: Axis, line: Line, value: float, seconds: float) -> Sample:
    gc.collect()  # a scene that is still there changes the kernels of the next
    scene = axis.build(Filling(line.law), value)
    spp = int(value) if axis.name == "spp" else axis.spp
    depth = int(value) if axis.name == "depth" else axis.max_depth
    depths = {"max_depth": depth, "rr_depth": axis.rr_depth}
    integrator = mi.load_dict({"type": line.plugin, **depths})
    first = measure.render_timed(scene, integrator, 0, spp, look=True)
    times: list[float] = []
    while len(times) < 2 or (sum(times) < seconds and len(times) < 15):
        times.append(measure.render_timed(scene, integrator, len(times) + 1, spp).seconds)
    return Sample(axis.name, line.name, float(value), float(np.median(times)), first.memory)


# --------------------------------------------------------------------- telling


def sentences(samples: Sequence[Sample]) -> list[str]:
    """How time and memory grow along each axis, one sentence per line."""
    told = []
    for axis in AXES:
        for line in lines(axis):
            along = [s for s in samples if (s.axis, s.line) == (axis.name, line.name)]
            if len(along) < 2:
                continue
            first, last = along[0], along[-1]
            told.append(
                f"`{line.name}`, {axis.text} from {first.value:g} to {last.value:g}: time grows "
                f"{last.seconds / first.seconds:.3g}-fold, over the upper half as the power "
                f"{_exponent(along):.2f}; memory from {first.memory / 1e6:.2g} to "
                f"{last.memory / 1e6:.2g} MB."
            )
    return told


def _exponent(along: Sequence[Sample]) -> float:
    """Slope of log time over log value, over the upper half of the values."""
    upper = along[-max(2, (len(along) + 1) // 2) :]
    x = [math.log(sample.value) for sample in upper]
    return float(np.polyfit(x, [math.log(sample.seconds) for sample in upper], 1)[0])


def write(samples: Sequence[Sample], environment: dict[str, Any], folder: Path) -> list[Path]:
    """Write ``scaling.json``, ``scaling.md`` and, with matplotlib, ``scaling.png``."""
    folder.mkdir(parents=True, exist_ok=True)
    data = {"schema": 1, "environment": environment, "samples": [asdict(s) for s in samples]}
    text = "# How the cost grows\n\n" + "\n".join(f"* {line}" for line in sentences(samples)) + "\n"
    written = []
    for name, content in (("scaling.json", json.dumps(data, indent=1)), ("scaling.md", text)):
        written.append(write_text(folder / name, content))
    try:
        import matplotlib
        from matplotlib.figure import Figure
    except ImportError:
        return written
    shown = [axis for axis in AXES if any(sample.axis == axis.name for sample in samples)]
    with matplotlib.rc_context(report.STYLE):
        figure = Figure(figsize=(3.2 * len(shown), 5), layout="constrained")
        places = figure.subplots(2, len(shown), squeeze=False)
        for column, axis in enumerate(shown):
            for line in lines(axis):
                along = [s for s in samples if (s.axis, s.line) == (axis.name, line.name)]
                shade, marker = report.colour(line.name)
                style = {"color": shade, "marker": marker, "markersize": 4, "label": line.name}
                x = [sample.value for sample in along]
                places[0, column].plot(x, [sample.seconds for sample in along], **style)
                places[1, column].plot(x, [sample.memory / 1e6 for sample in along], **style)
            for place in places[:, column]:
                report.logarithmic(place)
            places[0, column].set(ylabel="seconds", title=axis.text)
            places[1, column].set(ylabel="MB", xlabel=axis.text)
            places[0, column].legend(fontsize=7)
        with replacing(folder / "scaling.png") as (aside,):
            figure.savefig(aside, format="png", dpi=110)
    return [*written, folder / "scaling.png"]
