"""Laws that hold for every model, on all its examples, from both origins.

Relations are those of ``nonexp.testing.relations``. References are numerical quadrature,
differences and automatic differentiation, never a second copy of a model's formula. Single
precision, extreme parameters and the statistics of samples are the subject of stability/.
"""

from __future__ import annotations

import copy
import pickle
import xml.dom.minidom
from typing import Any

import numpy as np
import pytest
from build import MODELS, QUICK, law, model_id
from drjit.llvm.ad import PCG32, Float, Float64
from tiers import quick

from nonexp.numerics.lookup import tables_in
from nonexp.testing import relations
from nonexp.testing.arrays import with_arrays
from nonexp.testing.faults import Fault
from nonexp.transmittance.kinds import parameters_of

every_model = pytest.mark.parametrize("case", quick(MODELS, QUICK.__contains__), ids=model_id)


@every_model
def test_transmittance_starts_at_one_falls_and_is_convex(case: Any) -> None:
    relations.falls_and_is_convex(law(case))


@every_model
def test_fp_is_minus_the_derivative_of_ff(case: Any) -> None:
    relations.fp_is_minus_the_slope_of_ff(law(case))


@every_model
def test_reciprocity_fp_is_sigma_bar_pf(case: Any) -> None:
    relations.reciprocity(law(case))


@every_model
def test_pp_is_minus_the_derivative_of_pf(case: Any) -> None:
    relations.pp_is_minus_the_slope_of_pf(law(case))


@every_model
def test_densities_jump_as_they_declare(case: Any) -> None:
    relations.declared_jumps(law(case))


def test_a_jump_that_is_not_declared_is_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    quadratic = law(("quadratic", {}))
    monkeypatch.setattr(type(quadratic), "jumps", ())
    with pytest.raises(Fault, match=r"pp jumps by -0\.5 at 2, but jumps say 0"):
        relations.declared_jumps(quadratic)
    linear = law(("linear", {}))
    monkeypatch.setattr(type(linear), "jumps", ())
    with pytest.raises(Fault, match="there are atoms"):
        relations.declared_jumps(linear)


@every_model
def test_densities_integrate_to_what_collides(case: Any) -> None:
    relations.integrals(law(case))


@every_model
def test_first_flight_is_a_random_part_of_a_length_biased_flight(case: Any) -> None:
    relations.renewal(law(case))


@every_model
def test_floats_and_arrays_agree(case: Any) -> None:
    relations.floats_and_arrays(law(case))


@every_model
@pytest.mark.parametrize("kernel", ["ff", "fp", "pf", "pp"])
def test_no_nan_from_nothing_to_infinity(case: Any, kernel: str) -> None:
    relations.nothing_but_numbers(law(case), (kernel,))


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
    tau = Float64(relations.depths(model))
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


@every_model
def test_gradients_by_parameters_match_differences(case: Any) -> None:
    """By every number, item of a vector and parameter of a component that has derivatives."""
    relations.derivatives_by_parameters(law(case))
