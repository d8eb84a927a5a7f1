"""Scenes of some of a scene's shapes, so that rays meet nothing else."""

from __future__ import annotations

from collections import OrderedDict
from typing import Any

import mitsuba as mi

_KEPT = 4
_PLACED = ("Sphere", "Cylinder", "Disk", "Rectangle")


class Subscenes:
    """Scenes of some shapes, each built once for each state of their geometry.

    An integrator keeps its own, so that they go when its scene goes: objects that are still there
    are part of the kernels of all other scenes.
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


def is_watched(shape: Any) -> bool:
    """Whether a change of a shape's geometry is noticed here: others must not be used."""
    return bool(shape.is_mesh()) or shape.class_name() in _PLACED


def _state(shape: Any) -> tuple[Any, ...]:
    """What changes with a shape's geometry, behind the arrays that this refers to."""
    if shape.is_mesh():
        positions, faces = shape.vertex_positions_buffer(), shape.faces_buffer()
        return (positions, faces), positions.index, faces.index
    matrix = mi.traverse(shape)["to_world"].matrix
    return (matrix, *(entry.index for row in matrix for entry in row))
