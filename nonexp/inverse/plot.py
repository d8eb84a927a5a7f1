"""Figures of fits to images, with matplotlib (the extra ``plot``)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..fitting.plot import STYLE, require
from ..images.png import tone_map
from .result import ImageFit
from .views import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["plot_losses", "plot_report"]

_COLOURS = ("#D55E00", "#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
_MOST = 4
"""Laws that are drawn: the best ones."""


def plot_report(laws: Sequence[ImageFit], target: Array, view: int = 0) -> Figure:
    """The image of a view, what each law makes of it, the best one first, and the searches.

    Raises ``ImportError`` where matplotlib is missing.
    """
    require()
    import matplotlib
    from matplotlib.figure import Figure

    fits = laws[:_MOST]
    differences = [one.images[view] - target for one in fits]
    scale = 3 * min(float(np.sqrt(np.mean(d**2))) for d in differences) or 1.0
    parts: Any
    with matplotlib.rc_context(STYLE | {"axes.grid": False}):
        figure = Figure(figsize=(2.4 * (len(fits) + 1), 6.6), layout="constrained")
        parts = figure.subfigures(2, 1, height_ratios=(2, 1))
        upper, lower = parts
        axes = upper.subplots(2, len(fits) + 1, squeeze=False)
        _picture(axes[0, 0], target, "image")
        axes[1, 0].axis("off")
        for i, (one, difference) in enumerate(zip(fits, differences, strict=True), 1):
            _picture(axes[0, i], one.images[view], one.law)
            shown = axes[1, i].imshow(difference.mean(axis=2), "RdBu_r", vmin=-scale, vmax=scale)
            axes[1, i].set(xticks=[], yticks=[])
        axes[1, 1].set_ylabel("fitted - image")
        upper.colorbar(shown, ax=list(axes[1]), location="left", shrink=0.8)
        left, right = lower.subplots(1, 2)
        _losses(left, fits)
        _values(right, fits[0])
    return figure


def plot_losses(losses: Array) -> Figure:
    """The losses of a gradient descent. Raises ``ImportError`` where matplotlib is missing."""
    require()
    import matplotlib
    from matplotlib.figure import Figure

    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(4.8, 3), layout="constrained")
        axes = figure.subplots()
        axes.plot(np.arange(1, len(losses) + 1), losses, color=_COLOURS[1], linewidth=1.2)
        axes.set(yscale="log", xlabel="iteration", ylabel="loss")
    return figure


def _picture(axes: Axes, image: Array, title: str) -> None:
    colours = image if image.shape[2] == 3 else np.repeat(image, 3, axis=2)
    axes.imshow(tone_map(np.maximum(colours, 0)))
    axes.set(title=title, xticks=[], yticks=[])


def _losses(axes: Axes, fits: Sequence[ImageFit]) -> None:
    for i, one in enumerate(fits):
        steps = range(len(one.steps))
        loss = np.array([step.loss for step in one.steps])
        error = np.array([step.error for step in one.steps])
        style: dict[str, Any] = {"color": _COLOURS[i], "label": one.law, "marker": "o", "ms": 3}
        axes.errorbar(steps, np.maximum(loss, error / 10), error, lw=1.2, elinewidth=0.8, **style)
    axes.set(yscale="log", xlabel="step", ylabel="loss")
    axes.legend()


def _values(axes: Axes, best: ImageFit) -> None:
    """The numbers of the best law on their way, as parts of their last values."""
    for i, one in enumerate(best.unknowns):
        path = np.array([one.value(float(step.at[i])) for step in best.steps])
        label = f"{one.label} = {best.values[one.label]:.4g}"
        style: dict[str, Any] = {"color": _COLOURS[i % len(_COLOURS)], "marker": "o", "ms": 3}
        axes.plot(path / path[-1] if path[-1] else path, label=label, lw=1.2, **style)
    axes.axhline(1, color="#666666", linewidth=0.8)
    positive = all(one.logarithmic for one in best.unknowns)
    axes.set(xlabel="step", ylabel=f"{best.law}: by the last value")
    if positive:
        axes.set_yscale("log")
    axes.legend()
