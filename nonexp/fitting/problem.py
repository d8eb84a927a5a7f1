"""The least-squares problem behind :mod:`nonexp.fitting`: what is free, the solution, its errors.

The optimizer is ``scipy.optimize.least_squares``. It works on *coordinates*: a parameter, or the
logarithm of one that is positive without an upper limit, or of a ratio of weights.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import drjit as dr
import numpy as np
import numpy.typing as npt

from .. import models
from ..system.machine import array_types
from ..transmittance import parameters
from ..transmittance.kinds import Kind, kind_of, number, parameters_of, single

__all__ = ["EXACT", "SCANNED", "Errors", "Problem", "Solution", "each", "kinds_of"]

Array = npt.NDArray[np.float64]


SCANNED = (*range(1, 17), 20, 24, 32, 40, 48, 64)
"""Whole numbers that are tried first; then the neighbours of the best."""

_REACH = math.log(1e10)
"""How far from its start a positive parameter may go."""

_STARTS = 2
"""From how many starting points the fit is made."""

EXACT = 1e-9
"""Residuals below are rounding: they do not make one model better than another."""

_VAGUE = 5.0
"""Standard error of a logarithm from which on a parameter counts as not determined."""


@dataclasses.dataclass(frozen=True)
class _Coordinate:
    """A quantity of the optimizer: a parameter or an item of one, or its logarithm."""

    name: str
    item: int | None = None
    log: bool = False
    low: float = -math.inf
    high: float = math.inf
    unit: float = 1.0
    """of a quantity that is not a logarithm"""

    @property
    def label(self) -> str:
        return self.name if self.item is None else f"{self.name}[{self.item}]"


@dataclasses.dataclass(frozen=True, eq=False)
class Solution:
    """Where the optimizer stopped."""

    held: dict[str, Any]
    """complete parameters; those of the coordinates have their values at the start"""
    coordinates: tuple[_Coordinate, ...]
    at: Array
    chi2: float
    jacobian: Array
    active: npt.NDArray[np.bool_]
    """which coordinates sit at a limit"""


@dataclasses.dataclass(frozen=True, eq=False)
class Errors:
    """How well a solution is known."""

    covariance: Array
    """of the quantities in ``standard``"""
    standard: dict[str, float]
    """standard error of each reported number, the mean ``extinction`` last; inf where the data do
    not determine it, NaN where it sits at its limit"""
    notes: list[str]


@dataclasses.dataclass(frozen=True, eq=False)
class Problem:
    """One model, the data, and what is free."""

    name: str
    x: Array
    y: Array
    deviations: Array | None
    kinds: dict[str, Kind | None]
    """of all parameters"""
    starts: tuple[dict[str, Any], ...]
    """complete parameters to start from"""
    numbers: tuple[str, ...]
    """parameters that are numbers or vectors of the kernel"""
    free: tuple[str, ...]
    """those of them that are fitted"""
    whole: tuple[str, ...]
    """whole numbers that are found by trial"""
    sigma_t: float | None
    """optical depth per unit of ``x``; None: fitted"""
    normalise: bool
    """report ``sigma_t`` as the mean extinction, and the law for mean extinction 1"""
    scales: dict[str, int]
    """the free parameters that depend on the unit of ``x``, and how"""

    @classmethod
    def of(
        cls,
        name: str,
        x: Array,
        y: Array,
        deviations: Array | None,
        sigma_t: float | str,
        start: Mapping[str, Any],
        fixed: Mapping[str, Any],
    ) -> Problem:
        """The problem that :func:`nonexp.fit` describes; ``ValueError`` where there is none."""
        kinds = kinds_of(name)
        for key in {**start, **fixed}:
            if key not in kinds:
                known = ", ".join(kinds) or "none"
                raise ValueError(f"{name} has no parameter {key!r}: its parameters are {known}")
        whole = [k for k, v in kinds.items() if isinstance(v, parameters.Whole) and k not in fixed]
        numbers = [k for k, v in kinds.items() if _is_number(v)]
        starts = _starts(name, start, fixed, numbers, whole)
        numbers = [k for k in numbers if _width(starts[0][k])]
        free = [k for k in numbers if k not in fixed]
        if not number(models.create(name, **starts[0]).sigma_bar):
            raise ValueError(f"{name} does not depend on tau: there is nothing to fit")

        # sigma_t would repeat a scale that the parameters hold.
        declared = {k: kind.scales for k in numbers if (kind := kinds[k]) and kind.scales}
        own = {k: power for k, power in declared.items() if k in free}
        normalise = sigma_t == "fit" and bool(own) and own == declared
        held: float | None = None
        if not isinstance(sigma_t, str):
            held = float(sigma_t)
        elif normalise or (sigma_t == "auto" and own):
            held = 1.0
        if held is not None and not free and not whole:
            raise ValueError(f"{name} has nothing left to fit: all its parameters are held")
        return cls(
            name=name,
            x=x,
            y=y,
            deviations=deviations,
            kinds=kinds,
            starts=tuple(starts),
            numbers=tuple(numbers),
            free=tuple(free),
            whole=tuple(whole),
            sigma_t=held,
            normalise=normalise,
            scales=own if held is not None else {},
        )

    @property
    def count(self) -> int:
        """How many quantities are fitted."""
        widths = sum(_width(self.starts[0][k]) - self._relative(k) for k in self.free)
        return widths + len(self.whole) + (self.sigma_t is None)

    def transmittance(self, values: Mapping[str, Any], tau: Array) -> Array:
        """The model's ff in double precision. Free parameters are variables of the kernel, so
        that one kernel serves for all their values."""
        kind = array_types().Float64
        opaque = {k: each(values[k], lambda v: dr.opaque(kind, v)) for k in self.numbers}
        model = models.create(self.name, **{**values, **opaque})
        return np.array(model.ff(kind(tau)))

    def solve(self) -> Solution:
        """The best solution, over the whole numbers that are free too."""
        if not self.whole:
            return self._solve(self.starts)
        ranges = {k: self.kinds[k].range for k in self.whole}  # type: ignore[union-attr]
        tried: dict[tuple[int, ...], Solution] = {}

        def attempt(numbers: tuple[int, ...]) -> None:
            inside = all(
                n in ranges[k] and n <= max(SCANNED[-1], ranges[k].least)
                for k, n in zip(self.whole, numbers, strict=True)
            )
            if inside and numbers not in tried:
                chosen = dict(zip(self.whole, numbers, strict=True))
                tried[numbers] = self._solve([start | chosen for start in self.starts], most=1)

        def best() -> tuple[int, ...]:
            return min(tried, key=lambda numbers: tried[numbers].chi2)

        choices = [sorted({int(ranges[k].least), *SCANNED}) for k in self.whole]
        for numbers in itertools.product(*choices):
            attempt(numbers)
        while True:
            centre = best()
            for i, step in itertools.product(range(len(centre)), (-1, 1)):
                attempt((*centre[:i], centre[i] + step, *centre[i + 1 :]))
            if best() == centre:
                return tried[centre]

    def reported(self, solution: Solution, at: Array | None = None) -> tuple[dict[str, Any], float]:
        """The parameters and sigma_t to report, for the solution or another point near it."""
        at = solution.at if at is None else at
        values, sigma_t = self._values(solution.held, solution.coordinates, at)
        if self.normalise:
            sigma_t = number(models.create(self.name, **values).sigma_bar)
            for name, power in self.scales.items():
                values[name] = each(values[name], _times(sigma_t**power))
        return values, sigma_t

    def errors(self, solution: Solution) -> Errors:
        """Covariance and standard errors of the reported quantities, and what to say of them."""
        inner, blind, notes = self._inner(solution)
        coordinates, active = solution.coordinates, np.flatnonzero(solution.active)
        values = self._flat(solution)
        gradient = self._gradient(solution)
        covariance = gradient @ inner @ gradient.T
        errors = np.sqrt(np.maximum(np.diag(covariance), 0))
        size = np.abs([*values.values()]) + 1e-300
        for direction in blind:
            errors[np.abs(gradient @ direction) > 1e-6 * size * np.linalg.norm(direction)] = np.inf
        named = dict(zip(values, map(float, errors), strict=True))
        vague = [
            c.label
            for c, variance in zip(coordinates, np.diag(inner), strict=True)
            if c.log
            and not self._relative(c.name)
            and variance > _VAGUE**2
            and math.isfinite(named.get(c.label, math.inf))
        ]
        if vague:
            named |= dict.fromkeys(vague, math.inf)
            verb = "is" if len(vague) == 1 else "are"
            notes.append(f"{_listed(vague)} {verb} not determined by these data, not even roughly.")
        for i in active:
            if math.isfinite(named.get(coordinates[i].label, math.inf)):
                named[coordinates[i].label] = math.nan
        return Errors(covariance, named, notes)

    # ------------------------------------------------------------------------ coordinates

    def _relative(self, name: str) -> bool:
        """Whether only the ratios of a vector's items matter, as of weights."""
        kind = self.kinds.get(name)
        return kind is not None and kind.relative and _width(self.starts[0][name]) > 1

    def _coordinates(self, start: dict[str, Any], scale: float) -> tuple[list[_Coordinate], Array]:
        """The coordinates, and where they start for a law over ``scale`` times ``x``."""
        coordinates, at = [], []
        for name in self.free:
            value = start[name]
            allowed = self.kinds[name].range  # type: ignore[union-attr]
            unit = scale ** -self.scales.get(name, 0)
            items = list(value) if isinstance(value, tuple) else [value]
            if self._relative(name):
                items = [max(v, 1e-3 * max(items)) for v in items]
                items = [v / items[-1] for v in items[:-1]]
            for i, item in enumerate(items):
                index = i if isinstance(value, tuple) else None
                if self._relative(name):
                    c, u = _logarithm(name, index, math.log(item))
                else:
                    c, u = _coordinate(name, index, float(item) * unit, unit, allowed)
                coordinates.append(c)
                at.append(u)
        if self.sigma_t is None:
            c, u = _logarithm("sigma_t", None, math.log(scale))
            coordinates.append(c)
            at.append(u)
        return coordinates, np.array(at)

    def _values(
        self, held: dict[str, Any], coordinates: Sequence[_Coordinate], at: Array
    ) -> tuple[dict[str, Any], float]:
        """The parameters and sigma_t at a point of the optimizer."""
        values, sigma_t = dict(held), self.sigma_t or 1.0
        vectors: dict[str, list[float]] = {}
        for c, u in zip(coordinates, at, strict=True):
            value = math.exp(u) if c.log else float(u) * c.unit
            if c.name == "sigma_t":
                sigma_t = value
            elif c.item is None:
                values[c.name] = value
            else:
                vectors.setdefault(c.name, []).append(value)
        for name, items in vectors.items():
            if self._relative(name):
                total = sum(items) + 1
                items = [item / total for item in (*items, 1)]
            values[name] = tuple(items)
        return values, sigma_t

    def _flat(self, solution: Solution, at: Array | None = None) -> dict[str, float]:
        """The reported quantities by name, with the mean extinction."""
        values, sigma_t = self.reported(solution, at)
        flat: dict[str, float] = {}
        for name in self.free:
            if isinstance(values[name], tuple):
                flat |= {f"{name}[{i}]": value for i, value in enumerate(values[name])}
            else:
                flat[name] = values[name]
        if self.normalise or self.sigma_t is None:
            flat["sigma_t"] = sigma_t
        sigma_bar = number(models.create(self.name, **values).sigma_bar)
        return flat | {"extinction": sigma_t * sigma_bar}

    def _allowed(self, values: dict[str, Any]) -> bool:
        try:
            models.create(self.name, **values)
        except ValueError:
            return False
        return True

    # ------------------------------------------------------------------------ optimization

    def _weighted(self, difference: Array, every: int = 1) -> Array:
        return difference if self.deviations is None else difference / self.deviations[::every]

    def _residuals(self, tau_values: tuple[dict[str, Any], float]) -> Array:
        values, sigma_t = tau_values
        try:
            difference = self.transmittance(values, sigma_t * self.x) - self.y
        except ValueError:  # parameters that are allowed singly but not together
            difference = np.full(len(self.x), 1e3)
        return np.nan_to_num(self._weighted(difference), nan=1e3, posinf=1e3, neginf=-1e3)

    def _scaled(self, start: dict[str, Any]) -> tuple[float, float]:
        """The least sum of squares over the scales of a start, and that scale."""
        if self.sigma_t is not None and not self.scales:
            return float(np.sum(self._residuals((start, self.sigma_t)) ** 2)), 1.0
        positive = self.x[self.x > 0]
        low, high = 0.01 / positive.max(), 100 / positive.min()
        scales = np.geomspace(low, high, 1 + math.ceil(6 * math.log10(high / low)))
        every = 1 + len(self.x) // 200
        tried = self.transmittance(start, np.outer(scales, self.x[::every]).ravel())
        difference = self._weighted(tried.reshape(len(scales), -1) - self.y[::every], every)
        sums = np.nan_to_num(np.sum(difference**2, axis=1), nan=np.inf)
        best = int(np.argmin(sums))
        return float(sums[best]), float(scales[best]) / (self.sigma_t or 1)

    def _solve(self, starts: Iterable[dict[str, Any]], most: int = _STARTS) -> Solution:
        """The best solution from some starting points."""
        from scipy import optimize  # takes as long to import as the rest of the package

        found = []
        ranked = sorted(((*self._scaled(start), start) for start in starts), key=lambda s: s[0])
        for _, scale, start in ranked[:most]:
            coordinates, at = self._coordinates(start, scale)
            if not coordinates:
                chi2 = float(np.sum(self._residuals((start, self.sigma_t or 1.0)) ** 2))
                empty = np.zeros((len(self.x), 0))
                found.append(Solution(start, (), at, chi2, empty, np.zeros(0, dtype=bool)))
                continue
            result = optimize.least_squares(
                lambda u, c=coordinates, s=start: self._residuals(self._values(s, c, u)),
                at,
                jac="3-point",
                bounds=([c.low for c in coordinates], [c.high for c in coordinates]),
                x_scale="jac",
                ftol=1e-13,
                xtol=1e-12,
                gtol=1e-14,
                max_nfev=100,
            )
            chi2 = float(2 * result.cost)
            at, limits = self._snapped(start, coordinates, result.x, chi2)
            found.append(Solution(start, tuple(coordinates), at, chi2, result.jac, limits))
        return min(found, key=lambda solution: solution.chi2)

    def _snapped(
        self, held: dict[str, Any], coordinates: list[_Coordinate], at: Array, chi2: float
    ) -> tuple[Array, npt.NDArray[np.bool_]]:
        """The solution, with coordinates moved onto a bound that they nearly reached if it fits as
        well there; and which these are."""
        at, limits = at.copy(), np.zeros(len(at), dtype=bool)
        for i, c in enumerate(coordinates):
            for bound in (c.low, c.high):
                moved = at.copy()
                moved[i] = bound
                if abs(at[i] - bound) < 1e-5:
                    values = self._values(held, coordinates, moved)
                    if self._allowed(values[0]) and (
                        np.sum(self._residuals(values) ** 2) <= chi2 * (1 + 1e-6) + EXACT**2
                    ):
                        at, limits[i] = moved, True
        return at, limits

    # ------------------------------------------------------------------------ errors

    def _inner(self, solution: Solution) -> tuple[Array, list[Array], list[str]]:
        """Covariance of the coordinates, directions in which the data say nothing, and notes."""
        coordinates, notes = solution.coordinates, []
        blind: list[Array] = []
        unit = np.eye(len(coordinates))
        for i in np.flatnonzero(solution.active):
            c = coordinates[i]
            if _at_limit(c, solution.at[i], self.kinds.get(c.name)):
                notes.append(f"{c.label} is at the limit of its range.")
            else:
                blind.append(unit[i])
                notes.append(f"{c.label} is not determined by these data: no finite value is best.")

        # With columns of unit length the singular values tell how different the columns are.
        length = np.linalg.norm(solution.jacobian, axis=0)
        silent = ~solution.active & (length <= 1e-9 * length.max(initial=0))
        for i in np.flatnonzero(silent):
            blind.append(unit[i])
            notes.append(f"{coordinates[i].label} is not determined by these data.")
        use = np.flatnonzero(~solution.active & ~silent)
        inner = np.zeros((len(coordinates), len(coordinates)))
        if len(use):
            columns = solution.jacobian[:, use] / length[use]
            _, singular, directions = np.linalg.svd(columns, full_matrices=False)
            null = singular < 1e-6 * singular[0]
            for direction in directions[null]:
                alike = use[np.abs(direction) > 0.1 * np.abs(direction).max()]
                blind.append(direction / length[use] @ unit[use])
                names = _listed([coordinates[i].label for i in alike])
                notes.append(f"{names} cannot be told apart by these data.")
            weights = np.where(null, 0, 1 / np.where(null, 1, singular)) ** 2
            block = (directions.T * weights) @ directions
            inner[np.ix_(use, use)] = block / np.outer(length[use], length[use])

        if self.deviations is None:
            spare = len(self.x) - self.count
            inner *= solution.chi2 / spare if spare > 0 else math.nan
            if spare <= 0:
                notes.append("There are as many parameters as points: no errors can be given.")
        return inner, blind, notes

    def _gradient(self, solution: Solution) -> Array:
        """Derivatives of the reported quantities by the coordinates."""
        columns = []
        for i, c in enumerate(solution.coordinates):
            step = 1e-6 * max(1.0, abs(solution.at[i]))
            ends = []
            for sign in (-1, 1):
                at = solution.at.copy()
                at[i] = min(max(at[i] + sign * step, c.low), c.high)
                if not self._allowed(self._values(solution.held, solution.coordinates, at)[0]):
                    at = solution.at
                ends.append((at[i], np.array([*self._flat(solution, at).values()])))
            (low, before), (high, after) = ends
            columns.append((after - before) / max(high - low, 1e-300))
        rows = len(self._flat(solution))
        return np.array(columns).T if columns else np.zeros((rows, 0))


# --------------------------------------------------------------------------------------- helpers


def kinds_of(name: str) -> dict[str, Kind | None]:
    """The parameters of a model, and their kinds; ``ValueError`` for an unknown model."""
    if name not in models.registry:
        raise ValueError(f"model is {name!r}: it must be one of {', '.join(models.names())}")
    return {key: kind_of(field) for key, field in parameters_of(models.registry[name]).items()}


def _is_number(kind: Kind | None) -> bool:
    return isinstance(kind, (parameters.Number, parameters.Vector)) and kind.differentiable


def _starts(
    name: str,
    start: Mapping[str, Any],
    fixed: Mapping[str, Any],
    numbers: Sequence[str],
    whole: Sequence[str],
) -> list[dict[str, Any]]:
    """Complete parameters to start from: the user's, or those of the model's examples."""
    values: list[dict[str, Any]] = []
    problem = None
    cls = models.registry[name]
    for example in cls.examples[:1] if start else cls.examples:
        # An example says where to start; what it holds besides is not for other data.
        own = {k: v for k, v in example.items() if k in (*numbers, *whole)}
        try:
            model = models.create(name, **{**own, **start, **fixed})
        except ValueError as error:
            problem = problem or error
            continue
        fields = parameters_of(cls).items()
        complete = {key: each(getattr(model, field.name), single) for key, field in fields}
        if not values or all(_width(complete[k]) == _width(values[0][k]) for k in numbers):
            values.append(complete)
    if problem is not None and not values:
        raise problem
    return values


def _logarithm(name: str, item: int | None, u: float) -> tuple[_Coordinate, float]:
    return _Coordinate(name, item, True, u - _REACH, u + _REACH), u


def _coordinate(
    name: str, item: int | None, value: float, unit: float, allowed: Any
) -> tuple[_Coordinate, float]:
    """How the optimizer sees a parameter that starts at ``value``; ``unit`` is its natural size."""
    low, high = max(allowed.above, allowed.least), allowed.most
    if low >= 0 and high == math.inf and (low > 0 or allowed.above == 0):
        floor = math.log(low) if low > 0 else -math.inf
        u = math.log(max(value, 1.01 * low))
        return _Coordinate(name, item, True, max(floor, u - _REACH), u + _REACH), u
    low, high, u = low / unit, high / unit, value / unit
    width = high - low if high - low < math.inf else 1.0
    if allowed.above > -math.inf:
        low += 1e-9 * width
    u = min(max(u, low + 0.05 * width), high - 0.05 * width)
    return _Coordinate(name, item, False, low, high, unit), u


def _at_limit(c: _Coordinate, u: float, kind: Any) -> bool:
    """Whether a coordinate at one of its bounds is at the limit of the parameter's range."""
    if not c.log:
        return True
    return kind is not None and kind.range.least > 0 and u < math.log(kind.range.least) + 1e-6


def each(value: Any, change: Callable[[Any], Any]) -> Any:
    """A value, or each item of a tuple, changed."""
    return tuple(map(change, value)) if isinstance(value, tuple) else change(value)


def _times(factor: float) -> Callable[[float], float]:
    return lambda value: factor * value


def _width(value: Any) -> int:
    return len(value) if isinstance(value, tuple) else 1


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
