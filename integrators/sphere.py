"""Where a sphere of a scene is."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from .jit import opaque


def centre_and_radius(shape: mi.Shape) -> tuple[Any, Any]:
    """Centre and radius of a sphere, no part of the kernel."""
    box = shape.bbox()
    return opaque(mi.Point3f, box.center()), opaque(mi.Float, 0.5 * float(dr.max(box.extents())))
