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
from typing import Any, ClassVar

from .kinds import kind_of

__all__ = ["Draw", "Transmittance"]

Draw = Callable[[], Any]
"""Returns the next uniform random number in [0, 1)."""


class Transmittance(ABC):
    """A transmittance law over optical depth.

    Concrete models are dataclasses with ``frozen=True, eq=False``; their fields are the parameters,
    declared with the functions of :mod:`nonexp.parameters`, and are checked when a model is made.
    Values and arguments are Python floats or Dr.Jit floating-point arrays, freely mixed.
    """

    examples: ClassVar[tuple[dict[str, Any], ...]] = ({},)
    """Parameters on which the test suite runs the model; the first are those that tables show,
    the defaults where all parameters have one."""

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):  # type: ignore[arg-type]
            kind = kind_of(field)
            if kind is None:
                continue
            value = getattr(self, field.name)
            if value is None and kind.same_as is not None:
                value = getattr(self, kind.same_as)
            if value is None and field.metadata.get("required"):
                raise ValueError(f"{type(self).__name__}.{field.name} is missing: {kind.doc}")
            label = f"{type(self).__name__}.{field.name}"
            object.__setattr__(self, field.name, kind.accept(label, value))
        self.prepare()

    def prepare(self) -> None:  # noqa: B027  (most models have nothing to prepare)
        """Called once when all parameters are known.

        For checks that concern several parameters (raising ``ValueError``), and for tables made
        from them. Does nothing by default.
        """

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

    @property
    def kinks(self) -> tuple[Any, ...]:
        """Optical depths, in ascending order, at which a density jumps or an atom sits.

        What quadrature and plots should split at; nothing is computed from them.
        """
        return tuple(where for where, _ in self.atoms)

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
