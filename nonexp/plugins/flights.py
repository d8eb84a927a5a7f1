"""How flights through a grid are drawn: by a walk through its cells, or by null collisions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from nonexp.numerics.laplace import AliasTable
from nonexp.plugins.density import Density
from nonexp.transmittance import Transmittance

__all__ = ["TRACKING", "Choice", "mixing", "reach"]

TRACKING = ("auto", "regular", "delta")
"""Values of the parameter ``tracking``."""


def reach(model: Transmittance) -> float:
    """Optical depth from which on no transmittance is left in single precision; may be infinite."""
    depths = np.geomspace(1e-3, 1e9, 2401)
    gone = np.flatnonzero(model.ff(depths) < 1e-45)
    return float(depths[gone[0]]) if gone.size else np.inf


def mixing(extinctions: tuple[Any, Any] | None) -> tuple[AliasTable | None, AliasTable | None]:
    """Tables that draw S of a law ``T = E[exp(-S tau)]``: as it is, and in proportion to S.

    None where there is nothing to draw.
    """
    if extinctions is None:
        return None, None
    values, weights = (np.array(part, dtype=float) for part in extinctions)
    if np.all(values == 1) or not values @ weights > 0:
        return None, None
    return AliasTable(values, weights), AliasTable(values, values * weights)


@dataclass(frozen=True)
class Choice:
    """Which of the two ways, and why."""

    delta: bool
    """null collisions"""
    reason: str

    @staticmethod
    def of(
        wanted: str, density: Density, extinctions: tuple[Any, Any] | None, extinction: float
    ) -> Choice:
        """The way for a grid with ``extinction`` where its density is 1, as the parameter
        ``tracking`` has it. ``ValueError`` if that cannot be."""
        if extinctions is None:
            if wanted == "delta":
                raise ValueError(
                    "tracking is 'delta': it must be 'regular' or 'auto' for a transmittance that "
                    "is no mixture of exponentials with constant parameters"
                )
            return Choice(False, "the law is no mixture of exponentials")
        if wanted != "auto":
            return Choice(wanted == "delta", f"tracking is {wanted!r}")
        values, weights = (np.array(part, dtype=float) for part in extinctions)
        steps = extinction * float(values @ weights) * density.bound_across
        cells = density.steps_across
        shown = f"{steps:.3g} tentative collisions across against {cells:.3g} steps by cells"
        return Choice(steps < _STEP * cells, shown)


_STEP = 0.25
"""Measured cost of a step from cell to cell, in tentative collisions and the noise they add."""
