"""Rays that leave a surface start a little off it, so that they do not meet it again.

Mitsuba's own distance, ``(1 + |p|) RayEpsilon``, is about 1e-4 of a scene unit however small the
scene, and lies along the normal, so that the ray runs beside the line that it stands for. A medium
notices both: here the distance follows the size of the scene, to what single precision needs, and
the ray starts on its own line unless it grazes the surface.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from .jit import opaque

# In steps of the coordinates' precision: what intersections and positions may be off by.
_STEPS = 64
_GRAZING = 0.1


class Offset:
    """Origins of rays that leave the surfaces of one scene."""

    def __init__(self, scene: mi.Scene) -> None:
        epsilon = float(dr.epsilon(mi.Float))
        self._relative = 1500 * epsilon  # Mitsuba's RayEpsilon
        box = scene.bbox()
        extent = np.max(np.abs([box.min, box.max])) if box.valid() else 0.0
        limit = _STEPS * epsilon * min(float(extent), 1e30)
        self.limit = opaque(mi.Float, limit)
        """Greatest distance, but for surfaces that a ray grazes."""

    def onward(self, vertex: Any, d: Any) -> Any:
        """Where the path goes on from ``vertex`` in direction ``d``; there itself if ``vertex.n``
        is zero, as at collisions."""
        size, cosine = self._size(vertex), dr.dot(vertex.n, d)
        steep = dr.abs(cosine) > _GRAZING
        along_ray = size / dr.abs(dr.select(steep, cosine, 1)) * d
        along_normal = dr.mulsign(size, cosine) * vertex.n
        step = dr.select(steep, mi.Vector3f(along_ray), mi.Vector3f(along_normal))
        return mi.Point3f(vertex.p + step)

    def segment(self, vertex: Any, target: Any) -> Any:
        """Ray from ``vertex`` to just before ``target``."""
        toward = target - vertex.p
        size = dr.mulsign(self._size(vertex), dr.dot(vertex.n, toward))
        origin = mi.Point3f(dr.fma(size, vertex.n, vertex.p))
        d = target - origin
        distance = dr.norm(d)
        length = distance * (1 - 10 * self._relative)
        return mi.Ray3f(origin, d / distance, length, vertex.time, vertex.wavelengths)

    def _size(self, vertex: Any) -> Any:
        mitsubas = (1 + dr.max(dr.abs(vertex.p))) * self._relative
        return dr.minimum(mitsubas, self.limit)
