"""The linear law: every flight from a particle has the same length."""

from dataclasses import dataclass
from typing import Any, ClassVar

from ..transmittance import Transmittance
from ..transmittance.parameters import parameter
from .power import BoundedPower


@dataclass(frozen=True, eq=False)
class Linear(BoundedPower, Transmittance):
    """T = 1 - tau/b up to tau = b, then 0: perfectly ordered, mutually repelling particles.

    From a particle the next collision is exactly ``b`` away (a Dirac law); from a fixed point it
    is uniform on [0, b]. The strongest negative correlation that is admissible. A collision at
    the very distance of a surface counts as a collision: ``pf(b) = 0``.
    """

    n = 1
    b: Any = parameter(
        1.0, above=0, scales=1, doc="flight length after a collision, in optical depth"
    )
    examples: ClassVar[tuple[dict[str, Any], ...]] = ({}, {"b": 0.25}, {"b": 1.72}, {"b": 1000.0})
