"""The quadratic law: flights from a particle are uniformly distributed."""

from dataclasses import dataclass
from typing import Any, ClassVar

import drjit as dr

from ..numerics import filled, select
from ..parameters import parameter
from ..transmittance import Draw, Transmittance


@dataclass(frozen=True, eq=False)
class Quadratic(Transmittance):
    """T = (1 - tau/b)^2 up to tau = b, then 0: negatively correlated particles.

    From a particle the next collision is uniform on [0, b].
    """

    b: Any = parameter(2.0, above=0, doc="longest flight, in optical depth")
    examples: ClassVar[tuple[dict[str, Any], ...]] = ({}, {"b": 0.5}, {"b": 30.0})

    @property
    def sigma_bar(self) -> Any:
        return 2 / self.b

    def ff(self, tau: Any) -> Any:
        return self.pf(tau) ** 2

    def pf(self, tau: Any) -> Any:
        return dr.maximum((self.b - tau) / self.b, 0)

    def pp(self, tau: Any) -> Any:
        return select(tau < self.b, 1 / self.b, filled(tau, 0.0))

    def sample_f(self, draw: Draw) -> Any:
        u = draw()
        return self.b * (u / (1 + dr.sqrt(1 - u)))  # 1 - sqrt(1-u) without cancellation

    def sample_p(self, draw: Draw) -> Any:
        return self.b * draw()
