"""One path through a scene, event by event: what it carries, and the sections of its loop.

An event is a flight to a collision or a surface, the emission there, a connection to an emitter,
scattering, and the next ray.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import drjit as dr
import mitsuba as mi

from . import tracking
from .adjoint import Adjoint, Record
from .connection import BentRay, Connections, Hit, Link, Start
from .expected import Begun, Outlook, Way, look
from .forced import Chosen, Forced, Origin
from .media import Media, medium_interaction, optical_depth
from .rays import Contact
from .spectral import at_channel, balanced
from .surface import eval_pdf_sample

MOST_PASSES = 1 << 16
"""Null surfaces that a path passes in a row, at most: whatever a scene is, its paths end."""


@dataclass
class Flight:
    """What a path carries of its flight through media; parts that a scene does not need are None.

    A flight goes on straight through surfaces inside one medium (*null surfaces*).
    """

    location: Any
    """the medium that the ray runs in"""
    from_particle: Any
    """the flight began at a collision (with memory: :attr:`.media.Origin.start`)"""
    offset: Any
    """from the last event to the ray's origin, which stands off surfaces"""
    fresh: Any
    """the flight begins here (with null surfaces)"""
    tau: Any
    """optical depth left on this flight (with null surfaces)"""
    drawn: Any
    """optical depth of this flight in all (with null surfaces and chromatic extinction)"""
    flown: Any
    """integral of the density from where this flight began to the last event (likewise)"""
    balance: Any
    """weight of each channel, with mean 1 (chromatic extinction)"""
    began: Any
    """where it did (with null surfaces, while paths are replayed)"""
    weight: Any
    """the throughput there (likewise)"""
    ahead: Any
    """how the next flight begins if this one ends at a collision (with memory and null surfaces)"""
    begun: Begun | None
    """what has been expected of it (with null surfaces, and expected values)"""


@dataclass
class Glass:
    """What a path carries where connections bend through glass and rays can hit emitters."""

    anchor: Any
    """last event that connected through glass"""
    armed: Any
    """the path comes straight from there"""
    crossed: Any
    """it has since left the glass, and done nothing else"""
    seen: Any
    """emission that the ray hits is already counted"""


@dataclass
class Path:
    """What a path carries from event to event; parts that a scene does not need are None."""

    active: Any
    """still on its way"""
    depth: Any
    """number of scattering events so far, straight passes not counted"""
    o: Any
    """origin of the ray"""
    d: Any
    """direction of the ray"""
    far: Any
    """length of the ray: that of the camera's ray, then infinite"""
    throughput: Any
    """product of sampling weights"""
    radiance: Any
    """collected so far"""
    opaque: Any
    """the camera ray hit something: alpha of the pixel"""
    eta: Any
    """product of relative indices of refraction"""
    pdf: Any
    """solid-angle density with which the last event chose its direction"""
    certain: Any
    """no connection could have found what this ray finds: emission counts in full"""
    vertex: Any
    """position of the last event (with null surfaces)"""
    passes: Any
    """null surfaces passed since then (with null surfaces)"""
    flight: Flight | None
    glass: Glass | None
    tangent: Any
    """derivatives so far, as :meth:`.adjoint.Adjoint.start` (while paths are replayed)"""
    chosen: Chosen | None
    """one of the flights so far (while paths are replayed, where densities jump)"""
    forced: Forced | None
    """the flight that must end at a collision, on such paths"""


@dataclass
class Arrival:
    """Where a flight ended; the parts from ``inside`` on exist only in scenes with media."""

    first: Any
    """it is that of the camera's ray"""
    last: Any
    """nothing that scatters here counts any more"""
    ray: Any
    si: Any
    """surface that the ray hits"""
    contact: Contact | None
    """all surfaces there, where some coincide"""
    bsdf: Any
    """its BSDF"""
    collided: Any
    """the flight ended at a collision before"""
    on_surface: Any
    """or there, or at infinity"""
    p: Any
    """position"""
    carried: Any
    """throughput, with the balance of the channels"""
    from_particle: Any
    """how the next flight begins, as :attr:`Flight.from_particle`"""
    inside: Any = None
    """the flight was in a medium"""
    sigma_t: Any = None
    """extinction that the flight was drawn with"""
    tau: Any = None
    """optical depth left at its start"""
    column: Any = None
    """integral of the density from the last event to the surface; where that is 1, the distance"""
    drawn: Any = None
    """optical depth of the flight in all (with null surfaces and chromatic extinction)"""
    reached: Any = None
    """integral of the density from where the flight began to the surface (likewise)"""
    tracked: Any = None
    """flown by null collisions"""
    balance: Any = None
    """weight of each channel"""
    ahead: Any = None
    """how the next flight would begin at a collision (with memory)"""
    blocked: Any = None
    """before it reached the depth at which it must collide"""
    outlook: Outlook | None = None
    """what was expected of the flight (with expected values)"""
    weight: Any = None
    """of what it came to, not yet in the throughput (with null surfaces, and a rule)"""
    expected: Any = None
    """emission behind it is to count by expectation (with expected emission)"""
    shown: Any = None
    """weight of that (likewise)"""
    refused: Any = None
    """it would have collided (with a rule)"""

    @property
    def start(self) -> tuple[Any, ...]:
        """That, at a collision, where media ask for it."""
        return () if self.ahead is None else (self.ahead,)


@dataclass
class Emission:
    """Emission that a ray hits."""

    lit: Any
    """there is some that counts"""
    radiance: Any
    hit: Hit | None
    """as connections see it"""
    emitter: Any


@dataclass
class Scattering:
    """Scattering at an event: the value towards a connection, and a new direction."""

    value: Any
    value_pdf: Any
    d: Any
    pdf: Any
    weight: Any
    bs: Any
    """the BSDF's sample"""
    passed: Any
    """straight through a surface"""
    certain: Any
    """no connection could have found the new direction"""


@dataclass(frozen=True)
class Events:
    """The sections of the loop, in one scene and one call of the integrator."""

    options: Any
    """the integrator: ``max_depth``, ``rr_depth``, ``hide_emitters``, ``skip_area_emitters``"""
    nee: Connections
    """with the scene, its needs, media, glass and rays"""
    connects: bool
    """something connects to emitters"""
    hero: Any
    """channel that draws all flights (chromatic extinction)"""
    time: Any
    wavelengths: Any
    adjoint: Adjoint | None = None
    """what collects derivatives, while paths are replayed"""
    origin: Origin | None = None
    """where paths begin whose first flight must end at a collision"""

    @property
    def keeps(self) -> bool:
        """Paths keep the whole of a flight, past null surfaces."""
        return self.chromatic or self.adjoint is not None

    @property
    def expects_on(self) -> bool:
        """Flights of which something is expected may go on past null surfaces."""
        past = self.null and self.nee.needs.null_ball is None
        return bool(self.media and self.media.looks and past)

    @property
    def media(self) -> Media | None:
        return self.nee.media

    @property
    def null(self) -> bool:
        """Rays pass straight through some surface."""
        return self.nee.needs.null_surfaces

    @property
    def resumes(self) -> bool:
        """Flights may go on where an event begins."""
        return self.null or self.origin is not None

    @property
    def chromatic(self) -> bool:
        return self.hero is not None

    @property
    def bent_hits(self) -> bool:
        """Rays can hit emitters to which connections bend."""
        return bool(self.nee.glass and self.nee.needs.hittable_emitters)

    def begin(self, ray: Any, medium: Any, active: Any) -> Path:
        """The path at the sensor."""
        media, null, chromatic = self.media, self.null, self.chromatic
        resumes, replayed = self.resumes, self.adjoint is not None
        flight = glass = None
        if media:
            flight = Flight(
                location=media.at(mi.MediumPtr(medium)),
                from_particle=mi.UInt32(0) if media.remembers else mi.Bool(False),
                offset=mi.Vector3f(0),
                fresh=mi.Bool(True) if resumes else None,
                tau=mi.Float(0) if resumes else None,
                drawn=mi.Float(0) if resumes and self.keeps else None,
                flown=mi.Float(0) if (resumes and self.keeps) or self.expects_on else None,
                balance=mi.UnpolarizedSpectrum(1) if chromatic else None,
                began=mi.Point3f(ray.o) if null and replayed else None,
                weight=mi.Spectrum(1) if null and replayed else None,
                ahead=mi.UInt32(0) if null and media.remembers else None,
                begun=Begun.start(chromatic, media.refuses) if self.expects_on else None,
            )
        if self.bent_hits:
            glass = Glass(mi.Point3f(0), mi.Bool(False), mi.Bool(False), mi.Bool(False))
        environment = self.nee.scene.environment() is not None
        return Path(
            active=mi.Bool(active) & (self.options.max_depth > 0),
            depth=mi.UInt32(0),
            o=mi.Point3f(ray.o),
            d=mi.Vector3f(ray.d),
            far=mi.Float(ray.maxt),
            throughput=mi.Spectrum(1),
            radiance=mi.Spectrum(0),
            opaque=mi.Bool(environment and not self.options.hide_emitters),
            eta=mi.Float(1),
            pdf=mi.Float(0),
            certain=mi.Bool(True),
            vertex=mi.Point3f(ray.o) if null else None,
            passes=mi.UInt32(0) if null else None,
            flight=flight,
            glass=glass,
            tangent=self.adjoint.start() if self.adjoint else None,
            chosen=None,
            forced=None,
        )

    def resume(self, active: Any) -> Path:
        """The path that begins at its origin."""
        assert self.origin
        at, tau = self.origin.flight, self.origin.tau
        s = self.begin(mi.Ray3f(at.p, at.d, self.time, self.wavelengths), None, active)
        flight = s.flight
        assert flight
        s.depth, s.eta, s.throughput = at.depth, at.eta, at.throughput
        flight.location, flight.from_particle = at.location, mi.Bool(True)
        flight.fresh, flight.tau = mi.Bool(False), mi.Float(tau)
        if self.keeps:
            flight.drawn = mi.Float(tau)
        if self.chromatic:
            flight.balance = self.origin.balance
        s.forced = Forced(mi.Bool(active), mi.Float(0))
        return s

    def event(self, sampler: mi.Sampler, s: Path) -> tuple[mi.Sampler, Path]:
        """The body of the loop."""
        record = Record(s.radiance) if self.adjoint else None
        counted = s.active
        a = self.fly(sampler, s)
        if record and s.flight:
            record.flight = self._flown(s, s.flight, a)
            begun = s.flight.weight if self.null else s.throughput
            record.weight = begun * a.balance if self.chromatic else begun
        if s.forced:
            assert self.origin
            a.blocked = s.forced.pending & ~a.collided
            length = dr.dot(a.p - self.origin.flight.p, s.d)
            ends = s.active & s.forced.pending & a.collided
            s.forced.length = dr.select(ends, length, s.forced.length)
            s.forced.pending &= ~ends
        emission = self.emission(s, a)
        a.on_surface &= a.si.is_valid()
        n = dr.select(a.collided, 0, a.si.n) if self.media else a.si.n
        vertex = mi.Interaction3f(0, self.time, self.wavelengths, a.p, n)
        link, in_glass = None, mi.Bool(False)
        weight = emission.hit.weight if emission and emission.hit else None
        if self.connects:
            connecting, in_glass = self.connecting(s, a, emission)
            hit = emission.hit if emission else None
            link, weight = self.nee.aim(vertex, sampler, connecting, in_glass, hit)
        if emission:
            emitted = emission.radiance if weight is None else emission.radiance * weight
            shown = a.carried if a.shown is None else a.shown
            if record:
                factor = a.carried if weight is None else a.carried * weight
                record.emissions.append((factor, emission.emitter, a.si, emission.lit))
            s.radiance = dr.select(emission.lit, dr.fma(shown, emitted, s.radiance), s.radiance)
        if self.media and s.flight and self.media.any("emits"):
            mei = medium_interaction(s.d, a.ray, a.p)
            light = self.media.ask("emitted", s.flight.location, mei, *a.start, active=a.collided)
            s.radiance = dr.select(a.collided, dr.fma(a.carried, light, s.radiance), s.radiance)
            if record:
                record.glow = a.carried, s.flight.location, mei, a.collided
        wo = link.wo if link else mi.Vector3f(0, 0, 1)
        scattering = self.scatter(sampler, s, a, wo, record)
        if link:
            light = self.arriving(sampler, s, a, vertex, link, scattering, record)
            s.radiance = dr.select(link.active, s.radiance + light, s.radiance)
        collected, carried = s.radiance, a.carried
        self.advance(sampler, s, a, vertex, scattering, in_glass, record)
        if self.adjoint and record:
            if self.null and s.flight:
                record.done = s.flight.fresh | ~s.active
            s.tangent = self.adjoint.after(
                self.media, s.tangent, record, collected, carried, counted
            )
            if s.chosen:
                self._offer(self.adjoint, s, s.chosen, a)
        return sampler, s

    def _offer(self, adjoint: Adjoint, s: Path, chosen: Chosen, a: Arrival) -> None:
        """The flight that begins here, if its density jumps."""
        assert self.media and s.flight
        jumps = mi.Bool(False)
        for _, here in adjoint.jumping(self.media, s.flight.location):
            jumps |= here
        throughput = s.throughput
        if self.chromatic:
            throughput = throughput * s.flight.balance
        chosen.offer(s, a.p, throughput, s.active & a.collided & jumps)

    # ------------------------------------------------------------- flight to the next event

    def fly(self, sampler: mi.Sampler, s: Path) -> Arrival:
        """Draw a flight, and find where it ends."""
        media, flight = self.media, s.flight
        first, last = s.depth == 0, s.depth + 1 >= self.options.max_depth
        ray = mi.Ray3f(s.o, s.d, s.far, self.time, self.wavelengths)
        if not (media and flight):
            si, contact = self._intersect(ray, first, s.active)
            surface = first, last, ray, si, contact, si.bsdf()
            collided = mi.Bool(False)
            return Arrival(*surface, collided, s.active, si.p, s.throughput, collided)

        location = flight.location
        inside = s.active & media.inside(location)
        extinction = media.sigma_t(location, medium_interaction(s.d, ray))
        sigma_t = at_channel(extinction, self.hero) if self.chromatic else extinction
        origin = media.origin(flight.from_particle, self.wavelengths, self.hero)
        tau = drawn = media.flight(location, origin, sampler, inside)
        ahead = None
        if media.remembers:
            u = sampler.next_1d(inside)
            ahead = media.ask("ahead", location, origin, tau, u, active=inside)
            origin.ahead = ahead = (
                dr.select(flight.fresh, ahead, flight.ahead) if self.null else ahead
            )
        if self.resumes:
            drawn = dr.select(flight.fresh, tau, flight.drawn) if self.keeps else None
            tau = dr.select(flight.fresh, tau, flight.tau)
        gap = dr.dot(flight.offset, s.d)
        travelled = tau / sigma_t  # from the last event, not from the ray's origin
        t_collision = travelled - gap
        horizon = None
        if not (media.all("varies") or media.all("looks_far")):
            known = inside & ~media.where("varies", location) if media.any("varies") else inside
            limit = t_collision
            if media.looks:
                horizon = self._horizon(media, location, extinction) - gap
                limit = dr.maximum(limit, horizon)
            ray.maxt = dr.select(known, dr.minimum(limit, s.far), s.far)
        si, contact = self._intersect(ray, first, s.active)
        column = si.t + gap
        if media.walks:
            o, end = dr.fma(-gap, s.d, s.o), dr.minimum(si.t, s.far) + gap
            travelled, column = media.ask(
                "distance", location, o, s.d, end, travelled, active=inside
            )
            t_collision = travelled - gap
        tracked = tracked_balance = None
        if media.tracks:
            tracked = inside & media.holds("tracked", location)
            found, tracked_balance = tracking.next_collision(
                media, location, ray, dr.minimum(si.t, s.far), tau, self.hero, sampler, tracked
            )
            t_collision = dr.select(tracked, found, t_collision)
            travelled = dr.select(tracked, found + gap, travelled)
            column = dr.select(tracked, 0, column)  # what is left is no depth: it stays
        # A tie of collision and surface is a collision; what never ends sees infinity.
        collided = inside & (t_collision <= si.t) & (t_collision <= s.far)
        outlook = drawn_collision = None
        if media.looks:
            drawn_collision = collided
            way = Way(inside, origin, extinction, si, s.o, s.d, s.far, gap, travelled, horizon)
            outlook, column = look(media, flight, way, sampler, collided, column)
            if outlook.rule:
                collided = collided & (outlook.rule.kept | ~outlook.here)
        p = dr.select(collided, _collision(s, flight, travelled, gap), si.p)
        surface = first, last, ray, si, contact, si.bsdf()
        begins = collided if ahead is None else dr.select(collided, ahead, 0)
        a = Arrival(*surface, collided, s.active & ~collided, p, s.throughput, begins)
        a.inside, a.sigma_t, a.tau, a.column, a.drawn, a.tracked, a.ahead = (
            inside, sigma_t, tau, column, drawn, tracked, ahead,
        )  # fmt: skip
        if self.keeps or self.expects_on:
            a.reached = column + flight.flown if self.resumes else column
        if self.chromatic:
            relative = extinction / dr.select(sigma_t > 0, sigma_t, 1)
            depths = dr.select(collided, relative * drawn, optical_depth(extinction, a.reached))
            densities = media.ask("densities", location, origin, collided, depths, relative, drawn)
            if media.tracks:
                densities *= tracked_balance
            if outlook and outlook.rule:
                densities = outlook.rule.densities(outlook, collided, densities)
            a.balance = dr.select(inside, balanced(flight.balance, densities), flight.balance)
            a.carried = s.throughput * a.balance
        if outlook:
            self._weigh(media, s, flight, a, outlook, drawn_collision)
        return a

    def _horizon(self, media: Media, location: Any, extinction: Any) -> Any:
        """Length of a flight up to which emission is expected; 0 where none is."""
        mean = dr.mean(extinction) if self.chromatic else extinction
        return media.ask("horizon", location, mean)

    def _weigh(
        self, media: Media, s: Path, flight: Flight, a: Arrival, outlook: Outlook, collided: Any
    ) -> None:
        """Weigh emission that is expected, and what the flight came to."""
        a.outlook = outlook
        if outlook.seen is not None:
            a.expected, a.shown = outlook.seen, mi.Spectrum(s.throughput * outlook.emission)
        if outlook.rule:
            weight = outlook.rule.weight(a.collided, outlook.survived)
            weight = mi.Spectrum(dr.select(outlook.here, weight, 1))
            a.carried = mi.Spectrum(a.carried * weight)
            if flight.begun:
                a.weight = weight
            else:
                s.throughput = mi.Spectrum(s.throughput * weight)
            a.refused = collided & ~a.collided
        if a.shown is not None:
            a.shown = dr.select(a.expected, a.shown, a.carried)

    def _flown(self, s: Path, flight: Flight, a: Arrival) -> tuple[Any, ...]:
        """What the flight that ends here depends on."""
        sigma_t = dr.select(a.sigma_t > 0, a.sigma_t, 1)
        column = dr.select(a.collided, a.drawn / sigma_t, a.reached)
        mei = medium_interaction(s.d, a.ray)
        gap = dr.dot(flight.offset, s.d)
        start = flight.began if self.null else dr.fma(-gap, s.d, s.o)
        length = dr.select(a.collided | a.si.is_valid(), dr.dot(a.p - start, s.d), dr.inf)
        end = a.inside, start, length
        return flight.location, flight.from_particle, a.collided, column, mei, *end

    def _intersect(self, ray: Any, first: Any, active: Any) -> tuple[Any, Contact | None]:
        """The surface that a ray hits; behind the emitters, if these are hidden."""
        si, contact = self.nee.tracer.hit(ray, first, active)
        if not self.options.hide_emitters:
            return si, contact
        hidden = active & first & si.is_valid() & (si.shape.emitter() != None)  # noqa: E711
        onward = si.spawn_ray(ray.d)
        behind = self.options.skip_area_emitters(self.nee.scene, onward, True, hidden)
        skipped = behind.compute_surface_interaction(onward, mi.RayFlags.All, hidden)
        skipped.t += si.t
        if contact:
            contact.several &= ~hidden
        return dr.select(hidden, skipped, si), contact

    # ------------------------------------------------------------- emission hit by the ray

    def emission(self, s: Path, a: Arrival) -> Emission | None:
        """What the surface, or the environment, emits; None if nothing that rays can hit does."""
        if not self.nee.needs.hittable_emitters:
            return None
        emitter = a.si.emitter(self.nee.scene)
        seeing = a.on_surface if a.expected is None else a.on_surface | (s.active & a.expected)
        lit = seeing & (emitter != None)  # noqa: E711
        if self.options.hide_emitters:
            lit &= ~a.first
        if a.blocked is not None:
            lit &= ~a.blocked
        if s.glass:
            lit &= ~s.glass.seen
        radiance, hit = emitter.eval(a.si, lit), None
        if self.connects:
            origin = s.vertex if self.null else s.o
            bent = BentRay(s.glass.anchor, origin, lit & s.glass.crossed) if s.glass else None
            hit = self.nee.hit(a.si, origin, s.pdf, s.certain, bent, lit)
        return Emission(lit, radiance, hit, emitter)

    # ------------------------------------------------------------- connection to an emitter

    def connecting(self, s: Path, a: Arrival, emission: Emission | None) -> tuple[Any, Any]:
        """Masks of the events that connect straight, and of those that do through glass."""
        media, needs = self.media, self.nee.needs
        straight, in_glass = mi.Bool(False), mi.Bool(False)
        if needs.smooth_surfaces:
            smooth = a.on_surface & mi.has_flag(a.bsdf.flags(), mi.BSDFFlags.Smooth)
            if a.blocked is not None:
                smooth &= ~a.blocked
            straight = smooth & ~a.last
            if media and s.flight and media.any("sealed"):
                sealed = media.where("sealed", s.flight.location)
                straight &= ~sealed | a.si.is_medium_transition()
        if media and s.flight and media.connects:
            straight |= a.collided & ~a.last & media.holds("connects", s.flight.location)
        if self.nee.glass:
            if needs.smooth_surfaces:
                in_glass |= smooth
            if media and s.flight and media.any("samples"):
                in_glass |= a.collided & media.holds("samples", s.flight.location)
            in_glass &= s.depth + 2 < self.options.max_depth
            if s.glass and emission:
                in_glass &= ~(emission.lit & s.glass.crossed)  # the search is for another one
        return straight, in_glass

    def arriving(
        self,
        sampler: mi.Sampler,
        s: Path,
        a: Arrival,
        vertex: Any,
        link: Link,
        scattering: Scattering,
        record: Record | None,
    ) -> Any:
        """What a connection contributes."""
        location = s.flight.location if s.flight else None
        if self.media and self.nee.needs.smooth_boundaries:
            leaving = partial(self._behind, a, location)
        else:
            leaving = partial(_stay, location)
        start = Start(vertex, leaving, a.from_particle)
        useful = dr.any(scattering.value != 0)
        shares = record.shares if record else None
        arriving = self.nee.arriving(link, start, sampler, useful, shares)
        light = mi.Spectrum(link.light * arriving)
        weight = link.weight(scattering.value_pdf)
        contribution = a.carried * scattering.value * light * weight
        if record:
            factor, value = a.carried * light * weight, scattering.value
            onward = a.carried * value * arriving * weight
            lit = partial(self.nee.light, link, vertex, link.active)
            record.link = contribution, factor, value, onward, lit, link.active
        return contribution

    # ------------------------------------------------------------- scattering

    def scatter(
        self, sampler: mi.Sampler, s: Path, a: Arrival, wo: Any, record: Record | None
    ) -> Scattering:
        """Evaluate the BSDF or the phase function towards ``wo``, and sample it."""
        si, on_surface, collided = a.si, a.on_surface, a.collided
        u1, u2 = sampler.next_1d(), sampler.next_2d()
        value, value_pdf, bs, weight = eval_pdf_sample(
            a.bsdf, si, si.to_local(wo), u1, u2, on_surface
        )
        d, pdf = si.to_world(bs.wo), bs.pdf
        passed = on_surface & mi.has_flag(bs.sampled_type, mi.BSDFFlags.Null)
        certain = mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)
        if record:
            record.surface = a.bsdf, si, si.to_local(wo), bs.wo, on_surface
        if self.media and s.flight:
            location = s.flight.location
            mei = medium_interaction(s.d, a.ray, a.p)
            m = self.media.ask(
                "scatter", location, mei, wo, u1, u2, *a.start, active=collided & ~a.last
            )
            if record:
                record.phase = location, mei, wo, m.wo, collided & ~a.last
            value = dr.select(collided, m.albedo * m.value, value)
            value_pdf = dr.select(collided, m.pdf, value_pdf)
            weight = dr.select(collided, m.albedo * m.weight, weight)
            d = dr.select(collided, m.wo, d)
            pdf = dr.select(collided, m.wo_pdf, pdf)
            certain = dr.select(collided, ~self.media.holds("connects", location), certain)
        return Scattering(value, value_pdf, d, pdf, weight, bs, passed, certain)

    # ------------------------------------------------------------- the next ray

    def advance(
        self,
        sampler: mi.Sampler,
        s: Path,
        a: Arrival,
        vertex: Any,
        scattering: Scattering,
        in_glass: Any,
        record: Record | None,
    ) -> None:
        """Take the new direction, or end."""
        d, on_surface = scattering.d, a.on_surface
        s.active = on_surface | (a.collided & ~a.last) if self.media else on_surface
        s.opaque |= s.active & ~scattering.passed
        if a.refused is not None:
            s.opaque |= a.refused & ~a.last
        s.active &= scattering.pdf > 0
        s.throughput = dr.select(s.active, s.throughput * scattering.weight, s.throughput)
        s.eta = dr.select(on_surface, s.eta * scattering.bs.eta, s.eta)
        scattered = s.active & ~scattering.passed
        s.far = mi.Float(dr.largest(mi.Float))
        s.depth = dr.select(scattered, s.depth + 1, s.depth)
        out: Any = mi.Bool(False)
        if s.glass:
            out = self._leave_glass(s, a, vertex, scattering, in_glass, scattered, record)
        s.pdf = dr.select(scattered & ~out, scattering.pdf, s.pdf)
        s.certain = dr.select(scattered, scattering.certain, s.certain)
        if self.nee.silent:
            # No connection gets through here: what this ray finds counts in full.
            hidden = scattering.passed & (self.nee.silent.of(a.bsdf) != 0)
            s.certain |= hidden
            if s.glass:
                s.glass.armed &= ~hidden
                s.glass.crossed &= ~hidden
        s.o, s.d = self.nee.offset.onward(vertex, d), d
        if self.media and s.flight:
            self._go_on(self.media, s, s.flight, a, scattered)
        if self.null:
            s.vertex = dr.select(scattered, a.p, s.vertex)
            s.passes = dr.select(scattered, 0, s.passes + 1)
            s.active &= s.passes < MOST_PASSES

        # Russian roulette.
        balance = s.flight.balance if s.flight else None
        carried = s.throughput if balance is None else s.throughput * balance
        s.active &= dr.any(carried != 0) & (s.depth < self.options.max_depth)
        survival = dr.detach(dr.minimum(dr.max(carried) * dr.square(s.eta), 0.95))
        roulette = scattered & (s.depth > self.options.rr_depth)
        s.active &= ~roulette | (sampler.next_1d() < survival)
        s.throughput = dr.select(roulette, s.throughput * dr.rcp(survival), s.throughput)

    def _leave_glass(
        self,
        s: Path,
        a: Arrival,
        vertex: Any,
        scattering: Scattering,
        in_glass: Any,
        scattered: Any,
        record: Record | None,
    ) -> Any:
        """Follow a path out of glass; the mask of those that leave it here."""
        assert s.glass and self.nee.glass
        bs, on_surface = scattering.bs, a.on_surface
        # What the camera sees reflected in glass is not left to chance.
        seen = on_surface & a.first & ~a.last & self.nee.glass.meets(a.si)
        if self.media and s.flight:
            seen &= ~self.media.inside(s.flight.location)
        share, hit = self.nee.reflected(a.si, vertex, a.bsdf, seen)
        emitter = hit.emitter(self.nee.scene)
        reflected = a.carried * mi.Spectrum(share * emitter.eval(hit, seen))
        s.radiance = dr.select(seen, s.radiance + reflected, s.radiance)
        if record:
            record.emissions.append((a.carried * share, emitter, hit, seen))
        s.glass.seen = seen & mi.has_flag(bs.sampled_type, mi.BSDFFlags.DeltaReflection)
        # Out of the glass, the density is that of the last direction within.
        out = s.glass.armed & mi.has_flag(bs.sampled_type, mi.BSDFFlags.DeltaTransmission)
        out &= scattered & on_surface & (dr.dot(scattering.d, a.si.n) > 0)
        s.glass.crossed = dr.select(scattered, out, s.glass.crossed)
        delta = on_surface & mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)
        s.glass.armed = dr.select(scattered, in_glass & ~delta, s.glass.armed)
        s.glass.anchor = dr.select(scattered & in_glass, a.p, s.glass.anchor)
        return out

    def _behind(self, a: Arrival, location: Any, d: Any) -> Any:
        """Location of a ray that leaves an event in direction ``d``."""
        assert self.media
        return self.media.behind(a.si, a.on_surface, location, d, a.contact)

    def _go_on(self, media: Media, s: Path, flight: Flight, a: Arrival, scattered: Any) -> None:
        """Begin a flight, or go on with the present one, straight through a null surface."""
        flight.offset = mi.Vector3f(s.o - a.p)
        beyond = self._behind(a, flight.location, s.d)
        fresh = flight.fresh
        if self.resumes:
            fresh = flight.fresh = scattered | (beyond != flight.location)
            flight.tau = dr.maximum(a.tau - a.sigma_t * a.column, 0)
            if a.weight is not None:
                s.throughput = dr.select(fresh, s.throughput * a.weight, s.throughput)
        if self.null:
            flight.ahead = a.ahead
        if a.blocked is not None:
            s.active &= ~(a.blocked & fresh)
        if self.chromatic:
            balance = a.balance
            if self.resumes:
                # Tracked flights have no memory: each stretch counts by itself.
                done = fresh | a.tracked if media.tracks else fresh
                balance = dr.select(done, balance, flight.balance)
            flight.balance = mi.UnpolarizedSpectrum(balance)
        if (self.resumes and self.keeps) or flight.begun:
            if self.keeps:
                flight.drawn = a.drawn
            flight.flown = dr.select(fresh, 0, a.reached)
            if self.adjoint:
                flight.began = dr.select(fresh, a.p, flight.began)
                flight.weight = dr.select(fresh, s.throughput, flight.weight)
            if flight.begun and a.outlook:
                flight.begun = a.outlook.begun()
            flight.from_particle = dr.select(fresh, a.from_particle, flight.from_particle)
        else:
            flight.from_particle = a.from_particle
        flight.location = beyond


def _collision(s: Path, flight: Flight, travelled: Any, gap: Any) -> Any:
    """Point at a distance of ``travelled`` from the last event.

    The ray starts off the surface, and so runs beside the line that it stands for. Right behind
    the surface the point goes back to that line (but for 0.1 % of the offset, to stay inside):
    in a dense medium all happens there. The share falls as the square of the distance, so that
    the point stays inside a curved surface that the ray only grazes.
    """
    square = dr.maximum(dr.squared_norm(flight.offset), 1e-30)
    share = dr.maximum(1 - 1e-3 * dr.square(travelled) / square, 0)
    on_ray = dr.fma(s.d, travelled - gap, s.o)
    return on_ray - share * (0.999 * flight.offset - gap * s.d)


def _stay(location: Any, _direction: Any) -> Any:
    return location
