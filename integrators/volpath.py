"""The volumetric path tracer for media with any transmittance law.

Evaluated anew for each variant by :mod:`nonexp.plugins`.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from nonexp.plugins.values import choice

from . import forced
from .adjoint import Adjoint
from .connection import Connections
from .glass import refraction
from .jit import Numbering, recording
from .media import scene_media
from .needs import SceneNeeds, forgotten_media
from .path import Events, Path
from .rays import Contacts, NullBall, Offset, Subscenes, Tracer
from .replay import replay
from .spectral import draw_channel


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
    ``expected_emission`` (``auto``, ``on`` or ``off``, default ``auto``)
        Count emission that a ray meets in a medium with its expected value, also where the flight
        collides before; and in dark media (albedo below 1/3) let fewer paths collide, with larger
        weights. ``auto``: where that pays; ``on``: in all media but those with null collisions;
        ``off``: flights are drawn as light flies. The image is the same, the noise is not.

    A flight through a medium is drawn from the law that its origin asks for: one law after a
    collision in this medium, the other after anything else (see :mod:`nonexp.transmittance`).
    Surfaces with the same medium on both sides that let a ray straight through do not end it.
    Where extinction differs between wavelengths, one of a path's channels draws all its flights,
    and the path is weighted by the balance heuristic over all channels. Media of Mitsuba's own are
    the exponential media they are; heterogeneous ones are tracked with null collisions.

    ``mi.render(scene, params)`` differentiates images by replaying their paths, forward and
    backward, without bias; parameters by which there is no derivative raise ``ValueError``.
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        depth = _integer(props, "max_depth", -1, "-1 (no limit) or an integer >= 0", -1)
        self.max_depth = depth if depth >= 0 else 2**32 - 1
        self.rr_depth = _integer(props, "rr_depth", 5, "an integer > 0", 1)
        self.hide_emitters = props.get("hide_emitters", False)
        self.refractive_nee = choice(props, "refractive_nee", ("auto", "on", "off"))
        self.expected_emission = choice(props, "expected_emission", ("auto", "on", "off"))
        self._warned, self._results = False, None
        self._subscenes, self._contact_scenes = Subscenes(), Subscenes()

    def sample(
        self,
        scene: mi.Scene,
        sampler: mi.Sampler,
        ray: mi.RayDifferential3f,
        medium: Any = None,
        active: Any = True,
    ) -> tuple[mi.Spectrum, mi.Bool, list[mi.Float]]:
        path = self.trace(scene, sampler, ray, medium, active)
        return path.radiance, path.opaque, []

    def trace(
        self,
        scene: mi.Scene,
        sampler: mi.Sampler,
        ray: mi.Ray3f,
        medium: Any,
        active: Any,
        adjoint: Adjoint | None = None,
        regular: bool = False,
    ) -> Path:
        """The ends of paths that begin as rays. An ``adjoint`` collects derivatives, on the same
        paths as those without it; all of these must walk through grids (``regular``)."""
        self._warn(scene, medium)
        # Replayed paths draw everything: their derivatives know no expected values.
        expected = "off" if regular or adjoint else self.expected_emission
        needs = SceneNeeds.of(scene, medium, self.refractive_nee, self.hide_emitters, expected)
        media = scene_media(
            needs.media, needs.sealed, needs.shell is not None, regular, needs.expected
        )
        hero = draw_channel(sampler.next_1d()) if media and media.chromatic else None
        glass = refraction(needs.lobes, self._subscenes)
        ends = needs.smooth_surfaces or glass or (media and media.connects)
        connects = needs.emitters and bool(ends)
        offset, together = Offset(scene), needs.coincident
        contacts = None
        if together.groups:
            contacts = Contacts(
                together.groups, together.ranks, together.doubled, self._contact_scenes, offset
            )
        tracer = Tracer.of(scene, self._subscenes, contacts, needs.shell)
        varies = media and media.any("varies")
        ball = NullBall.of(needs.null_ball, tracer) if connects and not varies else None
        silent = Numbering([mi.BSDFPtr(bsdf) for bsdf in needs.silent]) if needs.silent else None
        if adjoint:
            adjoint.begin(media)
        nee = Connections(scene, tracer, needs, media, offset, glass, ball, silent, adjoint)
        events = Events(self, nee, connects, hero, ray.time, ray.wavelengths, adjoint)
        backward = adjoint is not None and adjoint.mode == dr.ADMode.Backward
        with dr.isolate_grad(when=backward):
            start = events.begin(ray, medium, active)
            if adjoint and adjoint.forces and start.flight:
                start.chosen = forced.Chosen.none(start.flight.location, sampler)
            _, path = dr.while_loop(
                (sampler, start),
                lambda sampler, s: s.active,
                events.event,
                label="nonexp: path",
            )
        if adjoint and path.chosen:
            path.tangent = forced.count(events, path.chosen, path.tangent, sampler, adjoint)
        if adjoint and backward:
            adjoint.leaves.pass_on(path.tangent)
        # Where reverse mode fails on a loop of which results are gone, Dr.Jit 1.5 crashes at exit.
        self._results = path if dr.grad_enabled(path) else None
        return path

    def render_forward(
        self, scene: mi.Scene, params: Any, sensor: Any = 0, seed: Any = 0, spp: int = 0
    ) -> mi.TensorXf:
        """The derivative of an image, for the tangents of scene parameters: what ``mi.render``
        calls. Raises ``ValueError`` for parameters by which there is none."""
        return replay(self, scene, sensor).render_forward(scene, params, sensor, seed, spp)

    def render_backward(
        self,
        scene: mi.Scene,
        params: Any,
        grad_in: mi.TensorXf,
        sensor: Any = 0,
        seed: Any = 0,
        spp: int = 0,
    ) -> None:
        """The derivatives by scene parameters of what depends on an image: what ``mi.render``
        calls. Raises ``ValueError`` for parameters by which there is none."""
        replay(self, scene, sensor).render_backward(scene, params, grad_in, sensor, seed, spp)

    def _warn(self, scene: mi.Scene, medium: Any) -> None:
        """Once, of cameras that do not say that they stand in a medium."""
        if self._warned or medium is not None or recording():
            return
        self._warned = True
        for sensor, inside in forgotten_media(scene):
            mi.Log(
                mi.LogLevel.Warn,
                f"sensor {sensor.id()!r} stands in the medium {inside.id()!r}, but does not refer "
                f'to it: its rays start in vacuum (add <ref name="medium" id="..."/>)',
            )

    def to_string(self) -> str:
        depth = -1 if self.max_depth == 2**32 - 1 else self.max_depth
        return (
            f"NonexpVolpath[max_depth={depth}, rr_depth={self.rr_depth}, "
            f"hide_emitters={self.hide_emitters}]"
        )


def _integer(props: mi.Properties, name: str, default: int, allowed: str, least: int) -> int:
    value = props.get(name, default)
    if type(value) is not int or not least <= value < 2**31:
        raise ValueError(f"{name} is {value}: it must be {allowed}, and below 2^31")
    return value
