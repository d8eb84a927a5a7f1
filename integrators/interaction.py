"""What media are asked about: a ray, or a point on it."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi


def medium_interaction(
    direction: Any, like: Any, p: Any = None, t: Any = None
) -> mi.MediumInteraction3f:
    """A ray in ``direction``, with the time and wavelengths of ``like``, and a point on it."""
    mei = dr.zeros(mi.MediumInteraction3f)
    mei.wi, mei.time, mei.wavelengths = -direction, like.time, like.wavelengths
    mei.sh_frame = mi.Frame3f(mei.wi)
    if p is not None:
        mei.p = p
    if t is not None:
        mei.t = t
    return mei
