"""Expected values in place of draws: emission behind media, and collisions that hardly scatter.

A flight is drawn, and then it has collided or not. But the transmittance T up to the next surface
is known, whatever the law. So emission on that surface, or at infinity, counts in each sample with
the weight T, even where the flight has collided before (*expected emission*).

Collisions may be refused then: a flight that would have collided is kept with the probability q,
and else goes on to the surface. Right weights are 1/q of a collision that is kept and T/P at the
surface, which a flight now reaches with the probability P = 1 - q (1 - T). With

    q = keep / (keep + (1 - keep) T)

paths collide as often as they would if collisions and surfaces counted ``keep`` to 1, and both
weights times what follows, albedo or 1, are at most 1 where keep is not below the albedo.

Past surfaces inside one medium a flight goes on: its q is that of its first stretch. What is behind
such a surface is reached with the probability P there, so that emission on the next one counts T
there over P here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from .media import Media


@dataclass
class Begun:
    """What a flight that may go on past null surfaces carries of its beginning."""

    survived: Any
    """transmittance so far"""
    first: Any
    """that of its first stretch, which decides q (with the rule)"""
    kept: Any
    """its collision counts (with the rule)"""

    @staticmethod
    def start(chromatic: bool, refuses: bool) -> Begun:
        """State before any flight."""
        return Begun(
            mi.UnpolarizedSpectrum(1) if chromatic else mi.Float(1),
            mi.Float(1) if refuses else None,
            mi.Bool(True) if refuses else None,
        )


@dataclass
class Outlook:
    """A flight up to the next surface, as far as it can be expected."""

    here: Any
    """it can: in such media"""
    survived: Any
    """transmittance up to the surface"""
    seen: Any
    """emission there is to count by expectation (None: in no medium)"""
    emission: Any
    """weight of that, relative to the beginning of the flight"""
    rule: Rule | None
    """the rule for collisions (None: in no medium)"""

    def begun(self) -> Begun:
        """What the flight carries on, straight through the surface."""
        rule = self.rule
        return Begun(self.survived, rule.first if rule else None, rule.kept if rule else None)


@dataclass
class Rule:
    """Which collisions count."""

    first: Any
    q: Any
    """probability that one is kept"""
    not_q: Any
    """1 - q, without cancellation"""
    kept: Any
    """this one would be"""

    @staticmethod
    def of(keep: Any, first: Any, u: Any) -> Rule:
        """The rule where the transmittance of the first stretch is ``first``, and a decision by
        the random number ``u``."""
        total = dr.fma(1 - keep, first, keep)
        some = total > 0
        over = dr.rcp(dr.select(some, total, 1))
        q = dr.select(some, keep * over, 1)
        return Rule(first, q, dr.select(some, (1 - keep) * first * over, 0), u < q)

    def reached(self, survived: Any) -> Any:
        """Probability that a flight reaches a point with this transmittance."""
        return dr.fma(self.q, survived, self.not_q)

    def weight(self, collided: Any, survived: Any) -> Any:
        """Weight of what a flight came to: a kept collision, or the surface."""
        return dr.select(collided, dr.rcp(self.q), ratio(survived, self.reached(survived)))

    def densities(self, outlook: Outlook, collided: Any, densities: Any) -> Any:
        """Densities of a flight, one per channel, with the rule."""
        changed = dr.select(collided, self.q * densities, self.reached(outlook.survived))
        return dr.select(outlook.here, changed, densities)


@dataclass
class Way:
    """The ray of a flight, up to the surface that it hits."""

    inside: Any
    """it runs in a medium"""
    origin: Any
    """where the flight began, as media ask for it"""
    extinction: Any
    si: Any
    """the surface"""
    o: Any
    d: Any
    far: Any
    """length of the ray"""
    gap: Any
    """distance from the last event to its origin"""
    travelled: Any
    """distance from there to the collision, if there is one"""
    horizon: Any
    """distance up to which emission is expected (None: any)"""


def look(
    media: Media, flight: Any, way: Way, sampler: mi.Sampler, collided: Any, column: Any
) -> tuple[Outlook, Any]:
    """What is expected of a flight, and the integral of the density up to the surface, also where
    it has ``collided`` before."""
    location, begun, chromatic = flight.location, flight.begun, media.chromatic
    here = way.inside & media.holds("looks", location)
    column = dr.select(here, _whole_column(media, location, way, here, collided, column), column)
    depth = (column + flight.flown if begun else column) * way.extinction
    depth = dr.select(way.extinction > 0, depth, 0)  # none where nothing collides, however far
    survived = media.ask("survival", location, way.origin, depth)
    before = type(survived)(1)
    if begun:
        before = dr.select(flight.fresh, before, begun.survived)
    rule, reached = None, before
    if media.refuses:
        first = dr.mean(survived) if chromatic else survived
        if begun:
            first = dr.select(flight.fresh, first, begun.first)
        rule = Rule.of(media.keep(location), first, sampler.next_1d(here))
        if begun:
            rule.kept = dr.select(flight.fresh, rule.kept, begun.kept)
        reached = rule.reached(before)
    seen = None
    if media.any("expects"):
        seen = here & media.holds("expects", location)
        if way.horizon is not None:
            seen &= way.si.t <= way.horizon
    emission = survived
    if begun and chromatic:
        emission = flight.balance * ratio(survived, dr.mean(flight.balance * reached))
    elif begun:
        emission = ratio(survived, reached)
    elif chromatic:
        emission = flight.balance * survived
    return Outlook(here, survived, seen, emission, rule), column


def _whole_column(
    media: Media, location: Any, way: Way, here: Any, collided: Any, column: Any
) -> Any:
    """Integral of the density from the last event to the surface; ``column`` is that to the
    collision in grids."""
    far = dr.select(way.far < dr.largest(mi.Float), way.far, dr.inf)
    end = dr.select(way.si.is_valid(), way.si.t, far) + way.gap
    if not media.walks:
        return end
    walked = media.where("walked", location)
    p, left = dr.fma(way.travelled - way.gap, way.d, way.o), end - way.travelled
    beyond = here & walked & collided
    rest = media.ask("column", location, p, way.d, left, way.extinction, active=beyond)
    return dr.select(walked, dr.select(collided, column + rest, column), end)


def ratio(a: Any, b: Any) -> Any:
    """``a / b``, 0 where b is."""
    return dr.select(b > 0, a / dr.select(b > 0, b, 1), 0)
