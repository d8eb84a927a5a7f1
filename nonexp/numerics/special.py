"""Special functions and an interpolant that several laws could need.

They take Python floats and Dr.Jit arrays of either precision, and carry no derivatives: models
attach exact ones with :func:`nonexp.numerics.with_derivative`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import drjit as dr
import numpy as np

from . import log1p, select
from .lookup import Table

__all__ = ["LogLogSpline", "log1p_excess_ratio", "poisson_sum"]


def poisson_sum(x: Any, weights: Sequence[float]) -> Any:
    """``e^-x sum_i weights[i] x^i/i!`` for ``x >= 0``; up to 64 weights within [0, 1].

    The mean of ``weights`` over a Poisson law of mean ``x``: all ones give the regularised upper
    incomplete gamma function ``Q(len(weights), x)``. No term overflows; values are lost to
    underflow only where they are below 1e-30 (single precision).
    """
    # e^-x is spent in equal parts: one before the sum so that it stays below the largest float
    # (e^85 for 64 weights), the others after it so that none underflows on its own.
    parts = 1 if len(weights) == 1 else 2 if len(weights) <= 5 else 4
    single = dr.is_array_v(x) and dr.type_v(x) == dr.VarType.Float32
    x = dr.minimum(x, 260.0 if single else 2800.0)  # there the result is 0
    part = dr.exp(-x / parts)
    total = weights[-1] * part
    for i in range(len(weights) - 1, 0, -1):
        total = total * (x * (1 / i))
        if weights[i - 1]:
            total = total + weights[i - 1] * part
    for _ in range(parts - 1):
        total = total * part
    return dr.minimum(total, 1.0)


def log1p_excess_ratio(x: Any) -> Any:
    """``ln(1+x)/x - 1/(1+x)`` for ``x > 0``, accurate to a few ulp also for small ``x``."""
    s = x / (2 + x)  # ln(1+x) = 2 atanh(s)
    z = s * s
    series: Any = 1 / 25
    for n in range(23, 1, -2):
        series = series * z + 1 / n
    small = (1 - s) * (x / (2 + 2 * x) + z * series)
    return select(x < 0.5, small, log1p(x) / x - 1 / (1 + x))


class LogLogSpline:
    """Positive function of a positive argument: a cubic Hermite spline of its logarithm over the
    argument's.

    ``function`` gives, for a NumPy array of arguments, the logarithm of the values and its
    derivative by the logarithm of the argument. The spline reaches from ``2^low`` to ``2^high``
    and keeps the end values beyond; values above 3e38 count as infinite. Its relative error is
    ``(ln 2/per_octave)^4/384`` times the fourth derivative, and a few ulp.
    """

    def __init__(
        self, function: Callable[[Any], tuple[Any, Any]], low: int, high: int, per_octave: int
    ) -> None:
        self._low, self._high, self._per_octave = low, high, per_octave
        knots = np.arange(low * per_octave, high * per_octave + 1) / per_octave
        log, slope = function(np.exp2(knots))
        slope = slope * (math.log(2) / per_octave)
        rise, begin, end = np.diff(log), slope[:-1], slope[1:]
        columns = np.stack([log[:-1], begin, 3 * rise - 2 * begin - end, begin + end - 2 * rise])
        infinite = columns[0] > 88.7  # in single precision
        columns[:, infinite] = 0
        columns[0] = np.where(infinite, np.inf, np.exp(columns[0]))
        self._table = Table(columns.T)

    def __call__(self, x: Any) -> Any:
        inside = dr.clip(x, 2.0**self._low, 2.0**self._high * (1 - 2.0**-22))
        place = dr.log2(inside) * self._per_octave
        cell = dr.floor(place)
        index: Any = cell - self._low * self._per_octave
        if dr.is_array_v(index):
            index = dr.uint32_array_t(index)(index)
        value, c1, c2, c3 = self._table.row(x, index)
        t = place - cell
        return value * dr.exp(t * dr.fma(dr.fma(c3, t, c2), t, c1))
