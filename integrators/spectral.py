"""Spectral multiple importance sampling over the channels (or wavelengths) of a path.

One channel, the hero, draws all flights of a path. Had another channel drawn the same path, its
density would differ; the weight of the path is its contribution over the mean density of all
channels (the balance heuristic for a sample of one technique; Veach 1997, Wilkie et al. 2014). As
flights are drawn in proportion to what they contribute, a channel's weight is its density over the
mean density: the *balance*, whose mean over the channels is 1.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi


def channels() -> int:
    """Number of channels, or of wavelengths per path."""
    return int(dr.size_v(mi.UnpolarizedSpectrum))


def draw_channel(sample: Any) -> Any:
    """A channel, uniformly from one random number."""
    return dr.minimum(mi.UInt32(sample * channels()), channels() - 1)


def at_channel(spectrum: Any, channel: Any) -> Any:
    """One component of a spectrum."""
    value = spectrum[0]
    for k in range(1, channels()):
        value = dr.select(channel == k, spectrum[k], value)
    return value


def balanced(balance: Any, densities: Any) -> Any:
    """The balance after a step that the channels would make with these ``densities``."""
    product = balance * densities
    mean = dr.mean(product)
    # By rounding, no channel may seem able to do what the hero did.
    possible = (mean > 0) & dr.isfinite(mean)
    result = dr.select(possible, product / dr.select(possible, mean, 1), balance)
    return mi.UnpolarizedSpectrum(result)
