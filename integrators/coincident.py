"""Surfaces that lie in one place: fog that stands on the ground, boxes that share a face.

A ray hits only one of them, and which is chance. Shapes of which parts coincide are therefore put
into groups without coincidences, and what a ray hits is looked for in each group: then the media of
all surfaces in one place are known, whatever their order and whatever side the ray comes from.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import mitsuba as mi
import numpy as np
from scipy.spatial import cKDTree

from nonexp.system import insides

from .jit import Remembered, recording
from .rays import place, state

_OPAQUE, _TRANSMITTING, _PASSING = 2, 1, 0
_FLAT = ("Rectangle", "Disk")
_KINDS = (*_FLAT, "Sphere", "Cylinder")

# Holds no shapes: those that exist are part of the kernels of all scenes.
_known = Remembered(16)


@dataclass(frozen=True)
class Coincident:
    """The shapes of a scene of which parts coincide with another, or nearly so."""

    groups: tuple[tuple[Any, ...], ...] = ()
    """shapes that do not coincide with each other, in the scene's order"""
    ranks: tuple[int, ...] = ()
    """for all shapes, group by group: of several in one place, the greatest scatters"""
    pairs: tuple[tuple[Any, Any], ...] = ()
    """which coincide"""
    doubled: tuple[tuple[Any, Any], ...] = ()
    """meshes of which faces coincide with each other, back to back, as of two boxes in one mesh;
    and a mask of the one half of such faces"""


def coincident(shapes: Sequence[Any], distance: float) -> Coincident:
    """Look for shapes closer than ``distance`` over an area, one of them a boundary of a medium or
    a surface that lets rays straight through.

    Planes and triangles, spheres, and equal cylinders are looked at. None are found while a
    function is being frozen, which can read nothing.
    """
    seen = [shape for shape in shapes if shape.is_mesh() or shape.class_name() in _KINDS]
    crossed = [shape.is_medium_transition() or scatters(shape, mi.BSDFFlags.Null) for shape in seen]
    if recording() or not any(crossed):
        return Coincident()
    # Boxes are cheap to look at in each render, and nearly always tell that there is nothing.
    boxes = np.array([[*box.min, *box.max] for box in (shape.bbox() for shape in seen)])
    key: Any = distance, tuple(crossed), boxes.tobytes()
    near = _known.get(key, None, lambda: _near(boxes.reshape(-1, 2, 3), crossed, distance))
    single = [i for i, shape in enumerate(seen) if crossed[i] and _may_be_doubled(shape)]
    if not (near or single):
        return Coincident()
    involved = sorted({*single, *(i for pair in near for i in pair)})
    states = [state(seen[i]) for i in involved]
    key = (
        *key,
        *((i, seen[i].class_name(), n) for i, (_, n) in zip(involved, states, strict=True)),
    )
    pairs, doubled = _known.get(key, states, lambda: _looked_for(seen, near, single, distance))
    groups = _groups([*pairs, *((i, i) for i in doubled)])
    order = [i for group in groups for i in group]
    return Coincident(
        groups=tuple(tuple(seen[i] for i in group) for group in groups),
        # Among equals the first in the scene.
        ranks=tuple(_scattering(seen[i]) * len(seen) + len(seen) - 1 - i for i in order),
        pairs=tuple((seen[i], seen[j]) for i, j in pairs),
        doubled=tuple((seen[i], faces) for i, faces in doubled.items()),
    )


def scatters(shape: Any, flag: mi.BSDFFlags) -> bool:
    """Whether the BSDF of a shape, if it has one, has a flag."""
    bsdf = shape.bsdf()
    return bsdf is not None and bool(mi.has_flag(bsdf.flags(), flag))


def _scattering(shape: Any) -> int:
    bsdf = shape.bsdf()
    if shape.is_emitter() or bsdf is None:
        return _OPAQUE
    if bsdf.class_name() == "Null":
        return _PASSING
    through = mi.BSDFFlags.Transmission | mi.BSDFFlags.Null
    return _TRANSMITTING if mi.has_flag(bsdf.flags(), through) else _OPAQUE


def _may_be_doubled(shape: Any) -> bool:
    return bool(shape.is_mesh()) and _scattering(shape) == _PASSING


def _near(boxes: Any, crossed: list[bool], distance: float) -> list[tuple[int, int]]:
    """Pairs of shapes whose boxes touch, one of them to be crossed."""
    found: set[tuple[int, int]] = set()
    for i in np.flatnonzero(crossed).tolist():
        touching = _overlap(np.moveaxis(boxes, 1, 0), boxes[i][:, None], distance).all(axis=1)
        found |= {(min(i, j), max(i, j)) for j in np.flatnonzero(touching).tolist() if j != i}
    return sorted(found)


def _looked_for(
    shapes: list[Any], near: list[tuple[int, int]], single: list[int], distance: float
) -> tuple[list[tuple[int, int]], dict[int, Any]]:
    surfaces = {i: _Surface(shapes[i]) for pair in near for i in pair}
    pairs = [(i, j) for i, j in near if surfaces[i].meets(surfaces[j], distance)]
    doubled = {
        i: faces for i in single if (faces := _back_to_back(_triangles(shapes[i]), distance)).any()
    }
    return pairs, doubled


def _groups(pairs: list[tuple[int, int]]) -> list[list[int]]:
    """What occurs in pairs, divided so that no pair is in one group."""
    groups: list[list[int]] = []
    for i in sorted({k for pair in pairs for k in pair}):
        others = {k for pair in pairs if i in pair for k in pair if k != i}
        free = next((group for group in groups if not others & set(group)), None)
        if free is None:
            groups.append([i])
        else:
            free.append(i)
    return groups


class _Surface:
    """Where a shape is: the planes that it has parts in, or the numbers of a round one."""

    def __init__(self, shape: Any) -> None:
        self._shape, self._kind = shape, shape.class_name()
        bounds = shape.bbox()
        self.box = np.array([bounds.min, bounds.max], dtype=float)

    def meets(self, other: _Surface, distance: float) -> bool:
        """Whether both, whose boxes touch, have parts in one place."""
        if self._is_flat and other._is_flat:
            return self._shares_plane(other, distance)
        if self._kind != other._kind or self._is_flat or other._is_flat:
            return False
        return bool(np.max(np.abs(self._matrix - other._matrix)) < distance)

    @property
    def _is_flat(self) -> bool:
        return bool(self._shape.is_mesh()) or self._kind in _FLAT

    @cached_property
    def _matrix(self) -> Any:
        """Of a sphere the diagonal form, since it looks the same however it is turned."""
        if self._kind == "Sphere" and (where := place(self._shape)):
            return np.concatenate([np.array(value, dtype=float).ravel() for value in where])
        return np.array(mi.traverse(self._shape)["to_world"].matrix, dtype=float).ravel()

    @cached_property
    def _triangles(self) -> Any:
        """Corners of flat parts, shape (n, 3, 3)."""
        if self._shape.is_mesh():
            return _triangles(self._shape)
        corners = np.array([[-1, -1, 0, 1], [1, -1, 0, 1], [1, 1, 0, 1], [-1, 1, 0, 1]])
        square = (corners @ self._matrix.reshape(4, 4).T)[:, :3]
        return square[[[0, 1, 2], [2, 3, 0]]]

    def _near(self, other: _Surface, distance: float) -> Any:
        """Those of the triangles that reach into the box of another shape."""
        boxes = np.stack([self._triangles.min(axis=1), self._triangles.max(axis=1)])
        return self._triangles[_overlap(boxes, other.box[:, None], distance).all(axis=1)]

    def _shares_plane(self, other: _Surface, distance: float) -> bool:
        ours, boxes = _planes(self._near(other, distance))
        theirs, other_boxes = _planes(other._near(self, distance))
        if not (len(ours) and len(theirs)):
            return False
        # Normals that differ by an angle are apart by that angle times the size.
        size = np.array([*[np.abs([self.box, other.box]).max()] * 3, 1])
        found = cKDTree(ours * size).query_ball_tree(cKDTree(theirs * size), distance, p=np.inf)
        return any(
            np.sum(_overlap(boxes[i], other_boxes[j], -distance)) >= 2
            and _overlap(boxes[i], other_boxes[j], distance).all()
            for i, several in enumerate(found)
            for j in several
        )


def _overlap(a: Any, b: Any, margin: float) -> Any:
    """Per axis, whether boxes overlap, or come closer than ``margin``."""
    return np.minimum(a[1], b[1]) - np.maximum(a[0], b[0]) >= -margin


def _triangles(mesh: Any) -> Any:
    """Corners of a mesh's faces, shape (n, 3, 3)."""
    points = np.array(insides.vertex_positions(mesh), dtype=float).reshape(-1, 3)
    return points[np.array(insides.faces(mesh)).reshape(-1, 3)]


def _normals(triangles: Any) -> tuple[Any, Any]:
    """Unit normals and distances of triangles from the origin, (n, 4); zeros without an area. And
    the sides that they face: +1 or -1, normals being turned to have a positive main component."""
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    main = np.take_along_axis(normal, np.abs(normal).argmax(axis=1)[:, None], axis=1)
    side = np.sign(main)
    offset = np.einsum("ij,ij->i", normal * side, triangles.mean(axis=1))
    return np.concatenate([normal * side, offset[:, None]], axis=1), side.ravel()


def _keys(planes: Any) -> Any:
    """Numbers that are equal for equal planes, but for rounding: a hash of rounded numbers."""
    rounded = np.round(planes / (1e-6 * np.abs(planes).max(axis=0, initial=1e-300)))
    factors = np.array([1, 0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], np.uint64)
    return (rounded.astype(np.int64).view(np.uint64) * factors).sum(axis=1, dtype=np.uint64)


def _planes(triangles: Any) -> tuple[Any, Any]:
    """Planes of triangles, each once, and the boxes of what lies in them."""
    planes, side = _normals(triangles)
    triangles, planes = triangles[side != 0], planes[side != 0]
    _, first, which = np.unique(_keys(planes), return_index=True, return_inverse=True)
    boxes = np.stack([triangles.min(axis=1), triangles.max(axis=1)], axis=1)
    merged = boxes[first].copy()
    np.minimum.at(merged[:, 0], which, boxes[:, 0])
    np.maximum.at(merged[:, 1], which, boxes[:, 1])
    return planes[first], merged


def _back_to_back(triangles: Any, distance: float) -> Any:
    """Mask of the faces of a mesh that coincide with others that face the other way: of those that
    face the positive side."""
    planes, side = _normals(triangles)
    keys, found = _keys(planes), np.zeros(len(triangles), dtype=bool)
    front, back = np.flatnonzero(side > 0), np.flatnonzero(side < 0)
    low, high = triangles.min(axis=1), triangles.max(axis=1)
    for i in front[np.isin(keys[front], keys[back])]:
        facing = back[keys[back] == keys[i]]
        shared = np.minimum(high[i], high[facing]) - np.maximum(low[i], low[facing])
        overlaps = (shared > distance).sum(axis=1) >= 2
        found[i] = bool((overlaps & (shared > -distance).all(axis=1)).any())
    return found
