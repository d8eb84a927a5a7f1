"""The density of a medium on a grid, laid out for walks through its cells."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

__all__ = ["BRICK", "Bounds", "Density", "Placement"]

BRICK = 8
"""Cells along each side of a brick: a walk takes a brick of one density in one step."""

_RAMP = 1 << 20
"""Voxels of the grids by which a volume's transform is found."""


@dataclass(frozen=True)
class Placement:
    """Where a ``gridvolume`` lies, and how it interpolates: what Mitsuba does not show."""

    to_unit: Any
    """3 x 4 matrix from scene to the unit cube that the grid fills, in double precision"""
    nearest: bool
    """the density is that of the nearest voxel, else interpolated between eight"""
    repeats: bool
    """beyond the outermost voxels interpolation continues at the other side"""

    @staticmethod
    def of(volume: mi.Volume) -> Placement:
        """Find out by looking up grids whose values are coordinates, in place of the volume's data.

        The transform is that with which Mitsuba looks up the volume, to a few 1e-8 of the cube's
        size. Raises ``ValueError`` if ``to_world`` is singular.
        """
        parameters = mi.traverse(volume)
        data = parameters["data"]
        kept, channels = type(data)(data), int(data.shape[3])

        def look(axis: int, values: Any, points: Any) -> Any:
            shape = [1, 1, 1, channels]
            shape[2 - axis] = len(values)
            column = np.repeat(np.asarray(values, np.float32), channels)
            parameters["data"] = mi.TensorXf(mi.Float(column), shape=tuple(shape))
            parameters.update()
            at = dr.zeros(mi.Interaction3f)
            at.p = mi.Point3f(np.asarray(points).T)
            found = volume.eval_1(at) if channels == 1 else volume.eval_3(at)[0]
            return np.array(found, dtype=np.float64)

        try:
            return _found(look, volume.bbox())
        finally:
            parameters["data"] = kept
            parameters.update()


def _found(look: Any, box: Any) -> Placement:
    real = np.dtype(np.float64 if mi.variant().endswith("double") else np.float32)
    low, high = np.array(box.min, dtype=float), np.array(box.max, dtype=float)
    centre, size = (low + high) / 2, high - low
    if not (np.all(np.isfinite(size)) and np.all(size > 0)):
        raise ValueError("sigma_t.to_world is singular: the grid has no volume")
    rng = np.random.default_rng(1)
    ramp = np.arange(_RAMP)

    def coordinates(points: Any) -> Any:
        """In the unit cube. A voxel's value is its number, at its centre or all over it."""
        return np.stack([look(axis, ramp, points) for axis in range(3)], 1) / _RAMP + 0.5 / _RAMP

    def fit(points: Any) -> tuple[Any, float]:
        seen = coordinates(points)
        terms = np.concatenate([(points - centre) / size, np.ones((len(points), 1))], 1)
        matrix = np.linalg.lstsq(terms, seen, rcond=None)[0]
        return matrix.T, float(np.abs(terms @ matrix - seen).max())

    # First near the centre, in a part of the box that lies inside the cube; then all over it.
    share, off = 0.5, np.inf
    while off > 2 / _RAMP and share > 1e-3:
        points = (centre + share * size * (rng.random((512, 3)) - 0.5)).astype(real).astype(float)
        matrix, off = fit(points)
        share /= 2
    if off > 2 / _RAMP or not abs(np.linalg.det(matrix[:, :3])) > 1e-9:
        raise ValueError("sigma_t.to_world is singular: the grid has no volume")

    def of_unit(unit: Any) -> Any:
        steps = np.linalg.solve(matrix[:, :3], (unit - matrix[:, 3]).T).T
        return (centre + size * steps).astype(real).astype(float)

    matrix, _ = fit(of_unit(0.01 + 0.98 * rng.random((4096, 3))))
    linear = matrix[:, :3] / size
    to_unit = np.concatenate([linear, (matrix[:, 3] - linear @ centre)[:, None]], 1)
    quarter = look(0, [0, 1], of_unit(np.array([[0.4, 0.5, 0.5], [1.25, 0.5, 0.5]])))
    return Placement(to_unit, nearest=quarter[0] in (0.0, 1.0), repeats=bool(quarter[1] < 0.5))


class Bounds:
    """Upper bounds of a density in blocks of cells, cubes of ``size`` cells each.

    Steps of null collisions end at their faces: large blocks have few faces, small ones tighter
    bounds.
    """

    def __init__(self, density: Density, size: int) -> None:
        bricks = np.abs(np.array(density.bricks)).reshape(density.brick_shape)
        step = size // BRICK
        padded = np.pad(bricks, [(0, -n % step) for n in bricks.shape])
        depth, height, width = shape = tuple(n // step for n in padded.shape)
        blocks = padded.reshape(depth, step, height, step, width, step).max(axis=(1, 3, 5))
        self.size = size
        self.across = float(blocks.mean()) * density.size
        """integral of the bound from one side of the grid to another, on average"""
        self.steps = float(np.mean(shape))
        """blocks from one side to another, on average"""
        self.values = mi.Float(blocks.ravel().tolist())
        self.scale = _real(1 / size)
        self.counts = [_whole(n) for n in (width, height, depth)]
        self.strides = [_whole(n) for n in (1, width, width * height)]

    def of(self, block: Sequence[Any], active: Any) -> Any:
        """The bound in a block, by its place among all; zero beyond them."""
        inside = mi.Bool(active)
        for b, n in zip(block, self.counts, strict=True):
            inside &= (b >= 0) & (b < n)
        x, y, z = (b * s for b, s in zip(block, self.strides, strict=True))
        return dr.gather(mi.Float, self.values, mi.UInt32(x + y + z), inside)

    def arrays(self) -> list[Any]:
        """All that kernels read."""
        return [self.values, self.scale, *self.counts, *self.strides]


class Density:
    """Density ``rho(x)`` of a medium on a grid, zero outside of it.

    In *index space* a cell is a unit cube with integer corners, cells count from 0. A cell is a
    voxel where the ``nearest`` one gives the density; else it lies between the centres of eight
    voxels, and the grid begins and ends half a cell within the outermost ones. All sizes are data:
    grids of any size and transform share their kernels. The values are those of the volume, not a
    copy.
    """

    def __init__(self, volume: mi.Volume, placement: Placement, channel: int = 0) -> None:
        tensor = mi.traverse(volume)["data"]
        depth, height, width, channels = (int(n) for n in tensor.shape)
        self.voxels = (width, height, depth)
        self.nearest = placement.nearest
        shift = 0.0 if self.nearest else 0.5
        rows = placement.to_unit * np.array(self.voxels)[:, None]
        # Points count from the middle of the grid, wherever that is: so they keep their digits.
        middle = np.linalg.solve(placement.to_unit[:, :3], 0.5 - placement.to_unit[:, 3])
        middle = np.array(mi.ScalarPoint3f(middle), dtype=float)
        rows[:, 3] += rows[:, :3] @ middle + shift
        cells = self.voxels if self.nearest else tuple(n + 1 for n in self.voxels)
        ends = [0 if placement.repeats else n - 1 for n in self.voxels]
        bricks = [-(-n // BRICK) for n in cells]
        self.size = float(np.mean(np.linalg.norm(np.linalg.inv(placement.to_unit[:, :3]), axis=0)))
        """mean length of an edge, in scene units"""
        self.data = dr.detach(tensor.array)
        unit = np.array(list(np.ndindex(2, 2, 2)), dtype=float) - placement.to_unit[:, 3]
        self.corners_of_box = np.linalg.solve(placement.to_unit[:, :3], unit.T).T
        """of the parallelepiped that the grid fills: 8 points"""
        self.channel = _whole(channel)
        self.rows = [[_real(x) for x in row] for row in rows]
        """affine map to index space, from the middle"""
        self.middle = mi.Point3f(*map(_real, middle))
        self.cells = [_whole(n) for n in cells]
        self.low = _real(shift)
        """index at which the grid begins"""
        self.high = [_real(n + shift) for n in self.voxels]
        """and ends"""
        self.strides = [_whole(channels * n) for n in (1, width, width * height)]
        self.before = [_whole(n - 1 - end) for n, end in zip(self.voxels, ends, strict=True)]
        """voxel before the first one"""
        self.after = [_whole(end) for end in ends]
        """voxel after the last one"""
        self.brick_shape = tuple(reversed(bricks))
        self.brick_strides = [_whole(n) for n in (1, bricks[0], bricks[0] * bricks[1])]
        self.bricks = self._bricks(bricks)
        """density of each brick; where it is not constant, minus the largest one"""

    def attached(self, data: Any) -> Density:
        """The same with data that have derivatives, and no constant brick that hides some."""
        twin = copy.copy(self)
        twin.data = data
        twin.bricks = dr.full(mi.Float, -1, dr.width(self.bricks))
        dr.eval(twin.bricks)
        return twin

    def arrays(self) -> list[Any]:
        """All that kernels read, but the data of the volume."""
        rows = [number for row in self.rows for number in row]
        sizes = [*self.strides, *self.brick_strides]
        return [
            *rows, *self.middle, *self.cells, self.low, *self.high, self.channel, *self.before,
            *self.after, *sizes, self.bricks,
        ]  # fmt: skip

    @property
    def uniform(self) -> float:
        """Share of the bricks in which the density is constant."""
        return float(np.mean(np.array(self.bricks) >= 0))

    @property
    def steps_across(self) -> float:
        """Steps of a walk from one side of the grid to another, on average."""
        cells = float(np.mean(self.voxels))
        return cells * (1 - self.uniform) + cells / BRICK * self.uniform

    def index(self, point: Any) -> Any:
        """A point in index space."""
        near = point - self.middle
        return mi.Point3f(*(_product(row, near, row[3]) for row in self.rows))

    def index_step(self, vector: Any) -> Any:
        """A vector in index space."""
        return mi.Vector3f(*(_product(row, vector, None) for row in self.rows))

    def brick(self, cell: Sequence[Any], active: Any) -> Any:
        """Density of the brick around a cell; where it is not constant, minus the largest one."""
        return self._brick([c >> 3 for c in cell], active)

    def _brick(self, brick: Sequence[Any], active: Any) -> Any:
        x, y, z = (b * s for b, s in zip(brick, self.brick_strides, strict=True))
        return dr.gather(mi.Float, self.bricks, mi.UInt32(x + y + z), active)

    def corners(self, cell: Sequence[Any], active: Any) -> list[Any]:
        """Density at the corners of a cell, x first, then y; its only value if ``nearest``."""
        if self.nearest:
            return [self._value([c * s for c, s in zip(cell, self.strides, strict=True)], active)]
        sides = []
        for c, s, before, after, n in zip(
            cell, self.strides, self.before, self.after, self.cells, strict=True
        ):
            low, high = dr.select(c > 0, c - 1, before), dr.select(c < n - 1, c, after)
            sides.append((low * s, high * s))
        (x0, x1), (y0, y1), (z0, z1) = sides
        rows = [y + z for z in (z0, z1) for y in (y0, y1)]
        return [self._value([row, x], active) for row in rows for x in (x0, x1)]

    def lookup(self, point: Any, active: Any = True) -> Any:
        """Density at a point of the scene."""
        q = self.index(point)
        inside = mi.Bool(active)
        for k in range(3):
            inside &= (q[k] >= self.low) & (q[k] <= self.high[k])
        cell = [dr.clip(mi.Int32(dr.floor(q[k])), 0, self.cells[k] - 1) for k in range(3)]
        corners = self.corners(cell, inside)
        return self.interpolated(corners, [q[k] - mi.Float(cell[k]) for k in range(3)])

    def interpolated(self, corners: Sequence[Any], within: Sequence[Any]) -> Any:
        """Density at a position in a cell, from 0 to 1 along each axis."""
        values = list(corners)
        for share in within if len(values) == 8 else ():
            pairs = zip(values[::2], values[1::2], strict=True)
            values = [dr.fma(b - a, share, a) for a, b in pairs]
        return values[0]

    def _value(self, offsets: Sequence[Any], active: Any) -> Any:
        return dr.gather(mi.Float, self.data, mi.UInt32(sum(offsets) + self.channel), active)

    def _bricks(self, counts: Sequence[int]) -> Any:
        """Density of each brick, or minus the largest one, by looking at all of it."""
        number = dr.arange(mi.Int32, counts[0] * counts[1] * counts[2])
        _, sy, sz = self.brick_strides
        z = number // sz
        y = (number - z * sz) // sy
        first = [BRICK * c for c in (number - z * sz - y * sy, y, z)]
        # Where cells have eight corners, every second cell and the last one show all of them.
        looks, stride = (BRICK, 1) if self.nearest else (BRICK // 2 + 1, 2)

        def body(k: Any, low: Any, high: Any) -> tuple[Any, Any, Any]:
            steps = (k % looks, k // looks % looks, k // looks**2)
            cell = [
                dr.minimum(c + dr.minimum(stride * step, BRICK - 1), n - 1)
                for c, step, n in zip(first, steps, self.cells, strict=True)
            ]
            for value in self.corners(cell, True):
                low, high = dr.minimum(low, value), dr.maximum(high, value)
            return k + 1, low, high

        _, low, high = dr.while_loop(
            (mi.Int32(0), mi.Float(dr.inf), mi.Float(-dr.inf)),
            lambda k, low, high: k < looks**3,
            body,
            label="nonexp: bricks",
        )
        result = dr.select(low == high, low, -high)
        dr.eval(result)
        return result


# Numbers in memory: other ones need no other kernel.


def _real(value: float) -> Any:
    return dr.opaque(mi.Float, float(value))


def _whole(value: int) -> Any:
    return dr.opaque(mi.Int32, int(value))


def _product(row: Sequence[Any], vector: Any, constant: Any) -> Any:
    first = row[0] * vector[0] if constant is None else dr.fma(row[0], vector[0], constant)
    return dr.fma(row[2], vector[2], dr.fma(row[1], vector[1], first))
