"""Flights through heterogeneous media, with null collisions.

Delta tracking finds the next collision, ratio tracking estimates a transmittance; both step from
one tentative collision of the majorant to the next. They hold for exponential flights alone, which
have no memory: those of the exponential law, or of a mixture of exponentials once its factor on
the extinction, the ``thinning``, is drawn.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from nonexp.numerics import log1p

from .media import Media, medium_interaction
from .spectral import at_channel, balanced

_LITTLE = 0.3
"""Transmittance below which Russian roulette plays."""


@dataclass
class _Track:
    """State on the way along a ray."""

    t: Any
    """distance from the ray's origin"""
    stepping: Any
    """neither collided nor at the end"""
    collided: Any
    """at a real collision"""
    weight: Any
    """the channels' densities of the steps so far, or the transmittance"""
    brick: Any
    """the brick it is in (None: majorants are the same everywhere)"""


def next_collision(
    media: Media,
    location: Any,
    ray: Any,
    end: Any,
    thinning: Any,
    hero: Any,
    sampler: Any,
    active: Any,
) -> tuple[Any, Any]:
    """Distance of the next real collision on ``ray`` before ``end``, infinite if there is none.

    Also returns, in chromatic scenes, the channels' densities of this flight relative to their
    mean; ``hero`` is the channel that draws it.
    """

    def collide(sampler: Any, s: _Track, sigma_n: Any, sigma_t: Any, majorant: Any) -> None:
        own = at_channel(sigma_t, hero) if media.chromatic else sigma_t[0]
        real = s.stepping & (sampler.next_1d(s.stepping) * majorant < own)
        if media.chromatic:
            balance = balanced(s.weight, dr.select(real, sigma_t, sigma_n))
            s.weight = mi.UnpolarizedSpectrum(dr.select(s.stepping, balance, s.weight))
        s.collided |= real
        s.stepping &= ~real

    found = _track(
        media, location, ray, end, thinning, sampler, active, collide, "nonexp: delta tracking"
    )
    return dr.select(found.collided, found.t, dr.inf), found.weight


def transmittance(
    media: Media, location: Any, ray: Any, end: Any, thinning: Any, sampler: Any, active: Any
) -> Any:
    """Unbiased estimate of the transmittance along ``ray`` up to ``end``, a spectrum.

    Of a mixture of exponentials where ``thinning`` is drawn anew.
    """

    def collide(sampler: Any, s: _Track, sigma_n: Any, sigma_t: Any, majorant: Any) -> None:
        weight = s.weight * (sigma_n / majorant)
        if media.any("bricked"):
            # What hardly counts any more is not tracked to the end.
            survival = dr.minimum(dr.max(weight) / _LITTLE, 1)
            lives = sampler.next_1d(s.stepping) < survival
            weight = dr.select(lives, weight / survival, 0)
        s.weight = mi.UnpolarizedSpectrum(dr.select(s.stepping, weight, s.weight))
        s.stepping &= dr.any(s.weight != 0)

    track = _track(
        media, location, ray, end, thinning, sampler, active, collide, "nonexp: ratio tracking"
    )
    return track.weight


def _track(
    media: Media,
    location: Any,
    ray: Any,
    end: Any,
    thinning: Any,
    sampler: Any,
    active: Any,
    collide: Callable[[Any, _Track, Any, Any, Any], None],
    label: str,
) -> _Track:
    """Step along ``ray`` up to ``end``, from one tentative collision to the next.

    Where bricks have majorants of their own, a step also ends where the ray leaves a brick: what is
    exponential has no memory. ``collide(sampler, state, sigma_n, sigma_t, majorant)`` says what
    happens at a tentative collision, in the lanes that are stepping.
    """
    near, far, majorant = media.ask("bounds", location, ray)
    far = dr.minimum(far, end)
    bricks = None
    if media.any("bricked"):
        bricks = _Bricks(*media.ask("bricks", location, ray))

    def step(sampler: Any, s: _Track) -> tuple[Any, _Track]:
        free = -log1p(-sampler.next_1d(s.stepping))
        if not bricks:
            s.t = s.t + free / (majorant * thinning)
            s.stepping &= s.t < far
            tentative(sampler, s, majorant)
            return sampler, s
        local = majorant * media.ask("bound", location, s.brick, active=s.stepping)
        rate = local * thinning
        there = s.t + dr.select(rate > 0, free / rate, dr.inf)
        exit, beyond = bricks.leave(s.brick, s.t)
        leaves = there >= exit
        s.t = dr.minimum(there, exit)
        s.brick = dr.select(leaves, beyond, s.brick)
        goes_on = s.stepping & (s.t < far)
        s.stepping = goes_on & ~leaves
        tentative(sampler, s, local)
        s.stepping |= goes_on & leaves
        return sampler, s

    def tentative(sampler: Any, s: _Track, majorant: Any) -> None:
        mei = medium_interaction(ray.d, ray, ray(s.t), s.t)
        sigma_n, sigma_t = media.ask("coefficients", location, mei, majorant, active=s.stepping)
        collide(sampler, s, sigma_n, sigma_t, majorant)

    state = _Track(
        t=near,
        stepping=active & (near < far),
        collided=mi.Bool(False),
        weight=mi.UnpolarizedSpectrum(1),
        brick=bricks.at(near) if bricks else None,
    )
    _, found = dr.while_loop((sampler, state), lambda sampler, s: s.stepping, step, label=label)
    return found


class _Bricks:
    """A ray through unit cubes."""

    def __init__(self, o: Any, d: Any) -> None:
        self.o, self.d = o, d
        # Parallel to planes it meets them far away, not at infinity: no 0 * inf.
        tiny = dr.maximum(1e-12 * dr.max(dr.abs(d)), 1e-30)
        self.inverse = [dr.rcp(dr.select(dr.abs(d[k]) > tiny, d[k], tiny)) for k in range(3)]

    def at(self, t: Any) -> Any:
        """The brick at a distance."""
        return mi.Vector3i(dr.floor(self.o + self.d * t))

    def leave(self, brick: Any, t: Any) -> tuple[Any, Any]:
        """Distance, not below ``t``, at which the ray leaves a brick, and the next one."""
        exits = []
        for k in range(3):
            plane = brick[k] + dr.select(self.inverse[k] > 0, 1, 0)
            exits.append((mi.Float(plane) - self.o[k]) * self.inverse[k])
        first = dr.minimum(dr.minimum(exits[0], exits[1]), exits[2])
        beyond = mi.Vector3i(brick)
        for k in range(3):
            onward = brick[k] + dr.select(self.inverse[k] > 0, 1, -1)
            beyond[k] = dr.select(exits[k] <= first, onward, brick[k])
        return dr.maximum(first, t), beyond
