"""log1p and expm1 to 2 ulp over the whole normal range, with exact derivatives."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import drjit as dr
import mpmath
import numpy as np
import pytest
from drjit.llvm.ad import Float, Float64

from nonexp import numerics


def every_kind_of_float32(low: float, high: float) -> Any:
    """Random bit patterns (all exponents alike), and a dense uniform set around zero."""
    rng = np.random.default_rng(1)
    bits = rng.integers(0, 2**32, 2_000_000, dtype=np.uint64).astype(np.uint32)
    x = np.concatenate([bits.view(np.float32), rng.uniform(-2, 4, 1_000_000).astype(np.float32)])
    return x[np.isfinite(x) & (np.abs(x) >= np.finfo(np.float32).tiny) & (x > low) & (x < high)]


def ulps(got: Any, exact: Any) -> Any:
    return np.abs(got - exact) / np.spacing(np.abs(exact).astype(np.float32))


@pytest.mark.parametrize(
    ("ours", "reference", "low", "high"),
    [(numerics.log1p, np.log1p, -1, np.inf), (numerics.expm1, np.expm1, -np.inf, 88.72)],
)
def test_two_ulp_in_float32(
    ours: Callable[[Any], Any], reference: Callable[[Any], Any], low: float, high: float
) -> None:
    x = every_kind_of_float32(low, high)
    assert np.max(ulps(np.array(ours(Float(x)), dtype=float), reference(x.astype(float)))) <= 2


@pytest.mark.parametrize(
    ("ours", "exact"), [(numerics.log1p, mpmath.log1p), (numerics.expm1, mpmath.expm1)]
)
def test_two_ulp_in_float64(ours: Callable[[Any], Any], exact: Callable[[Any], Any]) -> None:
    rng = np.random.default_rng(2)
    x = np.concatenate([rng.uniform(-0.99, 3, 2000), 10.0 ** rng.uniform(-300, 2, 2000)])
    got = np.array(ours(Float64(x)))
    with mpmath.workdps(40):
        error = [
            abs(mpmath.mpf(float(g)) - exact(mpmath.mpf(float(v)))) / np.spacing(abs(g))
            for g, v in zip(got, x, strict=True)
        ]
    assert max(error) <= 2


def test_limits() -> None:
    points = [-2, -1, 0, math.inf, math.nan]
    expected = [math.nan, -math.inf, 0, math.inf, math.nan]
    np.testing.assert_array_equal(np.array(numerics.log1p(Float(points))), expected)
    np.testing.assert_array_equal([numerics.log1p(p) for p in points], expected)

    points = [-math.inf, -200, 0, 89, math.inf, math.nan]
    expected = [-1, -1, 0, math.inf, math.inf, math.nan]
    np.testing.assert_array_equal(np.array(numerics.expm1(Float(points))), expected)
    assert numerics.expm1(1e4) == math.inf


@pytest.mark.parametrize(
    ("ours", "slope", "x"),
    [
        (numerics.log1p, lambda x: 1 / (1 + x), [-0.9, -1e-7, 0, 1e-7, 0.5, 1e6]),
        (numerics.expm1, np.exp, [-80, -0.3, 0, 1e-7, 0.5, 80]),
    ],
)
def test_derivative(ours: Any, slope: Any, x: list[float]) -> None:
    v = Float(x)
    dr.enable_grad(v)
    dr.backward(ours(v))
    np.testing.assert_allclose(np.array(v.grad), slope(np.array(x)), rtol=5e-7)


def test_masked_lanes_do_not_poison_the_gradient() -> None:
    v = Float([-1, 0.5])
    dr.enable_grad(v)
    dr.backward(dr.select(v > 0, numerics.log1p(v), 0))
    np.testing.assert_allclose(np.array(v.grad), [0, 1 / 1.5], rtol=1e-6)


@pytest.mark.parametrize("alpha", [1e-3, 0.1, 2.0, 100.0, 1e4, 1e6])
def test_scaled_log1p_and_its_derivatives(alpha: float) -> None:
    tau = np.array([1e-8, 1e-3, 0.1, 1, 30, 1e4, 1e8], dtype=np.float32)
    t, a = Float(tau), Float(alpha)
    dr.enable_grad(t, a)
    value = numerics.scaled_log1p(t, dr.gather(Float, a, dr.zeros(dr.llvm.ad.UInt, len(tau))))
    a_wide = np.float32(alpha).astype(float)
    with mpmath.workdps(40):
        x = [mpmath.mpf(float(v)) / mpmath.mpf(float(a_wide)) for v in tau]
        exact = np.array([float(a_wide * mpmath.log1p(v)) for v in x])
        by_tau = np.array([float(1 / (1 + v)) for v in x])
        by_alpha = np.array([float(mpmath.log1p(v) - v / (1 + v)) for v in x])
    np.testing.assert_allclose(np.array(value), exact, rtol=5e-7)
    dr.backward(value, dr.ADFlag.ClearInterior)
    np.testing.assert_allclose(np.array(t.grad), by_tau, rtol=5e-7)
    np.testing.assert_allclose(np.array(a.grad), [by_alpha.sum()], rtol=2e-6)
