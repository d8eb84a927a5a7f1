"""Whether a shape encloses a volume: no gap through which its inside could be reached."""

from __future__ import annotations

from collections import OrderedDict
from typing import Any

import mitsuba as mi
import numpy as np

_known: OrderedDict[tuple[int, int], tuple[Any, bool]] = OrderedDict()
_KEPT = 64


def encloses(shape: mi.Shape) -> bool:
    """Whether the side that ``shape``'s normals turn away from is a closed volume.

    Certain for spheres and meshes; False for all other shapes.
    """
    if shape.has_flipped_normals():
        return False
    if shape.is_mesh():
        return _watertight(shape)
    return bool(shape.shape_type() == mi.ShapeType.Sphere)


def _watertight(mesh: Any) -> bool:
    """Every edge belongs to two faces that run through it in opposite directions, and the faces
    turn outwards. Vertices count as one where they coincide. Asked once per state of the mesh."""
    positions, faces = mesh.vertex_positions_buffer(), mesh.faces_buffer()
    key = (positions.index, faces.index)
    if key not in _known:
        # Holding the arrays keeps their numbers from being given to others.
        _known[key] = (positions, faces), _is_watertight(np.array(positions), np.array(faces))
        if len(_known) > _KEPT:
            _known.popitem(last=False)
    _known.move_to_end(key)
    return _known[key][1]


def _is_watertight(positions: Any, faces: Any) -> bool:
    points = positions.reshape(-1, 3)
    _, same = np.unique(points, axis=0, return_inverse=True)
    corners = same.reshape(-1)[faces.reshape(-1, 3)].astype(np.int64)
    proper = np.all(corners != np.roll(corners, 1, axis=1), axis=1)  # no area, no hole either
    corners, triangles = corners[proper], points[faces.reshape(-1, 3)][proper].astype(float)
    if not len(corners):
        return False
    ahead = np.concatenate([corners[:, [i, (i + 1) % 3]] for i in range(3)])
    count = corners.max() + 1
    forth = np.sort(ahead[:, 0] * count + ahead[:, 1])
    back = np.sort(ahead[:, 1] * count + ahead[:, 0])
    if np.any(forth[1:] == forth[:-1]) or np.any(forth != back):
        return False
    a, b, c = np.moveaxis(triangles - triangles.mean(axis=(0, 1)), 1, 0)
    return bool(np.sum(a * np.cross(b, c)) > 0)
