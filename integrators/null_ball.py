"""Shadow rays past a single index-matched sphere, without walking through it.

Where a sphere is the only surface that lets rays straight through, it is known where a ray enters
and leaves its medium, and whether anything else is in the way is one occlusion test.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from .jit import recording
from .scene_needs import SceneNeeds
from .sphere import centre_and_radius
from .subscene import Subscenes

MOST_FACES = 1 << 14
"""Scenes with more than this are not held in memory twice."""

MOST_SHAPES = 64
"""With more than this, looking whether one has changed takes milliseconds in each render."""


class NullBall:
    """The sphere, and a scene of all other shapes, if there are any."""

    def __init__(self, ball: Any, others: mi.Scene | None) -> None:
        self._centre, self._radius = centre_and_radius(ball)
        self._others = others

    @staticmethod
    def of(scene: mi.Scene, needs: SceneNeeds, subscenes: Subscenes) -> NullBall | None:
        """The sphere of a scene that has just one, and no other null surface or medium."""
        ball = needs.null_ball
        if ball is None:
            return None
        others = tuple(shape for shape in scene.shapes() if shape != ball)
        if len(others) > MOST_SHAPES or any(s.class_name() == "Instance" for s in others):
            return None
        if others and recording():
            return None
        faces = sum(shape.face_count() if shape.is_mesh() else 1 for shape in others)
        if faces > MOST_FACES:
            return None
        return NullBall(ball, subscenes.of(others) if others else None)

    def ray_test(self, ray: Any, active: Any) -> Any:
        """Whether anything but the sphere is on a shadow ray."""
        return self._others.ray_test(ray, active) if self._others else mi.Bool(False)

    def length(self, p: Any, d: Any, distance: Any, inside: Any) -> Any:
        """Length inside the sphere of a line from ``p``, itself ``inside`` or not."""
        # The distance of the line from the centre, by a difference that does not cancel.
        o = p - self._centre
        along = -dr.dot(o, d)
        off = dr.fma(self._radius, self._radius, -dr.squared_norm(dr.fma(along, d, o)))
        half = dr.sqrt(dr.maximum(off, 0))
        near = dr.select(inside, 0, dr.maximum(along - half, 0))
        return dr.maximum(dr.minimum(along + half, distance) - near, 0)
