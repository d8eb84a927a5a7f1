"""Fitting a model to a measured or simulated transmittance.

:func:`fit` is also ``nonexp.models.fit``; ``nonexp fit`` calls it from the command line.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping
from numbers import Real
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from .. import models
from ..models import _notation as notation
from ..transmittance import Transmittance
from ..transmittance.columns import check_measured, read_table
from ..transmittance.kinds import number
from ..transmittance.shown import html_table, signed, with_error
from .problem import EXACT, SCANNED, Problem, each, kinds_of

__all__ = ["Fit", "compare", "fit", "read_table"]

Array = npt.NDArray[np.float64]


@dataclasses.dataclass(frozen=True, repr=False, eq=False)
class Fit:
    """A model fitted to a transmittance. ``print(fit)`` and Jupyter show it as a table."""

    name: str
    """key of the model"""
    model: Transmittance
    """the model with the fitted parameters"""
    sigma_t: float
    """optical depth per unit of distance; 1 where the model's own parameters are distances"""
    parameters: dict[str, Any]
    """value of each parameter of the model: a float, a tuple of floats, an int, or what was held"""
    errors: dict[str, Any]
    """standard error of each that was fitted, also of ``sigma_t`` and the mean ``extinction``;
    inf where the data do not determine it, NaN where it sits at its limit"""
    residual: float
    """root mean square of model - data"""
    covariance: Array
    """of the quantities in ``names``"""
    names: tuple[str, ...]
    """what was fitted, a vector item by item: ``("sigma[0]", "sigma[1]", "sigma_t")``"""
    chi2: float
    """sum of squares of (model - data) / sigma, sigma = 1 if none was given"""
    aic: float
    """Akaike's information criterion; of two models the one with less is the better"""
    points: int
    """number of data"""
    freedom: int
    """points less fitted quantities: what ``chi2`` should be where ``sigma`` was given"""
    notes: tuple[str, ...] = ()
    """what to know before trusting the errors, one sentence each"""

    @property
    def extinction(self) -> float:
        """Mean extinction per unit of distance, ``sigma_t * model.sigma_bar``."""
        return self.sigma_t * number(self.model.sigma_bar)

    def ff(self, distance: Any) -> Array:
        """The fitted transmittance over distance."""
        return np.asarray(self.model.ff(self.sigma_t * np.asarray(distance, dtype=np.float64)))

    def to_xml(self, indent: str = "") -> str:
        """The lines of a medium in a scene: extinction per scene unit, and transmittance."""
        short = {
            name: _rounded(value)
            for name, value in self.parameters.items()
            if isinstance(value, (float, tuple))
        }
        try:
            model = models.create(self.name, **{**self.parameters, **short})
        except ValueError:
            model = self.model
        sigma_t = f'{indent}<float name="sigma_t" value="{_rounded(self.sigma_t)!r}"/>\n'
        return sigma_t + notation.to_xml(model, indent)

    def rows(self) -> list[tuple[str, str, str]]:
        """Name, value and standard error of every number, as text."""
        rows = []
        quantities = {**self.parameters, "sigma_t": self.sigma_t}
        if "extinction" in self.errors and math.isfinite(self.extinction):
            quantities["extinction"] = self.extinction
        for name, value in quantities.items():
            error = self.errors.get(name)
            if isinstance(value, (int, float)):
                rows.append((name, *with_error(value, error)))
            elif isinstance(error, tuple):
                for i, pair in enumerate(zip(value, error, strict=True)):
                    rows.append((f"{name}[{i}]", *with_error(*pair)))
        return rows

    @property
    def _title(self) -> str:
        return f"{self.name}, fitted to {self.points} points: rms residual {self.residual:.3g}"

    def __str__(self) -> str:
        lines = [self._title]
        rows = self.rows()
        widths = [max(len(row[i]) for row in rows) for i in (0, 1)]
        for name, value, error in rows:
            lines.append(f"  {name:{widths[0]}}  {value:>{widths[1]}} {signed(error)}".rstrip())
        return "\n".join([*lines, *(f"  {note}" for note in self.notes)])

    def _repr_html_(self) -> str:
        rows = [(name, value, signed(error)) for name, value, error in self.rows()]
        return html_table(self._title, ("parameter", "value", "standard error"), rows, self.notes)

    def __repr__(self) -> str:
        shown = ", ".join(f"{name}={value} {signed(error)}" for name, value, error in self.rows())
        return f"Fit({self.name}: {shown}, residual={self.residual:.3g})"


def fit(
    model: str,
    tau: Any,
    ff: Any,
    *,
    sigma: Any = None,
    sigma_t: float | Literal["auto", "fit"] = "auto",
    start: Mapping[str, Any] | None = None,
    fixed: Mapping[str, Any] | None = None,
) -> Fit:
    """Least-squares fit of a model's parameters to the transmittance ``ff`` over ``tau``.

    Fitted are the model's numbers and vectors, and by trial its whole numbers (up to 64). ``fixed``
    holds parameters at a value, ``start`` gives the first guess, which also sets how many terms a
    vector has. ``sigma`` are the standard deviations of the data, one or one per point; without,
    all points count alike and the errors are scaled to their scatter.

    ``tau`` may also be distance. Then ``sigma_t``, the optical depth per unit of distance, comes
    into play; the fitted transmittance is ``model.ff(sigma_t * tau)``:

    * ``"auto"``: 1 where the model has a scale of its own to fit (``b`` of ``linear``), so that
      its lengths are in units of ``tau``; fitted where not (``exponential``, ``gamma``);
    * ``"fit"``: always fitted. A model with a scale of its own is normalised to
      ``sigma_bar = 1`` (unless ``fixed`` holds its scale), so that ``sigma_t`` is the mean
      extinction, and comparable between models;
    * a number: held there.

    Weights that count only in relation to each other are normalised to sum 1.

    >>> import nonexp
    >>> x = [0.5, 1.0, 2.0, 4.0]
    >>> result = nonexp.models.fit("gamma", x, [nonexp.models.create("gamma").ff(3 * v) for v in x])
    >>> round(result.parameters["alpha"], 6), round(result.sigma_t, 6)
    (2.0, 3.0)

    Raises ``ValueError`` for an unknown model or parameter, data that are no transmittance, fewer
    data than fitted quantities, and a model without any.
    """
    x, y, deviations = check_measured(tau, ff, sigma)
    held = isinstance(sigma_t, Real) and 0 < float(sigma_t) < math.inf
    if not held and sigma_t not in ("auto", "fit"):
        raise ValueError(f"sigma_t is {sigma_t!r}: it must be a finite number > 0, 'auto' or 'fit'")
    problem = Problem.of(model, x, y, deviations, sigma_t, start or {}, fixed or {})
    if len(x) < problem.count:
        raise ValueError(
            f"{model} has {problem.count} parameters to fit, more than there are points ({len(x)})"
        )
    return _result(problem)


def compare(
    names: Iterable[str],
    tau: Any,
    ff: Any,
    *,
    start: Mapping[str, Any] | None = None,
    fixed: Mapping[str, Any] | None = None,
    **options: Any,
) -> tuple[list[Fit], dict[str, str]]:
    """Fits of several models, best first by AIC; and the models that refused, with the reason.

    The options are those of :func:`fit`; each model takes of ``start`` and ``fixed`` what it has.
    Raises ``ValueError`` for data that are no transmittance.
    """
    check_measured(tau, ff, options.get("sigma"))
    fits, refused = [], {}
    for name in names:
        known = kinds_of(name)
        own = [{k: v for k, v in (some or {}).items() if k in known} for some in (start, fixed)]
        try:
            fits.append(fit(name, tau, ff, start=own[0], fixed=own[1], **options))
        except ValueError as error:
            refused[name] = str(error)
    return sorted(fits, key=lambda result: result.aic), refused


def _result(problem: Problem) -> Fit:
    solution = problem.solve()
    values, sigma_t = problem.reported(solution)
    found = problem.errors(solution)
    flat, notes = found.standard, list(found.notes)
    errors = {
        name: tuple(flat[f"{name}[{i}]"] for i in range(len(values[name])))
        if isinstance(values[name], tuple)
        else flat[name]
        for name in problem.free
    }
    errors |= {name: flat[name] for name in ("sigma_t", "extinction") if name in flat}
    for name in problem.whole:
        if values[name] == SCANNED[-1]:
            notes.append(f"{name} = {values[name]} is the largest that was tried.")

    n, k = len(problem.x), problem.count
    if problem.deviations is None:
        aic = n * math.log(max(solution.chi2 / n, EXACT**2)) + 2 * k
    else:
        aic = solution.chi2 + 2 * k
    difference = problem.transmittance(values, sigma_t * problem.x) - problem.y
    return Fit(
        name=problem.name,
        model=models.create(problem.name, **values),
        sigma_t=sigma_t,
        parameters=values,
        errors=errors,
        residual=float(np.sqrt(np.mean(difference**2))),
        covariance=found.covariance[:-1, :-1],
        names=tuple(flat)[:-1],
        chi2=solution.chi2,
        aic=aic,
        points=n,
        freedom=n - k,
        notes=tuple(notes),
    )


def _rounded(value: Any) -> Any:
    return each(value, lambda v: float(f"{v:.7g}") if isinstance(v, float) else v)
