"""Where rays meet a scene: its spheres in closed form, everything else by Mitsuba.

To Embree a sphere is a foreign body: each look at one costs a second walk through the scene and a
call back. A few spheres are cheaper to look at in the kernel, before anything else: what lies
behind them then needs no look at all.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from .jit import opaque, recording
from .sphere import place
from .subscene import Subscenes, is_watched

MOST_SPHERES = 32

MOST_FACES = 1 << 18
"""Scenes with more than this are not held in memory twice."""

MOST_SHAPES = 64
"""With more than this, looking whether one has changed takes milliseconds in each render."""


@dataclass(frozen=True)
class _Sphere:
    shape: Any
    pointer: Any
    """as the kernel sees the shape: no part of it, since scenes are loaded in any order"""
    centre: Any
    radius: Any

    def chord(self, o: Any, d: Any) -> tuple[Any, Any]:
        """Half the length inside the sphere of a line, squared, and the distance to its middle.

        The distance of the line from the centre comes from a difference that does not cancel.
        """
        o = o - self.centre
        middle = -dr.dot(o, d)
        square = dr.fma(self.radius, self.radius, -dr.squared_norm(dr.fma(middle, d, o)))
        return square, middle

    def distance(self, ray: Any, limit: Any) -> tuple[Any, Any]:
        """Whether a ray meets the sphere within ``limit``, and how far away."""
        square, middle = self.chord(ray.o, ray.d)
        half = dr.sqrt(dr.maximum(square, 0))
        near, far = middle - half, middle + half
        t = dr.select(near >= 0, near, far)
        return (square >= 0) & (t >= 0) & (t <= limit), t


class Tracer:
    """Rays in one scene."""

    def __init__(self, scene: Any, spheres: tuple[_Sphere, ...] = ()) -> None:
        self._scene, self.spheres = scene, spheres

    @staticmethod
    def of(scene: mi.Scene, subscenes: Subscenes) -> Tracer:
        """Tells spheres from all other shapes, if that is possible and pays."""
        spheres, rest = told_apart(scene)
        if not spheres:
            return Tracer(scene)
        return Tracer(subscenes.of(rest) if rest else None, spheres)

    def intersect(self, ray: mi.Ray3f, coherent: Any, active: Any) -> mi.SurfaceInteraction3f:
        """The first surface on a ray."""
        flags = mi.RayFlags.All
        if not self.spheres:
            return self._scene.ray_intersect(ray, flags, coherent, active)
        limit, met = mi.Float(ray.maxt), dr.zeros(mi.ShapePtr)
        with dr.suspend_grad():
            for sphere in self.spheres:
                closer, t = sphere.distance(ray, limit)
                limit = dr.select(closer, t, limit)
                met = dr.select(closer, sphere.pointer, met)
        on_sphere = active & (met != None)  # noqa: E711
        first = dr.zeros(mi.PreliminaryIntersection3f)
        first.valid, first.t, first.shape = on_sphere, dr.select(on_sphere, limit, dr.inf), met
        if self._scene:
            shorter = mi.Ray3f(ray)
            shorter.maxt = limit
            nearer = self._scene.ray_intersect_preliminary(shorter, coherent, active)
            first = dr.select(nearer.is_valid(), nearer, first)
        return first.compute_surface_interaction(ray, flags, active)

    def occluded(self, ray: mi.Ray3f, active: Any, passing: Any = None) -> Any:
        """Whether anything is on a ray; not the sphere ``passing``."""
        blocked = mi.Bool(False)
        for sphere in self.spheres:
            if sphere.shape != passing:
                blocked |= sphere.distance(ray, ray.maxt)[0]
        if self._scene:
            blocked |= self._scene.ray_test(ray, active & ~blocked)
        return active & blocked


def told_apart(scene: mi.Scene) -> tuple[tuple[_Sphere, ...], tuple[Any, ...]]:
    """The spheres that are met in closed form, and all other shapes."""
    shapes = tuple(scene.shapes())
    none: tuple[_Sphere, ...] = ()
    if "llvm" not in mi.variant() or recording() or len(shapes) > MOST_SHAPES:
        return none, shapes
    places = [place(shape) for shape in shapes]
    rest = tuple(shape for shape, found in zip(shapes, places, strict=True) if not found)
    if not 0 < len(shapes) - len(rest) <= MOST_SPHERES:
        return none, shapes
    if not all(is_watched(shape) for shape in rest):
        return none, shapes
    if sum(shape.face_count() if shape.is_mesh() else 1 for shape in rest) > MOST_FACES:
        return none, shapes
    spheres = tuple(
        _Sphere(shape, opaque(mi.ShapePtr, shape), *found)
        for shape, found in zip(shapes, places, strict=True)
        if found
    )
    return spheres, rest
