"""Rays in a scene: where they start, what they hit, and spheres that the kernel intersects.

To Embree a sphere is a user-defined geometry: each test of one costs a second walk through the
scene and a call back. A few spheres are cheaper to intersect in the kernel, before anything else:
what lies behind them then needs no test at all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from nonexp.system import insides

from .jit import Numbering, Remembered, opaque, recording

MOST_SPHERES = 32

MOST_FACES = 1 << 18
"""Scenes with more than this are not held in memory twice."""

MOST_SHAPES = 64
"""With more than this, looking whether one has changed takes milliseconds in each render."""

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
        self.extent = _STEPS * epsilon * min(float(extent), 1e30)
        self.limit = opaque(mi.Float, self.extent)
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

    def reach(self, si: Any, d: Any) -> Any:
        """Distance along a ray within which surfaces coincide: none that it starts beyond."""
        cosine = dr.maximum(dr.abs(dr.dot(si.n, d)), _GRAZING)
        return 0.9 * self._size(si) / cosine

    def _size(self, vertex: Any) -> Any:
        mitsubas = (1 + dr.max(dr.abs(vertex.p))) * self._relative
        return dr.minimum(mitsubas, self.limit)


# --------------------------------------------------------------------- spheres


_places = Remembered(64)


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
    arrays, numbers = state(shape)  # reading them would wait for kernels each time
    found: tuple[Any, Any] | None = _places.get(
        (mi.variant(), numbers), arrays, lambda: _sphere(transform)
    )
    return found


def _sphere(transform: Any) -> tuple[Any, Any] | None:
    """Centre and radius of what a transformation makes of the unit sphere, if it is a sphere."""
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


def detachable(shapes: Sequence[Any]) -> bool:
    """Whether a scene of these shapes alone would notice a change of their geometry, and is made
    soon."""
    placed = all(shape.is_mesh() or shape.class_name() in _PLACED for shape in shapes)
    faces = sum(shape.face_count() if shape.is_mesh() else 1 for shape in shapes)
    return placed and faces <= MOST_FACES


def separate(scene: mi.Scene, left_out: Any = None) -> tuple[tuple[Sphere, ...], tuple[Any, ...]]:
    """The spheres that the kernel intersects itself, if that is possible and pays, and all other
    shapes; without one that is ``left_out``."""
    shapes = tuple(shape for shape in scene.shapes() if shape != left_out)
    none: tuple[Sphere, ...] = ()
    if "llvm" not in mi.variant() or recording() or len(shapes) > MOST_SHAPES:
        return none, shapes
    places = [place(shape) for shape in shapes]
    rest = tuple(shape for shape, found in zip(shapes, places, strict=True) if not found)
    if not 0 < len(shapes) - len(rest) <= MOST_SPHERES:
        return none, shapes
    if not detachable(rest):
        return none, shapes
    spheres = tuple(
        Sphere(shape, opaque(mi.ShapePtr, shape), *found)
        for shape, found in zip(shapes, places, strict=True)
        if found
    )
    return spheres, rest


# --------------------------------------------------------------------- intersections


@dataclass
class Contact:
    """All surfaces in the place where a ray hits several."""

    several: Any
    """there may be"""
    d: Any
    """direction of the ray"""
    surfaces: list[tuple[Any, Any]]
    """each group's surface, and whether it is there"""


class Contacts:
    """Finds the surfaces that coincide with one that was hit, in ``groups`` of shapes.

    ``ranks`` (for all shapes, group by group) tell which of them scatters: that of the greatest.
    Meshes with ``doubled`` faces are divided into two without.
    """

    def __init__(
        self, groups: Any, ranks: Any, doubled: Any, subscenes: Subscenes, offset: Offset
    ) -> None:
        shapes = [shape for group in groups for shape in group]
        halves = {id(mesh): subscenes.divided(mesh, faces) for mesh, faces in doubled}
        layers = [
            tuple(halves[id(shape)][0] if id(shape) in halves else shape for shape in group)
            for group in groups
        ]
        if halves:
            layers.append(tuple(half for _, half in halves.values()))
        self._scenes = [subscenes.of(layer) for layer in layers]
        ranked = dict(zip(map(id, shapes), ranks, strict=True))
        parts = [(half, ranked[mesh]) for mesh, both in halves.items() for half in both]
        ranked_shapes = [*zip(shapes, ranks, strict=True), *parts]
        self._numbering = Numbering([mi.ShapePtr(shape) for shape, _ in ranked_shapes])
        self._ranks = mi.UInt32([0, *(rank + 1 for _, rank in ranked_shapes)])
        self._offset = offset

    def at(self, ray: mi.Ray3f, si: Any, active: Any) -> tuple[Any, Contact]:
        """The surface that scatters where a ray hits ``si``, and all that are there."""
        several = active & (self._numbering.of(si.shape) != 0)
        reach = self._offset.reach(si, ray.d)
        start = dr.fma(ray.d, si.t - reach, ray.o)
        around = mi.Ray3f(start, ray.d, 2 * reach, ray.time, ray.wavelengths)
        best, rank, surfaces = si, self._rank(si, several), []
        for scene in self._scenes:
            other = scene.ray_intersect(around, mi.RayFlags.All, False, several)
            there = several & other.is_valid()
            other.t = si.t
            better = there & (self._rank(other, there) > rank)
            rank = dr.select(better, self._rank(other, there), rank)
            best = dr.select(better, other, best)
            surfaces.append((other, there))
        return best, Contact(several, ray.d, surfaces)

    def _rank(self, si: Any, active: Any) -> Any:
        return dr.gather(mi.UInt32, self._ranks, self._numbering.of(si.shape), active)


class Tracer:
    """Intersects rays with one scene: its ``spheres`` here, everything else by Mitsuba."""

    def __init__(
        self, scene: Any, spheres: tuple[Sphere, ...] = (), contacts: Contacts | None = None
    ) -> None:
        self._scene, self.spheres, self._contacts = scene, spheres, contacts

    @staticmethod
    def of(
        scene: mi.Scene,
        subscenes: Subscenes,
        contacts: Contacts | None = None,
        left_out: Any = None,
    ) -> Tracer:
        """The tracer of a scene, without a shape that is ``left_out``."""
        spheres, rest = separate(scene, left_out)
        if not spheres and left_out is None:
            return Tracer(scene, contacts=contacts)
        return Tracer(subscenes.of(rest) if rest else None, spheres, contacts)

    def hit(
        self, ray: mi.Ray3f, coherent: Any, active: Any
    ) -> tuple[mi.SurfaceInteraction3f, Contact | None]:
        """The first surface on a ray, and all surfaces there in a scene where some coincide."""
        si = self.intersect(ray, coherent, active)
        if self._contacts is None:
            return si, None
        return self._contacts.at(ray, si, active & si.is_valid())

    def intersect(self, ray: mi.Ray3f, coherent: Any, active: Any) -> mi.SurfaceInteraction3f:
        """The first surface on a ray."""
        flags = mi.RayFlags.All
        if self._scene and not self.spheres:
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
        self._known, self._parts = Remembered(4), Remembered(4)

    def of(self, shapes: tuple[Any, ...]) -> mi.Scene:
        """A scene of these shapes alone.

        Not while a function is being frozen, which can use only the scenes that it was given.
        """
        states = [state(shape) for shape in shapes]
        key = tuple(
            (id(shape), *numbers) for shape, (_, numbers) in zip(shapes, states, strict=True)
        )
        return self._known.get(key, (shapes, states), lambda: _scene_of(shapes))

    def divided(self, mesh: Any, faces: Any) -> tuple[Any, Any]:
        """An index-matched mesh in two: without the faces of a mask, and with them alone."""
        arrays, numbers = state(mesh)
        key = (id(mesh), numbers)
        both: tuple[Any, Any] = self._parts.get(
            key, (mesh, arrays), lambda: (_part_of(mesh, ~faces), _part_of(mesh, faces))
        )
        return both


def _part_of(mesh: Any, faces: Any) -> Any:
    """Some faces of an index-matched mesh, with its media."""
    properties = mi.Properties("part")
    properties["bsdf"] = mesh.bsdf()
    for side in ("interior", "exterior"):
        if (medium := getattr(mesh, f"{side}_medium")()) is not None:
            properties[side] = medium
    positions, chosen = insides.vertex_positions(mesh), np.array(insides.faces(mesh))
    chosen = chosen.reshape(-1, 3)[faces]
    part: Any = mi.Mesh("part", len(positions) // 3, len(chosen), props=properties)
    parameters = mi.traverse(part)
    parameters["vertex_positions"] = mi.Float(positions)
    parameters["faces"] = mi.UInt32(chosen.ravel())
    parameters.update()
    return part


def _scene_of(shapes: tuple[Any, ...]) -> Any:
    properties = mi.Properties("scene")
    for number, shape in enumerate(shapes):
        properties[f"shape_{number}"] = shape
    return mi.PluginManager.instance().create_object(properties)


def state(shape: Any) -> tuple[Any, tuple[int, ...]]:
    """The arrays that hold a shape's geometry, and their numbers, which change when it does."""
    if shape.is_mesh():
        arrays: Any = insides.vertex_positions(shape), insides.faces(shape)
    else:
        matrix = mi.traverse(shape)["to_world"].matrix
        arrays = tuple(entry for row in matrix for entry in row)
    # Copies, which share the variables: those of the shape would keep it from being collected.
    arrays = tuple(type(array)(array) for array in arrays)
    return arrays, insides.variables(*arrays)
