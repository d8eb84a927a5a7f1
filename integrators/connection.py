"""Next-event estimation: a straight connection from a vertex to a sampled point on an emitter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from .media import Media
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
    vertex: mi.Interaction3f,
    location: Any,
    from_particle: Any,
    sample: mi.Point2f,
    active: Any,
) -> tuple[mi.DirectionSample3f, mi.Spectrum]:
    """Sample an emitter from ``vertex``; return where it is and radiance/pdf times transmittance.

    ``location(direction)`` tells the medium in which a ray leaves the vertex; ``from_particle``
    marks the vertices that are collisions.
    """
    if media and media.all_sealed:
        media = None
    ds, light = scene.sample_emitter_direction(vertex, sample, not needs.null_surfaces, active)
    active = active & (ds.pdf != 0)
    light = dr.select(active, light, 0)
    if needs.null_surfaces:
        light *= _walk(scene, needs, media, vertex, ds, location, from_particle, active)
    elif media:
        start = location(ds.d)
        tau = media.sigma_t(start) * _distance(needs, ds, ds.dist)
        survival = media.survival(start, from_particle, tau)
        light = dr.select(media.inside(start), light * survival, light)
    return ds, light


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
    vertex: mi.Interaction3f,
    ds: mi.DirectionSample3f,
    location: Any,
    from_particle: Any,
    active: Any,
) -> mi.Spectrum:
    """Transmittance to ``ds.p`` past any number of surfaces that let light straight through.

    Within one medium optical depths add up across such surfaces, and the law is evaluated once,
    where the ray leaves that medium.
    """

    def remaining(s: _Ray) -> Any:
        return _distance(needs, ds, dr.dot(ds.p - s.start, ds.d))

    def body(s: _Ray) -> tuple[_Ray]:
        si = scene.ray_intersect(s.ray, s.active)
        hit = s.active & si.is_valid()
        through = si.bsdf().eval_null_transmission(si, hit)
        s.transmittance = dr.select(hit, s.transmittance * through, s.transmittance)
        if media:
            length = dr.select(hit, dr.dot(si.p - s.start, ds.d), remaining(s))
            inside = s.active & media.inside(s.location)
            s.tau = dr.select(inside, dr.fma(media.sigma_t(s.location), length, s.tau), s.tau)
            beyond = media.behind(si, hit, s.location, s.ray.d)
            left = beyond != s.location
            survival = media.survival(s.location, s.from_particle, s.tau)
            s.transmittance = dr.select(left & inside, s.transmittance * survival, s.transmittance)
            s.tau = dr.select(left, 0, s.tau)
            s.from_particle &= ~left
            s.location = beyond
            s.start = si.p
        s.ray = si.spawn_ray_to(ds.p)
        s.active = hit & dr.any(s.transmittance != 0)
        return (s,)

    start = location(ds.d) if media else None
    state = _Ray(
        ray=vertex.spawn_ray_to(ds.p),
        start=mi.Point3f(vertex.p) if media else None,
        location=start,
        tau=mi.Float(0),
        from_particle=mi.Bool(from_particle),
        transmittance=mi.Spectrum(1),
        active=mi.Bool(active),
    )
    (end,) = dr.while_loop((state,), lambda s: s.active, body, label="nonexp: shadow ray")
    if not media:
        return end.transmittance
    survival = media.survival(end.location, end.from_particle, end.tau)
    return dr.select(media.inside(end.location), end.transmittance * survival, end.transmittance)
