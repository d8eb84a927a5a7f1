"""Grids, textures and other parameters of many numbers from images, by gradient descent."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..rendering.passes import pass_seed, whole
from ..rendering.progress import row
from .derivatives import replays, restored
from .unknowns import Bounds, allowed, find, listed
from .views import Array, View, views

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Descent", "descend"]

_END = 0.1
"""What is left of the rate at the end."""


@dataclass(frozen=True, eq=False, repr=False)
class Descent:
    """Parameters of a scene after a gradient descent."""

    values: dict[str, Array]
    """the parameters, by their names in the scene, in their own shapes"""
    losses: Array
    """loss of each iteration: weighted mean of (rendered - image)^2, without the noise of the
    render; it scatters, by the few samples that an iteration takes"""
    targets: tuple[Array, ...]
    """the images"""

    def apply(self, scene: mi.Scene) -> None:
        """Give a scene these parameters."""
        parameters = mi.traverse(scene)
        for key, value in self.values.items():
            parameters[key] = type(parameters[key])(value.astype(np.float32))
        parameters.update()

    def __repr__(self) -> str:
        shapes = ", ".join(f"{key} {np.shape(value)}" for key, value in self.values.items())
        return f"Descent({shapes}: {len(self.losses)} iterations, loss {self.losses[-1]:.3g})"

    def plot(self) -> Figure:
        """The loss over the iterations. Raises ``ImportError`` where matplotlib is missing."""
        from .plot import plot_losses

        return plot_losses(self.losses)


def descend(
    scene: mi.Scene,
    parameters: str | Sequence[str] | Mapping[str, Any],
    images: Any,
    *,
    bounds: Mapping[str, Bounds] | None = None,
    sensors: Sequence[Any] | None = None,
    weights: Any = None,
    iterations: int = 100,
    rate: float = 0.1,
    spp: int = 16,
    seed: int = 0,
    progress: bool = False,
) -> Descent:
    """Fit parameters of many numbers to images, such as the density of a grid, by gradient descent.

    As :func:`fit`, but by first derivatives alone, so that the cost does not depend on how many
    numbers a parameter has, and without standard errors. ``mi.ad.Adam`` steps down the gradient of
    the loss; then the numbers are clamped to their bounds. ``rate`` is about how far they move in
    one step, as a part of the parameter's mean at the start; it falls to a tenth of that over the
    ``iterations``. Each renders all views with ``spp`` samples
    per pixel, once for the images and once for the gradient, whose noise is independent. Where to
    start, in a mapping, is a number or an array. Afterwards the scene is what it was.

    Raises ``KeyError`` for parameters that the scene does not have, ``ValueError`` for arguments
    that are not allowed, images that do not fit the sensors, and parameters by which there is no
    derivative.
    """
    iterations, spp = whole("iterations", iterations, 1), whole("spp", spp, 2)
    if not 0 < rate < math.inf:
        raise ValueError(f"rate is {rate}: it must be a finite number > 0")
    if not replays(scene, backward=True):
        raise ValueError(
            f"the integrator is {type(scene.integrator()).__name__}: descend needs nonexp_volpath, "
            "or one of Mitsuba's that replay paths"
        )
    seen = views(scene, images, sensors, weights)
    traversed = mi.traverse(scene)
    given = parameters if isinstance(parameters, Mapping) else dict.fromkeys(listed(parameters))
    starts, limits, rates = {}, {}, {}
    for name, start in given.items():
        key, item = find(traversed, name)
        if item is not None:
            raise ValueError(f"{name} is a single number: descend takes whole parameters")
        starts[key] = _start(traversed[key], start)
        limits[key] = (bounds or {}).get(name) or allowed(traversed, key)
        rates[key] = rate * (float(np.abs(np.array(starts[key])).mean()) or 1.0)

    losses: list[float] = []
    with contextlib.ExitStack() as stack:
        for key in starts:
            stack.enter_context(restored(traversed, key))
        update = stack.enter_context(row("descend")) if progress else None
        optimizer = mi.ad.Adam(lr=1.0)
        for key, value in starts.items():
            optimizer[key] = value
        for number in range(iterations):
            left = _END ** (number / max(iterations - 1, 1))
            optimizer.set_learning_rate({key: left * own for key, own in rates.items()})
            traversed.update(optimizer)
            total = sum(view.count for view in seen)
            parts = [
                _backward(
                    scene, traversed, view, total, spp, pass_seed(seed, number * len(seen) + i)
                )
                for i, view in enumerate(seen)
            ]
            losses.append(sum(parts))
            optimizer.step()
            for key, (low, high) in limits.items():
                optimizer[key] = dr.clip(dr.detach(optimizer[key]), low, high)
            if update is not None:
                update((number + 1) / iterations, f"iteration {number + 1}, loss {losses[-1]:.3g}")
        values = {key: np.array(dr.detach(optimizer[key])) for key in starts}
    return Descent(values, np.array(losses), tuple(view.image for view in seen))


def _backward(
    scene: mi.Scene, parameters: Any, view: View, total: float, spp: int, seed: int
) -> float:
    """Add the gradient of a view's part of the loss to that of the parameters; returns the part."""
    halves = []
    for number in range(2):
        with dr.suspend_grad():
            image = mi.render(
                scene, sensor=view.sensor, spp=(spp + 1) // 2, seed=pass_seed(seed, number)
            )
        halves.append(np.array(image, dtype=np.float64))
    one, two = (view.colours(half) - view.image for half in halves)
    adjoint = np.zeros_like(halves[0], dtype=np.float32)
    adjoint[..., : view.image.shape[2]] = view.weight * (one + two) / total
    scene.integrator().render_backward(
        scene, parameters, mi.TensorXf(adjoint), view.sensor, pass_seed(seed, 2), spp
    )
    return float(np.sum(view.weight * one * two)) / total


def _start(value: Any, start: Any) -> Any:
    """A parameter of the same shape, from a number or an array."""
    if not dr.is_array_v(value) or not dr.is_float_v(value):
        raise ValueError(f"{value} cannot be fitted: only real numbers can")
    kind = type(value)
    if start is None:
        return kind(dr.detach(value))
    shape = np.shape(np.array(value))
    array = np.asarray(start, dtype=np.float32)
    if array.size not in (1, math.prod(shape)):
        raise ValueError(f"start has the shape {array.shape}: it must be one number, or {shape}")
    return kind(np.broadcast_to(array.reshape(shape) if array.size > 1 else array, shape).copy())
