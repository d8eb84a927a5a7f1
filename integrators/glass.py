"""Connections that bend: from a point inside glass, through its surface, to a point on an emitter.

Where a straight line from ``x`` to ``y`` leaves a body of glass, light does not follow it. It
follows the path ``x - p - y`` on which the generalised half vector ``eta_in w_i + eta_out w_o`` at
the surface point ``p`` is parallel to the normal (Walter, Zhao, Holzschuch, Bala 2009). Newton's
method finds ``p`` (manifold next-event estimation: Hanika, Droske, Fascione 2015; Zeltner,
Georgiev, Jakob 2020). The search starts where the straight line meets the surface and takes no
random numbers, so that ``x`` and ``y`` determine what it finds, if anything: its density is known,
and it can be weighed against paths that find the emitter by chance.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from nonexp.system import insides

from .jit import Numbering, opaque, recording
from .rays import Subscenes, place

STEPS = 16
"""Most points that a search looks at."""

SHORTEST = 1 / 64
"""Newton's steps are halved where they lead astray, down to this."""

TOLERANCE = 2e-5
"""Greatest component of the half vector along the surface: some radians of the direction."""

SAME = 1e-3
"""Two crossings are one if they are closer than this fraction of their distance from ``x``."""


@dataclass
class Line:
    """A straight line to somewhere."""

    p: Any
    """its end"""
    d: Any
    """its direction"""
    distance: Any
    """its length, infinite if it leads to an emitter at infinity"""


@dataclass
class Crossing:
    """The place where a connection passes through a surface."""

    found: Any
    """there is one"""
    si: Any
    """the surface there, seen from inside"""
    line: Line
    """the way there from inside"""
    onward: Line
    """the way from there to the emitter"""
    spread: Any
    """solid angle within per solid angle without"""
    passing: Any
    """probability with which the surface lets a ray through"""
    transmitted: Any
    """radiance within per radiance without, a spectrum"""

    def density(self, ds: Any) -> Any:
        """Solid-angle density of this connection to a sampled emitter, over that of ``ds``.

        Both are taken where the connection starts; ``ds`` leads straight to the emitter.
        """
        per_angle = dr.rcp(self.spread)
        distance = self.onward.distance
        straight = dr.abs(dr.dot(ds.d, ds.n)) / dr.square(ds.dist)
        behind = dr.maximum(-dr.dot(self.onward.d, ds.n), 0) / dr.square(distance)
        of_area = dr.isfinite(distance) & ~ds.delta
        return per_angle * dr.select(of_area, straight / behind, 1)

    def is_at(self, p: Any, precision: Any) -> Any:
        """Whether ``p`` is the place, but for rounding and for the ``precision`` of ``p``."""
        return dr.norm(p - self.si.p) < dr.fma(SAME, self.line.distance, precision)


@dataclass
class _Point:
    """A surface as a search sees it; derivatives are by two coordinates along the surface."""

    p: Any
    """position"""
    n: Any
    """shading normal, outwards"""
    dp: tuple[Any, Any]
    """derivatives of the position"""
    dn: tuple[Any, Any]
    """derivatives of the normal"""
    valid: Any
    """there is such a point, and the ray comes from inside"""
    lobe: Any = None
    """which of several surfaces it is on"""


@dataclass
class _Search:
    """State of Newton's method."""

    p: Any
    """the best point so far"""
    error: Any
    """the half vector's component along the surface there, squared"""
    step: Any
    """where Newton's method leads from there"""
    share: Any
    """how much of this step is taken next"""
    count: Any
    """number of points looked at"""
    active: Any
    """the search goes on"""


def refraction(lobes: tuple[Any, ...], subscenes: Subscenes) -> Refraction | None:
    """The smooth dielectric shapes through which connections bend; None if there is none."""
    where = place(lobes[0]) if len(lobes) == 1 else None
    if where:
        return Ball(lobes[0], *where)
    return Surfaces(lobes, subscenes.of(lobes)) if lobes and not recording() else None


class Refraction(ABC):
    """Smooth dielectric surfaces, and the search for crossings."""

    @abstractmethod
    def eta(self, point: _Point) -> Any:
        """Relative index of refraction, inside to outside."""

    @abstractmethod
    def first(self, x: Any, d: Any, active: Any) -> _Point:
        """The first point of a surface in direction ``d`` from ``x``."""

    @abstractmethod
    def moved(self, x: Any, p: Any, step: Any, start: _Point, active: Any) -> _Point:
        """The point next to ``p + step``, on the surface where the search had its ``start``."""

    @abstractmethod
    def surface(self, x: Any, w: Any, it: Any, active: Any) -> tuple[Any, Any]:
        """Surface interaction, and BSDF, where a ray from ``x`` leaves the glass."""

    @abstractmethod
    def meets(self, si: Any) -> Any:
        """Whether a ray met one of the surfaces, from outside."""

    def find(self, x: Any, straight: Line, it: Any, active: Any) -> tuple[Any, Crossing]:
        """Search the crossing on the way from ``x`` to where a straight line leads.

        Also returns the mask of the lanes in which a surface is in the way of that line: there no
        straight connection is possible. ``it`` has the time and the wavelengths.
        """
        with dr.suspend_grad():
            return self._find(dr.detach(x), dr.detach(straight), it, active)

    def _find(self, x: Any, target: Line, it: Any, active: Any) -> tuple[Any, Crossing]:
        start = self.first(x, target.d, active)
        separated = active & start.valid & (dr.norm(start.p - x) < target.distance)
        eta = self.eta(start)
        error, step, _ = _newton(start, x, target, eta)
        state = _Search(
            p=mi.Point3f(start.p),
            error=error,
            step=step,
            share=mi.Float(1),
            count=mi.UInt32(0),
            active=separated & (error > TOLERANCE**2),
        )

        def look(s: _Search) -> _Search:
            trial = self.moved(x, s.p, s.share * s.step, start, s.active)
            error, step, _ = _newton(trial, x, target, eta)
            better = s.active & trial.valid & (error < s.error)
            s.p = dr.select(better, trial.p, s.p)
            s.error = dr.select(better, error, s.error)
            s.step = dr.select(better, step, s.step)
            s.share = dr.select(better, dr.minimum(2 * s.share, 1), 0.5 * s.share)
            s.count += 1
            s.active &= (s.error > TOLERANCE**2) & (s.count < STEPS) & (s.share > SHORTEST)
            return s

        (end,) = dr.while_loop(
            (state,), lambda s: s.active, lambda s: (look(s),), label="nonexp: refraction"
        )
        found = separated & (end.error <= TOLERANCE**2)
        return separated, self._crossing(x, target, end.p, start, eta, it, found)

    def _crossing(
        self, x: Any, target: Line, p: Any, start: _Point, eta: Any, it: Any, found: Any
    ) -> Crossing:
        w = p - x
        distance = dr.norm(w)
        w /= distance
        point = self.moved(x, p, mi.Vector3f(0), start, found)
        _, _, spread = _newton(point, x, target, eta)
        onward = _line(p, target)
        si, bsdf = self.surface(x, w, it, found)
        # The half vector is also parallel to the normal where light is reflected.
        for n in (point.n, si.n):
            found &= (dr.dot(w, n) > 0) & (dr.dot(onward.d, n) > 0)
        found &= point.valid & dr.isfinite(spread) & (spread > 0)
        # The greatest random number chooses transmission, unless all is reflected.
        sample, weight = bsdf.sample(mi.BSDFContext(), si, 1.0, mi.Point2f(0.5), found)
        found &= mi.has_flag(sample.sampled_type, mi.BSDFFlags.DeltaTransmission)
        return Crossing(
            found=found,
            si=si,
            line=Line(mi.Point3f(si.p), mi.Vector3f(w), distance),
            onward=onward,
            spread=spread,
            passing=sample.pdf,
            transmitted=weight * sample.pdf,
        )


def _line(p: Any, target: Line) -> Line:
    """From a point on the surface to where ``target`` leads."""
    infinite = dr.isinf(target.distance)
    away = target.p - p
    distance = dr.norm(away)
    d = dr.select(infinite, target.d, away / distance)
    # Emitters at infinity stand somewhere behind all that is in the scene.
    end = dr.select(infinite, p + target.d * distance, target.p)
    return Line(mi.Point3f(end), mi.Vector3f(d), dr.select(infinite, dr.inf, distance))


def _newton(point: _Point, x: Any, target: Line, eta: Any) -> tuple[Any, Any, Any]:
    """One look at a point of the surface.

    Returns the squared length of the half vector's component along the surface, Newton's step
    towards the point where it is zero, and the spread there: solid angle at ``x`` per solid angle
    behind the surface.
    """
    n = point.n
    onward = _line(point.p, target)
    w_i, w_o = x - point.p, onward.d
    near, far = dr.rcp(dr.norm(w_i)), dr.rcp(onward.distance)
    w_i *= near
    h = dr.fma(eta, w_i, w_o)
    along_n = dr.dot(h, n)
    s = dr.normalize(point.dp[0] - n * dr.dot(n, point.dp[0]))
    t = dr.cross(n, s)
    c_s, c_t = dr.dot(h, s), dr.dot(h, t)

    def change(dp: Any, dn: Any) -> tuple[Any, Any]:
        a = (eta * near) * (w_i * dr.dot(w_i, dp) - dp) + far * (w_o * dr.dot(w_o, dp) - dp)
        a -= along_n * dn
        return dr.dot(a, s), dr.dot(a, t)

    s_u, t_u = change(point.dp[0], point.dn[0])
    s_v, t_v = change(point.dp[1], point.dn[1])
    det = dr.fma(s_u, t_v, -s_v * t_u)
    safe = dr.select(det != 0, det, dr.inf)
    u = (s_v * c_t - t_v * c_s) / safe
    v = (t_u * c_s - s_u * c_t) / safe
    area = dr.abs(dr.dot(dr.cross(point.dp[0], point.dp[1]), w_i))
    spread = area * dr.square(near) * dr.abs(dr.dot(n, w_o)) / dr.abs(safe)
    return dr.square(c_s) + dr.square(c_t), u * point.dp[0] + v * point.dp[1], spread


class Ball(Refraction):
    """A single sphere: everything in closed form."""

    def __init__(self, shape: Any, centre: Any, radius: Any) -> None:
        self._shape, self._bsdf = shape, shape.bsdf()
        self._centre, self._radius = centre, radius
        self._eta = opaque(mi.Float, _eta(shape))

    def eta(self, point: _Point) -> Any:
        return self._eta

    def first(self, x: Any, d: Any, active: Any) -> _Point:
        d = dr.normalize(d)
        o = x - self._centre
        b, c = dr.dot(o, d), dr.fma(self._radius, self._radius, -dr.squared_norm(o))
        t = dr.sqrt(dr.maximum(dr.fma(b, b, c), 0)) - b
        return self._at(x + t * d, c > 0)

    def moved(self, x: Any, p: Any, step: Any, start: _Point, active: Any) -> _Point:
        # A step beyond the horizon would come back to the same side.
        size = dr.norm(step)
        step = step * dr.minimum(1, 0.5 * self._radius / dr.maximum(size, 1e-30))
        return self._at(p + step, mi.Bool(True))

    def meets(self, si: Any) -> Any:
        return (si.shape == mi.ShapePtr(self._shape)) & (si.wi.z > 0)

    def surface(self, x: Any, w: Any, it: Any, active: Any) -> tuple[Any, Any]:
        ray = mi.Ray3f(x, w, it.time, it.wavelengths)
        si = self._shape.ray_intersect(ray, mi.RayFlags.All, active)
        return si, self._bsdf

    def _at(self, near: Any, valid: Any) -> _Point:
        n = dr.normalize(near - self._centre)
        s, t = mi.coordinate_system(n)
        curvature = dr.rcp(self._radius)
        p = dr.fma(self._radius, n, self._centre)
        return _Point(p, n, (s, t), (s * curvature, t * curvature), valid)


class Surfaces(Refraction):
    """Any smooth surfaces, several ones, meshes with vertex normals among them.

    They are looked for in a scene of their own, so that nothing inside is in the way of a search.
    """

    def __init__(self, shapes: tuple[Any, ...], scene: mi.Scene) -> None:
        self._scene = scene
        self._alone = shapes[0] if len(shapes) == 1 else None
        self._meshes = any(shape.is_mesh() for shape in shapes)
        self._others = any(not shape.is_mesh() for shape in shapes)
        self._etas = dr.concat([opaque(mi.Float, _eta(shape)) for shape in shapes])
        self._numbering = Numbering([mi.ShapePtr(shape) for shape in shapes])

    def eta(self, point: _Point) -> Any:
        if self._alone:
            return self._etas
        return dr.gather(mi.Float, self._etas, point.lobe - 1, point.valid)

    def first(self, x: Any, d: Any, active: Any) -> _Point:
        d = dr.normalize(d)
        flags = mi.RayFlags.All
        if self._others:
            flags |= insides.normal_derivatives()
        si = self._scene.ray_intersect(mi.Ray3f(x, d), flags, False, active)
        dp, dn = (si.dp_du, si.dp_dv), (si.dn_du, si.dn_dv)
        if self._meshes:
            mesh = self._alone or mi.MeshPtr(si.shape)
            of_mesh = _mesh_derivatives(mesh, si, active & si.is_valid())
            if self._others:
                is_mesh = si.shape.is_mesh()
                dp, dn = dr.select(is_mesh, of_mesh, (dp, dn))
            else:
                dp, dn = of_mesh
        n = si.sh_frame.n
        valid = si.is_valid() & (dr.dot(d, n) > 0) & (dr.dot(d, si.n) > 0)
        lobe = None if self._alone else self._numbering.of(si.shape)
        return _Point(si.p, n, dp, dn, valid, lobe)

    def moved(self, x: Any, p: Any, step: Any, start: _Point, active: Any) -> _Point:
        point = self.first(x, p + step - x, active)
        if not self._alone:
            point.valid &= point.lobe == start.lobe
        return point

    def meets(self, si: Any) -> Any:
        return (self._numbering.of(si.shape) != 0) & (si.wi.z > 0)

    def surface(self, x: Any, w: Any, it: Any, active: Any) -> tuple[Any, Any]:
        ray = mi.Ray3f(x, w, it.time, it.wavelengths)
        si = self._scene.ray_intersect(ray, mi.RayFlags.All, False, active)
        return si, self._alone.bsdf() if self._alone else si.bsdf()


def _mesh_derivatives(mesh: Any, si: Any, active: Any) -> Any:
    """Derivatives of position and normal on a triangle, by its barycentric coordinates.

    Those of a surface interaction do not belong together on meshes with texture coordinates.
    """
    corners = mesh.face_indices(si.prim_index, active)
    p = [mesh.vertex_position(corner, active) for corner in corners]
    n = [mesh.vertex_normal(corner, active) for corner in corners]
    u, v = _barycentric(p, si.p)
    mean = n[0] + u * (n[1] - n[0]) + v * (n[2] - n[0])
    length = dr.rcp(dr.norm(mean))
    unit = mean * length

    def turned(change: Any) -> Any:
        return length * (change - unit * dr.dot(unit, change))

    return (
        (mi.Vector3f(p[1] - p[0]), mi.Vector3f(p[2] - p[0])),
        (mi.Vector3f(turned(n[1] - n[0])), mi.Vector3f(turned(n[2] - n[0]))),
    )


def _barycentric(corners: list[Any], p: Any) -> tuple[Any, Any]:
    a, b, c = corners[1] - corners[0], corners[2] - corners[0], p - corners[0]
    aa, ab, bb = dr.squared_norm(a), dr.dot(a, b), dr.squared_norm(b)
    ac, bc = dr.dot(a, c), dr.dot(b, c)
    det = dr.rcp(dr.fma(aa, bb, -ab * ab))
    return (bb * ac - ab * bc) * det, (aa * bc - ab * ac) * det


def _eta(shape: Any) -> Any:
    return mi.traverse(shape.bsdf())["eta"]
