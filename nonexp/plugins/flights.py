"""How flights through a grid are drawn: by a walk through its cells, or by null collisions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from nonexp.numerics.laplace import AliasTable
from nonexp.plugins.density import BRICK, Bounds, Density
from nonexp.transmittance import Transmittance
from nonexp.transmittance.kinds import number

__all__ = ["TRACKING", "Choice", "mixing", "reach"]

TRACKING = ("auto", "regular", "delta")
"""Values of the parameter ``tracking``."""


def reach(model: Transmittance) -> float:
    """Optical depth from which on no transmittance is left in single precision; may be infinite."""
    depths = np.geomspace(1e-3, 1e9, 2401)
    gone = np.flatnonzero(model.ff(depths) < 1e-45)
    return float(depths[gone[0]]) if gone.size else np.inf


def mixing(extinctions: tuple[Any, Any]) -> tuple[AliasTable | None, AliasTable | None]:
    """Tables that draw S of a law ``T = E[exp(-S tau)]``: as it is, and in proportion to S.

    None where S is always 1.
    """
    values, weights = (np.array(part, dtype=float) for part in extinctions)
    if np.all(values == 1) or not values @ weights > 0:
        return None, None
    return AliasTable(values, weights), AliasTable(values, values * weights)


@dataclass(frozen=True)
class Choice:
    """Which of the two ways, and why."""

    extinctions: tuple[Any, Any] | None
    """of flights by null collisions, as :attr:`Transmittance.extinctions`; None for a walk"""
    bounds: Bounds | None
    """upper bounds of the density for these"""
    reason: str

    @staticmethod
    def of(wanted: str, density: Density, model: Transmittance, extinction: float) -> Choice:
        """The way for a grid with ``extinction`` where its density is 1, as the parameter
        ``tracking`` has it. ``ValueError`` if that cannot be."""
        why = f"tracking is {wanted!r}"
        if wanted == "regular":
            return Choice(None, None, why)
        rate = extinction * number(model.sigma_bar)
        finest = Bounds(density, BRICK)
        if wanted == "auto":
            collisions, steps = rate * finest.across, density.steps_across
            why = f"{collisions:.3g} tentative collisions across against {steps:.3g} cells"
            if collisions >= _STEP * steps:
                return Choice(None, None, why)
        extinctions = model.extinctions
        if extinctions is None and wanted == "delta":
            raise ValueError(
                "tracking is 'delta': it must be 'regular' or 'auto' for a transmittance that is "
                "no mixture of exponentials"
            )
        if extinctions is None:
            return Choice(None, None, "the law is no mixture of exponentials")
        sizes = range(1, 5)
        all_bounds = [finest, *(Bounds(density, BRICK << k) for k in sizes)]
        best = min(all_bounds, key=lambda one: rate * one.across + _FACE * one.steps)
        return Choice(extinctions, best, why)


_FACE = 0.2
"""Cost of a step that ends at the face of a block, in tentative collisions."""
_STEP = 0.25
"""Measured cost of a step from cell to cell, in tentative collisions and the noise they add."""
