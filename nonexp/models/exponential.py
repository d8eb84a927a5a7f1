"""The exponential law: uncorrelated scatterers."""

from dataclasses import dataclass
from typing import Any

import drjit as dr

from ..numerics import log1p
from ..transmittance import Draw, Transmittance


@dataclass(frozen=True, eq=False)
class Exponential(Transmittance):
    """T = exp(-tau), Beer and Lambert's law of independently placed particles.

    The only law without memory: all four transmittances and densities are the same function.
    """

    @property
    def sigma_bar(self) -> Any:
        return 1.0

    @property
    def extinctions(self) -> tuple[Any, Any]:
        return (1.0,), (1.0,)

    @property
    def jumps(self) -> tuple[tuple[Any, Any], ...] | None:
        return ()

    def ff(self, tau: Any) -> Any:
        return dr.exp(-tau)

    def pf(self, tau: Any) -> Any:
        return dr.exp(-tau)

    def pp(self, tau: Any) -> Any:
        return dr.exp(-tau)

    def sample_f(self, draw: Draw) -> Any:
        return -log1p(-draw())

    def sample_p(self, draw: Draw) -> Any:
        return -log1p(-draw())
