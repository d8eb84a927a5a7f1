"""Flights that are made to collide where the density of a law jumps.

Each flight between collisions adds a term to the derivative of an image for each jump (see
:class:`.adjoint.Jumps`). A path estimates the sum of these terms by one of its flights, chosen in
proportion to its throughput, and by one more path from where that flight began, whose first flight
must end at the jump.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi

from .adjoint import Adjoint, Jumps
from .media import medium_interaction
from .spectral import at_channel, channels, draw_channel


@dataclass
class Chosen:
    """One of the flights of a path from collision to collision (reservoir sampling)."""

    rng: Any
    """random numbers for the choice, which the path itself does not use"""
    total: Any
    """sum of the weights of all flights so far"""
    weight: Any
    """its own, 0 if there is none"""
    p: Any
    """where it began"""
    d: Any
    location: Any
    depth: Any
    eta: Any
    throughput: Any
    """with the balance of the channels"""

    @staticmethod
    def none(location: Any, sampler: mi.Sampler) -> Chosen:
        """No flight yet. ``location`` tells the type only."""
        u = sampler.clone().next_1d()
        lanes = dr.arange(mi.UInt32, dr.width(u))
        key, sequence = mi.sample_tea_32(mi.UInt32(mi.Float32(u) * 2.0**24), lanes, 8)
        return Chosen(
            rng=mi.PCG32(1, mi.UInt64(key), mi.UInt64(sequence)),
            total=mi.Float(0),
            weight=mi.Float(0),
            p=mi.Point3f(0),
            d=mi.Vector3f(0, 0, 1),
            location=type(location)(0),
            depth=mi.UInt32(0),
            eta=mi.Float(1),
            throughput=mi.Spectrum(0),
        )

    def offer(self, s: Any, p: Any, throughput: Any, active: Any) -> None:
        """Take the flight that a path ``s`` begins at ``p``, or keep the one before."""
        weight = dr.select(active, dr.max(dr.abs(throughput)), 0)
        self.total += weight
        taken = (weight > 0) & (mi.Float(self.rng.next_float32()) * self.total < weight)
        self.weight = dr.select(taken, weight, self.weight)
        self.p, self.d = dr.select(taken, p, self.p), dr.select(taken, s.d, self.d)
        self.location = dr.select(taken, s.flight.location, self.location)
        self.depth = dr.select(taken, s.depth, self.depth)
        self.eta = dr.select(taken, s.eta, self.eta)
        self.throughput = dr.select(taken, throughput, self.throughput)


@dataclass
class Forced:
    """The first flight of a path that must end at a collision."""

    pending: Any
    """it has not ended"""
    length: Any
    """its length"""


@dataclass(frozen=True)
class Origin:
    """Where such a path begins."""

    flight: Chosen
    tau: Any
    """optical depth, or in the channel that draws flights, at which it collides first"""
    balance: Any
    """of that channel alone (chromatic extinction)"""


def count(events: Any, chosen: Chosen, tangent: Any, sampler: mi.Sampler, adjoint: Adjoint) -> Any:
    """Trace the path from the chosen flight, and count its terms."""
    media = events.media
    u, hero, balance = sampler.next_1d(), None, None
    if events.chromatic:
        hero = draw_channel(sampler.next_1d())
        alone = [dr.select(hero == k, channels(), 0) for k in range(channels())]
        balance = mi.UnpolarizedSpectrum(*alone)
    active = chosen.weight > 0
    adjoint.leaves.renew(active)
    depth, height = mi.Float(1), mi.Float(0)
    for twin, here in adjoint.jumping(media, chosen.location):
        where, own = Jumps(twin.model.jumps).draw(u)
        depth = dr.detach(dr.select(here, where, depth))
        height = dr.select(here, own, height)
    plain = replace(
        events,
        nee=replace(events.nee, adjoint=None),
        adjoint=None,
        hero=hero,
        origin=Origin(chosen, depth, balance),
    )
    _, path = dr.while_loop(
        (sampler, plain.resume(active)),
        lambda sampler, s: s.active,
        plain.event,
        label="nonexp: path from a jump",
    )
    reached = active & ~path.forced.pending
    carried = chosen.throughput if balance is None else chosen.throughput * balance
    collected = path.radiance
    if adjoint.baseline is not None:
        collected = collected - carried * adjoint.baseline
    share = height * chosen.total / dr.select(active, chosen.weight, 1)
    collected = dr.detach(dr.select(reached, share * collected, 0))

    ray = mi.Ray3f(chosen.p, chosen.d, events.time, events.wavelengths)
    mei = medium_interaction(chosen.d, ray)
    sigma_t = media.sigma_t(chosen.location, mei)
    column = depth / (sigma_t if hero is None else at_channel(sigma_t, hero))
    column = dr.detach(dr.select(reached, column, 0))
    terms: Any = mi.Spectrum(0)
    with dr.resume_grad():
        adjoint.leaves.renew(reached)
        for twin, here in adjoint.jumping(media, chosen.location):
            where, _ = Jumps(twin.model.jumps).draw(u)
            extinction = mi.UnpolarizedSpectrum(twin.extinction(mei))
            here &= reached
            terms += dr.select(here, collected * (extinction * column - where), 0)
            if "density" in twin.kinds:
                slope = collected * dr.detach(extinction)
                line = chosen.p, chosen.d, path.forced.length
                tangent = adjoint.spread(tangent, twin, here, slope, line)
        return adjoint.add(tangent, terms)
