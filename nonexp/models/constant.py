"""The constant law: vacuum."""

from dataclasses import dataclass
from typing import Any

import drjit as dr

from ..numerics import filled
from ..transmittance import Draw, Transmittance


@dataclass(frozen=True, eq=False)
class Constant(Transmittance):
    """T = 1: nothing ever collides; the limit of every law for vanishing extinction."""

    @property
    def sigma_bar(self) -> Any:
        return 0.0

    @property
    def extinctions(self) -> tuple[Any, Any]:
        return (0.0,), (1.0,)

    def ff(self, tau: Any) -> Any:
        return filled(tau, 1.0)

    def pf(self, tau: Any) -> Any:
        return filled(tau, 1.0)

    def pp(self, tau: Any) -> Any:
        return filled(tau, 0.0)

    def sample_f(self, draw: Draw) -> Any:
        return dr.inf

    def sample_p(self, draw: Draw) -> Any:
        return dr.inf
