"""Rays in a scene: where they start, what they hit, and spheres that the kernel intersects.

To Embree a sphere is a user-defined geometry: each test of one costs a second walk through the
scene and a call back. A few spheres are cheaper to intersect in the kernel, before anything else:
what lies behind them then needs no test at all.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from .jit import opaque, recording

MOST_SPHERES = 32

MOST_FACES = 1 << 18
"""Scenes with more than this are not held in memory twice."""

MOST_SHAPES = 64
"""With more than this, looking whether one has changed takes milliseconds in each render."""

_KEPT = 4
_PLACED = ("Sphere", "Cylinder", "Disk", "Rectangle")

# In steps of the coordinates' precision: what intersections and positions may be off by.
_STEPS = 64
_GRAZING = 0.1


# --------------------------------------------------------------------- origins


class Offset:
    """Origins of rays that leave the surfaces of one scene, a little off them.

    Mitsuba's own distance, ``(1 + |p|) RayEpsilon``, is about 1e-4 of a scene unit however small
    the scene, and lies along the normal, so that the ray runs beside the line that it stands for. A
    medium notices both: here the distance follows the size of the scene, to what single precision
    needs, and the ray starts on its own line unless it grazes the surface.
    """

    def __init__(self, scene: mi.Scene) -> None:
        epsilon = float(dr.epsilon(mi.Float))
        self._relative = 1500 * epsilon  # Mitsuba's RayEpsilon
        box = scene.bbox()
        extent = np.max(np.abs([box.min, box.max])) if box.valid() else 0.0
        limit = _STEPS * epsilon * min(float(extent), 1e30)
        self.limit = opaque(mi.Float, limit)
        """Greatest distance, but for surfaces that a ray grazes."""

    def onward(self, vertex: Any, d: Any) -> Any:
        """Where the path goes on from ``vertex`` in direction ``d``; there itself if ``vertex.n``
        is zero, as at collisions."""
        size, cosine = self._size(vertex), dr.dot(vertex.n, d)
        steep = dr.abs(cosine) > _GRAZING
        along_ray = size / dr.abs(dr.select(steep, cosine, 1)) * d
        along_normal = dr.mulsign(size, cosine) * vertex.n
        step = dr.select(steep, mi.Vector3f(along_ray), mi.Vector3f(along_normal))
        return mi.Point3f(vertex.p + step)

    def segment(self, vertex: Any, target: Any) -> Any:
        """Ray from ``vertex`` to just before ``target``."""
        toward = target - vertex.p
        size = dr.mulsign(self._size(vertex), dr.dot(vertex.n, toward))
        origin = mi.Point3f(dr.fma(size, vertex.n, vertex.p))
        d = target - origin
        distance = dr.norm(d)
        length = distance * (1 - 10 * self._relative)
        return mi.Ray3f(origin, d / distance, length, vertex.time, vertex.wavelengths)

    def _size(self, vertex: Any) -> Any:
        mitsubas = (1 + dr.max(dr.abs(vertex.p))) * self._relative
        return dr.minimum(mitsubas, self.limit)


# --------------------------------------------------------------------- spheres


def place(shape: mi.Shape) -> tuple[Any, Any] | None:
    """Centre and radius of a sphere, no part of the kernel; None for other shapes.

    A sphere that a transformation has made an ellipsoid is none (while a function is being frozen,
    this cannot be told).
    """
    if shape.class_name() != "Sphere":
        return None
    transform = mi.traverse(shape)["to_world"].matrix
    if recording():
        centre, axis = transform @ mi.Vector4f(0, 0, 0, 1), transform @ mi.Vector4f(1, 0, 0, 0)
        return mi.Point3f(centre.xyz), dr.norm(axis)
    matrix = np.array(transform, dtype=float).reshape(4, 4)
    axes, centre = matrix[:3, :3], matrix[:3, 3]
    square = axes.T @ axes
    if np.max(np.abs(square - square[0, 0] * np.eye(3))) > 1e-5 * square[0, 0]:
        return None
    return opaque(mi.Point3f, centre), opaque(mi.Float, np.sqrt(square[0, 0]))


@dataclass(frozen=True)
class Sphere:
    """A sphere that the kernel intersects itself."""

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
        """Whether a ray hits the sphere within ``limit``, and how far away."""
        square, middle = self.chord(ray.o, ray.d)
        half = dr.sqrt(dr.maximum(square, 0))
        near, far = middle - half, middle + half
        t = dr.select(near >= 0, near, far)
        return (square >= 0) & (t >= 0) & (t <= limit), t


def separate(scene: mi.Scene) -> tuple[tuple[Sphere, ...], tuple[Any, ...]]:
    """The spheres that the kernel intersects itself, if that is possible and pays, and all other
    shapes."""
    shapes = tuple(scene.shapes())
    none: tuple[Sphere, ...] = ()
    if "llvm" not in mi.variant() or recording() or len(shapes) > MOST_SHAPES:
        return none, shapes
    places = [place(shape) for shape in shapes]
    rest = tuple(shape for shape, found in zip(shapes, places, strict=True) if not found)
    if not 0 < len(shapes) - len(rest) <= MOST_SPHERES:
        return none, shapes
    if not all(shape.is_mesh() or shape.class_name() in _PLACED for shape in rest):
        return none, shapes  # a change of their geometry would not be noticed
    if sum(shape.face_count() if shape.is_mesh() else 1 for shape in rest) > MOST_FACES:
        return none, shapes
    spheres = tuple(
        Sphere(shape, opaque(mi.ShapePtr, shape), *found)
        for shape, found in zip(shapes, places, strict=True)
        if found
    )
    return spheres, rest


# --------------------------------------------------------------------- intersections


class Tracer:
    """Intersects rays with one scene: its ``spheres`` here, everything else by Mitsuba."""

    def __init__(self, scene: Any, spheres: tuple[Sphere, ...] = ()) -> None:
        self._scene, self.spheres = scene, spheres

    @staticmethod
    def of(scene: mi.Scene, subscenes: Subscenes) -> Tracer:
        """The tracer of a scene."""
        spheres, rest = separate(scene)
        if not spheres:
            return Tracer(scene)
        return Tracer(subscenes.of(rest) if rest else None, spheres)

    def intersect(self, ray: mi.Ray3f, coherent: Any, active: Any) -> mi.SurfaceInteraction3f:
        """The first surface on a ray."""
        flags = mi.RayFlags.All
        if not self.spheres:
            return self._scene.ray_intersect(ray, flags, coherent, active)
        limit, hit = mi.Float(ray.maxt), dr.zeros(mi.ShapePtr)
        with dr.suspend_grad():
            for sphere in self.spheres:
                closer, t = sphere.distance(ray, limit)
                limit = dr.select(closer, t, limit)
                hit = dr.select(closer, sphere.pointer, hit)
        on_sphere = active & (hit != None)  # noqa: E711
        first = dr.zeros(mi.PreliminaryIntersection3f)
        first.valid, first.t, first.shape = on_sphere, dr.select(on_sphere, limit, dr.inf), hit
        if self._scene:
            shorter = mi.Ray3f(ray)
            shorter.maxt = limit
            nearer = self._scene.ray_intersect_preliminary(shorter, coherent, active)
            first = dr.select(nearer.is_valid(), nearer, first)
        return first.compute_surface_interaction(ray, flags, active)

    def occluded(self, ray: mi.Ray3f, active: Any, passing: Any = None) -> Any:
        """Whether a ray hits anything; not the sphere ``passing``."""
        blocked = mi.Bool(False)
        for sphere in self.spheres:
            if sphere.shape != passing:
                blocked |= sphere.distance(ray, ray.maxt)[0]
        if self._scene:
            blocked |= self._scene.ray_test(ray, active & ~blocked)
        return active & blocked


class NullBall:
    """Shadow rays past a single index-matched sphere, without walking through it.

    Where a sphere is the only surface that lets rays straight through, it is known where a ray
    enters and leaves its medium, and whether anything else is in the way is one occlusion test.
    """

    def __init__(self, sphere: Sphere, tracer: Tracer) -> None:
        self._sphere, self._tracer = sphere, tracer

    @staticmethod
    def of(shape: Any, tracer: Tracer) -> NullBall | None:
        """That of ``shape``, if the tracer intersects it itself."""
        found = [sphere for sphere in tracer.spheres if sphere.shape == shape]
        return NullBall(found[0], tracer) if found else None

    def occluded(self, ray: mi.Ray3f, active: Any) -> Any:
        """Whether anything but the sphere is on a shadow ray."""
        return self._tracer.occluded(ray, active, passing=self._sphere.shape)

    def length(self, p: Any, d: Any, distance: Any, inside: Any) -> Any:
        """Length inside the sphere of a line from ``p``, itself ``inside`` or not."""
        square, middle = self._sphere.chord(p, d)
        half = dr.sqrt(dr.maximum(square, 0))
        near, far = middle - half, middle + half
        # Within the sphere, but not in its medium: a ray that leaves it enters nothing.
        outside = near > -1e-4 * self._sphere.radius
        length = dr.minimum(far, distance) - dr.select(inside, 0, dr.maximum(near, 0))
        return dr.select(inside | outside, dr.maximum(length, 0), 0)


# --------------------------------------------------------------------- scenes of some shapes


class Subscenes:
    """Scenes of some of a scene's shapes, so that rays hit nothing else.

    Each is built once for each state of their geometry. An integrator keeps its own, so that they
    go when its scene goes: objects that exist are part of the kernels of all other scenes.
    """

    def __init__(self) -> None:
        self._known: OrderedDict[tuple[Any, ...], tuple[Any, Any]] = OrderedDict()

    def of(self, shapes: tuple[Any, ...]) -> mi.Scene:
        """A scene of these shapes alone.

        Not while a function is being frozen, which can use only the scenes that it was given.
        """
        states = [_state(shape) for shape in shapes]
        key = tuple((id(shape), *state[1:]) for shape, state in zip(shapes, states, strict=True))
        if key not in self._known:
            properties = mi.Properties("scene")
            for number, shape in enumerate(shapes):
                properties[f"shape_{number}"] = shape
            scene = mi.PluginManager.instance().create_object(properties)
            # Holding shapes and arrays keeps their numbers from being given to others.
            self._known[key] = scene, (shapes, states)
            if len(self._known) > _KEPT:
                self._known.popitem(last=False)
        self._known.move_to_end(key)
        return self._known[key][0]


def _state(shape: Any) -> tuple[Any, ...]:
    """What changes with a shape's geometry, behind the arrays that this refers to."""
    if shape.is_mesh():
        positions, faces = shape.vertex_positions_buffer(), shape.faces_buffer()
        return (positions, faces), positions.index, faces.index
    matrix = mi.traverse(shape)["to_world"].matrix
    return (matrix, *(entry.index for row in matrix for entry in row))
