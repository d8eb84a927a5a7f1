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

    ``collide(sampler, state, sigma_n, sigma_t, majorant)`` says what happens there.
    """

    def step(sampler: Any, s: _Track) -> tuple[Any, _Track]:
        s.t = s.t - log1p(-sampler.next_1d(s.stepping)) / rate
        s.stepping &= s.t < far
        mei = medium_interaction(ray.d, ray, ray(s.t), s.t)
        sigma_n, sigma_t = media.ask("coefficients", location, mei, active=s.stepping)
        collide(sampler, s, sigma_n, sigma_t, majorant)
        return sampler, s

    near, far, majorant = media.ask("bounds", location, ray)
    far, rate = dr.minimum(far, end), majorant * thinning
    state = _Track(near, active & (near < far), mi.Bool(False), mi.UnpolarizedSpectrum(1))
    _, found = dr.while_loop((sampler, state), lambda sampler, s: s.stepping, step, label=label)
    return found
