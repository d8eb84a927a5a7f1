"""Exact optical depths through a grid: a walk through its cells (regular tracking).

Along a ray the density within a cell is a polynomial of the distance, of degree 3 where it is
interpolated between eight voxels. Two-point Gauss-Legendre quadrature integrates it exactly, with
positive weights. Bricks of constant density are one step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from nonexp.plugins.density import BRICK, Density

_GAUSS = 0.5 - 0.5 / 3**0.5
"""First node on [0, 1]; the other lies as far from 1."""


def column(density: Density, o: Any, d: Any, length: Any, most: Any, active: Any) -> Any:
    """Integral of the density over ``length`` along a ray; ``most`` where it is more than that."""
    s = _Line(density, o, d, length).walk(most, active)
    return dr.select(s.found, most, s.column)


def distance(
    density: Density, o: Any, d: Any, length: Any, target: Any, active: Any
) -> tuple[Any, Any]:
    """Distance along a ray over which the density integrates to ``target``; infinite where that is
    beyond ``length``. Also returns the integral up to there, or to ``length``.
    """
    line = _Line(density, o, d, length)
    # What collides at once still collides where there is something.
    target = dr.maximum(target, dr.smallest(mi.Float))
    s = line.walk(target, active)
    t = line.near + s.t + line.invert(s, target - s.column)
    return dr.select(s.found, t, dr.inf), dr.select(s.found, target, s.column)


def spread(density: Density, o: Any, d: Any, length: Any, weight: Any, active: Any) -> Any:
    """Derivatives of :func:`column` by the data of the grid, which are attached.

    In backward mode they are counted with a ``weight``; where that is None, the result is the
    derivative for the tangents of the data. Cells of constant bricks count like all others.
    """
    line = _Line(density, o, d, length)
    end = line.walk(dr.inf, active, _Spread(weight))
    return end.spread


@dataclass(frozen=True)
class _Spread:
    """Counts the derivatives of each step."""

    weight: Any

    def count(self, so_far: Any, piece: Any) -> Any:
        """Those of one step, whose part of the integral is attached."""
        if not dr.grad_enabled(piece):
            return so_far
        if self.weight is None:
            return so_far + dr.detach(dr.forward_to(piece))
        dr.backward_from(self.weight * piece)
        return so_far


def interval(density: Density, o: Any, d: Any) -> tuple[Any, Any]:
    """Distances at which a ray enters a grid and leaves it; the latter is smaller if it misses."""
    line = _Line(density, o, d, dr.inf)
    return line.near, line.near + line.length


@dataclass
class _Walk:
    """State of a walk, at the start of a step."""

    t: Any
    """distance from where the ray enters the grid"""
    column: Any
    """integral of the density up to there"""
    cell: Any
    found: Any
    """the integral reaches its target in this step"""
    walking: Any
    """neither that, nor at the end"""
    spread: Any = None
    """derivative of the integral (with derivatives)"""


@dataclass
class _Step:
    """The cell, or the brick of constant density, that a walk is in."""

    cell: list[Any]
    """its first cell"""
    size: Any
    """its cells along each side"""
    mixed: Any
    """it is a cell of its own"""
    constant: Any
    """density, if it is not"""
    exits: list[Any]
    """distances at which the ray leaves it along each axis"""
    end: Any
    """distance at which it does, the ray's end if that comes before"""


class _Line:
    """A ray in index space, from where it enters the grid to where it ends.

    Distances stay those of the scene. They count from the entry: then they are small, and so are
    their rounding errors.
    """

    def __init__(self, density: Density, o: Any, d: Any, length: Any) -> None:
        p, self.d = density.index(o), density.index_step(d)
        largest = dr.max(dr.abs(self.d))
        self.inverse, self.ahead = [], []
        self.near, far = mi.Float(0), mi.Float(length)
        for k in range(3):
            # A ray parallel to planes meets them far away, not at infinity: no 0 * inf.
            slope = dr.select(dr.abs(self.d[k]) > 1e-12 * largest, self.d[k], 1e-12 * largest)
            inverse = dr.rcp(slope)
            a = (density.low - p[k]) * inverse
            b = (density.high[k] - p[k]) * inverse
            self.near = dr.maximum(self.near, dr.minimum(a, b))
            far = dr.minimum(far, dr.maximum(a, b))
            self.inverse.append(inverse)
            self.ahead.append(inverse > 0)
        self.length = far - self.near
        self.p = [
            dr.clip(dr.fma(self.d[k], self.near, p[k]), density.low, density.high[k])
            for k in range(3)
        ]
        self.density = density

    def walk(self, target: Any, active: Any, spread: _Spread | None = None) -> _Walk:
        """Step from cell to cell until the integral reaches ``target``."""
        cells = self.density.cells
        start = [dr.clip(mi.Int32(p), 0, n - 1) for p, n in zip(self.p, cells, strict=True)]
        state = _Walk(
            t=mi.Float(0),
            column=mi.Float(0),
            cell=mi.Vector3i(*start),
            found=mi.Bool(False),
            walking=active & (self.length > 0) & (target > 0),
            spread=mi.Float(0) if spread else None,
        )
        (found,) = dr.while_loop(
            (state,),
            lambda s: s.walking,
            lambda s: (self._advance(s, target, spread),),
            label="nonexp: walk through a grid",
        )
        return found

    def _advance(self, s: _Walk, target: Any, spread: _Spread | None) -> _Walk:
        step = self._step(s, s.walking)
        dt = step.end - s.t
        if spread:
            with dr.resume_grad():
                piece = dr.detach(dt) * self._mean(s, dr.detach(dt), s.walking)
                s.spread = spread.count(s.spread, dr.select(s.walking, piece, 0))
        mean = self._mean(s, dt, s.walking & step.mixed)
        total = dr.fma(dr.select(step.mixed, mean, step.constant), dt, s.column)
        s.found = s.walking & (total >= target)
        onward = s.walking & ~s.found
        cell, inside = self._next(s, step)
        s.column = dr.select(onward, total, s.column)
        s.t = dr.select(onward, step.end, s.t)
        s.walking = onward & inside & (step.end < self.length)
        s.cell = dr.select(s.walking, cell, s.cell)
        return s

    def _mean(self, s: _Walk, dt: Any, active: Any) -> Any:
        """Mean density over ``dt`` within a cell."""
        corners = self.density.corners(s.cell, active)
        if self.density.nearest:
            return corners[0]
        a, b = (self._mean_at(s, corners, dr.fma(dt, g, s.t)) for g in (_GAUSS, 1 - _GAUSS))
        return 0.5 * (a + b)

    def _mean_at(self, s: _Walk, corners: Sequence[Any], t: Any) -> Any:
        within = [dr.fma(self.d[k], t, self.p[k]) - mi.Float(s.cell[k]) for k in range(3)]
        return self.density.interpolated(corners, within)

    def _step(self, s: _Walk, active: Any) -> _Step:
        constant = self.density.brick(s.cell, active)
        mixed = constant < 0
        size = dr.select(mixed, mi.Int32(1), BRICK)
        first = [dr.select(mixed, c, c & ~(BRICK - 1)) for c in s.cell]
        exits = []
        for k in range(3):
            plane = mi.Float(first[k] + dr.select(self.ahead[k], size, 0))
            exits.append((plane - self.p[k]) * self.inverse[k])
        exit = dr.minimum(dr.minimum(exits[0], exits[1]), exits[2])
        end = dr.maximum(dr.minimum(exit, self.length), s.t)
        return _Step(first, size, mixed, constant, exits, end)

    def _next(self, s: _Walk, step: _Step) -> tuple[Any, Any]:
        """The cell behind a step, and whether that lies in the grid."""
        exit = dr.minimum(dr.minimum(step.exits[0], step.exits[1]), step.exits[2])
        cell, inside = [], mi.Bool(True)
        for k in range(3):
            within = mi.Int32(dr.fma(self.d[k], step.end, self.p[k]))
            within = dr.clip(within, step.cell[k], step.cell[k] + step.size - 1)
            beyond = step.cell[k] + dr.select(self.ahead[k], step.size, -1)
            c = dr.select(step.exits[k] <= exit, beyond, within)
            inside &= (c >= 0) & (c < self.density.cells[k])
            cell.append(c)
        return mi.Vector3i(*cell), inside

    def invert(self, s: _Walk, rest: Any) -> Any:
        """Distance within the step of a walk that ended there, over which the density integrates to
        ``rest``."""
        step = self._step(s, s.found)
        dt = step.end - s.t
        corners = self.density.corners(s.cell, s.found & step.mixed)
        if self.density.nearest:
            value = dr.select(step.mixed, corners[0], step.constant)
            return dr.clip(rest / value, 0, dt)
        within = [dr.fma(self.d[k], s.t, self.p[k]) - mi.Float(s.cell[k]) for k in range(3)]
        cubic = _cubic(corners, within, [self.d[k] * dt for k in range(3)])
        cubic = [dr.select(step.mixed, c, constant) for c, constant in
                 zip(cubic, (step.constant, 0, 0, 0), strict=True)]  # fmt: skip
        return dt * _solve(cubic, rest / dt)


def _cubic(corners: Sequence[Any], start: Sequence[Any], change: Sequence[Any]) -> list[Any]:
    """Coefficients, from the constant on, of the density along a line through a cell that begins at
    ``start`` and is ``change`` long, over [0, 1]."""
    values: list[list[Any]] = [[v] for v in corners]
    for q, e in zip(start, change, strict=True):
        merged = []
        for low, high in zip(values[::2], values[1::2], strict=True):
            slopes = [b - a for a, b in zip(low, high, strict=True)]
            terms = [dr.fma(q, slope, a) for slope, a in zip(slopes, low, strict=True)]
            merged.append(
                [
                    terms[0],
                    *(dr.fma(e, slopes[k - 1], terms[k]) for k in range(1, len(terms))),
                    e * slopes[-1],
                ]
            )
        values = merged
    return values[0]


def _solve(cubic: Sequence[Any], rest: Any) -> Any:
    """Where the integral of a cubic >= 0 from 0 on is ``rest``; in [0, 1].

    Newton's method, kept between bounds that close in, from the solution for a linear density.
    """
    f0, slope = cubic[0], cubic[1] + cubic[2] + cubic[3]
    x = 2 * rest / (f0 + dr.sqrt(dr.maximum(dr.fma(2 * slope, rest, dr.square(f0)), 0)))
    x = dr.select(dr.isfinite(x), dr.clip(x, 0, 1), 0.5)
    low, high = mi.Float(0), mi.Float(1)
    integral = [c / (k + 1) for k, c in enumerate(cubic)]
    for _ in range(5):
        excess = dr.fma(x, _polynomial(integral, x), -rest)
        low, high = dr.select(excess > 0, low, x), dr.select(excess > 0, x, high)
        newton = x - excess / _polynomial(cubic, x)
        x = dr.select((newton >= low) & (newton <= high), newton, 0.5 * (low + high))
    return x


def _polynomial(coefficients: Sequence[Any], x: Any) -> Any:
    value = coefficients[-1]
    for c in reversed(coefficients[:-1]):
        value = dr.fma(value, x, c)
    return value
