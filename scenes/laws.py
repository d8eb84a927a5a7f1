"""Transmittance laws written as functions, for the model ``custom`` (media/custom.xml)."""

from typing import Any

import drjit as dr


def soft_repulsion(tau: Any) -> Any:
    """T = 1 - tanh(tau): short flights between collisions are rare, pp(0) = 0."""
    return 2 / (1 + dr.exp(2 * tau))
