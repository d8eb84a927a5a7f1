"""The tabulated law: measured or computed transmittance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ..transmittance.columns import Columns, check_measured, read
from ..transmittance.parameters import text, vector
from ..transmittance.piecewise import Curve, Piecewise, hermite

# Tables in single precision are convex, or straight, only up to this.
_ROUNDING = 2e-7

_NOISE = 5
"""Standard deviations by which a measurement may miss the convex table nearest to it."""

_RAMPS = 200
"""Most corners that this table can have."""


@dataclass(frozen=True, eq=False)
class Tabulated(Piecewise):
    """T = a convex curve through given points (tau, ff), from a file or from two vectors.

    A file has columns tau and ff, as text or as NPZ; :func:`nonexp.fitting.read_table` says how
    they are found. Rows may stand in any order; (0, 1) is added in front if it is missing.

    The curve goes through all points (to single precision), falls, is convex, and has a continuous
    slope: pf is continuous and piecewise linear, pp piecewise constant; samples follow the curve
    exactly. Straight rows stay straight; else slopes at the points are geometric means of those of
    the chords, weighted by distance. With spacing h of a smooth law the errors of ff and pf fall
    about as h^3 and h^2. Where another knot is needed between two points to stay convex, it is
    added (Schumaker 1983). After the last row T goes on as an exponential; with T = 0 there the law
    ends, with an atom if it ends with a slope (straight tables: the linear law); and T = T(inf)
    from where the table has become flat.

    Tables that rise or are not convex, by more than 2e-7 in ff, are refused (``ValueError`` with
    the row), unless the file has standard deviations: then the curve goes through the convex
    points nearest to the measured ones (weighted least squares), if none of them is more than five
    standard deviations away. The extinction ``sigma_bar`` is the slope of the curve at 0: it is
    only as accurate as the rows near 0.
    """

    filename: Any = text(is_file=True, doc="file with the columns tau and ff")
    tau: Any = vector(
        (), least=0, differentiable=False, scales=1, doc="optical depths, instead of a file"
    )
    values: Any = vector(
        (), differentiable=False, scene_name="ff", doc="transmittance at these depths"
    )
    examples: ClassVar[tuple[dict[str, Any], ...]] = (
        {"tau": (0.125, 0.25, 0.5, 1.0, 2.0, 4.0), "ff": (0.875, 0.75, 0.52, 0.25, 0.06, 0.004)},
        {"tau": (0.0, 0.5, 1.0, 2.0), "ff": (1.0, 0.75, 0.5, 0.0)},
        {"tau": (0.1, 0.35, 0.5, 1.0, 3.0), "ff": (0.7, 0.4, 0.3, 0.1, 0.0)},
    )

    def make_curve(self) -> Curve:
        if bool(self.filename) == bool(self.tau or self.values):
            raise ValueError("Tabulated needs either a filename or both tau and ff")
        label = f"Tabulated.filename is {self.filename!r}" if self.filename else "Tabulated.ff"
        try:
            return _curve(*self._table())
        except (OSError, ValueError) as error:
            raise ValueError(f"{label}: {error}") from None

    def _table(self) -> tuple[Any, Any]:
        if not self.filename:
            return _convex(Columns.of({"tau": self.tau, "ff": self.values}))
        table = read(self.filename)
        try:
            try:
                return _convex(table)
            except ValueError:
                if table.sigma is None:
                    raise
                return _convex(_nearest_convex(table))
        except ValueError as error:
            raise ValueError(f"{error} (columns: {table.taken})") from None


# ------------------------------------------------------------------------------- checking


def _convex(table: Columns) -> tuple[Any, Any]:
    """The table from (0, 1) on, convex to the last bit; ``ValueError`` where it is not convex."""
    tau, ff, rows = table.tau, table.ff, table.rows

    def refuse(i: Any, words: str) -> None:
        raise ValueError(f"{rows[i]} has ff = {ff[i]:.9g} at tau = {tau[i]:.9g}: {words}")

    for i in np.flatnonzero(~(np.isfinite(tau) & np.isfinite(ff))):
        refuse(i, "both must be finite")
    for i in np.flatnonzero((ff < -_ROUNDING) | (ff > 1 + _ROUNDING)):
        refuse(i, "ff must be in [0, 1]")
    ff = np.clip(ff, 0, 1)
    for i in np.flatnonzero((tau < 0) | ((tau > 0) & (tau < 1e-18)) | (tau > 1e18)):
        refuse(i, "tau must be 0, or in [1e-18, 1e18]")
    for i in np.flatnonzero(np.diff(tau) == 0) + 1:
        refuse(i, f"tau must not be the same as in {rows[i - 1]}")
    if len(tau) and tau[0] == 0 and ff[0] < 1 - _ROUNDING:
        refuse(0, "at tau = 0 it must be 1")
    for i in np.flatnonzero(np.diff(ff) > _ROUNDING) + 1:
        refuse(i, f"it must not be above {rows[i - 1]}, where it is {ff[i - 1]:.9g}")

    start = 1 if len(tau) and tau[0] == 0 else 0
    x = np.append(0, tau[start:])
    y = np.minimum.accumulate(np.append(1, ff[start:]))
    if len(tau) < 2:
        raise ValueError(f"there are {len(tau)} rows: there must be at least 2")
    hull = _hull(x, y)
    excess = y - np.interp(x, x[hull], y[hull])
    worst = int(np.argmax(excess))
    if excess[worst] > _ROUNDING:
        straight = y[worst] - excess[worst]
        refuse(
            worst - 1 + start,
            f"the table must be convex, which here allows at most {straight:.9g} "
            "(the straight line between rows around it)",
        )
    if y[-1] == 1:
        raise ValueError("ff is 1 in all rows: use the model constant")
    return x, y - excess


def _nearest_convex(table: Columns) -> Columns:
    """The convex table nearest to a measured one, in units of its standard deviations.

    Convex, falling tables are sums of ramps that end at their rows, and of a constant, with weights
    that are not negative: non-negative least squares.
    """
    from scipy.optimize import nnls  # takes longer to import than all of nonexp

    tau, ff, sigma = check_measured(table.tau, table.ff, table.sigma, table.rows)
    assert sigma is not None
    ends = np.unique(tau[tau > 0])
    ends = ends[np.unique(np.linspace(0, len(ends) - 1, _RAMPS).astype(int))]

    def ramps(x: Any) -> Any:
        return np.append(np.maximum(1 - x[:, None] / ends, 0), np.ones((len(x), 1)), axis=1)

    sure = 1e4 / sigma.min()  # one more row, that must hold: T(0) = 1
    weight, _ = nnls(
        np.vstack([ramps(tau) / sigma[:, None], np.full((1, len(ends) + 1), sure)]),
        np.append(ff / sigma, sure),
    )
    weight = weight / weight.sum()
    off = np.abs(ramps(tau) @ weight - ff) / sigma
    worst = int(np.argmax(off))
    if off[worst] > _NOISE:
        raise ValueError(
            f"{table.rows[worst]} has ff = {ff[worst]:.9g} at tau = {tau[worst]:.9g}: it must be "
            f"within {_NOISE} standard deviations of a convex table; the nearest is "
            f"{off[worst]:.1f} away"
        )
    tau = np.unique(tau)
    return Columns.of({"tau": tau, "ff": np.minimum(ramps(tau) @ weight, 1)})


def _hull(x: Any, y: Any) -> list[int]:
    """Corners of the lower convex hull, from the first point to the last."""
    corners: list[int] = []
    for i in range(len(x)):
        while len(corners) > 1:
            a, b = corners[-2:]
            if (y[b] - y[a]) * (x[i] - x[b]) <= (y[i] - y[b]) * (x[b] - x[a]):
                break
            corners.pop()
        corners.append(i)
    return corners


# ------------------------------------------------------------------------------- the curve


def _curve(tau: Any, ff: Any) -> Curve:
    """The curve through a convex table that starts with (0, 1)."""
    nothing = np.flatnonzero(ff <= 0)
    count = nothing[0] + 1 if len(nothing) else len(ff)
    tau, ff = tau[:count], ff[:count]
    width = np.diff(tau)
    chord = np.minimum.accumulate(-np.diff(ff) / width)
    same = np.diff(chord) >= -1e-9 * chord[:-1]
    straight = np.append(same, False) | np.append(False, same)

    slope = np.empty(count)
    share = width[1:] / (width[:-1] + width[1:])
    slope[1:-1] = chord[:-1] ** share * chord[1:] ** (1 - share)
    only_left, only_right = straight[:-1] & ~straight[1:], straight[1:] & ~straight[:-1]
    slope[1:-1] = np.where(only_left, chord[:-1], np.where(only_right, chord[1:], slope[1:-1]))
    # Ends: the same law of growth goes on; a table that reaches 0 ends with a parabola.
    if count > 2:
        growth = chord[0] / max(chord[1], 1e-3 * chord[0])
        slope[0] = chord[0] * min(growth ** (1 - share[0]), 2)
    else:
        slope[0] = chord[0] if ff[-1] == 0 else -np.log(ff[-1]) / width[0]
    if straight[-1] or (count == 2 and ff[-1] == 0):
        slope[-1] = chord[-1]
    elif ff[-1] > 0:
        slope[-1] = min(chord[-1], ff[-1] * np.log(ff[-2] / ff[-1]) / width[-1])
    else:
        slope[-1] = max(chord[-1] - (chord[-2] - chord[-1]) * share[-1], 0)
    slope = np.minimum.accumulate(slope)

    flat = np.flatnonzero(slope <= 0)
    count = flat[0] + 1 if len(flat) else count
    return hermite(tau[:count], ff[:count], slope[:count])
