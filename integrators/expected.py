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


def ratio(a: Any, b: Any) -> Any:
    """``a / b``, 0 where b is."""
    return dr.select(b > 0, a / dr.select(b > 0, b, 1), 0)
