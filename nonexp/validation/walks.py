"""The collisions of paths, one by one.

A phase function that scatters isotropically and writes down where.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..testing.scenes import FURNACE, isotropic, scene
from .slabs import Light, paths, slab

__all__ = ["collisions", "first_depths", "recorder"]


def recorder(capacity: int) -> Any:
    """An isotropic phase function with the positions of up to ``capacity`` collisions.

    ``found()`` returns the numbers of the paths, which are the times of their rays, and the
    positions, shape (n, 3), in the order in which each path makes them.
    """

    base: Any = isotropic()

    class Recorder(base):
        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.slots = dr.zeros(mi.UInt32, 1)
            self.path = dr.zeros(mi.UInt32, capacity)
            self.place = [dr.zeros(mi.Float, capacity) for _ in range(3)]

        def found(self) -> tuple[Any, Any]:
            used = int(self.slots[0])
            if used > capacity:
                raise ValueError(f"capacity is {capacity}: {used} collisions were recorded")
            place = np.array([np.array(x)[:used] for x in self.place], dtype=float).T
            return np.array(self.path)[:used], place

        def met(self, mei: Any, active: Any) -> None:
            slot = dr.scatter_inc(self.slots, mi.UInt32(0), active)
            kept = active & (slot < capacity)
            dr.scatter(self.path, mi.UInt32(mei.time), slot, kept)
            for array, x in zip(self.place, mei.p, strict=True):
                dr.scatter(array, x, slot, kept)

    mi.register_phase("nonexp_recorder", Recorder)
    return mi.load_dict({"type": "nonexp_recorder"})


def collisions(medium: dict[str, Any], paths: int, steps: int, seed: int) -> Any:
    """Positions of the first ``steps`` collisions of paths from the origin of an infinite white
    medium, in which every flight ends: shape (paths, steps, 3)."""
    record = recorder(paths * steps)
    fog = mi.load_dict({**medium, "albedo": 1.0, "sample_emitters": False, "phase": record})
    endless = {"type": "nonexp_volpath", "rr_depth": 1_000_000, "max_depth": steps + 1}
    built = scene(endless, sky=FURNACE)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, paths)
    d = mi.warp.square_to_uniform_sphere(sampler.next_2d())
    ray = mi.RayDifferential3f(mi.Point3f(0), d, mi.Float(dr.arange(mi.UInt32, paths)))
    dr.eval(built.integrator().sample(built, sampler, ray, fog, True)[0])
    path, place = record.found()
    order = np.argsort(path, kind="stable")
    return place[order].reshape(paths, steps, 3)


def first_depths(
    medium: dict[str, Any], thickness: float, light: Light, seed: int, count: int
) -> Any:
    """Depths of the first collisions of the paths that :func:`.slabs.paths` draws with the same
    seed; infinity where a path crosses without one. Shape (count,)."""
    record = recorder(count)
    built = slab({**medium, "phase": record}, thickness, max_depth=2)
    paths(built, thickness, light, seed, count)
    path, place = record.found()
    found = np.full(count, np.inf)
    found[path] = thickness / 2 - place[:, 2]
    return found
