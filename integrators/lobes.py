"""Which shapes of a scene connections can bend through, and where that helps."""

from __future__ import annotations

from typing import Any

import mitsuba as mi

from .closed import encloses
from .entries import entry_of

_SMOOTH = ("Sphere", "Cylinder", "Disk", "Rectangle")


def lobes(scene: mi.Scene, shapes: list[Any], wanted: str) -> tuple[Any, ...]:
    """Shapes with a smooth dielectric surface: those of use (``auto``), all (``on``), none."""
    if wanted == "off" or (wanted == "auto" and not _finds_light(scene)):
        return ()
    present = set(map(id, scene.shapes()))  # not those that exist as instances alone
    found = [shape for shape in shapes if id(shape) in present and bends(shape)]
    if wanted == "auto":
        found = [shape for shape in found if _holds_something(shape, shapes)]
    return tuple(found)


def bends(shape: Any) -> bool:
    """Whether connections can bend through a shape: its normals turn smoothly, and are known."""
    bsdf = shape.bsdf()
    if bsdf is None or bsdf.class_name() != "SmoothDielectric" or shape.has_flipped_normals():
        return False
    if shape.is_mesh():
        return bool(shape.has_vertex_normals() and not shape.has_face_normals())
    return shape.class_name() in _SMOOTH


def _finds_light(scene: mi.Scene) -> bool:
    """Light comes from some direction rather than from everywhere, where any ray finds it."""
    return any(emitter.class_name() != "ConstantBackgroundEmitter" for emitter in scene.emitters())


def _holds_something(lobe: Any, shapes: list[Any]) -> bool:
    """Connections may begin behind the surface: in a medium, or on something within."""
    medium = lobe.interior_medium()
    if medium is not None:
        entry = entry_of(medium, sealed=True)
        if entry is not None and entry.samples:
            return True
    return encloses(lobe) and any(
        shape.bsdf() is not None
        and mi.has_flag(shape.bsdf().flags(), mi.BSDFFlags.Smooth)
        and lobe.bbox().contains(shape.bbox())
        for shape in shapes
    )
