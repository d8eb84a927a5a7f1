"""Next-event estimation: what arrives at a vertex along a straight line from an emitter."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import drjit as dr
import mitsuba as mi

from . import tracking
from .adjoint import Adjoint
from .glass import Crossing, Line, Refraction
from .jit import Numbering
from .media import Media, medium_interaction, optical_depth
from .needs import SceneNeeds
from .rays import NullBall, Offset, Tracer


@dataclass
class Start:
    """Where shadow rays begin."""

    vertex: mi.Interaction3f
    """the surface or the collision, whose normal is then zero"""
    location: Callable[[Any], Any]
    """the medium in which a ray leaves in a given direction"""
    from_particle: Any
    """it is a collision (with memory: :attr:`.media.Origin.start`)"""


@dataclass
class _Ray:
    """State of a shadow ray on its way through surfaces that let light straight through."""

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
    thinning: Any
    """factor on the extinction of that medium, if it is tracked"""
    transmittance: Any
    """product over surfaces passed and media left behind"""
    left: Any
    """distance to the end of the line from the last surface"""
    nudge: Any
    """how far the ray is moved on, since it hardly got away from the last surfaces"""
    active: Any
    """neither blocked nor arrived"""
    column: Any
    """integral of the density since it entered that medium (with derivatives)"""
    length: Any
    """the distance (likewise)"""
    began: Any
    """and where it did"""
    tangent: Any
    """derivatives so far (likewise), as :attr:`.path.Path.tangent`"""


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
    """An emitter hit by a ray, as connections from where the ray began see it."""

    ds: mi.DirectionSample3f
    """the place that was hit"""
    pdf: Any
    """solid-angle density with which a connection samples it"""
    ray_pdf: Any
    """solid-angle density of the ray's direction there"""
    bent: BentRay | None
    """its way out of glass"""
    weight: Any
    """share of the emission that counts, as straight connections are concerned"""


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
    ds: Any = None
    """the emitter's place as it was sampled (None: nobody differentiates)"""

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
    silent: Numbering | None
    """BSDFs that let light straight through without telling how much"""
    adjoint: Adjoint | None = None
    """what collects derivatives, while paths are replayed"""

    def hit(
        self,
        si: mi.SurfaceInteraction3f,
        origin: Any,
        ray_pdf: Any,
        certain: Any,
        bent: BentRay | None,
        active: Any,
    ) -> Hit:
        """What a ray from ``origin`` hit; ``certain``: no connection could have found it."""
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
    ) -> tuple[Link, Any]:
        """Sample an emitter to which ``vertex`` may be connected.

        ``active`` marks the vertices that connect straight, ``in_glass`` those that do through
        glass if that is in the way. Also returns the share of the emission at ``hit`` that counts,
        weighed against connections that bend where it has come out of glass.
        """
        wanted = active | in_glass if self.glass else active
        ds, light = self.scene.sample_emitter_direction(vertex, sampler.next_2d(), False, wanted)
        delta = ds.delta if self.needs.delta_emitters else None
        line, sampled = self._line(ds), ds.pdf != 0
        weight = hit.weight if hit else None
        if not self.glass:
            link = Link(light, ds.d, ds.pdf, delta, active & sampled, line)
            return self._kept(link, ds), weight

        # One search serves both: a ray that hit an emitter, and a new connection to one.
        x, end, searching = mi.Point3f(vertex.p), line, in_glass & sampled
        bent = hit.bent if hit else None
        if hit and bent:
            x = dr.select(bent.active, bent.start, x)
            end = dr.select(bent.active, self._line(hit.ds), line)
            searching |= bent.active
        separated, crossing = self.glass.find(x, end, vertex, searching)
        if hit and bent:
            weight = dr.select(bent.active, self._bent_weight(hit, bent, crossing), weight)
            separated &= ~bent.active
        bends = separated & crossing.found
        density = crossing.density(ds)
        link = Link(
            light=dr.select(bends, self._refracted(light, ds, crossing) / density, light),
            wo=dr.select(bends, crossing.line.d, ds.d),
            pdf=dr.select(bends, ds.pdf * density, ds.pdf),
            delta=delta,
            active=(active & sampled & ~separated) | bends,
            line=dr.select(bends, crossing.onward, line),
            bends=bends,
            crossing=crossing,
        )
        return self._kept(link, ds), weight

    def _kept(self, link: Link, ds: mi.DirectionSample3f) -> Link:
        if self.adjoint:
            link.ds = ds
        return link

    def light(self, link: Link, vertex: mi.Interaction3f, active: Any) -> Any:
        """The light of a connection once more, for derivatives by emitters."""
        value = self.scene.eval_emitter_direction(vertex, link.ds, active)
        light = dr.select(active, value / link.ds.pdf, 0)
        if not link.crossing:
            return light
        bent = self._refracted(light, link.ds, link.crossing) / link.crossing.density(link.ds)
        return dr.select(link.bends, bent, light)

    def arriving(
        self, link: Link, start: Start, sampler: mi.Sampler, active: Any, shares: Any = None
    ) -> Any:
        """Share of its light that arrives at ``start`` along a connection.

        ``shares``, a list, gets what counts the derivatives of transmittance.
        """
        active = active & link.active
        media = None if self.media and self.media.all("sealed") else self.media
        if not link.crossing:
            return self._share(media, start, link.line, sampler, active, shares)

        # To the surface of the glass, and on behind it as any other connection.
        vertex, bends = start.vertex, link.bends
        si, inner = link.crossing.si, link.crossing.line
        within = self._share(self.media, start, inner, sampler, active & bends, shares)
        surface = mi.Interaction3f(
            0,
            vertex.time,
            vertex.wavelengths,
            dr.select(bends, si.p, vertex.p),
            dr.select(bends, si.n, vertex.n),
        )

        def behind(d: Any) -> Any:
            assert media
            outside = media.behind(si, bends, start.location(inner.d), d)
            return dr.select(bends, outside, start.location(d))

        active &= ~bends | dr.any(within != 0)
        exit = Start(surface, behind, start.from_particle & ~bends)
        share = self._share(media, exit, link.line, sampler, active, shares)
        return dr.select(bends, within * share, share)

    def reflected(
        self, si: mi.SurfaceInteraction3f, vertex: mi.Interaction3f, bsdf: Any, active: Any
    ) -> tuple[Any, Any]:
        """What a ray would hit, were it reflected at the glass, and the share of its emission."""
        # The least random number chooses reflection.
        bs, weight = bsdf.sample(mi.BSDFContext(), si, 0.0, mi.Point2f(0.5), active)
        d = si.to_world(bs.wo)
        ray = mi.Ray3f(self.offset.onward(vertex, d), d, vertex.time, vertex.wavelengths)
        hit = self.tracer.intersect(ray, False, active)
        return weight * bs.pdf, hit

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

    def through(self, si: Any, active: Any) -> Any:
        """Share of light that a surface lets straight through, as far as it tells."""
        share = si.bsdf().eval_null_transmission(si, active)
        return dr.select(self.silent.of(si.bsdf()) != 0, 0, share) if self.silent else share

    def _share(
        self,
        media: Media | None,
        start: Start,
        line: Line,
        sampler: mi.Sampler,
        active: Any,
        shares: Any,
    ) -> Any:
        """Share of light that arrives at ``start`` along a line: 0 if that is blocked."""
        vertex, d = start.vertex, line.d
        ray = self.offset.segment(vertex, line.p)
        if self.needs.null_surfaces and not self.ball:
            again = sampler.clone() if self.adjoint else None
            passed, _ = self._walk(media, start, line, ray, sampler, active)
            if self.adjoint and media:
                shares.append(partial(self._count, media, start, line, ray, again, active))
            return dr.select(active, passed, 0)
        share = mi.Spectrum(1)
        if media:
            location, distance = start.location(d), line.distance
            if self.ball:
                distance = self.ball.length(vertex.p, d, distance, media.inside(location))
            sigma_t = media.sigma_t(location, medium_interaction(d, vertex))
            if media.walks:
                distance = media.ask(
                    "column", location, vertex.p, d, distance, sigma_t,
                    active=active & media.inside(location),
                )  # fmt: skip
            if self.adjoint:
                # A ray past a ball may begin outside of its medium.
                where = mi.Bool(True) if self.ball else location
                counted = where, start.from_particle, distance, active & media.inside(where)
                along = vertex.p, line.distance
                shares.append(partial(self._count_one, media, d, vertex, (*counted, *along)))
            tau = optical_depth(sigma_t, distance)
            origin = media.origin(start.from_particle, vertex.wavelengths)
            survival = media.ask("survival", location, origin, tau)
            if media.tracks:
                tracked = active & media.where("tracked", location)
                onward = mi.Ray3f(vertex.p, d, vertex.time, vertex.wavelengths)
                thinning = mi.Float(1)
                if media.thins:
                    thinning = media.flight(location, origin, sampler, tracked)
                survival *= tracking.transmittance(
                    media, location, onward, line.distance, thinning, sampler, tracked
                )
            share = survival if self.ball else dr.select(media.inside(location), survival, share)
        blocked = (self.ball or self.tracer).occluded(ray, active)
        return dr.select(active & ~blocked, share, 0)

    def _count_one(
        self, media: Media, d: Any, vertex: Any, counted: tuple[Any, ...], tangent: Any, weight: Any
    ) -> Any:
        """Count the derivative of a transmittance through one medium."""
        assert self.adjoint
        visit = self.adjoint.share(media, medium_interaction(d, vertex), weight)
        return visit(tangent, *counted)

    def _count(
        self,
        media: Media,
        start: Start,
        line: Line,
        ray: mi.Ray3f,
        sampler: mi.Sampler,
        active: Any,
        tangent: Any,
        weight: Any,
    ) -> Any:
        """Count those of a transmittance past surfaces, on the same way once more."""
        assert self.adjoint
        visit = self.adjoint.share(media, medium_interaction(line.d, start.vertex), weight)
        return self._walk(media, start, line, ray, sampler, active, visit, tangent)[1]

    def _walk(
        self,
        media: Media | None,
        start: Start,
        line: Line,
        ray: mi.Ray3f,
        sampler: mi.Sampler,
        active: Any,
        visit: Any = None,
        tangent: Any = None,
    ) -> tuple[Any, Any]:
        """Transmittance along ``ray`` to the end of a line, past any number of surfaces that let
        light straight through.

        Within one medium optical depths add up across such surfaces, and the law is evaluated once,
        where the ray leaves that medium. A ray that runs along a surface, or begins on the one that
        its target lies on, is moved on by steps that double, and ends at the latest behind its
        target: the number of steps is bounded by the distance over the offset of rays.

        ``visit`` counts derivatives, for each medium where the ray leaves it: the second result is
        ``tangent`` and those.
        """
        vertex, d = start.vertex, line.d

        def remaining(s: _Ray) -> Any:
            distance = dr.dot(line.p - s.start, d)
            if not self.needs.infinite_emitters:
                return distance
            return dr.select(dr.isinf(line.distance), dr.inf, distance)

        def body(sampler: mi.Sampler, s: _Ray) -> tuple[mi.Sampler, _Ray]:
            si, contact = self.tracer.hit(s.ray, False, s.active)
            hit = s.active & si.is_valid()
            through = self.through(si, hit)
            s.transmittance = dr.select(hit, s.transmittance * through, s.transmittance)
            if media:
                # Rounding may put a surface before the one left behind.
                length = dr.maximum(dr.select(hit, dr.dot(si.p - s.start, d), remaining(s)), 0)
                inside = s.active & media.inside(s.location)
                sigma_t = media.sigma_t(s.location, medium_interaction(d, vertex))
                column = length
                if media.walks:
                    column = media.ask(
                        "column", s.location, s.start, d, length, sigma_t, active=inside
                    )
                if visit:
                    s.column = dr.select(inside, s.column + column, s.column)
                    s.length = dr.select(inside, s.length + length, s.length)
                tau = optical_depth(sigma_t, column)
                s.tau = type(s.tau)(dr.select(inside, s.tau + tau, s.tau))
                if media.tracks:
                    tracked = inside & media.where("tracked", s.location)
                    onward = mi.Ray3f(s.start, d, vertex.time, vertex.wavelengths)
                    s.transmittance *= tracking.transmittance(
                        media, s.location, onward, length, s.thinning, sampler, tracked
                    )
                beyond = media.behind(si, hit, s.location, s.ray.d, contact)
                left = beyond != s.location
                origin = media.origin(s.from_particle, vertex.wavelengths)
                survival = media.ask("survival", s.location, origin, s.tau)
                s.transmittance = dr.select(
                    left & inside, s.transmittance * survival, s.transmittance
                )
                if visit:
                    there = s.began, s.length
                    counted = s.location, s.from_particle, s.column, left & inside
                    s.tangent = visit(s.tangent, *counted, *there)
                    s.column = dr.select(left, 0, s.column)
                    s.length = dr.select(left, 0, s.length)
                    s.began = dr.select(left, si.p, s.began)
                s.tau = type(s.tau)(dr.select(left, 0, s.tau))
                s.from_particle &= ~left
                if media.thins:
                    entered = media.origin(False, vertex.wavelengths)
                    drawn = media.flight(beyond, entered, sampler, hit & left)
                    s.thinning = dr.select(left, drawn, s.thinning)
                s.location = beyond
                s.start = si.p
            left = dr.dot(line.p - si.p, d)
            stuck = s.left - left < self.offset.limit
            s.nudge = dr.select(stuck, dr.fma(2, s.nudge, self.offset.limit / 16), 0)
            s.left = left
            s.ray = self.offset.segment(si, line.p)
            s.ray.o = dr.fma(d, s.nudge, s.ray.o)
            s.ray.maxt -= s.nudge
            s.active = hit & dr.any(s.transmittance != 0) & (s.ray.maxt > 0)
            s.active &= dr.dot(line.p - s.ray.o, d) > 0
            return sampler, s

        thinning = mi.Float(1)
        if media and media.thins:
            origin = media.origin(start.from_particle, vertex.wavelengths)
            thinning = media.flight(start.location(d), origin, sampler, active)
        state = _Ray(
            ray=ray,
            start=mi.Point3f(vertex.p) if media else None,
            location=start.location(d) if media else None,
            tau=mi.UnpolarizedSpectrum(0) if media and media.chromatic else mi.Float(0),
            from_particle=type(start.from_particle)(start.from_particle),
            thinning=thinning,
            transmittance=mi.Spectrum(1),
            left=dr.dot(line.p - vertex.p, d),
            nudge=mi.Float(0),
            active=mi.Bool(active),
            column=mi.Float(0) if visit else None,
            length=mi.Float(0) if visit else None,
            began=mi.Point3f(vertex.p) if visit else None,
            tangent=tangent,
        )
        _, end = dr.while_loop(
            (sampler, state), lambda sampler, s: s.active, body, label="nonexp: shadow ray"
        )
        if not media:
            return end.transmittance, None
        within = media.inside(end.location)
        origin = media.origin(end.from_particle, vertex.wavelengths)
        survival = media.ask("survival", end.location, origin, end.tau)
        passed = dr.select(within, end.transmittance * survival, end.transmittance)
        if visit:
            there = active & within
            counted = end.location, end.from_particle, end.column, there
            tangent = visit(end.tangent, *counted, end.began, end.length)
        return passed, tangent


def power_heuristic(a: Any, b: Any) -> Any:
    """Weight of a sample of density ``a`` that another technique finds with density ``b``."""
    weight = dr.square(a) / (dr.square(a) + dr.square(b))
    return dr.select(dr.isfinite(weight), weight, 0)
