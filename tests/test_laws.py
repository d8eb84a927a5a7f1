"""Laws that hold for every model, on all its examples, from both origins.

Values and derivatives in float64, statistics in float32. References are numerical quadrature
and automatic differentiation, never a second copy of a model's formula.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import drjit as dr
import numpy as np
import pytest
from build import MODELS, model_id
from drjit.llvm.ad import PCG32, Float, Float64
from scipy import integrate, stats

from nonexp import models
from nonexp.transmittance import Transmittance

every_model = pytest.mark.parametrize("case", MODELS, ids=model_id)
both_origins = pytest.mark.parametrize("origin", ["f", "p"])

DRAWS = 2**20
# 2 tests per model example: fewer than 100 in all, so one in 1e3 suites fails by chance.
FALSE_ALARM = 1e-5


def make(case: tuple[str, dict[str, Any]]) -> Transmittance:
    key, parameters = case
    return models.create(key, **parameters)


def reach(model: Transmittance) -> float:
    """Optical depth by which the model has done nearly all it does."""
    mean = 1 / model.sigma_bar if model.sigma_bar else 1.0
    return 20 * mean


def depths(model: Transmittance) -> Any:
    grid = np.concatenate([np.geomspace(1e-6, 1, 60), np.linspace(0.013, 1, 80)]) * reach(model)
    return np.sort(grid)


def slope(function: Any, tau: Any) -> Any:
    x = Float64(tau)
    dr.enable_grad(x)
    y = function(x)
    if not dr.grad_enabled(y):
        return np.zeros(len(tau))
    dr.backward(y)
    return np.array(x.grad)


def away_from_atoms(model: Transmittance, tau: Any) -> Any:
    for where, _ in model.atoms:
        tau = tau[np.abs(tau - where) > 1e-9 * where]
    return tau


@every_model
def test_transmittance_starts_at_one_falls_and_is_convex(case: Any) -> None:
    model = make(case)
    tau = np.linspace(0, reach(model), 400)
    ff = np.array(model.ff(Float64(tau)))
    assert ff[0] == 1
    assert np.all((ff >= 0) & (ff <= 1))
    assert np.all(np.diff(ff) <= 1e-15)
    assert np.all(np.diff(ff, 2) >= -1e-14)


@every_model
def test_fp_is_minus_the_derivative_of_ff(case: Any) -> None:
    model = make(case)
    tau = away_from_atoms(model, depths(model))
    fp = np.array(model.fp(Float64(tau)))
    np.testing.assert_allclose(-slope(model.ff, tau), fp, rtol=1e-9, atol=1e-300)


@every_model
def test_reciprocity_fp_is_sigma_bar_pf(case: Any) -> None:
    model = make(case)
    tau = Float64(depths(model))
    expected = float(model.sigma_bar) * np.array(model.pf(tau))
    np.testing.assert_allclose(np.array(model.fp(tau)), expected, rtol=1e-12)
    assert float(model.pf(0.0)) == 1
    at_zero = Float64(0)
    dr.enable_grad(at_zero)
    ff = model.ff(at_zero)
    if dr.grad_enabled(ff):
        dr.backward(ff)
        assert -at_zero.grad[0] == pytest.approx(float(model.sigma_bar), rel=1e-9)
    else:
        assert model.sigma_bar == 0


@every_model
def test_pp_is_minus_the_derivative_of_pf(case: Any) -> None:
    model = make(case)
    tau = away_from_atoms(model, depths(model))
    pp = np.array(model.pp(Float64(tau)))
    if model.sigma_bar:
        np.testing.assert_allclose(-slope(model.pf, tau), pp, rtol=1e-9, atol=1e-300)
    else:
        assert np.all(pp == 0)


@every_model
def test_densities_integrate_to_what_collides(case: Any) -> None:
    model = make(case)
    if not model.sigma_bar:
        pytest.skip("nothing collides")
    end = reach(model)
    points = [float(where) for where, _ in model.atoms if where < end] or None
    for density, survival in ((model.fp, model.ff), (model.pp, model.pf)):
        area, _ = integrate.quad(lambda t, d=density: float(d(t)), 0, end, points=points, limit=200)
        atoms = sum(p for where, p in model.atoms if where <= end and density == model.pp)
        assert area + atoms == pytest.approx(1 - float(survival(end)), abs=1e-8)


@every_model
def test_first_flight_is_a_random_part_of_a_length_biased_flight(case: Any) -> None:
    """Renewal theory: 1 - ff is sigma_bar times the integral of pf."""
    model = make(case)
    if not model.sigma_bar:
        pytest.skip("nothing collides")
    for end in (0.1, 0.7, 3.0):
        end = end / model.sigma_bar
        points = [float(where) for where, _ in model.atoms if where < end] or None
        area, _ = integrate.quad(lambda t: float(model.pf(t)), 0, end, points=points)
        assert 1 - float(model.ff(end)) == pytest.approx(model.sigma_bar * area, abs=1e-9)


@every_model
def test_floats_and_arrays_agree(case: Any) -> None:
    model = make(case)
    for tau in (0.0, 1e-8, 0.3, 1.0, 7.0, 1e8):
        for name in ("ff", "fp", "pf", "pp"):
            scalar = float(getattr(model, name)(tau))
            wide = getattr(model, name)(Float64(tau))
            narrow = getattr(model, name)(Float(tau))
            assert wide[0] == pytest.approx(scalar, rel=1e-12, abs=1e-300)
            assert narrow[0] == pytest.approx(scalar, rel=3e-5, abs=1e-37)


@every_model
@pytest.mark.parametrize("law", ["ff", "fp", "pf", "pp"])
def test_float32_is_as_good_as_float64(case: Any, law: str) -> None:
    """Relative error 2e-6 (1 + |ln value|), over 16 decades and to 4 ulp around each kink."""
    key, parameters = case
    fields = {f.name: f.default for f in dataclasses.fields(models.registry[key])}  # type: ignore[arg-type]
    rounded = {name: float(np.float32(v)) for name, v in {**fields, **parameters}.items()}
    narrow = models.create(key, **{name: Float(v) for name, v in rounded.items()})
    wide = models.create(key, **{name: Float64(v) for name, v in rounded.items()})

    tau = [np.geomspace(1e-8, 1e8, 500).astype(np.float32)]
    for kink in rounded.values():
        steps = np.arange(-4, 5)
        tau.append((np.float32(kink) + steps * np.spacing(np.float32(kink))).astype(np.float32))
    at = np.concatenate(tau)
    got = np.broadcast_to(np.array(getattr(narrow, law)(Float(at)), dtype=float), at.shape)
    exact = np.broadcast_to(np.array(getattr(wide, law)(Float64(at))), at.shape)
    tall = exact > 1e-30
    bar = 2e-6 * (1 + np.abs(np.log(exact[tall])))
    assert np.all(np.abs(got[tall] - exact[tall]) <= bar * exact[tall])
    assert np.all(got[~tall] <= 2e-30)


@every_model
@both_origins
def test_samples_follow_the_law(case: Any, origin: str) -> None:
    """Kolmogorov-Smirnov on 2^20 draws: finds a difference of 0.25 % in any probability."""
    model = make(case)
    generator = PCG32(DRAWS, 7)
    sample = getattr(model, f"sample_{origin}")(generator.next_float32)
    tau = np.broadcast_to(np.array(sample, dtype=np.float64), (DRAWS,))
    survival = model.ff if origin == "f" else model.pf
    if not model.sigma_bar:
        assert np.all(tau == math.inf)
        return
    if origin == "p":
        for where, probability in model.atoms:
            hits = np.count_nonzero(tau == where)
            assert stats.binomtest(hits, DRAWS, min(probability, 1)).pvalue > FALSE_ALARM
            tau = tau[tau != where]
        if len(tau) == 0:
            return

    def cdf(t: Any) -> Any:
        return 1 - np.array(survival(Float64(t)))

    assert stats.kstest(tau, cdf).pvalue > FALSE_ALARM


@every_model
@both_origins
def test_ends_of_the_random_numbers(case: Any, origin: str) -> None:
    model = make(case)
    sample = getattr(model, f"sample_{origin}")
    first = np.array(sample(lambda: Float(0)), dtype=float)
    last = np.array(sample(lambda: Float(1 - 2**-23)), dtype=float)
    assert not np.any(np.isnan([first, last]))
    assert np.all(first >= 0)
    assert np.all(last > 0)
    if origin == "f" and model.sigma_bar:
        assert np.all(first == 0)


@every_model
@pytest.mark.parametrize("law", ["ff", "fp", "pf", "pp"])
def test_no_nan_from_nothing_to_infinity(case: Any, law: str) -> None:
    model = make(case)
    tau = Float([0, 1e-38, 1e-8, 1, 1e8, 1e30, 3e38, dr.inf])
    value = np.array(getattr(model, law)(tau))
    assert np.all(np.isfinite(value) & (value >= 0))


@every_model
def test_gradients_by_parameters_match_differences(case: Any) -> None:
    key, given = case
    defaults = {f.name: f.default for f in dataclasses.fields(models.registry[key])}  # type: ignore[arg-type]
    for name, value in {**defaults, **given}.items():
        for law in ("ff", "pf", "pp"):
            for tau in (0.11, 0.53, 2.7):
                parameter = Float64(value)
                dr.enable_grad(parameter)
                model = models.create(key, **{**defaults, name: parameter})
                y = getattr(model, law)(Float64(tau))
                gradient = 0.0
                if dr.grad_enabled(y):
                    dr.backward(y)
                    gradient = parameter.grad[0]
                step = 1e-4 * value
                high, low = (
                    float(getattr(models.create(key, **{**defaults, name: value + s}), law)(tau))
                    for s in (step, -step)
                )
                difference = (high - low) / (2 * step)
                # Differences lose what rounding puts into the values: 1e-16/step.
                assert gradient == pytest.approx(difference, rel=1e-6, abs=2e-15 / step)
