"""Evaluating the spectra of a homogeneous medium, over the visible wavelengths."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

__all__ = ["grey", "somewhere", "visible"]


def somewhere(wavelengths: Any = 550.0) -> Any:
    """A medium interaction at the origin, at these wavelengths (nm) where the variant has any."""
    mei = dr.zeros(mi.MediumInteraction3f)
    if mi.is_spectral:
        mei.wavelengths = mi.Spectrum(wavelengths)
    return mei


def visible() -> Any:
    """:func:`somewhere`, at 81 visible wavelengths."""
    return somewhere(dr.linspace(mi.Float, 380.0, 780.0, 81))


def grey(values: Any) -> bool:
    """Whether values over channels or wavelengths are equal, up to rounding."""
    low, high = np.min(values), np.max(values)
    return bool(high - low <= 1e-5 * high)
