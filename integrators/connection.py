"""Next-event estimation: what arrives at a vertex along a straight line from an emitter."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from . import tracking
from .interaction import medium_interaction
from .media import Media
from .null_ball import NullBall
from .offset import Offset
from .refractive import Crossing, Line, Refraction
from .scene_needs import SceneNeeds
from .tracer import Tracer


@dataclass
class _Ray:
    """State of a shadow ray on its way through index-matched boundaries."""

    ray: Any
    """what is left of it"""
    start: Any
    """where that begins: the vertex or a point on a surface, the ray's origin stands off it"""
    location: Any
    """the medium it is in"""
    tau: Any
    """optical depth since it entered that medium"""
    from_particle: Any
    """it is still in the medium of the collision where it began"""
    transmittance: Any
    """product over surfaces passed and media left behind"""
    active: Any
    """neither blocked nor arrived"""


@dataclass
class BentRay:
    """A ray that may have come out of glass."""

    start: Any
    """where the path last scattered within"""
    p: Any
    """where it left the glass, nearly"""
    active: Any
    """it has done nothing else since then"""


@dataclass
class Hit:
    """An emitter met by a ray, as connections from where the ray began see it."""

    ds: mi.DirectionSample3f
    """the place that was met"""
    pdf: Any
    """solid-angle density with which a connection samples it"""
    ray_pdf: Any
    """solid-angle density of the ray's direction there"""
    bent: BentRay | None
    """its way out of glass"""
    weight: Any
    """share of the emission that counts"""


@dataclass
class Link:
    """A connection from a vertex to an emitter, not yet looked along."""

    light: Any
    """radiance of the emitter over the density of the connection"""
    wo: Any
    """direction from the vertex"""
    pdf: Any
    """solid-angle density there"""
    delta: Any
    """no ray finds the emitter (None: any does)"""
    active: Any
    """there is one"""
    line: Line
    """the way to the emitter, from where the glass ends if the connection bends"""
    bends: Any = None
    """it goes through glass (None: none does)"""
    crossing: Crossing | None = None
    """and where it leaves it"""

    def weight(self, ray_pdf: Any) -> Any:
        """Share of the connection that counts, if a ray takes its direction with this density."""
        if self.crossing:
            ray_pdf = dr.select(self.bends, ray_pdf * self.crossing.passing, ray_pdf)
        if self.delta is not None:
            ray_pdf = dr.select(self.delta, 0, ray_pdf)
        return power_heuristic(self.pdf, ray_pdf)


@dataclass(frozen=True)
class Connections:
    """Next-event estimation in one scene."""

    scene: mi.Scene
    tracer: Tracer
    needs: SceneNeeds
    media: Media | None
    offset: Offset
    glass: Refraction | None
    ball: NullBall | None

    def hit(
        self,
        si: mi.SurfaceInteraction3f,
        origin: Any,
        ray_pdf: Any,
        certain: Any,
        bent: BentRay | None,
        active: Any,
    ) -> Hit:
        """What a ray from ``origin`` met; ``certain``: no connection could have found it."""
        reference = dr.zeros(mi.Interaction3f)
        reference.p = origin
        if bent:
            reference.p = dr.select(bent.active, bent.start, origin)
            certain = certain & ~bent.active
        ds = mi.DirectionSample3f(self.scene, si, reference)
        pdf = self.scene.pdf_emitter_direction(reference, ds, active & ~certain)
        weight = dr.select(certain, 1, power_heuristic(ray_pdf, pdf))
        return Hit(ds, pdf, ray_pdf, bent, weight)

    def aim(
        self,
        vertex: mi.Interaction3f,
        sampler: mi.Sampler,
        active: Any,
        in_glass: Any,
        hit: Hit | None,
    ) -> Link:
        """Sample an emitter to which ``vertex`` may be connected.

        ``active`` marks the vertices that connect straight, ``in_glass`` those that do through
        glass if that is in the way. Where ``hit`` has come out of glass, it is weighed against
        connections that bend.
        """
        wanted = active | in_glass if self.glass else active
        ds, light = self.scene.sample_emitter_direction(vertex, sampler.next_2d(), False, wanted)
        delta = ds.delta if self.needs.delta_emitters else None
        line, sampled = self._line(ds), ds.pdf != 0
        if not self.glass:
            return Link(light, ds.d, ds.pdf, delta, active & sampled, line)

        # One search serves both: a ray that met an emitter, and a new connection to one.
        x, end, searching = mi.Point3f(vertex.p), line, in_glass & sampled
        bent = hit.bent if hit else None
        if hit and bent:
            x = dr.select(bent.active, bent.start, x)
            end = dr.select(bent.active, self._line(hit.ds), line)
            searching |= bent.active
        separated, crossing = self.glass.find(x, end, vertex, searching)
        if hit and bent:
            hit.weight = dr.select(bent.active, self._bent_weight(hit, bent, crossing), hit.weight)
            separated &= ~bent.active
        bends = separated & crossing.found
        density = crossing.density(ds)
        return Link(
            light=dr.select(bends, self._refracted(light, ds, crossing) / density, light),
            wo=dr.select(bends, crossing.line.d, ds.d),
            pdf=dr.select(bends, ds.pdf * density, ds.pdf),
            delta=delta,
            active=(active & sampled & ~separated) | bends,
            line=dr.select(bends, crossing.onward, line),
            bends=bends,
            crossing=crossing,
        )

    def arriving(
        self,
        link: Link,
        vertex: mi.Interaction3f,
        location: Callable[[Any], Any],
        from_particle: Any,
        sampler: mi.Sampler,
        active: Any,
    ) -> Any:
        """Light that arrives at ``vertex`` along its connection, over the density of that.

        ``location(direction)`` tells the medium in which a ray leaves the vertex; ``from_particle``
        marks the vertices that are collisions.
        """
        active = active & link.active
        media = None if self.media and self.media.all_sealed else self.media
        if not link.crossing:
            share = self._arriving(
                media, vertex, link.line, location, from_particle, sampler, active
            )
            return link.light * share

        # To the surface of the glass, and on behind it as any other connection.
        bends, si, inner = link.bends, link.crossing.si, link.crossing.line
        within = self._arriving(
            self.media, vertex, inner, location, from_particle, sampler, active & bends
        )
        surface = mi.Interaction3f(
            0,
            vertex.time,
            vertex.wavelengths,
            dr.select(bends, si.p, vertex.p),
            dr.select(bends, si.n, vertex.n),
        )

        def behind(d: Any) -> Any:
            assert media
            outside = media.behind(si, bends, location(inner.d), d)
            return dr.select(bends, outside, location(d))

        active &= ~bends | dr.any(within != 0)
        share = self._arriving(
            media, surface, link.line, behind, from_particle & ~bends, sampler, active
        )
        return mi.Spectrum(link.light * dr.select(bends, within * share, share))

    def reflected(
        self, si: mi.SurfaceInteraction3f, vertex: mi.Interaction3f, bsdf: Any, active: Any
    ) -> Any:
        """Emission that a ray would meet, were it reflected at the glass."""
        # The least random number chooses reflection.
        bs, weight = bsdf.sample(mi.BSDFContext(), si, 0.0, mi.Point2f(0.5), active)
        d = si.to_world(bs.wo)
        ray = mi.Ray3f(self.offset.onward(vertex, d), d, vertex.time, vertex.wavelengths)
        met = self.tracer.intersect(ray, False, active)
        return mi.Spectrum(weight * bs.pdf * met.emitter(self.scene).eval(met, active))

    def _refracted(self, light: Any, ds: mi.DirectionSample3f, crossing: Crossing) -> Any:
        """A sampled emitter's radiance over pdf, seen from behind the surface of glass."""
        if self.needs.near_emitters:
            # The light of a point depends on where it is seen from.
            seen = mi.DirectionSample3f(ds)
            seen.emitter = ds.emitter  # the copy has only what a position sample has
            seen.d, seen.dist = crossing.onward.d, dr.norm(ds.p - crossing.si.p)
            near = crossing.found & ds.delta
            value = self.scene.eval_emitter_direction(crossing.si, seen, near)
            near &= dr.isfinite(crossing.onward.distance)
            light = dr.select(near, value / ds.pdf, light)
        return light * crossing.transmitted

    def _bent_weight(self, hit: Hit, bent: BentRay, crossing: Crossing) -> Any:
        """Share of an emission that counts where a connection would have bent to find it."""
        connection_pdf = hit.pdf * crossing.density(hit.ds)
        weight = power_heuristic(hit.ray_pdf * crossing.passing, connection_pdf)
        # Only one of several ways through the glass is the one that connections take.
        # The ray starts off the surface, up to ten times the offset where it grazes.
        same = crossing.found & crossing.is_at(bent.p, 12 * self.offset.limit)
        return dr.select(same, weight, 1)

    def _line(self, ds: mi.DirectionSample3f) -> Line:
        """The straight line to a sampled emitter."""
        if not self.needs.infinite_emitters:
            return Line(ds.p, ds.d, ds.dist)
        infinite = mi.has_flag(ds.emitter.flags(), mi.EmitterFlags.Infinite)
        return Line(ds.p, ds.d, dr.select(infinite, dr.inf, ds.dist))

    def _arriving(
        self,
        media: Media | None,
        vertex: mi.Interaction3f,
        line: Line,
        location: Callable[[Any], Any],
        from_particle: Any,
        sampler: mi.Sampler,
        active: Any,
    ) -> Any:
        """Share of light that arrives at ``vertex`` along a line: 0 if that is blocked."""
        ray = self.offset.segment(vertex, line.p)
        if self.needs.null_surfaces and not self.ball:
            share = _walk(self, media, vertex, line, ray, location, from_particle, sampler, active)
            return dr.select(active, share, 0)
        share = mi.Spectrum(1)
        if media:
            start, distance = location(line.d), line.distance
            if self.ball:
                distance = self.ball.length(vertex.p, line.d, distance, media.inside(start))
            tau = optical_depth(media.sigma_t(start, medium_interaction(line.d, vertex)), distance)
            survival = media.survival(start, from_particle, tau)
            if media.tracks:
                tracked = active & media.tracked(start)
                onward = mi.Ray3f(vertex.p, line.d, vertex.time, vertex.wavelengths)
                survival *= tracking.transmittance(
                    media, start, onward, line.distance, sampler, tracked
                )
            share = survival if self.ball else dr.select(media.inside(start), survival, share)
        blocked = (self.ball or self.tracer).occluded(ray, active)
        return dr.select(active & ~blocked, share, 0)


def power_heuristic(a: Any, b: Any) -> Any:
    """Weight of a sample of density ``a`` that another technique finds with density ``b``."""
    weight = dr.square(a) / (dr.square(a) + dr.square(b))
    return dr.select(dr.isfinite(weight), weight, 0)


def optical_depth(sigma_t: Any, distance: Any) -> Any:
    """``sigma_t * distance``; none where a channel's extinction is zero, however far."""
    tau = sigma_t * distance
    return tau if dr.depth_v(tau) == 1 else dr.select(sigma_t > 0, tau, 0)


def _walk(
    connections: Connections,
    media: Media | None,
    vertex: mi.Interaction3f,
    line: Line,
    ray: mi.Ray3f,
    location: Any,
    from_particle: Any,
    sampler: mi.Sampler,
    active: Any,
) -> Any:
    """Transmittance to ``line.p`` past any number of surfaces that let light straight through.

    Within one medium optical depths add up across such surfaces, and the law is evaluated once,
    where the ray leaves that medium.
    """

    offset, d = connections.offset, line.d

    def remaining(s: _Ray) -> Any:
        distance = dr.dot(line.p - s.start, d)
        if not connections.needs.infinite_emitters:
            return distance
        return dr.select(dr.isinf(line.distance), dr.inf, distance)

    def body(sampler: mi.Sampler, s: _Ray) -> tuple[mi.Sampler, _Ray]:
        si = connections.tracer.intersect(s.ray, False, s.active)
        hit = s.active & si.is_valid()
        through = si.bsdf().eval_null_transmission(si, hit)
        s.transmittance = dr.select(hit, s.transmittance * through, s.transmittance)
        if media:
            # Rounding may put a surface before the one left behind.
            length = dr.maximum(dr.select(hit, dr.dot(si.p - s.start, d), remaining(s)), 0)
            inside = s.active & media.inside(s.location)
            tau = optical_depth(media.sigma_t(s.location, medium_interaction(d, vertex)), length)
            s.tau = type(s.tau)(dr.select(inside, s.tau + tau, s.tau))
            if media.tracks:
                tracked = inside & media.tracked(s.location)
                onward = mi.Ray3f(s.start, d, vertex.time, vertex.wavelengths)
                s.transmittance *= tracking.transmittance(
                    media, s.location, onward, length, sampler, tracked
                )
            beyond = media.behind(si, hit, s.location, s.ray.d)
            left = beyond != s.location
            survival = media.survival(s.location, s.from_particle, s.tau)
            s.transmittance = dr.select(left & inside, s.transmittance * survival, s.transmittance)
            s.tau = type(s.tau)(dr.select(left, 0, s.tau))
            s.from_particle &= ~left
            s.location = beyond
            s.start = si.p
        s.ray = offset.segment(si, line.p)
        s.active = hit & dr.any(s.transmittance != 0)
        return sampler, s

    start = location(d) if media else None
    state = _Ray(
        ray=ray,
        start=mi.Point3f(vertex.p) if media else None,
        location=start,
        tau=mi.UnpolarizedSpectrum(0) if media and media.chromatic else mi.Float(0),
        from_particle=mi.Bool(from_particle),
        transmittance=mi.Spectrum(1),
        active=mi.Bool(active),
    )
    _, end = dr.while_loop(
        (sampler, state), lambda sampler, s: s.active, body, label="nonexp: shadow ray"
    )
    if not media:
        return end.transmittance
    survival = media.survival(end.location, end.from_particle, end.tau)
    return dr.select(media.inside(end.location), end.transmittance * survival, end.transmittance)
