"""Next-event estimation: a straight connection from a vertex to a sampled point on an emitter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from . import tracking
from .media import Media
from .offset import Offset
from .scene_needs import SceneNeeds


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


def connect(
    scene: mi.Scene,
    needs: SceneNeeds,
    media: Media | None,
    offset: Offset,
    vertex: mi.Interaction3f,
    location: Any,
    from_particle: Any,
    sampler: mi.Sampler,
    active: Any,
) -> tuple[mi.DirectionSample3f, mi.Spectrum]:
    """Sample an emitter from ``vertex``; return where it is and radiance/pdf times transmittance.

    ``location(direction)`` tells the medium in which a ray leaves the vertex; ``from_particle``
    marks the vertices that are collisions.
    """
    if media and media.all_sealed:
        media = None
    ds, light = scene.sample_emitter_direction(vertex, sampler.next_2d(), False, active)
    active = active & (ds.pdf != 0)
    ray = offset.segment(vertex, ds.p)
    if not needs.null_surfaces:
        active &= ~scene.ray_test(ray, active)
    light = dr.select(active, light, 0)
    if needs.null_surfaces:
        light *= _walk(
            scene, needs, media, offset, vertex, ds, ray, location, from_particle, sampler, active
        )
    elif media:
        start = location(ds.d)
        distance = _distance(needs, ds, ds.dist)
        tau = optical_depth(media.sigma_t(start, sight(vertex, ds.d)), distance)
        survival = media.survival(start, from_particle, tau)
        if media.tracks:
            tracked = active & media.tracked(start)
            onward = mi.Ray3f(vertex.p, ds.d, vertex.time, vertex.wavelengths)
            survival *= tracking.transmittance(media, start, onward, distance, sampler, tracked)
        light = dr.select(media.inside(start), light * survival, light)
    return ds, light


def sight(vertex: Any, direction: Any) -> mi.MediumInteraction3f:
    """What a medium may ask about a ray that leaves ``vertex``: its direction and wavelengths."""
    mei = dr.zeros(mi.MediumInteraction3f)
    mei.wi, mei.time, mei.wavelengths = -direction, vertex.time, vertex.wavelengths
    mei.sh_frame = mi.Frame3f(mei.wi)
    return mei


def optical_depth(sigma_t: Any, distance: Any) -> Any:
    """``sigma_t * distance``; none where a channel's extinction is zero, however far."""
    tau = sigma_t * distance
    return tau if dr.depth_v(tau) == 1 else dr.select(sigma_t > 0, tau, 0)


def _distance(needs: SceneNeeds, ds: mi.DirectionSample3f, distance: Any) -> Any:
    """Length of a ray's last stretch: no end to it if the emitter is at infinity."""
    if not needs.infinite_emitters:
        return distance
    infinite = mi.has_flag(ds.emitter.flags(), mi.EmitterFlags.Infinite)
    return dr.select(infinite, dr.inf, distance)


def _walk(
    scene: mi.Scene,
    needs: SceneNeeds,
    media: Media | None,
    offset: Offset,
    vertex: mi.Interaction3f,
    ds: mi.DirectionSample3f,
    ray: mi.Ray3f,
    location: Any,
    from_particle: Any,
    sampler: mi.Sampler,
    active: Any,
) -> mi.Spectrum:
    """Transmittance to ``ds.p`` past any number of surfaces that let light straight through.

    Within one medium optical depths add up across such surfaces, and the law is evaluated once,
    where the ray leaves that medium.
    """

    def remaining(s: _Ray) -> Any:
        return _distance(needs, ds, dr.dot(ds.p - s.start, ds.d))

    def body(sampler: mi.Sampler, s: _Ray) -> tuple[mi.Sampler, _Ray]:
        si = scene.ray_intersect(s.ray, s.active)
        hit = s.active & si.is_valid()
        through = si.bsdf().eval_null_transmission(si, hit)
        s.transmittance = dr.select(hit, s.transmittance * through, s.transmittance)
        if media:
            # Rounding may put a surface before the one left behind.
            length = dr.maximum(dr.select(hit, dr.dot(si.p - s.start, ds.d), remaining(s)), 0)
            inside = s.active & media.inside(s.location)
            tau = optical_depth(media.sigma_t(s.location, sight(vertex, ds.d)), length)
            s.tau = type(s.tau)(dr.select(inside, s.tau + tau, s.tau))
            if media.tracks:
                tracked = inside & media.tracked(s.location)
                onward = mi.Ray3f(s.start, ds.d, vertex.time, vertex.wavelengths)
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
        s.ray = offset.segment(si, ds.p)
        s.active = hit & dr.any(s.transmittance != 0)
        return sampler, s

    start = location(ds.d) if media else None
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
