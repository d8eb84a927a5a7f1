"""Laws that hold for every model, on all its examples, from both origins.

Values and derivatives in float64. References are numerical quadrature, differences and automatic
differentiation, never a second copy of a model's formula. Single precision, extreme parameters and
the statistics of samples are the subject of stability/.
"""

from __future__ import annotations

import copy
import pickle
import xml.dom.minidom
from typing import Any

import drjit as dr
import numpy as np
import pytest
from arrays import with_arrays
from build import MODELS, QUICK, law, model_id
from drjit.llvm.ad import PCG32, Float, Float64
from tiers import quick

from nonexp.numerics.lookup import tables_in
from nonexp.transmittance import Transmittance
from nonexp.transmittance.kinds import parameters_of

every_model = pytest.mark.parametrize("case", quick(MODELS, QUICK.__contains__), ids=model_id)


def reach(model: Transmittance) -> float:
    """Twenty mean flights: the optical depths in which most happens."""
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


def away_from_kinks(model: Transmittance, tau: Any) -> Any:
    for where in model.kinks:
        tau = tau[np.abs(tau - where) > 1e-9 * where]
    return tau


def area(model: Transmittance, function: Any, end: float) -> float:
    """Integral from 0 in pieces that get ever smaller towards 0 and, from the left, each kink."""
    kinks = np.array([float(kink) for kink in model.kinks if 0 < kink < end])
    graded = np.outer(kinks, 1 - 0.25 ** np.arange(1, 26)).ravel()
    ends = np.unique(np.concatenate([[0.0], end * 0.25 ** np.arange(40), kinks, graded]))
    nodes, weights = np.polynomial.legendre.leggauss(40)
    half, middle = np.diff(ends)[:, None] / 2, (ends[1:] + ends[:-1])[:, None] / 2
    values = np.array(function(Float64((middle + half * nodes).ravel())))
    return float(np.sum(half * weights * np.broadcast_to(values, half.size * 40).reshape(-1, 40)))


@every_model
def test_transmittance_starts_at_one_falls_and_is_convex(case: Any) -> None:
    model = law(case)
    tau = np.linspace(0, reach(model), 400)
    ff = np.array(model.ff(Float64(tau)))
    assert ff[0] == 1
    assert np.all((ff >= 0) & (ff <= 1))
    assert np.all(np.diff(ff) <= 1e-15)
    assert np.all(np.diff(ff, 2) >= -1e-14)


@every_model
def test_fp_is_minus_the_derivative_of_ff(case: Any) -> None:
    model = law(case)
    tau = away_from_kinks(model, depths(model))
    fp = np.array(model.fp(Float64(tau)))
    np.testing.assert_allclose(-slope(model.ff, tau), fp, rtol=1e-9, atol=1e-300)


@every_model
def test_reciprocity_fp_is_sigma_bar_pf(case: Any) -> None:
    model = law(case)
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
    model = law(case)
    tau = away_from_kinks(model, depths(model))
    pp = np.array(model.pp(Float64(tau)))
    if model.sigma_bar:
        np.testing.assert_allclose(-slope(model.pf, tau), pp, rtol=1e-9, atol=1e-300)
    else:
        assert np.all(pp == 0)


@every_model
def test_densities_integrate_to_what_collides(case: Any) -> None:
    model = law(case)
    if not model.sigma_bar:
        pytest.skip("nothing collides")
    end = reach(model)
    for density, survival in ((model.fp, model.ff), (model.pp, model.pf)):
        atoms = sum(p for where, p in model.atoms if where <= end and density == model.pp)
        expected = 1 - float(survival(end))
        assert area(model, density, end) + atoms == pytest.approx(expected, abs=1e-8)


@every_model
def test_first_flight_is_a_random_part_of_a_length_biased_flight(case: Any) -> None:
    """Renewal theory: 1 - ff is sigma_bar times the integral of pf."""
    model = law(case)
    if not model.sigma_bar:
        pytest.skip("nothing collides")
    for end in (0.1, 0.7, 3.0):
        end = end / model.sigma_bar
        expected = model.sigma_bar * area(model, model.pf, end)
        assert 1 - float(model.ff(end)) == pytest.approx(expected, abs=1e-9)


@every_model
def test_floats_and_arrays_agree(case: Any) -> None:
    model = law(case)
    for tau in (0.0, 1e-8, 0.3, 1.0, 7.0, 1e8):
        for name in ("ff", "fp", "pf", "pp"):
            scalar = float(getattr(model, name)(tau))
            wide = getattr(model, name)(Float64(tau))
            narrow = getattr(model, name)(Float(tau))
            assert wide[0] == pytest.approx(scalar, rel=1e-12, abs=1e-300)
            assert narrow[0] == pytest.approx(scalar, rel=3e-5, abs=1e-37)


@every_model
@pytest.mark.parametrize("kernel", ["ff", "fp", "pf", "pp"])
def test_no_nan_from_nothing_to_infinity(case: Any, kernel: str) -> None:
    model = law(case)
    tau = Float([0, 1e-38, 1e-8, 1, 1e8, 1e30, 3e38, dr.inf])
    value = np.array(getattr(model, kernel)(tau))
    assert np.all(np.isfinite(value) & (value >= 0))


@every_model
@pytest.mark.parametrize("kernel", ["ff", "fp", "pf", "pp"])
def test_numpy_arrays_and_lists_are_taken_as_they_are(case: Any, kernel: str) -> None:
    function = getattr(law(case), kernel)
    tau = np.linspace(0, 5, 12).reshape(3, 4)
    values = function(tau)
    assert type(values) is np.ndarray and values.dtype == np.float64 and values.shape == (3, 4)
    wide = np.broadcast_to(np.array(function(Float64(tau.ravel()))), 12)
    np.testing.assert_array_equal(values.ravel(), wide)
    np.testing.assert_array_equal(function(tau.tolist()), values)
    np.testing.assert_array_equal(function(tau.T), values.T)  # not contiguous
    np.testing.assert_array_equal(function([0, 1]), function(np.array([0.0, 1.0])))
    assert function([]).shape == (0,)
    values[0, 0] = 2  # a copy of its own
    for one in (np.float64(0.3), np.float32(0.3), np.array(0.3)):
        assert np.ndim(function(one)) == 0
        assert float(function(one)) == float(function(float(one)))
    narrow, _ = with_arrays(law(case), Float)  # as a scene holds it
    np.testing.assert_allclose(
        getattr(narrow, kernel)(tau), wide.reshape(3, 4), rtol=2e-3, atol=1e-6
    )


@every_model
@pytest.mark.parametrize("kernel", ["ff", "fp", "pf", "pp"])
def test_what_is_no_optical_depth_is_refused(case: Any, kernel: str) -> None:
    function = getattr(law(case), kernel)
    for wrong, words in (
        (-1, "tau is -1: an optical depth must be >= 0"),
        (-0.5, "tau is -0.5"),
        (np.float32(-2), "tau is -2"),
        (np.array([1, -3.0]), "tau holds -3: an optical depth must be >= 0"),
        ([1, -3, np.nan], "tau holds -3"),
        ("far", "tau is 'far': it must be a number >= 0, or an array"),
        (None, "tau is None: it must be"),
        (1j, "tau is 1j: it must be"),
        ([[1, 2], [3]], "tau is .*: it must be a number >= 0, or an array"),
    ):
        with pytest.raises(ValueError, match=words):
            function(wrong)
    assert np.isnan(function([np.nan, 1.0])).tolist() == [True, False]
    assert np.isnan(function(np.nan))


@every_model
def test_laws_are_copied_and_pickled_with_their_tables(case: Any) -> None:
    model = law(case)
    tau = Float64(depths(model))
    fresh = len(pickle.dumps(model))
    for _ in range(2):  # before and after kernels have made arrays of their own
        for copied in (copy.deepcopy(model), pickle.loads(pickle.dumps(model))):
            assert type(copied) is type(model) and repr(copied) == repr(model)
            assert len(list(tables_in(copied))) == len(list(tables_in(model)))
            for name in ("ff", "fp", "pf", "pp"):
                values = getattr(copied, name)(tau), getattr(model, name)(tau)
                np.testing.assert_array_equal(*map(np.array, values))
            for name in ("sample_f", "sample_p"):
                numbers = [PCG32(64, 3).next_float32 for _ in range(2)]
                draws = getattr(copied, name)(numbers[0]), getattr(model, name)(numbers[1])
                np.testing.assert_array_equal(*map(np.array, draws))
        assert len(pickle.dumps(model)) == fresh  # without these


@every_model
def test_a_law_shows_itself_in_one_line_and_as_a_table(case: Any) -> None:
    model = law(case)
    assert "\n" not in repr(model)
    shown = model._repr_html_()
    assert f"<b>{type(model).__name__}: T = " in shown.replace("&#x27;", "'")
    for name, field in parameters_of(model).items():
        assert f"<tr><td>{name}</td>" in shown, field
    assert len(shown) < 3000  # also of long tables
    xml.dom.minidom.parseString(f"<div>{shown}</div>")


def kernels(model: Transmittance, tau: Any) -> Any:
    """ff, pf and pp as one array of shape (3, n)."""
    values = [getattr(model, name)(tau) for name in ("ff", "pf", "pp")]
    return np.array([np.broadcast_to(np.array(v, dtype=float), (len(tau),)) for v in values])


@every_model
def test_gradients_by_parameters_match_differences(case: Any) -> None:
    """By every number, item of a vector and parameter of a component that has derivatives."""
    given = law(case)
    narrow, leaves = with_arrays(given, Float64)
    tau = np.array([0.11, 0.53, 2.7])
    for kink in narrow.kinks:
        tau = tau[np.abs(tau - float(dr.slice(kink))) > 1e-3 * tau]
    for path, leaf in leaves.items():
        step = 1e-4 * (abs(leaf[0]) or 1.0)

        def shifted(shift: float, path: str = path) -> Transmittance:
            return with_arrays(given, Float64, {path: shift})[0]

        made = []
        for name in ("ff", "pf", "pp"):
            model, parameters = with_arrays(given, attached)
            dr.set_grad(parameters[path], 1)
            y = getattr(model, name)(Float64(tau))
            attached_to = dr.is_array_v(y) and dr.grad_enabled(y)
            made.append(np.array(dr.forward_to(y)) if attached_to else np.zeros(len(tau)))
        gradient = np.array([np.broadcast_to(g, (len(tau),)) for g in made])

        at = Float64(tau)
        try:
            low, high = kernels(shifted(-step), at), kernels(shifted(step), at)
            difference = (high - low) / (2 * step)
        except ValueError:  # at the end of its range: from inside
            ends = [shifted(k * step) for k in range(4)]
            jump = abs(float(dr.slice(ends[1].sigma_bar)) - float(dr.slice(ends[0].sigma_bar)))
            if jump > 0.01:
                continue  # derivatives leave it out
            values = [kernels(model, at) for model in ends]
            weights = np.array([-11, 18, -9, 2]) / 6
            difference = sum(w * v for w, v in zip(weights, values, strict=True)) / step
        # Differences lose what rounding puts into the values: 1e-16/step.
        np.testing.assert_allclose(gradient, difference, rtol=1e-6, atol=2e-15 / step)


def attached(value: float) -> Any:
    array = Float64(value)
    dr.enable_grad(array)
    return array
