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

import contextlib
import dataclasses
import functools
import inspect
import math
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from numbers import Real
from typing import Any, ClassVar, final

import drjit as dr
import numpy as np

from ..system.machine import array_types
from .kinds import kind_of, parameters_of
from .shown import brief, html_table

__all__ = ["Draw", "Transmittance"]

Draw = Callable[[], Any]
"""Returns the next uniform random number in [0, 1)."""


class Transmittance(ABC):
    """A transmittance law over optical depth.

    Concrete models are dataclasses with ``frozen=True, eq=False``; their fields are the parameters,
    declared with the functions of :mod:`nonexp.parameters`, and are checked when a model is made.
    Parameters are Python floats or Dr.Jit floating-point arrays, freely mixed.

    A subclass defines ``sigma_bar``, ``ff``, ``pf``, ``pp`` and the two samplers, for Python floats
    and Dr.Jit arrays, and declares ``atoms`` and ``kinks`` if it has any. From outside, ``ff``,
    ``fp``, ``pf`` and ``pp`` take an optical depth ``tau`` >= 0 as

    * a number, and return one;
    * a NumPy array or a sequence, and return a float64 array of the same shape, computed in double
      precision (needs a Dr.Jit backend: ``MachineError`` where none works);
    * a Dr.Jit array, and return one of its type: what kernels call. Depths are not checked here:
      values at negative ones mean nothing.

    Numbers and NumPy arrays raise ``ValueError`` where they are negative; NaN gives NaN.
    """

    examples: ClassVar[tuple[dict[str, Any], ...]] = ({},)
    """Parameters on which the test suite runs the model; the first are those that tables show,
    the defaults where all parameters have one."""

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        for name in ("ff", "fp", "pf", "pp"):
            law = getattr(cls, name)
            if not hasattr(law, "formula") and not getattr(law, "__isabstractmethod__", False):
                setattr(cls, name, _for_all_depths(law))

    def __post_init__(self) -> None:
        for name, field in parameters_of(self).items():
            kind = kind_of(field)
            if kind is None:
                continue
            label, value = f"{type(self).__name__}.{name}", getattr(self, field.name)
            if value is None and kind.same_as is not None:
                value = getattr(self, kind.same_as)
            if value is None and field.metadata.get("required"):
                raise ValueError(f"{label} is missing: {kind.doc}")
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

        :meth:`pp` is the density of the rest. A law declares them here; none by default.
        """
        return ()

    @property
    def kinks(self) -> tuple[Any, ...]:
        """Optical depths, in ascending order, at which a density jumps or an atom sits.

        What quadrature and plots should split at; nothing is computed from them. A law declares
        them here; by default they are those of the atoms.
        """
        return tuple(where for where, _ in self.atoms)

    @property
    def extinctions(self) -> tuple[Any, Any] | None:
        """Values of S and their probabilities, if the law is ``T = E[exp(-S tau)]``; None if not.

        Flights through grids may then draw an extinction S and track it by null collisions, which
        is faster where a grid is thin and fine. A law that is such a mixture may declare it here.
        """
        return None

    @property
    def jumps(self) -> tuple[tuple[Any, Any], ...] | None:
        """Where ``pp`` jumps, as pairs (tau, pp beyond it less pp before it); None: not declared.

        Derivatives of images by extinction and by the parameters of a law need them. A law without
        atoms whose ``pp`` is continuous returns ``()``. Where a law declares nothing, as by
        default, where it has atoms, and where ``pp`` is not bounded, derivatives are refused.
        """
        return None

    @abstractmethod
    def ff(self, tau: Any) -> Any:
        """Transmittance ``T(tau)`` between two fixed points."""

    @final
    def fp(self, tau: Any) -> Any:
        """Density of the first collision seen from a fixed point, per unit optical depth."""
        return self._sigma_bar_for(tau) * self.pf(tau)

    def _sigma_bar_for(self, tau: Any) -> Any:
        """``sigma_bar`` as a factor in kernels over ``tau``: a hook for laws that hold it as data,
        so that another value is no other kernel."""
        return self.sigma_bar

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

    def _repr_html_(self) -> str:
        """The parameters as a table, for Jupyter."""
        title = f"{type(self).__name__}: {(inspect.getdoc(self) or '').partition(chr(10))[0]}"
        rows = []
        for name, field in parameters_of(self).items():
            kind = kind_of(field)
            rows.append((name, brief(getattr(self, field.name)), kind.doc if kind else ""))
        return html_table(title, ("parameter", "value", ""), rows)


# --------------------------------------------------------------------------------------------------


def _for_all_depths(law: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    """A formula for floats and Dr.Jit arrays, as a method for all that users pass; checks them."""

    @functools.wraps(law)
    def method(self: Any, tau: Any) -> Any:
        if dr.is_array_v(tau):
            return law(self, tau)
        if not isinstance(tau, Real):
            tau = _depths(tau)
            if tau.ndim:
                return _over(self, law, tau)
        if tau < 0:
            raise ValueError(f"tau is {tau:g}: an optical depth must be >= 0")
        if tau != tau:
            return math.nan
        return law(self, tau if type(tau) in (int, float) else float(tau))

    method.formula = law  # type: ignore[attr-defined]
    return method


def _depths(tau: Any) -> Any:
    """A float64 array; ``ValueError`` where that would not be of numbers."""
    with contextlib.suppress(ValueError):  # of lists of lists of several lengths
        array = np.asarray(tau)
        if array.dtype.kind in "iuf":
            return array.astype(np.float64)
    raise ValueError(f"tau is {tau!r}: it must be a number >= 0, or an array of such")


def _over(model: Transmittance, law: Callable[[Any, Any], Any], tau: Any) -> Any:
    """A formula over a NumPy array, by the Dr.Jit backend of the model's parameters."""
    if np.any(tau < 0):
        raise ValueError(f"tau holds {np.nanmin(tau):g}: an optical depth must be >= 0")
    if not tau.size:
        return tau
    own = next((sys.modules[type(array).__module__] for array in _arrays(model)), None)
    values = law(model, (own or array_types()).Float64(tau.ravel()))
    values = np.array(dr.detach(values), dtype=np.float64)
    return np.where(np.isnan(tau), np.nan, np.broadcast_to(values, tau.size).reshape(tau.shape))


def _arrays(value: Any) -> Iterator[Any]:
    """The Dr.Jit arrays among a law's parameters."""
    if dr.is_array_v(value):
        yield value
    elif isinstance(value, Transmittance) and dataclasses.is_dataclass(value):
        value = tuple(getattr(value, field.name) for field in dataclasses.fields(value))
    if isinstance(value, tuple):
        for item in value:
            yield from _arrays(item)
