"""Gauss-Newton steps, damped where they do not help (Levenberg-Marquardt), on noisy equations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from .equations import Equations, Fitted, Images, Jacobians
from .unknowns import Bounds
from .views import Array

Mask = npt.NDArray[np.bool_]

__all__ = ["Solution", "Step", "search"]

_FAR = 1.5
"""How far a coordinate may move in one step: 1 is a factor e, or the whole range."""

_CALM = 4.0
"""Mean square of a step in units of its own noise up to which it counts as noise."""

_SMALL = 1e-3
"""Step of a coordinate that counts as none."""

_SURE = 3.0
"""Standard errors by which the images must depend on a combination of unknowns."""

_ROUNDING = 1e-6
"""Part of the other combinations' influence below which one's influence is rounding."""


@dataclass(frozen=True)
class Step:
    """Where a search was."""

    at: Array
    spp: int
    loss: float
    error: float
    """its standard error"""


@dataclass(eq=False)
class Solution:
    """Where a search ended."""

    at: Array
    fitted: Fitted
    covariance: Array
    """of the coordinates; 0 for those at a limit"""
    limits: Mask
    """which coordinates sit at a limit of their range"""
    blind: list[Array]
    """directions, of unit length, on which the images do not depend as far as one can tell"""
    converged: bool
    steps: list[Step] = field(default_factory=list)
    last: Array = field(default_factory=lambda: np.zeros(0))
    """the last step of an unfinished search"""


@dataclass(frozen=True, eq=False)
class _Inverse:
    """The normal equations solved, in the directions that the images determine."""

    directions: Array
    """columns, scaled so that ``v normal v`` is ``values``"""
    values: Array
    blind: list[Array]

    def step(self, gradient: Array, damping: float) -> Array:
        along = self.directions.T @ gradient / (self.values + damping)
        return np.asarray(-self.directions @ along)

    def covariance(self, spread: Array) -> Array:
        inverse = self.directions / self.values @ self.directions.T
        return np.asarray(inverse @ spread @ inverse)


def search(
    images: Images,
    start: Array,
    limits: Sequence[Bounds],
    *,
    spp: int,
    first_spp: int,
    most: int,
    seed: Callable[[], int],
    told: Callable[[Step], None],
) -> Solution:
    """Go from ``start`` to the coordinates of least loss, within their limits.

    Images begin with ``first_spp`` samples per pixel; the number doubles with each step, and
    quadruples where steps are noise, up to a quarter of ``spp``. Derivatives take a quarter of
    that again, because their noise counts only as far as images do not fit. A step that makes the
    loss greater, by more than its noise, is taken back and damped. Where steps are noise in the
    end there is one more, with the last derivatives and images of ``spp`` samples. Before that,
    derivatives that do not determine all unknowns are rendered again, with up to ``spp`` samples.
    """
    low, high = np.array(limits, dtype=float).reshape(-1, 2).T
    first_spp = min(first_spp, spp)
    end = max(spp // 4, first_spp)

    def derivatives(at: Array, fitted: Fitted, factor: int = 1) -> Jacobians:
        count = min(factor * max(now // 4, first_spp), spp)
        return images.jacobians(at, fitted, count, seed)

    at, now, damping, refused, factor = start, first_spp, 0.01, 0, 1
    fitted = images.at(at, now, seed)
    jacobians = derivatives(at, fitted)
    steps = [_told(Step(at, now, fitted.loss, fitted.error), told)]
    while True:
        found = images.equations(jacobians, fitted)
        inverse = _inverse(found, ~_held(at, low, high, found.gradient))
        full = inverse.step(found.gradient, 0.0)
        calm = _is_noise(full, inverse.covariance(found.noise)) or np.all(np.abs(full) < _SMALL)
        if calm and now >= end and inverse.blind and factor * max(now // 4, first_spp) < spp:
            factor *= 4
            jacobians = derivatives(at, fitted, factor)
            continue
        if (calm and now >= end) or len(steps) + refused > most:
            break
        step = _shortened(inverse.step(found.gradient, damping))
        tried, tried_spp = np.clip(at + step, low, high), min(end, now * (4 if calm else 2))
        there = images.at(tried, tried_spp, seed)
        if there.loss > fitted.loss + 2 * np.hypot(there.error, fitted.error):
            damping, refused = max(10 * damping, 0.1), refused + 1
            continue
        at, now, fitted = tried, tried_spp, there
        damping = damping / 10 if damping > 1e-4 else 0.0
        jacobians = derivatives(at, fitted)
        steps.append(_told(Step(at, now, fitted.loss, fitted.error), told))

    near = np.clip(at + _shortened(full), low, high)
    fitted = images.at(near, spp, seed)
    found = images.equations(jacobians, fitted)
    held = _held(near, low, high, found.gradient)
    inverse = _inverse(found, ~held)
    last = np.clip(near + _shortened(inverse.step(found.gradient, 0.0)), low, high)
    steps.append(_told(Step(last, spp, fitted.loss, fitted.error), told))
    return Solution(
        at=last,
        fitted=fitted,
        covariance=inverse.covariance(found.spread),
        limits=held | (last <= low) | (last >= high),
        blind=inverse.blind,
        converged=bool(calm),
        steps=steps,
        last=last - at,
    )


def _told(step: Step, told: Callable[[Step], None]) -> Step:
    told(step)
    return step


def _held(at: Array, low: Array, high: Array, gradient: Array) -> Mask:
    """Coordinates at a limit that the loss pushes out of their range."""
    return ((at <= low) & (gradient > 0)) | ((at >= high) & (gradient < 0))


def _shortened(step: Array) -> Array:
    """A step that is not too long; it keeps its direction."""
    longest = float(np.max(np.abs(step), initial=0.0))
    return step * min(1.0, _FAR / longest) if longest else step


def _is_noise(step: Array, covariance: Array) -> bool:
    """Whether a step may well be nothing but noise."""
    values, directions = np.linalg.eigh(covariance)
    use = values > 1e-12 * max(float(values.max(initial=0.0)), 1e-300)
    along = directions[:, use].T @ step
    return bool(np.sum(along**2 / values[use]) <= _CALM * max(int(use.sum()), 1))


def _inverse(found: Equations, free: Mask) -> _Inverse:
    """Solve the equations for the free coordinates."""
    count = len(free)
    blind: list[Array] = []
    scale = np.zeros(count)
    for i in np.flatnonzero(free):
        unit = np.eye(count)[i]
        if found.normal[i, i] > _SURE * found.uncertainty(unit):
            scale[i] = 1 / np.sqrt(found.normal[i, i])
        else:
            blind.append(unit)
    use = np.flatnonzero(scale)
    columns, values = [], []
    if len(use):
        block = found.normal[np.ix_(use, use)] * np.outer(scale[use], scale[use])
        for value, vector in zip(*_sorted_eigh(block), strict=True):
            direction = np.zeros(count)
            direction[use] = vector * scale[use]
            if value > max(_SURE * found.uncertainty(direction), _ROUNDING):
                columns.append(direction)
                values.append(value)
            else:
                blind.append(direction / np.linalg.norm(direction))
    directions = np.array(columns).T if columns else np.zeros((count, 0))
    return _Inverse(directions, np.array(values), blind)


def _sorted_eigh(block: Array) -> tuple[Array, Array]:
    values, vectors = np.linalg.eigh(block)
    return values, vectors.T
