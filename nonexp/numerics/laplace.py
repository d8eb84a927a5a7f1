"""Laplace transforms of an extinction that takes finitely many values, and draws of such values.

For kernels: the cost does not depend on how many values there are.
"""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import numpy as np

from . import select
from .lookup import Table, padded_length

__all__ = ["AliasTable", "LaplaceTransform"]

# Optical depths that the tables span: powers of two. Below and above transforms are exponentials.
_FIRST, _LAST = -30, 34
_DEGREE = {dr.VarType.Float32: 3, dr.VarType.Float64: 7}
# Fraction bits and bias of the exponent.
_LAYOUT = {dr.VarType.Float32: (23, 127), dr.VarType.Float64: (52, 1023)}


class LaplaceTransform:
    """``E[S^k exp(-S tau)] / E[S^k]``, k = 0 .. 3, for S of values ``sigma`` > 0 with ``weight``.

    ``moments[k]`` is E[S^k]. Python floats get the sum itself. For arrays ``r = -ln(value) / tau``
    is tabulated, a smooth and slowly falling function of ``ln tau``: piecewise polynomials, of
    degree 3 in single and 7 in double precision, on equal parts of each octave of tau, so that the
    leading bits of tau are the index and its other bits the exact local coordinate. They add
    relative errors of 2e-7 and 1e-12 times ``1 + |ln(value)|`` to the rounding. No derivatives.
    """

    def __init__(self, sigma: Any, weight: Any) -> None:
        order = np.argsort(sigma)
        self._sigma = np.asarray(sigma, dtype=np.float64)[order]
        weights = np.asarray(weight)[order] / np.sum(weight) * self._sigma ** np.arange(4)[:, None]
        self.moments = tuple(float(moment) for moment in weights.sum(axis=1))
        self._shares = weights / weights.sum(axis=1, keepdims=True)
        for bits in range(4, 9):
            self._bits = bits
            series, octave = self._chebyshev_series(2**bits)
            if _resolved(series, octave):
                break
        self._tables = {
            kind: tuple(Table(_powers(series[k, :, : degree + 1])) for k in range(4))
            for kind, degree in _DEGREE.items()
        }

    def __call__(self, k: int, tau: Any) -> Any:
        """The normalised transform of order ``k`` at tau in [0, inf]."""
        if not dr.is_array_v(tau):
            share = self._shares[k]
            return float((share * np.exp(-self._sigma * tau)).sum() / share.sum())  # 1 at 0
        tau = dr.detach(tau)
        fraction, bias = _LAYOUT[dr.type_v(tau)]
        integer = dr.uint32_array_t(tau) if fraction == 23 else dr.uint64_array_t(tau)
        # The factor leaves the greatest number below 2^_LAST in single precision, too.
        inside = dr.maximum(dr.minimum(tau, 2.0**_LAST * (1 - 2**-24)), 2.0**_FIRST)
        pattern = dr.reinterpret_array(integer, inside)
        index = (pattern >> (fraction - self._bits)) - ((_FIRST + bias) << self._bits)
        index = dr.minimum(index, ((_LAST - _FIRST) << self._bits) - 1)  # NaN stays in the table
        local = ((pattern << self._bits) & ((1 << fraction) - 1)) | (bias << fraction)
        t = dr.fma(dr.reinterpret_array(type(tau), local), 2, -3)  # -1 to 1 in each part
        row = self._tables[dr.type_v(tau)][k].row(tau, dr.uint32_array_t(tau)(index))
        r = row[-1]
        for coefficient in row[-2::-1]:
            r = dr.fma(r, t, coefficient)
        # The limit keeps inf * 0 away where r underflows.
        return dr.exp(-dr.minimum(tau, 3e38) * r)

    def _chebyshev_series(self, parts: int) -> tuple[Any, Any]:
        """Chebyshev series of r on ``parts`` pieces of each octave, and the ends of these pieces.

        Shapes (4, pieces, 8) and (pieces,).
        """
        count = 8
        t = np.cos(np.pi * (np.arange(count) + 0.5) / count)
        starts = np.ldexp(1 + np.arange(parts) / parts, np.arange(_FIRST, _LAST)[:, None])
        width = np.ldexp(1 / parts, np.arange(_FIRST, _LAST))[:, None, None]
        tau = starts[..., None] + width * (t + 1) / 2
        runs = tau.reshape(-1, 32)  # so short that their arrays fit in the cache
        exponents = np.stack([self._exponents(run) for run in runs], axis=1)
        r = (exponents / runs).reshape(4, -1, count)
        cosines = np.cos(np.pi * np.outer(np.arange(count), np.arange(count) + 0.5) / count)
        series = r @ cosines.T * 2 / count
        series[..., 0] /= 2
        return series, (starts + width[..., 0]).ravel()

    def _exponents(self, tau: Any) -> Any:
        """``-ln(value)`` for each k and tau, shape (4, len(tau))."""
        least = self._sigma[0]
        active = np.searchsorted(self._sigma - least, 300 / tau[0])  # the others add e^-300
        sigma, share = self._sigma[:active, None], self._shares[:, :active]
        # Not as matrix products: on so few rows the threads of BLAS wait for each other.
        value = np.einsum("kn,np->kp", share, np.exp((least - sigma) * tau))
        exponent = least * tau - np.log(value)
        if tau[0] * self.moments[1] < 1:  # transforms near 1
            gone = self._shares[:, active:].sum(axis=1, keepdims=True)
            missing = gone - np.einsum("kn,np->kp", share, np.expm1(-sigma * tau))
            exponent = np.where(missing < 0.5, -np.log1p(-np.minimum(missing, 0.5)), exponent)
        return exponent


def _resolved(series: Any, tau: Any) -> bool:
    """Whether the terms that are dropped are small: their sum, and the last for what follows it."""
    exponent = series[..., 0] * tau
    matters = exponent < 80
    single, double = _DEGREE.values()
    dropped = np.abs(series[..., single + 1 :]).sum(axis=-1) * tau <= 2e-7 * (1 + exponent)
    following = np.abs(series[..., double]) * tau <= 1e-12 * (1 + exponent)
    return bool(np.all((dropped & following) | ~matters))


def _powers(series: Any) -> Any:
    """Coefficients of powers from those of Chebyshev polynomials, last axis."""
    terms = series.shape[-1]
    change = np.zeros((terms, terms))
    for n in range(terms):
        powers = np.polynomial.chebyshev.cheb2poly(np.eye(terms)[n])
        change[n, : len(powers)] = powers
    return series @ change


class AliasTable:
    """Draws one of some values, each with the probability of its weight, by Walker's alias method.

    The table has 2^m places, each shared by two values. A place is chosen by a uniform number in
    [0, 1), exactly, and one of the two by another with what the first has left, to 2^-23 of the
    probability of a place or better.
    """

    def __init__(self, values: Any, weight: Any) -> None:
        places = padded_length(len(values))
        level = np.zeros(places)
        level[: len(values)] = np.asarray(weight) / np.sum(weight) * places
        value = np.full(places, values[0], dtype=np.float64)
        value[: len(values)] = values
        other = value.copy()
        below = [i for i in range(places) if level[i] < 1]
        above = [i for i in range(places) if level[i] >= 1]
        rest = level.copy()
        while below and above:
            small, large = below.pop(), above[-1]
            level[small], other[small] = rest[small], value[large]
            rest[large] -= 1 - rest[small]
            if rest[large] < 1:
                below.append(above.pop())
        for i in below + above:  # up to rounding these are full
            level[i] = 1
        self._table = Table(np.stack([level, value, other], axis=1))

    def arrays(self, kind: Any) -> list[Any]:
        """The arrays of a Dr.Jit type that kernels read."""
        self(kind(0.5), kind(0.5))
        return self._table.arrays(kind)

    def __call__(self, first: Any, second: Any) -> Any:
        """The value that two uniform numbers in [0, 1) choose."""
        x = first * len(self._table)
        if dr.is_array_v(x):
            index = dr.uint32_array_t(x)(x)
            step = 2.0**-23 if dr.type_v(x) == dr.VarType.Float32 else 2.0**-52
        else:
            index, step = math.floor(x), 2.0**-53
        level, value, other = self._table.row(x, index)
        # What is left of `first` refines `second`; the half keeps 0 from choosing the impossible.
        left = x - (type(x)(index) if dr.is_array_v(x) else index)
        return select(second + (left + step * len(self._table) / 2) * step < level, value, other)
