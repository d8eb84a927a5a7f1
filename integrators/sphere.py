"""Where a sphere of a scene is."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from .jit import opaque, recording


def place(shape: mi.Shape) -> tuple[Any, Any] | None:
    """Centre and radius, no part of the kernel; None for other shapes.

    What a transformation has bent out of shape is no sphere any more (while a function is being
    frozen, this cannot be told).
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
