"""Where a sphere of a scene is."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from .jit import opaque


def is_plain(shape: mi.Shape) -> bool:
    """Whether a shape is a sphere, and not one that a transformation has bent out of shape."""
    if shape.class_name() != "Sphere":
        return False
    matrix = np.array(mi.traverse(shape)["to_world"].matrix, dtype=float).reshape(4, 4)
    square = matrix[:3, :3].T @ matrix[:3, :3]
    return bool(np.allclose(square, square[0, 0] * np.eye(3), rtol=0, atol=1e-5 * square[0, 0]))


def centre_and_radius(shape: mi.Shape) -> tuple[Any, Any]:
    """Centre and radius of a sphere, no part of the kernel."""
    matrix = mi.traverse(shape)["to_world"].matrix
    axis = mi.Vector3f(matrix[0, 0], matrix[1, 0], matrix[2, 0])
    centre = mi.Point3f(matrix[0, 3], matrix[1, 3], matrix[2, 3])
    return opaque(mi.Point3f, centre), opaque(mi.Float, dr.norm(axis))
