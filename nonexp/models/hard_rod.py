"""The hard-rod law: flights from a particle are never shorter than a core."""

from dataclasses import dataclass
from typing import Any, ClassVar

import drjit as dr

from ..numerics import filled, log1p, select
from ..transmittance import Draw, Transmittance
from ..transmittance.parameters import parameter


@dataclass(frozen=True, eq=False)
class HardRod(Transmittance):
    """T = 1 - tau/(d+l) up to tau = d, then l/(d+l) exp(-(tau-d)/l): particles with a hard core.

    From a particle the next collision is at least ``d`` away, and beyond ``d`` exponentially
    distributed with mean ``l``: the gaps of impenetrable rods of length ``d`` placed at random on
    a line. Exponential for ``d = 0``; tends to the linear law of ``b = d`` as ``l`` vanishes.
    """

    d: Any = parameter(
        0.5, least=0, scales=1, doc="shortest flight after a collision, in optical depth"
    )
    l: Any = parameter(0.5, above=0, scales=1, doc="mean of what flights exceed d by")  # noqa: E741
    examples: ClassVar[tuple[dict[str, Any], ...]] = (
        {},
        {"d": 0.9, "l": 0.1},
        {"d": 0.25, "l": 2.0},
    )

    @property
    def sigma_bar(self) -> Any:
        return 1 / (self.d + self.l)

    @property
    def kinks(self) -> tuple[Any, ...]:
        return (self.d,)

    @property
    def jumps(self) -> tuple[tuple[Any, Any], ...] | None:
        return ((self.d, 1 / self.l),)

    def ff(self, tau: Any) -> Any:
        return (self.l * self.pf(tau) + dr.maximum(self.d - tau, 0)) / (self.d + self.l)

    def pf(self, tau: Any) -> Any:
        return dr.exp(-dr.maximum(0, tau - self.d) / self.l)

    def pp(self, tau: Any) -> Any:
        return select(tau >= self.d, self.pf(tau) / self.l, filled(tau, 0.0))

    def sample_f(self, draw: Draw) -> Any:
        u = draw()
        tau = u * (self.d + self.l)
        tail = dr.minimum((1 - u) * ((self.d + self.l) / self.l), 1)
        return select(tau < self.d, tau, self.d - self.l * dr.log(tail))

    def sample_p(self, draw: Draw) -> Any:
        return self.d - self.l * log1p(-draw())
