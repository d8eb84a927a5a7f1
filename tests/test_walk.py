"""Walks through grids, against walks in double precision that find every plane at once."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from tiers import quick

from nonexp.integrators import walk
from nonexp.plugins.density import Bounds, Density, Placement

RAYS = 1000
PLACES = {
    "unit": lambda: mi.ScalarTransform4f(),
    "rotated": lambda: (
        mi.ScalarTransform4f().translate([3, -2, 0.5]).rotate([0.6, 0.8, 0], 40).scale([2, 3, 0.7])
    ),
    "mm": lambda: mi.ScalarTransform4f().rotate([0, 0, 1], 30).scale(2e-3),
    "km": lambda: mi.ScalarTransform4f().translate([1e3, 2e3, 0]).scale(5e3),
    "mirrored": lambda: mi.ScalarTransform4f().scale([-1, 2, 1]),
    "sheared": lambda: mi.ScalarTransform4f(
        np.array([[1, 0.8, 0, 0], [0, 1, 0.3, 0], [0, 0, 1, 1], [0, 0, 0, 1.0]])
    ),
}
GRIDS = {
    "random": lambda rng: rng.random((7, 20, 13)),
    "bricks": lambda rng: np.kron(rng.random((3, 2, 4)) < 0.4, np.ones((9, 8, 10))) * 1.0,
    "sparse": lambda rng: np.where(rng.random((30, 23, 15)) < 0.005, rng.random((30, 23, 15)), 0),
    "one": lambda rng: rng.random((1, 1, 1)) + 0.5,
    "flat": lambda rng: rng.random((1, 50, 1)),
    "wide range": lambda rng: np.exp(8 * rng.random((9, 9, 9))),
}


class Exact:
    """A grid in double precision."""

    def __init__(self, values: Any, to_world: Any, nearest: bool, wrap: str) -> None:
        self.values, self.nearest = np.asarray(values, np.float32).astype(float), nearest
        self.size = np.array(self.values.shape[::-1])
        self.inverse = np.linalg.inv(np.array(to_world.matrix, dtype=float))
        self.repeat = wrap == "repeat"

    def index(self, points: Any) -> Any:
        unit = points @ self.inverse[:3, :3].T + self.inverse[:3, 3]
        return unit * self.size

    def at(self, q: Any) -> Any:
        """Density in voxels."""
        voxels = self.values.transpose(2, 1, 0)
        if self.nearest:
            i = np.clip(np.floor(q).astype(int), 0, self.size - 1)
            return voxels[tuple(np.moveaxis(i, -1, 0))]
        low = np.floor(q - 0.5).astype(int)
        share, total = q - 0.5 - low, 0.0
        for corner in np.ndindex(2, 2, 2):
            i = low + corner
            i = i % self.size if self.repeat else np.clip(i, 0, self.size - 1)
            weight = np.prod(np.where(corner, share, 1 - share), axis=-1)
            total = total + weight * voxels[tuple(np.moveaxis(i, -1, 0))]
        return total

    def columns(self, o: Any, d: Any, length: Any) -> tuple[Any, Any]:
        """Distances of all planes between cells along each ray, and the integral up to there."""
        a, b = self.index(o), self.index(o + d) - self.index(o)
        shift = 0.0 if self.nearest else 0.5
        cuts = [np.zeros(len(o)), np.full(len(o), float(length))]
        with np.errstate(divide="ignore", invalid="ignore"):
            for k in range(3):
                for plane in np.arange(self.size[k] + 1.0):
                    cuts.append((plane - a[:, k]) / b[:, k])
                for plane in np.arange(self.size[k]) + shift:
                    cuts.append((plane - a[:, k]) / b[:, k])
        t = np.nan_to_num(np.array(cuts).T, nan=0, posinf=0, neginf=0)
        t = np.sort(np.clip(t, 0, length), axis=1)
        nodes, weights = np.polynomial.legendre.leggauss(3)
        low, width = t[:, :-1], np.diff(t, axis=1)
        total = np.zeros_like(width)
        for node, weight in zip(nodes, weights, strict=True):
            at = low + width * (node + 1) / 2
            q = a[:, None] + at[..., None] * b[:, None]
            inside = np.all((q >= 0) & (q <= self.size), axis=-1)
            total += np.where(inside, self.at(q), 0) * width * weight / 2
        return t, np.concatenate([np.zeros((len(o), 1)), np.cumsum(total, axis=1)], axis=1)

    def column(self, o: Any, d: Any, length: Any) -> Any:
        """The integral over a length of its own along each ray."""
        t, sums = self.columns(o, d, float(np.max(length)))
        ray = np.arange(len(o))
        row = np.maximum([np.searchsorted(a, w) - 1 for w, a in zip(length, t, strict=True)], 0)
        low, total = t[ray, row], sums[ray, row]
        a, b = self.index(o), self.index(o + d) - self.index(o)
        nodes, weights = np.polynomial.legendre.leggauss(3)
        for node, weight in zip(nodes, weights, strict=True):
            q = a + (low + (length - low) * (node + 1) / 2)[:, None] * b
            inside = np.all((q >= 0) & (q <= self.size), axis=-1)
            total = total + np.where(inside, self.at(q), 0) * (length - low) * weight / 2
        return total


def volume(values: Any, to_world: Any, nearest: bool = False, wrap: str = "clamp") -> Any:
    return mi.load_dict(
        {
            "type": "gridvolume",
            "grid": mi.VolumeGrid(np.asarray(values, np.float32)),
            "to_world": to_world,
            "filter_type": "nearest" if nearest else "trilinear",
            "wrap_mode": wrap,
        }
    )


def density(values: Any, to_world: Any, nearest: bool = False, wrap: str = "clamp") -> Density:
    grid = volume(values, to_world, nearest, wrap)
    return Density(grid, Placement.of(grid))


def rays(to_world: Any, rng: Any, far: float = 0.3) -> tuple[Any, Any, float]:
    """Rays between points in and around the grid, single precision, and a length beyond it."""
    m = np.array(to_world.matrix, dtype=float)
    a, b = (rng.uniform(-f, 1 + f, (RAYS, 3)) @ m[:3, :3].T + m[:3, 3] for f in (far, 0.0))
    d = b - a
    # Some along the axes of the scene, some of these from a voxel's edge.
    axis = np.eye(3)[rng.integers(0, 3, RAYS)] * rng.choice([-1, 1], (RAYS, 1))
    d[: RAYS // 4] = axis[: RAYS // 4]
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    o, d = a.astype(np.float32), d.astype(np.float32)
    length = 4 * (1 + far) * float(np.linalg.norm(m[:3, :3], axis=0).max())
    return o.astype(float), d.astype(float), length


CASES = [
    *(("random", place, nearest, "clamp") for place in PLACES for nearest in (False, True)),
    *((grid, "rotated", nearest, "clamp") for grid in GRIDS for nearest in (False, True)),
    *(
        ("random", "unit", nearest, wrap)
        for wrap in ("repeat", "mirror")
        for nearest in (False, True)
    ),
]


@pytest.mark.parametrize(
    ("grid", "place", "nearest", "wrap"),
    quick(dict.fromkeys(CASES), lambda case: "rotated" in case and "sparse" not in case, True),
)
def test_columns_and_their_inversion(grid: str, place: str, nearest: bool, wrap: str) -> None:
    """To 1e-5, for columns of up to 20, as far as single precision knows where a ray is: to 4e-6
    of its length.

    Where density jumps, at the faces of the grid or of voxels, a ray that runs close along a face
    may count to the other side: that is left to one ray in a thousand.
    """
    rng = np.random.default_rng(5)
    values, to_world = np.asarray(GRIDS[grid](rng), np.float32), PLACES[place]()
    o, d, length = rays(to_world, rng)
    _, sums = Exact(values, to_world, nearest, wrap).columns(o, d, length)
    values *= np.float32(20 / sums[:, -1].max())
    exact = Exact(values, to_world, nearest, wrap)
    total = exact.columns(o, d, length)[1][:, -1]

    made, active = density(values, to_world, nearest, wrap), mi.Bool(True)
    origins, directions = mi.Point3f(o.T), mi.Vector3f(d.T)
    found = np.array(walk.column(made, origins, directions, length, dr.inf, active), dtype=float)
    slack = 1e-5 * np.maximum(total, 1) + 4e-6 * length * values.max()
    share = 0.999
    assert np.mean(np.abs(found - total) <= slack) >= share
    assert np.all((found > 0) == (total > 0)) or grid in ("bricks", "sparse")

    target = mi.Float(rng.random(RAYS) * total)
    where, reached = walk.distance(made, origins, directions, length, target, active)
    where, target = np.array(where, dtype=float), np.array(target, dtype=float)
    some = target < total - slack
    some &= target > 0
    assert np.mean(np.isfinite(where[some])) >= share
    some &= np.isfinite(where)
    back = exact.column(o[some], d[some], where[some])
    assert np.mean(np.abs(back - target[some]) <= slack[some]) >= share
    assert np.array_equal(np.array(reached)[some], target.astype(np.float32)[some])

    # Nothing beyond the end, and what is asked to stop early does.
    beyond = mi.Float(1.001 * total + 1e-3)
    where, reached = walk.distance(made, origins, directions, length, beyond, active)
    assert np.mean(np.isinf(np.array(where))) >= share
    assert np.allclose(np.array(reached), found, atol=1e-6)
    half = mi.Float(0.5 * found)
    stopped = walk.column(made, origins, directions, length, half, active)
    assert np.allclose(np.array(stopped), 0.5 * found)


@pytest.mark.parametrize("nearest", [False, True], ids=["trilinear", "nearest"])
def test_a_constant_grid_is_the_way_through_its_box(nearest: bool) -> None:
    """However a ray passes: along edges, faces and axes, from inside, away from it, too short."""
    made = density(np.full((3, 4, 5), 2.0), mi.ScalarTransform4f(), nearest)
    coordinates = [-0.5, -1e-7, 0.0, 0.2, 0.25, 0.5, 1.0, 1.5]
    o = np.array(np.meshgrid(coordinates, coordinates, coordinates)).reshape(3, -1)
    steps = np.array([s for s in np.ndindex(3, 3, 3) if s != (1, 1, 1)]) - 1.0
    o, d = np.repeat(o, len(steps), axis=1), np.tile(steps.T, o.shape[1])
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (0 - o) / d, (1 - o) / d
    near, far = np.fmin(a, b), np.fmax(a, b)
    outside = np.any((d == 0) & ((o < 0) | (o > 1)), axis=0)
    for length in (0.0, 0.3, 10.0):
        first = np.maximum(np.where(d == 0, 0, near).max(0), 0)
        last = np.minimum(np.where(d == 0, np.inf, far).min(0), length)
        exact = np.where(outside, 0, 2 * np.maximum(last - first, 0))
        found = walk.column(made, mi.Point3f(o), mi.Vector3f(d), length, dr.inf, mi.Bool(True))
        # A ray within a face may count or not.
        face = np.any((d == 0) & ((o <= 0) | (o >= 1)), axis=0)
        assert np.allclose(np.array(found)[~face], exact[~face], atol=2e-6)


def test_depths_that_are_none_or_no_numbers() -> None:
    made = density(np.pad(np.ones((8, 8, 8)), 8), mi.ScalarTransform4f())
    o, d = mi.Point3f(-1, 0.5, 0.5), mi.Vector3f(1, 0, 0)
    for target, expected in ((0.0, 1 + 7.5 / 24), (dr.inf, dr.inf), (dr.nan, dr.inf)):
        where, _ = walk.distance(made, o, d, 9.0, mi.Float(target), mi.Bool(True))
        # A depth of zero collides where density begins, not in the vacuum before.
        assert where[0] == pytest.approx(expected, abs=1e-4)
    odd = (mi.Point3f(dr.nan), d), (o, mi.Vector3f(dr.nan)), (o, mi.Vector3f(0, 0, 0))
    for start, direction in odd:
        found = walk.column(made, start, direction, 9.0, dr.inf, mi.Bool(True))
        assert not found[0] > 10
    assert walk.column(made, o, d, 9.0, dr.inf, mi.Bool(False))[0] == 0


def test_other_grids_need_no_other_kernel() -> None:
    rng = np.random.default_rng(2)

    def kernels(shape: tuple[int, ...], place: str, wrap: str) -> set[str]:
        made = density(rng.random(shape), PLACES[place](), wrap=wrap)
        o, d = mi.Point3f(0, 0, dr.arange(mi.Float, 100) / 100), mi.Vector3f(0, 0.6, 0.8)
        dr.eval(o, d)
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            dr.eval(walk.column(made, o, d, mi.Float(5), dr.inf, mi.Bool(True)))
            return {k["hash"] for k in dr.kernel_history() if "hash" in k}

    assert kernels((9, 4, 5), "unit", "clamp") == kernels((30, 20, 10), "rotated", "repeat")


@pytest.mark.parametrize("nearest", [False, True], ids=["trilinear", "nearest"])
@pytest.mark.parametrize("place", PLACES)
def test_lookups_are_those_of_mitsuba(place: str, nearest: bool) -> None:
    rng = np.random.default_rng(3)
    to_world = PLACES[place]()
    grid = volume(rng.random((6, 9, 7)), to_world, nearest)
    kept = np.array(mi.traverse(grid)["data"])
    made = Density(grid, Placement.of(grid))
    assert np.array_equal(np.array(mi.traverse(grid)["data"]), kept), "the data must be back"
    m = np.array(to_world.matrix, dtype=float)
    at = dr.zeros(mi.Interaction3f)
    at.p = mi.Point3f((rng.random((20000, 3)) @ m[:3, :3].T + m[:3, 3]).T)
    expected, found = np.array(grid.eval_1(at)), np.array(made.lookup(at.p))
    assert np.mean(np.abs(found - expected) < 3e-5) > (0.9995 if nearest else 0.99999)
    at.p = at.p + mi.Vector3f(m[:3, :3] @ np.array([1.001, 0, 0]))
    assert dr.all(made.lookup(at.p) == 0)


def test_memory_is_that_of_the_data() -> None:
    """A grid of 96^3: bricks and all else are 1 % of the data, and that is not copied."""
    grid = volume(np.random.default_rng(1).random((96, 96, 96)), mi.ScalarTransform4f())
    placement = Placement.of(grid)
    made = Density(grid, placement)
    assert made.data.index == mi.traverse(grid)["data"].array.index
    assert dr.width(made.bricks) == 13**3


def test_bricks_know_where_density_is_constant() -> None:
    values = np.zeros((32, 16, 16))
    values[20, 3, 5] = 1
    made = density(values, mi.ScalarTransform4f())
    bricks = np.array(made.bricks).reshape(5, 3, 3)
    assert np.argwhere(bricks < 0).tolist() == [[2, 0, 0]]
    assert made.uniform == pytest.approx(44 / 45)
    assert np.all(np.array(density(np.ones((9, 9, 9)), mi.ScalarTransform4f()).bricks) == 1)
    repeated = np.zeros((16, 16, 16))
    repeated[:, :, 0] = 1
    made = density(repeated, mi.ScalarTransform4f(), wrap="repeat")
    bricks = np.array(made.bricks).reshape(3, 3, 3)
    assert np.all(bricks[..., [0, 2]] < 0) and np.all(bricks[..., 1] == 0)


@pytest.mark.parametrize("nearest", [False, True], ids=["trilinear", "nearest"])
@pytest.mark.parametrize("wrap", ["clamp", "repeat"])
@pytest.mark.parametrize("size", [8, 16, 64])
def test_bounds_are_the_largest_densities(nearest: bool, wrap: str, size: int) -> None:
    values = np.random.default_rng(8).random((20, 9, 33)).astype(np.float32)
    made = density(values, mi.ScalarTransform4f(), nearest, wrap)
    bounds = Bounds(made, size)
    padded = values if nearest else np.pad(values, 1, mode="wrap" if wrap == "repeat" else "edge")
    corners = 0 if nearest else 1
    counts = [-(-(n - corners) // size) for n in padded.shape]
    for place in np.ndindex(*counts):
        part = padded[tuple(slice(size * b, size * b + size + corners) for b in place)]
        block = [mi.Int32(b) for b in reversed(place)]
        assert bounds.of(block, True)[0] == part.max()
    for outside in (-1, counts[2]):
        block = [mi.Int32(outside), mi.Int32(0), mi.Int32(0)]
        assert bounds.of(block, True)[0] == 0
