"""The gamma law: a power-law tail from gamma-distributed extinction."""

from dataclasses import dataclass
from typing import Any, ClassVar

import drjit as dr

from ..numerics import expm1, log1p, scaled_log1p
from ..numerics.quadrature import nodes_of_law
from ..transmittance import Draw, Transmittance
from ..transmittance.parameters import number, parameter


@dataclass(frozen=True, eq=False)
class Gamma(Transmittance):
    """T = (1 + tau/alpha)^-alpha: clustered particles, positive correlation (Davis 2006).

    The mean of ``exp(-s tau)`` over extinctions ``s`` that follow a gamma distribution of shape
    ``alpha`` and mean 1. Tends to the exponential law as ``alpha`` grows; the smaller ``alpha``,
    the longer the tail.
    """

    alpha: Any = parameter(2.0, above=0, doc="shape of the distribution of extinction")
    examples: ClassVar[tuple[dict[str, Any], ...]] = (
        {},
        {"alpha": 0.3},
        {"alpha": 1.0},
        {"alpha": 30.0},
        {"alpha": 1e5},
    )

    @property
    def sigma_bar(self) -> Any:
        return 1.0

    @property
    def extinctions(self) -> tuple[Any, Any]:
        alpha = number(self.alpha)
        return nodes_of_law("Gamma", "gamma", (alpha, 0.0, 1 / alpha))

    @property
    def jumps(self) -> tuple[tuple[Any, Any], ...] | None:
        return ()

    def ff(self, tau: Any) -> Any:
        return dr.exp(-scaled_log1p(tau, self.alpha))

    def pf(self, tau: Any) -> Any:
        return dr.exp(-(1 + 1 / self.alpha) * scaled_log1p(tau, self.alpha))

    def pp(self, tau: Any) -> Any:
        factor = 1 + 1 / self.alpha
        return factor * dr.exp(-(1 + 2 / self.alpha) * scaled_log1p(tau, self.alpha))

    def sample_f(self, draw: Draw) -> Any:
        return self.alpha * expm1(-log1p(-draw()) / self.alpha)

    def sample_p(self, draw: Draw) -> Any:
        return self.alpha * expm1(-log1p(-draw()) / (self.alpha + 1))
