"""The Erlang and Davis-Weinstein laws at the ends of their parameters, and their special functions.

Their values, derivatives and samples are held to the reference in stability/.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import drjit as dr
import mpmath
import numpy as np
import pytest
from drjit.llvm.ad import Float, Float64
from mpmath import mp
from scipy import stats
from tiers import thorough

from nonexp import models
from nonexp.numerics import special
from nonexp.transmittance import Transmittance

DRAWS = 1_000_000


def arrays(case: Any, kind: Any = Float) -> tuple[Transmittance, dict[str, Any]]:
    """The model with its real parameters as arrays that hold float32 numbers."""
    key, given = case
    held = {name: kind(float(np.float32(v))) for name, v in given.items() if name != "k"}
    return models.create(key, **{**given, **held}), held


@pytest.mark.parametrize("h", [0.5, 0.6, 0.75, 0.999, 1.0])
def test_density_at_zero_is_large_but_finite(h: float) -> None:
    model, _ = arrays(("davis_weinstein", {"h": h, "c": 3.0}))
    zero, near = np.array(model.pp(Float(0, 1e-30)))
    assert near <= zero * (1 + 1e-6) < np.inf
    assert zero > (1e11 if 0.5 < h < 0.75 else 0.2)
    assert model.pf(Float(0)) == 1 and model.ff(Float(0)) == 1


# -------------------------------------------------------------------------------------- samplers


def stream(seed: int) -> Callable[[], Float]:
    generator = np.random.default_rng(seed)
    return lambda: Float((generator.integers(0, 2**23, DRAWS) * 2.0**-23).astype(np.float32))


@pytest.mark.parametrize(("k", "origin", "draws"), [(1, "f", 1), (2, "f", 4), (7, "p", 7)])
def test_erlang_steps(k: int, origin: str, draws: int) -> None:
    """One number per step; zeros give a flight of no length, the largest numbers a finite one."""
    sample = getattr(models.create("erlang", k=k), f"sample_{origin}")
    for number, flight in ((0.0, lambda t: t == 0), (1 - 2.0**-23, lambda t: 3 < t < 40)):
        numbers = iter([Float(number)] * draws)
        assert flight(sample(lambda i=numbers: next(i))[0])
        assert next(numbers, None) is None


@pytest.mark.parametrize(
    ("h", "c"),
    [
        (0.75, 1.0),
        *thorough((0.501, 1e3), (0.75, 1e3), (0.9, 1e3), (1.0, 1.0), (1.0, 1e3), several=True),
    ],
)
def test_davis_weinstein_flights_are_inverted_exactly(h: float, c: float) -> None:
    """For all random numbers of float32: ascending, and cdf(sample(u)) = u within 4 2^-24."""
    case = ("davis_weinstein", {"h": h, "c": c})
    u = np.arange(2**23) * 2.0**-23
    tau = np.array(arrays(case)[0].sample_f(lambda: Float(u)), dtype=float)
    assert tau[0] == 0
    assert np.all(tau[1:] >= tau[:-1])
    cdf = 1 - np.array(arrays(case, Float64)[0].ff(Float64(tau)))
    assert np.max(np.abs(cdf - u)[tau < 3e38]) <= 4 * 2.0**-24
    if tau[-1] == np.inf:
        assert float(arrays(case, Float64)[0].ff(1e33)[0]) > 1 - u[tau < 3e38][-1] - 1e-6


@pytest.mark.parametrize("origin", ["f", "p"])
@pytest.mark.parametrize("by", ["h", "c"])
@pytest.mark.parametrize("h", [0.6, 0.9])
def test_flights_move_with_the_parameters(origin: str, by: str, h: float) -> None:
    """Derivatives of samples: E[min(tau, 2)] moves as its integral does."""
    model, held = arrays(("davis_weinstein", {"h": h, "c": 1.5}))
    dr.enable_grad(held[by])
    tau = getattr(model, f"sample_{origin}")(stream(5))
    dr.forward(held[by])
    moved = np.where(np.array(tau) < 2, np.array(dr.grad(tau), dtype=float), 0)

    x, weight = np.polynomial.legendre.leggauss(60)
    x, weight = 2 * ((x + 1) / 2) ** 8, weight * 8 * ((x + 1) / 2) ** 7
    model, held = arrays(("davis_weinstein", {"h": h, "c": 1.5}), Float64)
    dr.enable_grad(held[by])
    survival = (model.ff if origin == "f" else model.pf)(Float64(x))
    dr.forward(held[by])
    expected = np.sum(weight * np.array(dr.grad(survival)))
    assert abs(np.mean(moved) - expected) <= 5 * np.std(moved) / math.sqrt(DRAWS)


# ---------------------------------------------------------------------------------------- limits


def agree(a: Any, b: Any, tolerance: float, tau: Any = (1e-6, 0.03, 0.4, 1, 2.5, 8)) -> None:
    for law in ("ff", "pf", "pp"):
        for t in tau:
            assert getattr(a, law)(t) == pytest.approx(getattr(b, law)(t), rel=tolerance)


def test_one_step_is_the_exponential_law() -> None:
    agree(models.create("erlang", k=1), models.create("exponential"), 1e-14)
    assert models.create("erlang", k=1).sample_f(lambda: 0.5) == pytest.approx(math.log(2))


def test_many_steps_tend_to_the_linear_law() -> None:
    """Both meet in the corner of the linear law last, where erlang is at k^k e^-k/k!."""
    tau, linear = np.linspace(0, 2, 401), models.create("linear")
    for k in (1, 4, 16, 64):
        model = models.create("erlang", k=k)
        gap = np.array(model.ff(Float64(tau))) - np.array(linear.ff(Float64(tau)))
        assert tau[np.argmax(gap)] == 1
        assert np.max(gap) == pytest.approx(stats.poisson.pmf(k, k), rel=1e-12)


@pytest.mark.parametrize("c", [1e-2, 0.7, 20.0])
def test_davis_weinstein_at_its_ends(c: float) -> None:
    agree(models.create("davis_weinstein", h=1, c=c), models.create("gamma", alpha=c**-2), 1e-11)

    flat = models.create("davis_weinstein", h=0.5, c=c)
    rate = math.log1p(c) / c
    assert flat.sigma_bar == pytest.approx(rate, rel=1e-14)
    agree(flat, models.create("erlang", k=1, rate=rate), 1e-13)
    nearly = models.create("davis_weinstein", h=0.5 + 1e-9, c=c)
    for tau in (1e-3, 1.0, 5.0):
        assert nearly.ff(tau) == pytest.approx(flat.ff(tau), rel=1e-6)
        assert nearly.fp(tau) == pytest.approx(flat.fp(tau), rel=1e-6)


@pytest.mark.parametrize("h", [0.5, 0.75, 1.0])
def test_weak_fluctuations_leave_the_exponential_law(h: float) -> None:
    model = models.create("davis_weinstein", h=h, c=1e-14)
    agree(model, models.create("exponential"), 1e-12, (0.3, 1, 9))


# ---------------------------------------------------------------------------------- bad parameters


@pytest.mark.parametrize(
    ("key", "parameters", "message"),
    [
        ("erlang", {"k": 0}, r"Erlang\.k is 0: it must be a whole number 1 to 64"),
        ("erlang", {"k": 65}, r"Erlang\.k is 65: it must be a whole number 1 to 64"),
        ("erlang", {"k": 2.5}, r"Erlang\.k is 2\.5: it must be a whole number 1 to 64"),
        ("erlang", {"rate": 0}, r"Erlang\.rate is 0: it must be a finite number > 0"),
        ("davis_weinstein", {"h": 0.49}, r"DavisWeinstein\.h is 0\.49: .* in \[0\.5, 1\]"),
        ("davis_weinstein", {"h": Float(1.1)}, r"DavisWeinstein\.h is 1\.1: .* in \[0\.5, 1\]"),
        ("davis_weinstein", {"c": 0}, r"DavisWeinstein\.c is 0: it must be a finite number > 0"),
        ("davis_weinstein", {"c": math.nan}, r"DavisWeinstein\.c is nan: it must be"),
    ],
)
def test_bad_parameters(key: str, parameters: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        models.create(key, **parameters)


# ------------------------------------------------------------------------------ special functions


@pytest.mark.parametrize("kind", [Float, Float64])
def test_special_functions(kind: Any) -> None:
    x = np.geomspace(1e-20, 1e12, 400).astype(np.float32)
    ratio = np.array(special.log1p_excess_ratio(kind(x)), dtype=float)
    sums = {k: np.array(special.poisson_sum(kind(x), [1.0] * k)) for k in (4, 64)}
    with mp.workdps(60):
        exact = [float(mp.log1p(v) / v - 1 / (1 + v)) for v in map(mpmath.mpf, map(float, x))]
        gamma = {
            k: np.array([float(mp.gammainc(k, float(v), regularized=True)) for v in x if v < 1e3])
            for k in sums
        }
    np.testing.assert_allclose(ratio, exact, rtol=1e-6 if kind is Float else 1e-14)
    for k, expected in gamma.items():
        tall = expected > 1e-30
        got = sums[k][: len(expected)]
        np.testing.assert_allclose(got[tall], expected[tall], rtol=2e-6 if kind is Float else 1e-13)
        assert np.all(sums[k][len(expected) :] == 0)


def test_spline_of_a_power_law_is_exact_and_errs_to_fourth_order() -> None:
    x = np.geomspace(0.26, 3.9, 1000)
    power = special.LogLogSpline(lambda x: (1.7 * np.log(x), 1.7 + 0 * x), -2, 2, 1)
    np.testing.assert_allclose(np.array(power(Float64(x))), x**1.7, rtol=1e-14)
    assert power(2.0**-9) == power(0.25) == pytest.approx(0.25**1.7)

    errors = []
    for per_octave in (4, 8):
        spline = special.LogLogSpline(lambda x: (x, x), -2, 2, per_octave)
        errors.append(np.max(np.abs(np.log(np.array(spline(Float64(x)))) - x)))
        assert errors[-1] <= (math.log(2) / per_octave) ** 4 / 384 * 4
    assert errors[1] < errors[0] / 12

    steep = special.LogLogSpline(lambda x: (100 * x, 100 * x), -2, 2, 4)
    assert steep(Float(3.0)) == math.inf and steep(3.0) == math.inf
