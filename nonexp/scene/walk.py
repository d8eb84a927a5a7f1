"""The objects that a scene holds, wherever they hang."""

from __future__ import annotations

from typing import Any

import mitsuba as mi

from ..system import insides

__all__ = ["media", "shapes"]


def shapes(scene: mi.Scene) -> list[Any]:
    """All shapes, also those that are only there as instances."""
    direct = scene.shapes()
    if any(shape.class_name() == "Instance" for shape in direct):
        return insides.nested(scene, mi.Shape)
    return direct


def media(scene: mi.Scene) -> list[Any]:
    """All media, each once: on shapes, then on sensors, then on emitters."""
    found: list[Any] = []
    sides = (
        medium
        for shape in shapes(scene)
        for medium in (shape.interior_medium(), shape.exterior_medium())
    )
    ends = (end.get_medium() for end in (*scene.sensors(), *scene.emitters()))
    for medium in (*sides, *ends):
        if medium is not None and medium not in found:
            found.append(medium)
    return found
