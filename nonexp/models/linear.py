"""The linear law: every flight from a particle has the same length."""

from dataclasses import dataclass
from typing import Any, ClassVar

import drjit as dr

from ..numerics import filled, select
from ..parameters import parameter
from ..transmittance import Draw, Transmittance


@dataclass(frozen=True, eq=False)
class Linear(Transmittance):
    """T = 1 - tau/b up to tau = b, then 0: perfectly ordered, mutually repelling particles.

    From a particle the next collision is exactly ``b`` away (a Dirac law); from a fixed point it
    is uniform on [0, b]. The strongest negative correlation that is admissible. A collision at
    the very distance of a surface counts as a collision: ``pf(b) = 0``.
    """

    b: Any = parameter(1.0, above=0, doc="flight length after a collision, in optical depth")
    examples: ClassVar[tuple[dict[str, Any], ...]] = ({}, {"b": 0.25}, {"b": 1.72}, {"b": 1000.0})

    @property
    def sigma_bar(self) -> Any:
        return 1 / self.b

    @property
    def atoms(self) -> tuple[tuple[Any, Any], ...]:
        return ((self.b, 1.0),)

    def ff(self, tau: Any) -> Any:
        return dr.maximum((self.b - tau) / self.b, 0)

    def pf(self, tau: Any) -> Any:
        return select(tau < self.b, 1.0, filled(tau, 0.0))

    def pp(self, tau: Any) -> Any:
        return filled(tau, 0.0)

    def sample_f(self, draw: Draw) -> Any:
        return self.b * draw()

    def sample_p(self, draw: Draw) -> Any:
        return self.b
