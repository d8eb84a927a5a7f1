"""The quadratic law: flights from a particle are uniformly distributed."""

from dataclasses import dataclass
from typing import Any, ClassVar

from ..transmittance import Transmittance
from ..transmittance.parameters import parameter
from .power import BoundedPower


@dataclass(frozen=True, eq=False)
class Quadratic(BoundedPower, Transmittance):
    """T = (1 - tau/b)^2 up to tau = b, then 0: negatively correlated particles.

    From a particle the next collision is uniform on [0, b].
    """

    n = 2
    b: Any = parameter(2.0, above=0, scales=1, doc="longest flight, in optical depth")
    examples: ClassVar[tuple[dict[str, Any], ...]] = ({}, {"b": 0.5}, {"b": 30.0})
