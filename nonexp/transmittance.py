"""The contract of a transmittance model.

A model is one function, the transmittance ``T(tau)`` between two points that are not correlated
with the scatterers, over optical depth ``tau`` (extinction times distance, without unit). ``T``
starts at 1, never rises, and is convex; everything else follows from it. Flights differ by what
stands at their ends: ``f``, a fixed point (a surface, a sensor, a light, a medium boundary), or
``p``, a particle (a collision inside the medium)::

    sigma_bar  = -T'(0)               mean extinction per unit optical depth
    ff(tau)    = T(tau)               transmittance from f to f
    fp(tau)    = -T'(tau)             pdf of the first collision, from f
    pf(tau)    = -T'(tau)/sigma_bar   transmittance from p to f
    pp(tau)    = T''(tau)/sigma_bar   pdf of the next collision, from p

``ff`` and ``pf`` are the survival functions that belong to the pdfs ``fp`` and ``pp``; the relation
``fp = sigma_bar pf`` makes transport reciprocal. After Bitterli et al., *A radiative transfer
framework for non-exponential media* (2018) and d'Eon, *A reciprocal formulation of
non-exponential radiative transfer* (2018).
"""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Callable
from numbers import Real
from typing import Any, ClassVar

import drjit as dr

__all__ = ["Draw", "Transmittance", "parameter"]

Draw = Callable[[], Any]
"""Returns the next uniform random number in [0, 1)."""


class Transmittance(ABC):
    """A transmittance law over optical depth.

    Concrete models are dataclasses with ``frozen=True, eq=False``; their fields are the parameters,
    declared with :func:`parameter`, and are checked when a model is made. Values and arguments
    are Python floats or Dr.Jit floating-point arrays, freely mixed.
    """

    examples: ClassVar[tuple[dict[str, Any], ...]] = ({},)
    """Parameters on which the test suite runs the model."""

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):  # type: ignore[arg-type]
            check = field.metadata.get("check")
            if check is not None:
                check(f"{type(self).__name__}.{field.name}", getattr(self, field.name))

    @property
    @abstractmethod
    def sigma_bar(self) -> Any:
        """Mean extinction per unit optical depth, ``-T'(0)``."""

    @property
    def atoms(self) -> tuple[tuple[Any, Any], ...]:
        """Point masses of the next-collision law, as pairs (tau, probability).

        :meth:`pp` is the density of the rest.
        """
        return ()

    @abstractmethod
    def ff(self, tau: Any) -> Any:
        """Transmittance ``T(tau)`` between two fixed points."""

    def fp(self, tau: Any) -> Any:
        """Density of the first collision seen from a fixed point, per unit optical depth."""
        return self.sigma_bar * self.pf(tau)

    @abstractmethod
    def pf(self, tau: Any) -> Any:
        """Transmittance between a particle and a fixed point: P(next collision beyond tau)."""

    @abstractmethod
    def pp(self, tau: Any) -> Any:
        """Density of the next collision after a collision, per unit optical depth, less atoms."""

    @abstractmethod
    def sample_f(self, draw: Draw) -> Any:
        """Optical depth of the first collision from a fixed point; inf where there is none."""

    @abstractmethod
    def sample_p(self, draw: Draw) -> Any:
        """Optical depth of the next collision after a collision."""


def parameter(default: float, *, above: float = -dr.inf, doc: str = "") -> Any:
    """A finite real parameter greater than ``above``, as a dataclass field.

    Making a model with a value outside raises ``ValueError`` with the name, the value and the
    allowed range. A Dr.Jit array passes if it holds one such number.
    """
    allowed = "a finite number" if above == -dr.inf else f"a finite number > {above:g}"

    def check(name: str, value: Any) -> None:
        number = value
        if dr.is_array_v(value) and len(value) == 1:
            number = dr.detach(value)[0]
        if isinstance(number, bool) or not isinstance(number, Real):
            raise ValueError(f"{name} is {value!r}: it must be {allowed}")
        if not above < float(number) < dr.inf:
            raise ValueError(f"{name} is {float(number):g}: it must be {allowed}")

    limits = "" if above == -dr.inf else f"> {above:g}"
    metadata = {"check": check, "range": limits, "doc": doc}
    return dataclasses.field(default=default, metadata=metadata)
