"""The normal equations of a fit to images that are rendered with noise.

Every image and every derivative is rendered twice, with independent random numbers: the *halves*.
A product of two noisy things counts one half of each, so that its mean is the product of what they
are without noise:

    loss    sum w r1 r2                 r: fitted image - image
    gradient  sum w (J1 r2 + J2 r1) / 2   J: derivatives of the fitted image
    normal    sum w (J1 J2' + J2 J1') / 2

each divided by the sum of the weights w. The spread over the pixels says how well they are known.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from .derivatives import changed, numbers, replays, restored, tangent
from .unknowns import Unknown
from .views import Array, View

__all__ = ["Equations", "Fitted", "Images", "Jacobians"]

Jacobians = list[tuple[Array, Array]]
"""For each view two halves of the derivatives: unknowns x height x width x channels."""

_STEP = 0.1
"""How far a number moves for a difference, as a part of itself or of its range. Long, for little
noise: that derivatives are not quite right does not move the place where images agree."""

_MORE = 4
"""Samples of a difference, which is noisier, by those of a replay."""


@dataclass(frozen=True, eq=False)
class Fitted:
    """The rendered images at some coordinates, two halves for each view."""

    halves: tuple[tuple[Array, Array], ...]
    scales: Array
    """factor on the image of each view"""
    loss: float
    error: float
    """standard error of the loss, by the noise of the renders"""

    def mean(self, view: int) -> Array:
        """What is compared with the image of a view."""
        first, second = self.halves[view]
        return np.asarray(self.scales[view] * (first + second) / 2)


@dataclass(frozen=True, eq=False)
class Equations:
    """The normal equations at some coordinates."""

    normal: Array
    gradient: Array
    spread: Array
    """covariance of the gradient, by all that makes pixels differ from the fitted image"""
    noise: Array
    """covariance of the gradient, by the noise of the renders alone"""
    uncertainty: Callable[[Array], float]
    """standard error of ``v normal v``"""


class Images:
    """Renders what a fit compares with images, and its derivatives."""

    def __init__(
        self,
        scene: mi.Scene,
        views: Sequence[View],
        unknowns: Sequence[Unknown],
        write: Callable[[Array], None],
        exposed: bool,
    ) -> None:
        self.scene, self.views, self.unknowns = scene, views, list(unknowns)
        self._write, self._exposed = write, exposed
        self._weights = sum(view.count for view in views)
        self.ways: dict[str, str] = {}
        """unknown -> how its derivative is found: ``replay`` or ``differences``"""
        self._own = replays(scene)

    def _scales(self, at: Array) -> Array:
        if not self._exposed:
            return np.ones(len(self.views))
        return np.exp(at[len(self.unknowns) :])

    def at(self, at: Array, spp: int, seed: Callable[[], int]) -> Fitted:
        """The images and the loss at some coordinates."""
        self._write(at)
        scales = self._scales(at)
        halves, loss, squares = [], 0.0, 0.0
        for view, scale in zip(self.views, scales, strict=True):
            first, second = (view.mean(self._render(view), spp, seed()) for _ in range(2))
            halves.append((first, second))
            one, two = scale * first - view.image, scale * second - view.image
            loss += float(np.sum(view.weight * one * two))
            squares += float(view.spread(view.weight * (one**2 - two**2)[None])[0, 0]) / 4
        return Fitted(
            tuple(halves), scales, loss / self._weights, float(np.sqrt(squares)) / self._weights
        )

    def exposures(self, at: Array, spp: int, seed: Callable[[], int]) -> Array:
        """The factors with which the images at some coordinates fit best."""
        found = self.at(at, spp, seed)
        best = []
        for view, (one, two) in zip(self.views, found.halves, strict=True):
            product = float(np.sum(view.weight * one * two))
            best.append(float(np.sum(view.weight * view.image * (one + two) / 2)) / product)
        return np.array(best)

    def jacobians(self, at: Array, fitted: Fitted, spp: int, seed: Callable[[], int]) -> Jacobians:
        """Two halves of the derivatives of each view by the coordinates, those of ``fitted``."""
        self._write(at)
        return [
            (
                self._jacobian(at, number, fitted, 0, spp, seed),
                self._jacobian(at, number, fitted, 1, spp, seed),
            )
            for number in range(len(self.views))
        ]

    def equations(self, jacobians: Jacobians, fitted: Fitted) -> Equations:
        """The normal equations for the images of ``fitted``, with derivatives there or near."""
        count = len(jacobians[0][0])
        sums: dict[str, Any] = {
            "normal": np.zeros((count, count)),
            "gradient": np.zeros(count),
            "spread": np.zeros((count, count)),
            "noise": np.zeros((count, count)),
        }
        kept = []
        for number, view in enumerate(self.views):
            scale = fitted.scales[number]
            root = np.sqrt(view.weight)
            r1, r2 = (root * (scale * half - view.image) for half in fitted.halves[number])
            j1, j2 = (root * half for half in jacobians[number])
            product = np.einsum("ihwc,jhwc->ij", j1, j2)
            sums["normal"] += (product + product.T) / 2
            first, second = j1 * r2, j2 * r1
            sums["gradient"] += (first + second).sum(axis=(1, 2, 3)) / 2
            sums["spread"] += view.spread(first + second) / 4
            sums["noise"] += view.spread(first - second) / 4
            kept.append((view, j1, j2))

        def uncertainty(direction: Array) -> float:
            squares = 0.0
            for view, j1, j2 in kept:
                one, two = (np.tensordot(direction, j, 1) for j in (j1, j2))
                squares += float(view.spread((one**2 - two**2)[None])[0, 0]) / 4
            return float(np.sqrt(squares)) / self._weights

        return Equations(
            normal=sums["normal"] / self._weights,
            gradient=sums["gradient"] / self._weights,
            spread=sums["spread"] / self._weights**2,
            noise=sums["noise"] / self._weights**2,
            uncertainty=uncertainty,
        )

    # ------------------------------------------------------------------------ derivatives

    def _jacobian(
        self, at: Array, number: int, fitted: Fitted, half: int, spp: int, seed: Callable[[], int]
    ) -> Array:
        """One half of the derivatives of a view's image by the coordinates."""
        view, scale = self.views[number], fitted.scales[number]
        columns = [
            scale * unknown.slope(at[i]) * self._derivative(unknown, at[i], view, spp, seed())
            for i, unknown in enumerate(self.unknowns)
        ]
        if self._exposed:
            for other in range(len(self.views)):
                own = scale * fitted.halves[number][half]
                columns.append(own if other == number else np.zeros_like(own))
        return np.array(columns)

    def _derivative(self, one: Unknown, at: float, view: View, spp: int, seed: int) -> Array:
        """The derivative of an image by a number: by replay, or if that refuses by differences."""
        way = self.ways.get(one.label)
        if way is None and not self._own:
            way = "differences"
        if way != "differences":
            try:
                found = view.mean(self._tangent(view, one), spp, seed)
                self.ways[one.label] = "replay"
                return found
            except ValueError as error:
                if way is not None or "no derivative by" not in str(error):
                    raise
        self.ways[one.label] = "differences"
        return view.mean(self._difference(view, one, at), _MORE * spp, seed)

    def _render(self, view: View) -> Callable[[int, int], Any]:
        def once(spp: int, seed: int) -> Any:
            with dr.suspend_grad():
                return np.array(mi.render(self.scene, sensor=view.sensor, spp=spp, seed=seed))

        return once

    def _tangent(self, view: View, one: Unknown) -> Callable[[int, int], Any]:
        parameters = mi.traverse(self.scene)

        def once(spp: int, seed: int) -> Any:
            return tangent(
                self.scene, parameters, one.key, one.item, sensor=view.sensor, spp=spp, seed=seed
            )

        return once

    def _difference(self, view: View, one: Unknown, at: float) -> Callable[[int, int], Any]:
        parameters = mi.traverse(self.scene)
        here = one.value(at)
        step = _STEP * (here if one.logarithmic else one.unit)
        ends = max(here - step, one.low), min(here + step, one.high)

        def once(spp: int, seed: int) -> Any:
            images = []
            with restored(parameters, one.key) as base:
                for end in ends:
                    array = numbers(base)
                    array[one.item] = end
                    parameters[one.key] = changed(base, list(array))
                    parameters.update()
                    images.append(self._render(view)(spp, seed))
            return (images[1] - images[0]) / (ends[1] - ends[0])

        return once
