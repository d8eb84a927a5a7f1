"""Shadow rays past a single index-matched sphere, without walking through it.

Where a sphere is the only surface that lets rays straight through, it is known where a ray enters
and leaves its medium, and whether anything else is in the way is one occlusion test.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from .scene_needs import SceneNeeds
from .tracer import Tracer


class NullBall:
    """The sphere, among all other shapes."""

    def __init__(self, sphere: Any, tracer: Tracer) -> None:
        self._sphere, self._tracer = sphere, tracer

    @staticmethod
    def of(needs: SceneNeeds, tracer: Tracer) -> NullBall | None:
        """The sphere of a scene that has just one, and no other null surface or medium."""
        found = [sphere for sphere in tracer.spheres if sphere.shape == needs.null_ball]
        return NullBall(found[0], tracer) if found else None

    def occluded(self, ray: mi.Ray3f, active: Any) -> Any:
        """Whether anything but the sphere is on a shadow ray."""
        return self._tracer.occluded(ray, active, passing=self._sphere.shape)

    def length(self, p: Any, d: Any, distance: Any, inside: Any) -> Any:
        """Length inside the sphere of a line from ``p``, itself ``inside`` or not."""
        square, middle = self._sphere.chord(p, d)
        half = dr.sqrt(dr.maximum(square, 0))
        near = dr.select(inside, 0, dr.maximum(middle - half, 0))
        return dr.maximum(dr.minimum(middle + half, distance) - near, 0)
