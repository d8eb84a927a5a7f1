"""Elementary functions that stay accurate where the textbook form cancels.

Every function takes Python floats and Dr.Jit floating-point arrays of either precision on any
backend, and needs no Mitsuba variant. On Dr.Jit arrays the values come from additions,
multiplications and divisions alone, so that they do not depend on how a backend approximates its
logarithm and exponential; first derivatives are exact and attached for automatic differentiation.
"""

from __future__ import annotations

import math
from typing import Any

import drjit as dr

__all__ = ["expm1", "filled", "log1p", "scaled_log1p", "select", "with_derivative"]

_LN2 = math.log(2.0)

# Terms of the series below: enough for half an ulp at the end of the reduced interval.
_ATANH_TERMS = {dr.VarType.Float32: 6, dr.VarType.Float64: 13}
_EXP_TERMS = {dr.VarType.Float32: 8, dr.VarType.Float64: 15}
# ln 2 = high + low, where `high` has so few bits that exponent * high is exact.
_LN2_SPLIT = {
    dr.VarType.Float32: (0.693145751953125, 1.42860682030941723e-06),
    dr.VarType.Float64: (0.6931471803691238, 1.90821492927058770e-10),
}
_MAX_EXPONENT = {dr.VarType.Float32: 128, dr.VarType.Float64: 1024}


def log1p(x: Any) -> Any:
    """Logarithm of one plus x, ``ln(1 + x)``, without the rounding of ``1 + x``.

    Relative error at most 2 ulp for every normal ``x > -1``; ``log1p(-1) = -inf``, NaN below.
    """
    if not dr.is_array_v(x):
        return math.log1p(x) if x > -1 else (-math.inf if x == -1 else math.nan)
    value = _log1p_value(dr.detach(x))
    return with_derivative(value, (x, lambda v: dr.rcp(1 + v)))


def expm1(x: Any) -> Any:
    """Exponential minus one, ``e^x - 1``, without cancellation near zero.

    Relative error at most 2 ulp over the normal range; ``expm1(-inf) = -1``, ``expm1(inf) = inf``.
    """
    if not dr.is_array_v(x):
        try:
            return math.expm1(x)
        except OverflowError:
            return math.inf
    value = _expm1_value(dr.detach(x))
    return with_derivative(value, (x, dr.exp))


def scaled_log1p(tau: Any, alpha: Any) -> Any:
    """``alpha * ln(1 + tau/alpha)``, the exponent of a power law that tends to ``tau``.

    The derivative by ``alpha``, ``ln(1+x) - x/(1+x)`` with ``x = tau/alpha``, cancels for small
    ``x``; it is attached in a form that does not.
    """
    if not (dr.is_array_v(tau) or dr.is_array_v(alpha)):
        return alpha * log1p(tau / alpha)
    tau_, alpha_ = dr.detach(tau), dr.detach(alpha)
    x = tau_ / alpha_
    value = alpha_ * _log1p_value(x)
    return with_derivative(
        value,
        (tau, lambda _: dr.rcp(1 + x)),
        (alpha, lambda _: _log1p_excess(x)),
    )


def select(condition: Any, a: Any, b: Any) -> Any:
    """``a`` where the condition holds, else ``b``; also for the booleans of NumPy scalars."""
    if dr.is_array_v(condition):
        return dr.select(condition, a, b)
    return a if condition else b


def filled(like: Any, value: float) -> Any:
    """``value`` in the type and width of ``like`` (NaN where ``like`` is NaN)."""
    return select(dr.isnan(like), like, value)


def with_derivative(value: Any, *inputs: tuple[Any, Any]) -> Any:
    """``value`` with the first derivatives ``d value / d input = derivative(input)`` attached.

    ``inputs`` are pairs (variable, derivative); ``derivative`` is called, with the detached
    variable, only where gradients are enabled. The value itself must be detached.
    """
    tangent: Any = 0.0
    for variable, derivative in inputs:
        if dr.is_diff_v(variable) and dr.grad_enabled(variable):
            slope = derivative(dr.detach(variable))
            # A masked-off or infinite slope must not turn a zero gradient into NaN.
            tangent = tangent + variable * dr.select(dr.isfinite(slope), slope, 0)
    if not dr.is_array_v(tangent):
        return value
    return dr.replace_grad(type(tangent)(value), tangent)


# --------------------------------------------------------------------------------------------------


def _log1p_value(x: Any) -> Any:
    kind = dr.type_v(x)
    w = 1 + x
    mantissa, exponent = _frexp(w)  # w = mantissa * 2^exponent, mantissa in [1/2, 1)
    below = mantissa < math.sqrt(0.5)
    mantissa = dr.select(below, 2 * mantissa, mantissa)
    exponent = dr.select(below, exponent - 1, exponent)

    # w = 2^exponent (1 + f). With exponent 0 x itself is f: nothing is rounded away.
    direct = exponent == 0
    f = dr.select(direct, x, mantissa - 1)
    lost = dr.select(x > 1, 1 - (w - x), x - (w - 1))  # what rounding 1 + x dropped
    correction = dr.select(direct | (w > 2**30), 0, lost / w)

    # ln(1+f) = 2 atanh(s), s = f/(2+f); written as f - s (f - series) the leading term is exact.
    s = f / (2 + f)
    z = s * s
    series = z * _horner(z, [2 / (2 * k + 1) for k in range(1, _ATANH_TERMS[kind])])
    high, low = _LN2_SPLIT[kind]
    tail = correction + exponent * low
    result = exponent * high + (f - (s * (f - series) - tail))

    result = dr.select(x == dr.inf, dr.inf, result)
    result = dr.select(x == -1, -dr.inf, result)
    return dr.select((x < -1) | dr.isnan(x), dr.nan, result)


def _log1p_excess(x: Any) -> Any:
    """``ln(1+x) - x/(1+x) >= 0``, relative error of a few ulp also for small x."""
    series = x * x * _horner(-x, [(k - 1) / k for k in range(2, 14)])
    return dr.select(x < 0.1, series, _log1p_value(x) - x / (1 + x))


def _expm1_value(x: Any) -> Any:
    kind = dr.type_v(x)
    limit = _MAX_EXPONENT[kind]
    # A wide first interval keeps the subtraction 2^k - 1 away from results near zero.
    k = dr.select(dr.abs(x) < 0.5, 0, dr.round(x * (1 / _LN2)))
    k = dr.clip(k, -limit, limit)
    high, low = _LN2_SPLIT[kind]
    r = (x - k * high) - k * low
    r = dr.clip(r, -1, 1)  # x may be infinite: decided below

    # e^r - 1 = r + r^2/2 + ...
    p = r + r * r * _horner(r, [1 / math.factorial(n) for n in range(2, 3 + _EXP_TERMS[kind])])
    half = _exp2(k - 1, x)  # 2^128 overflows where 2^128 (1 + p) need not: scale in two steps
    large = (half * p + half) * 2 - 1
    small = 2 * (half * p + (half - 0.5))
    result = dr.select(k == 0, p, dr.select(k > 1, large, small))

    result = dr.select(x > limit * _LN2, dr.inf, result)
    result = dr.select(x < -limit * _LN2, -1, result)
    return dr.select(dr.isnan(x), dr.nan, result)


def _horner(z: Any, coefficients: list[float]) -> Any:
    result: Any = coefficients[-1]
    for c in reversed(coefficients[:-1]):
        result = dr.fma(result, z, c)
    return result


def _bits(x: Any) -> tuple[Any, int, int]:
    """Signed integer type of the width of x, number of mantissa bits, exponent bias."""
    if dr.type_v(x) == dr.VarType.Float32:
        return dr.int32_array_t(x), 23, 127
    return dr.int64_array_t(x), 52, 1023


def _frexp(x: Any) -> tuple[Any, Any]:
    """Mantissa in [1/2, 1) and exponent (as a float) of a positive normal x."""
    integer, shift, bias = _bits(x)
    bits = dr.reinterpret_array(integer, x)
    exponent = (bits >> shift) - (bias - 1)
    mantissa = dr.reinterpret_array(type(x), bits - (exponent << shift))
    return mantissa, type(x)(exponent)


def _exp2(k: Any, like: Any) -> Any:
    """2^k for an integral k held as a float; 0 below the normal range."""
    integer, shift, bias = _bits(like)
    exponent = dr.maximum(integer(k) + bias, 0)
    return dr.reinterpret_array(type(like), exponent << shift)
