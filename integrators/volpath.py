"""The volumetric path tracer for media with any transmittance law.

Evaluated anew for each variant by :mod:`nonexp.plugins`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import drjit as dr
import mitsuba as mi

from . import tracking
from .connection import BentRay, Connections, optical_depth
from .interaction import medium_interaction
from .media import scene_media
from .null_ball import NullBall
from .offset import Offset
from .refractive import refraction
from .scene_needs import SceneNeeds
from .spectral import at_channel, balanced, draw_channel
from .subscene import Subscenes
from .surface import eval_pdf_sample
from .tracer import Tracer


@dataclass
class _Path:
    """What a path carries from event to event; fields that a scene does not need are None."""

    active: Any
    """still on its way"""
    depth: Any
    """number of scattering events so far, straight passes not counted"""
    o: Any
    """origin of the ray"""
    d: Any
    """direction of the ray"""
    throughput: Any
    """product of sampling weights"""
    radiance: Any
    """collected so far"""
    opaque: Any
    """the camera ray met something: alpha of the pixel"""
    eta: Any
    """product of relative indices of refraction"""
    pdf: Any
    """solid-angle density with which the last event chose its direction"""
    certain: Any
    """no connection could have found what this ray finds: emission counts in full"""
    location: Any
    """the medium that the ray runs in"""
    from_particle: Any
    """the flight began at a collision"""
    far: Any
    """length of the ray: that of the camera's ray, then infinite"""
    offset: Any
    """from the last event to the ray's origin, which stands off surfaces (media only)"""
    vertex: Any
    """position of the last event (only where rays pass straight through surfaces)"""
    fresh: Any
    """the flight begins here (only where rays pass straight through surfaces)"""
    tau: Any
    """optical depth left on this flight (only where rays pass straight through surfaces)"""
    drawn: Any
    """optical depth of this flight in all (likewise, and chromatic)"""
    flown: Any
    """distance from where this flight began to the last event (likewise, and chromatic)"""
    balance: Any
    """weight of each channel, with mean 1 (only with chromatic extinction)"""
    anchor: Any
    """last event that connected through glass (only where connections bend)"""
    armed: Any
    """the path comes straight from there (likewise)"""
    crossed: Any
    """it has since left the glass, and done nothing else (likewise)"""
    seen: Any
    """emission that the ray meets is already counted (likewise)"""


class NonexpVolpath(mi.SamplingIntegrator):
    """Plugin ``nonexp_volpath``: volumetric path tracing, whatever the law of transmittance.

    Unidirectional, with next-event estimation and multiple importance sampling at surfaces and
    at collisions. Parameters, with Mitsuba's meanings and defaults:

    ``max_depth`` (integer, default -1)
        Longest path: 1 sees emitters only, 2 adds single scattering, ...; -1: no limit.
    ``rr_depth`` (integer > 0, default 5)
        Depth beyond which paths end by Russian roulette.
    ``hide_emitters`` (boolean, default false)
        Do not show emitters to the camera directly.
    ``refractive_nee`` (``auto``, ``on`` or ``off``, default ``auto``)
        Connect what lies inside smooth glass to emitters outside, through one surface. ``auto``:
        where something inside can connect, and light comes from somewhere rather than everywhere.

    A flight through a medium is drawn from the law that its origin asks for: one law after a
    collision in this medium, the other after anything else (see :mod:`nonexp.transmittance`).
    Surfaces with the same medium on both sides that let a ray straight through do not end it.
    Where extinction differs between wavelengths, one of a path's channels draws all its flights,
    and the path is weighted by the balance heuristic over all channels. Media of Mitsuba's own are
    the exponential media they are; heterogeneous ones are tracked with null collisions.
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        depth = _integer(props, "max_depth", -1, "-1 (no limit) or an integer >= 0", -1)
        self.max_depth = depth if depth >= 0 else 2**32 - 1
        self.rr_depth = _integer(props, "rr_depth", 5, "an integer > 0", 1)
        self.hide_emitters = props.get("hide_emitters", False)
        self.refractive_nee = _choice(props, "refractive_nee", ("auto", "on", "off"))
        self._subscenes = Subscenes()

    def sample(
        self,
        scene: mi.Scene,
        sampler: mi.Sampler,
        ray: mi.RayDifferential3f,
        medium: Any = None,
        active: Any = True,
    ) -> tuple[mi.Spectrum, mi.Bool, list[mi.Float]]:
        needs = SceneNeeds.of(scene, medium, self.refractive_nee)
        media = scene_media(needs)
        null = needs.null_surfaces
        offset = Offset(scene)
        start = media.at(mi.MediumPtr(medium)) if media else None
        chromatic = bool(media and media.chromatic)
        hero = draw_channel(sampler.next_1d()) if chromatic else None
        collisions_connect = bool(media and media.connects)
        glass = refraction(needs, self._subscenes)
        tracks = bool(media and media.tracks)
        bent_hits = bool(glass and needs.hittable_emitters)
        connections = needs.emitters and bool(needs.smooth_surfaces or collisions_connect or glass)
        tracer = Tracer.of(scene, self._subscenes)
        ball = NullBall.of(needs, tracer) if null and connections and not tracks else None
        nee = Connections(scene, tracer, needs, media, offset, glass, ball)
        path = _Path(
            active=mi.Bool(active) & (self.max_depth > 0),
            depth=mi.UInt32(0),
            o=mi.Point3f(ray.o),
            d=mi.Vector3f(ray.d),
            throughput=mi.Spectrum(1),
            radiance=mi.Spectrum(0),
            opaque=mi.Bool(scene.environment() is not None and not self.hide_emitters),
            eta=mi.Float(1),
            pdf=mi.Float(0),
            certain=mi.Bool(True),
            location=start,
            from_particle=mi.Bool(False) if media else None,
            far=mi.Float(ray.maxt),
            offset=mi.Vector3f(0) if media else None,
            vertex=mi.Point3f(ray.o) if null else None,
            fresh=mi.Bool(True) if null and media else None,
            tau=mi.Float(0) if null and media else None,
            drawn=mi.Float(0) if null and chromatic else None,
            flown=mi.Float(0) if null and chromatic else None,
            balance=mi.UnpolarizedSpectrum(1) if chromatic else None,
            anchor=mi.Point3f(0) if bent_hits else None,
            armed=mi.Bool(False) if bent_hits else None,
            crossed=mi.Bool(False) if bent_hits else None,
            seen=mi.Bool(False) if bent_hits else None,
        )
        time, wavelengths = ray.time, ray.wavelengths

        def event(sampler: mi.Sampler, s: _Path) -> tuple[mi.Sampler, _Path]:
            # --------------------------------------------------- flight to the next event
            ray = mi.Ray3f(s.o, s.d, s.far, time, wavelengths)
            if media:
                inside = s.active & media.inside(s.location)
                extinction = media.sigma_t(s.location, medium_interaction(s.d, ray))
                sigma_t = at_channel(extinction, hero) if chromatic else extinction
                tau = media.flight(s.location, s.from_particle, sampler, inside)
                if null:
                    drawn = dr.select(s.fresh, tau, s.drawn) if chromatic else None
                    tau = dr.select(s.fresh, tau, s.tau)
                gap = dr.dot(s.offset, s.d)
                travelled = tau / sigma_t  # from the last event, not from the ray's origin
                t_collision = travelled - gap
                ray.maxt = dr.select(inside, dr.minimum(t_collision, s.far), s.far)
            si = tracer.intersect(ray, s.depth == 0, s.active)
            if self.hide_emitters:
                si = self._skip_emitters(scene, ray, si, s.active & (s.depth == 0))
            if media and media.tracks:
                tracked = inside & media.tracked(s.location)
                end = dr.minimum(si.t, s.far)
                found, tracked_balance = tracking.next_collision(
                    media, s.location, ray, end, hero, sampler, tracked
                )
                t_collision = dr.select(tracked, found, t_collision)
                travelled = dr.select(tracked, found + gap, travelled)
            if media:
                # A tie of collision and surface is a collision; what never ends sees infinity.
                collided = inside & (t_collision <= si.t) & (t_collision <= s.far)
                on_surface = s.active & ~collided
                p = _collision(s, travelled, gap)
                p = dr.select(collided, p, si.p)
            else:
                collided, on_surface, p = mi.Bool(False), s.active, si.p
            carried = s.throughput
            if media and chromatic:
                reached = si.t + gap + s.flown if null else si.t + gap
                relative = extinction / dr.select(sigma_t > 0, sigma_t, 1)
                depths = dr.select(
                    collided,
                    relative * (drawn if null else tau),
                    optical_depth(extinction, reached),
                )
                densities = media.densities(
                    s.location, s.from_particle, collided, depths, relative, drawn if null else tau
                )
                if media.tracks:
                    densities *= tracked_balance
                balance = dr.select(inside, balanced(s.balance, densities), s.balance)
                carried = s.throughput * balance

            # --------------------------------------------------- emission met by the ray
            hit = None
            if needs.hittable_emitters:
                emitter = si.emitter(scene)
                lit = on_surface & (emitter != None)  # noqa: E711
                if self.hide_emitters:
                    lit &= s.depth > 0
                if bent_hits:
                    lit &= ~s.seen
                emitted = emitter.eval(si, lit)
                if connections:
                    origin = s.vertex if null else s.o
                    bent = BentRay(s.anchor, origin, lit & s.crossed) if bent_hits else None
                    hit = nee.hit(si, origin, s.pdf, s.certain, bent, lit)

            on_surface &= si.is_valid()
            bsdf = si.bsdf()

            # --------------------------------------------------- connection to an emitter
            vertex = mi.Interaction3f(
                0, time, wavelengths, p, dr.select(collided, 0, si.n) if media else si.n
            )
            first, last = s.depth == 0, s.depth + 1 >= self.max_depth
            wo = mi.Vector3f(0, 0, 1)
            if connections:
                connecting, in_glass = mi.Bool(False), mi.Bool(False)
                if needs.smooth_surfaces:
                    smooth = on_surface & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
                    connecting = smooth & ~last
                    if media and media.some_sealed:
                        connecting &= ~media.sealed(s.location) | si.is_medium_transition()
                if media and media.connects:
                    connecting |= collided & ~last & media.collision_connects(s.location)
                if glass:
                    if needs.smooth_surfaces:
                        in_glass |= smooth
                    if media and media.samples:
                        in_glass |= collided & media.collision_samples(s.location)
                    in_glass &= s.depth + 2 < self.max_depth
                    if bent_hits:
                        in_glass &= ~(lit & s.crossed)  # the search is for another connection
                link = nee.aim(vertex, sampler, connecting, in_glass, hit)
                wo = link.wo

            if needs.hittable_emitters:
                if hit is not None:
                    emitted *= hit.weight
                s.radiance = dr.select(lit, dr.fma(carried, emitted, s.radiance), s.radiance)

            # --------------------------------------------------- scattering
            u1, u2 = sampler.next_1d(), sampler.next_2d()
            value, value_pdf, bs, weight = eval_pdf_sample(
                bsdf, si, si.to_local(wo), u1, u2, on_surface
            )
            d, pdf = si.to_world(bs.wo), bs.pdf
            passed = on_surface & mi.has_flag(bs.sampled_type, mi.BSDFFlags.Null)
            certain = mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)
            if media:
                mei = medium_interaction(s.d, ray, p)
                scatter = media.scatter(s.location, mei, wo, u1, u2, collided & ~last)
                value = dr.select(collided, scatter.albedo * scatter.value, value)
                value_pdf = dr.select(collided, scatter.pdf, value_pdf)
                weight = dr.select(collided, scatter.albedo * scatter.weight, weight)
                d = dr.select(collided, scatter.wo, d)
                pdf = dr.select(collided, scatter.wo_pdf, pdf)
                certain = dr.select(collided, ~media.collision_connects(s.location), certain)
            if connections:
                if media and needs.smooth_boundaries:
                    leaving = partial(media.behind, si, on_surface, s.location)
                else:
                    leaving = partial(_stay, s.location)
                useful = dr.any(value != 0)
                light = nee.arriving(link, vertex, leaving, collided, sampler, useful)
                contribution = carried * value * light * link.weight(value_pdf)
                s.radiance = dr.select(link.active, s.radiance + contribution, s.radiance)

            # --------------------------------------------------- the next ray
            s.active = on_surface | (collided & ~last) if media else on_surface
            s.opaque |= s.active & ~passed
            s.active &= pdf > 0
            s.throughput = dr.select(s.active, s.throughput * weight, s.throughput)
            s.eta = dr.select(on_surface, s.eta * bs.eta, s.eta)
            scattered = s.active & ~passed
            s.far = mi.Float(dr.largest(mi.Float))
            s.depth = dr.select(scattered, s.depth + 1, s.depth)
            if glass and bent_hits:
                # What the camera sees reflected in glass is not left to chance.
                s.seen = on_surface & first & ~last & glass.meets(si)
                if media:
                    s.seen &= ~media.inside(s.location)
                reflected = carried * nee.reflected(si, vertex, bsdf, s.seen)
                s.radiance = dr.select(s.seen, s.radiance + reflected, s.radiance)
                s.seen &= mi.has_flag(bs.sampled_type, mi.BSDFFlags.DeltaReflection)
                # Out of the glass, the density is that of the last direction within.
                out = s.armed & mi.has_flag(bs.sampled_type, mi.BSDFFlags.DeltaTransmission)
                out &= scattered & on_surface & (dr.dot(d, si.n) > 0)
                s.crossed = dr.select(scattered, out, s.crossed)
                s.pdf = dr.select(scattered & ~out, pdf, s.pdf)
                delta = on_surface & mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)
                s.armed = dr.select(scattered, in_glass & ~delta, s.armed)
                s.anchor = dr.select(scattered & in_glass, p, s.anchor)
            else:
                s.pdf = dr.select(scattered, pdf, s.pdf)
            s.certain = dr.select(scattered, certain, s.certain)
            s.o, s.d = offset.onward(vertex, d), d
            if media:
                s.offset = mi.Vector3f(s.o - p)
                beyond = media.behind(si, on_surface, s.location, d)
                if null:
                    # Straight through a surface inside one medium the flight goes on.
                    s.fresh = scattered | (beyond != s.location)
                    s.tau = dr.maximum(tau - sigma_t * (si.t + gap), 0)
                if null and chromatic:
                    s.drawn, s.flown = drawn, dr.select(s.fresh, 0, reached)
                    # Tracked flights have no memory: each stretch counts by itself.
                    done = s.fresh | tracked if media.tracks else s.fresh
                    balance = dr.select(done, balance, s.balance)
                if chromatic:
                    s.balance = mi.UnpolarizedSpectrum(balance)
                if null and chromatic:
                    s.from_particle = dr.select(s.fresh, collided, s.from_particle)
                else:
                    s.from_particle = collided
                s.location = beyond
            if null:
                s.vertex = dr.select(scattered, p, s.vertex)

            # --------------------------------------------------- termination
            carried = s.throughput * s.balance if chromatic else s.throughput
            s.active &= dr.any(carried != 0) & (s.depth < self.max_depth)
            survival = dr.detach(dr.minimum(dr.max(carried) * dr.square(s.eta), 0.95))
            roulette = scattered & (s.depth > self.rr_depth)
            s.active &= ~roulette | (sampler.next_1d() < survival)
            s.throughput = dr.select(roulette, s.throughput * dr.rcp(survival), s.throughput)
            return sampler, s

        sampler, path = dr.while_loop(
            (sampler, path), lambda sampler, s: s.active, event, label="nonexp: path"
        )
        return path.radiance, path.opaque, []

    def _skip_emitters(self, scene: mi.Scene, ray: Any, si: Any, active: Any) -> Any:
        """What stands behind the area emitters that a camera ray meets first."""
        hidden = active & si.is_valid() & (si.shape.emitter() != None)  # noqa: E711
        onward = si.spawn_ray(ray.d)
        behind = self.skip_area_emitters(scene, onward, True, hidden)
        skipped = behind.compute_surface_interaction(onward, mi.RayFlags.All, hidden)
        skipped.t += si.t
        return dr.select(hidden, skipped, si)

    def to_string(self) -> str:
        depth = -1 if self.max_depth == 2**32 - 1 else self.max_depth
        return (
            f"NonexpVolpath[max_depth={depth}, rr_depth={self.rr_depth}, "
            f"hide_emitters={self.hide_emitters}]"
        )


def _choice(props: mi.Properties, name: str, allowed: tuple[str, ...]) -> str:
    value = props.get(name, allowed[0])
    if value not in allowed:
        raise ValueError(
            f"{name} is {value!r}: it must be {', '.join(allowed[:-1])} or {allowed[-1]}"
        )
    return str(value)


def _integer(props: mi.Properties, name: str, default: int, allowed: str, least: int) -> int:
    value = props.get(name, default)
    if type(value) is not int or not least <= value < 2**31:
        raise ValueError(f"{name} is {value}: it must be {allowed}, and below 2^31")
    return value


def _collision(s: _Path, travelled: Any, gap: Any) -> Any:
    """Point at a distance of ``travelled`` from the last event.

    The ray starts off the surface, and so runs beside the line that it stands for. Right behind
    the surface the point goes back to that line (but for 0.1 % of the offset, to stay inside):
    in a dense medium all happens there. The share falls as the square of the distance, so that
    the point stays inside a curved surface that the ray only grazes.
    """
    square = dr.maximum(dr.squared_norm(s.offset), 1e-30)
    share = dr.maximum(1 - 1e-3 * dr.square(travelled) / square, 0)
    on_ray = dr.fma(s.d, travelled - gap, s.o)
    return on_ray - share * (0.999 * s.offset - gap * s.d)


def _stay(location: Any, _direction: Any) -> Any:
    return location
