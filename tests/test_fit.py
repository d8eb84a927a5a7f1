"""Fits of models to transmittances: what they recover, what they say, what they refuse."""

from __future__ import annotations

import dataclasses
import itertools
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from build import MODELS, QUICK, model_id
from drjit.llvm.ad import Float64
from tiers import THOROUGH, quick

import nonexp
from nonexp import fitting, models, parameters
from nonexp.fitting import plot as plotting
from nonexp.system import machine
from nonexp.transmittance.shown import with_error

Parameters = dict[str, Any]

NOISE = 0.005

# Model, parameters, extinction to find besides (None: the model has a scale of its own).
CASES: list[tuple[str, Parameters, float | None]] = [
    ("exponential", {}, 3.0),
    ("gamma", {"alpha": 0.6}, 2.0),
    ("linear", {"b": 2.5}, None),
    ("quadratic", {"b": 2.5}, None),
    ("power", {"n": 2.5, "b": 3.0}, None),
    ("hard_rod", {"d": 0.6, "l": 0.8}, None),
    ("erlang", {"k": 3, "rate": 2.5}, None),
    ("davis_weinstein", {"h": 0.8, "c": 2.0}, 2.0),
    ("exponential_mixture", {"sigma": (0.3, 3.0), "weight": (0.3, 0.7)}, None),
]


def curve(name: str, parameters: Parameters, x: Any) -> Any:
    return np.array(models.create(name, **parameters).ff(Float64(x)))


def gamma_data(noise: float = NOISE, points: int = 50) -> tuple[Any, Any]:
    x = np.linspace(0.05, 4, points)
    scatter = np.random.default_rng(7).normal(size=points)
    return x, curve("gamma", {"alpha": 0.6}, 2 * x) + noise * scatter


def flat(values: Any) -> list[float]:
    return list(values) if isinstance(values, tuple) else [values]


def deviations(result: fitting.Fit, truth: Parameters) -> list[float]:
    """Errors of the fitted quantities, in standard errors; terms of a sum in ascending order."""
    found = {**result.parameters, "sigma_t": result.sigma_t}
    z = []
    for name, error in result.errors.items():
        if name == "extinction":
            continue
        order = np.argsort(found["sigma"]) if isinstance(error, tuple) else [0]
        for i, true in zip(order, flat(truth[name]), strict=True):
            z.append((flat(found[name])[i] - true) / flat(error)[i])
    return z


# ------------------------------------------------------------------------------- what is recovered


@pytest.mark.parametrize(("name", "parameters", "sigma_t"), CASES, ids=[c[0] for c in CASES])
@pytest.mark.parametrize("unit", [1.0, 1e-4])
def test_noisy_data_give_the_parameters_within_their_errors(
    name: str, parameters: Parameters, sigma_t: float | None, unit: float
) -> None:
    x = np.linspace(0.05, 4, 80)
    noise = NOISE * np.random.default_rng(1).normal(size=len(x))
    y = curve(name, parameters, (sigma_t or 1) * x) + noise
    result = models.fit(name, x * unit, y)
    powers = {"b": 1, "d": 1, "l": 1, "rate": -1, "sigma": -1, "sigma_t": -1}
    truth = {
        k: tuple(v * unit ** powers.get(k, 0) for v in flat(value))
        if isinstance(value, tuple)
        else value * unit ** powers.get(k, 0)
        for k, value in {**parameters, "sigma_t": sigma_t or 1.0}.items()
    }
    assert result.parameters.get("k") == parameters.get("k")
    z = deviations(result, truth)
    assert len(z) == len(result.names) > 0
    assert np.abs(z).max() < 4
    assert ("sigma_t" in result.names) == (sigma_t is not None)
    assert (result.sigma_t == 1) == (sigma_t is None)
    assert 0.7 * NOISE < result.residual < 1.3 * NOISE
    assert not result.notes
    bar = models.create(name, **parameters).sigma_bar * (sigma_t or 1) / unit
    assert abs(result.extinction - bar) < 4 * result.errors["extinction"]


@pytest.mark.parametrize(("name", "parameters", "sigma_t"), CASES, ids=[c[0] for c in CASES])
def test_exact_data_are_met_exactly(
    name: str, parameters: Parameters, sigma_t: float | None
) -> None:
    x = np.linspace(0.05, 4, 60)
    result = models.fit(name, x, curve(name, parameters, (sigma_t or 1) * x))
    assert result.residual < 1e-9
    for key, true in parameters.items():
        assert sorted(flat(result.parameters[key])) == pytest.approx(sorted(flat(true)), rel=1e-5)
    assert result.sigma_t == pytest.approx(sigma_t or 1, rel=1e-5)
    np.testing.assert_allclose(result.ff(x), curve(name, parameters, (sigma_t or 1) * x), atol=1e-8)


@THOROUGH
@pytest.mark.parametrize("known", [True, False], ids=["sigma given", "sigma from the scatter"])
@pytest.mark.parametrize(
    ("name", "truth"),
    [("exponential", {"sigma_t": 1.5}), ("hard_rod", {"d": 0.6, "l": 0.7, "sigma_t": 1.0})],
)
def test_standard_errors_are_those_of_many_repeats(
    name: str, truth: Parameters, known: bool
) -> None:
    rng = np.random.default_rng(3)
    x = np.linspace(0.05, 3, 40)
    sigma = np.linspace(0.5, 1.5, 40) * 0.01 if known else np.full(40, 0.01)
    parameters = {k: v for k, v in truth.items() if k != "sigma_t"}
    y = curve(name, parameters, truth["sigma_t"] * x)
    repeats = 80
    z, chi2 = [], []
    for _ in range(repeats):
        noisy = y + sigma * rng.normal(size=40)
        result = models.fit(name, x, noisy, sigma=sigma if known else None)
        z.append(deviations(result, truth))
        chi2.append(result.chi2 / result.freedom)
    assert np.abs(np.mean(z, axis=0)).max() < 4 / math.sqrt(repeats)
    assert np.abs(np.std(z, axis=0) - 1).max() < 4 / math.sqrt(2 * repeats)
    if known:
        assert np.mean(chi2) == pytest.approx(1, abs=0.1)


def test_weights_of_the_data_count() -> None:
    x = np.array([0.5, 1.0, 1.5, 2.0])
    y = np.exp(-x)
    y[3] += 0.3  # an outlier that is known to be uncertain
    result = models.fit("exponential", x, y, sigma=[1e-3, 1e-3, 1e-3, 1.0])
    assert result.sigma_t == pytest.approx(1, abs=1e-3)
    assert models.fit("exponential", x, y, sigma=0.01).sigma_t < 0.95
    assert models.fit("exponential", x, y, sigma=0.01).sigma_t == pytest.approx(
        models.fit("exponential", x, y).sigma_t
    )


@pytest.mark.thorough
def test_whole_numbers_are_found_by_trial() -> None:
    x = np.linspace(0, 3, 300)
    y = curve("pulse", {"a": 0.5, "b": 2.5, "n": 5}, x)
    result = models.fit("pulse", x, y)
    assert result.parameters["n"] == 5
    assert result.residual < 1e-9
    held = models.fit("pulse", x, y, fixed={"n": 3})
    assert held.parameters["n"] == 3
    assert held.residual > 1e-4
    erlang = models.fit("erlang", x, curve("erlang", {"k": 17, "rate": 20.0}, x))
    assert erlang.parameters == {"k": 17, "rate": pytest.approx(20)}


# ------------------------------------------------------------------------------- sigma_t


def test_a_law_with_a_scale_can_be_normalised() -> None:
    x = np.linspace(0.05, 4, 60)
    y = curve("hard_rod", {"d": 0.6, "l": 1.4}, x)
    result = models.fit("hard_rod", x, y, sigma_t="fit")
    assert result.names == ("d", "l", "sigma_t")
    assert result.parameters == {"d": pytest.approx(0.3), "l": pytest.approx(0.7)}
    assert result.sigma_t == pytest.approx(0.5)
    assert float(result.model.sigma_bar) == pytest.approx(1)
    # d + l = 1 has no error: those of d and l are opposite.
    noise = NOISE * np.random.default_rng(1).normal(size=len(x))
    errors = models.fit("hard_rod", x, y + noise, sigma_t="fit").errors
    assert errors["d"] == pytest.approx(errors["l"], rel=1e-5)
    assert errors["sigma_t"] == pytest.approx(errors["extinction"])


@pytest.mark.parametrize(
    ("name", "sigma_t", "fixed", "free"),
    [
        ("gamma", "auto", {}, ("alpha", "sigma_t")),
        ("gamma", 2.0, {}, ("alpha",)),
        ("gamma", "auto", {"alpha": 0.6}, ("sigma_t",)),
        ("linear", "auto", {"b": 1.0}, ("sigma_t",)),
        ("linear", 0.5, {}, ("b",)),
        ("hard_rod", "auto", {"d": 0.2}, ("l",)),
        ("hard_rod", "fit", {"d": 0.2}, ("l", "sigma_t")),
        ("power", "auto", {"b": 4.0}, ("n", "sigma_t")),
        ("mixture", "fit", {}, ("weight[0]", "weight[1]", "sigma_t")),
        ("mixture", "auto", {}, ("weight[0]", "weight[1]", "sigma_t")),
    ],
)
def test_what_is_fitted(
    name: str, sigma_t: float | str, fixed: Parameters, free: tuple[str, ...]
) -> None:
    result = models.fit(name, *gamma_data(), sigma_t=sigma_t, fixed=fixed)
    assert result.names == free
    assert result.covariance.shape == (len(free), len(free))
    for key, value in fixed.items():
        assert result.parameters[key] == value and key not in result.errors
    if isinstance(sigma_t, float):
        assert result.sigma_t == sigma_t
    assert result.name == name and type(result.model) is models.registry[name]


def test_a_table_or_a_function_is_scaled() -> None:
    table = {"tau": (0.5, 1.0, 2.0), "ff": (0.7, 0.5, 0.2)}
    x = np.linspace(0.1, 1, 20)
    result = models.fit("tabulated", x, curve("tabulated", table, 3 * x), fixed=table)
    assert result.sigma_t == pytest.approx(3, rel=1e-5)


def test_the_start_says_how_many_terms() -> None:
    truth = {"sigma": (0.1, 1.0, 9.0), "weight": (0.3, 0.3, 0.4)}
    x = np.geomspace(0.01, 30, 120)
    y = curve("exponential_mixture", truth, x)
    assert models.fit("exponential_mixture", x, y).residual > 1e-4
    start = {"sigma": "0.2, 2, 5"}
    assert models.fit("exponential_mixture", x, y, start=start).residual < 1e-9


# ------------------------------------------------------------------------------- declared scales


def scaled(case: Any, changes: Parameters, tau: Any) -> Any:
    """ff of a law whose parameters are multiplied; None where that law is not allowed."""
    model = models.create(case[0], **case[1])
    values = {name: getattr(model, f.name) for name, f in parameters.parameters_of(model).items()}
    for name, factor in changes.items():
        value = values[name]
        multiplied = tuple(factor * v for v in flat(value))
        values[name] = multiplied if isinstance(value, tuple) else multiplied[0]
    try:
        return models.create(case[0], **values).ff(tau)
    except ValueError:
        return None


def nearby(case: Any) -> Any:
    """The same law with numbers of no special meaning."""
    kinds = {k: parameters.kind_of(f) for k, f in fields_of(case[0]).items()}
    special = [k for k, v in case[1].items() if is_real(kinds[k]) and len(flat(v))]
    other = {k: tuple(1.07 * v + 0.01 for v in flat(case[1][k])) for k in special}
    return case[0], case[1] | {
        k: v if isinstance(case[1][k], tuple) else v[0] for k, v in other.items()
    }


def fields_of(name: str) -> Any:
    return parameters.parameters_of(models.registry[name])


def is_real(kind: Any) -> bool:
    return isinstance(kind, (parameters.Number, parameters.Vector))


@pytest.mark.parametrize("case", quick(MODELS, QUICK.__contains__), ids=model_id)
def test_declared_scales_are_those_of_the_formula(case: Any) -> None:
    """ff(s tau; p) = ff(tau; p s^-scales) for the declared scales, and for no others."""
    tau = np.geomspace(0.02, 20, 25)
    cases = [case]
    if all(k not in ("tau", "ff") for k in case[1]):  # a table of other numbers is not convex
        cases.append(nearby(case))
    for one in cases:
        model = models.create(one[0], **one[1])
        fields = fields_of(one[0]).items()
        kinds = {name: parameters.kind_of(field) for name, field in fields}
        given = {n: getattr(model, f.name) for n, f in fields if is_real(kinds[n])}
        given = {name: value for name, value in given.items() if flat(value)}
        for name in [n for n in given if isinstance(given[n], tuple)]:
            same = scaled(one, {name: 2.0}, tau)
            evaluated = same is not None and np.allclose(same, model.ff(tau), rtol=1e-7, atol=1e-9)
            assert evaluated == kinds[name].relative, name
        names = [k for k in given if not kinds[k].relative and any(flat(given[k]))]
        held = [k for k in names if kinds[k].scales]
        declared = tuple(kinds[k].scales for k in names)
        for scales in itertools.product((0, 1, -1), repeat=len(names)):
            changes = {k: 2.0**-power for k, power in zip(names, scales, strict=True)}
            other = scaled(one, changes, tau)
            if other is None:
                assert scales != declared
                continue
            symmetric = np.allclose(model.ff(2 * tau), other, rtol=1e-7, atol=1e-9)
            assert symmetric == (scales == declared and (bool(held) or not model.sigma_bar))


def test_without_a_declaration_no_scale_is_assumed() -> None:
    @dataclasses.dataclass(frozen=True, eq=False)
    class Own(models.registry["linear"]):  # type: ignore[misc]
        b: Any = nonexp.parameter(1.0, above=0)

    models.register(Own, "own")
    try:
        x = np.linspace(0.05, 1, 20)
        result = models.fit("own", x, 1 - x / 2)
        assert result.names == ("b", "sigma_t")
        assert "b and sigma_t cannot be told apart by these data." in result.notes
    finally:
        del models.registry["own"]


# ------------------------------------------------------------------------------- what is doubtful


def test_parameters_that_cannot_be_told_apart_are_named() -> None:
    x = np.linspace(0.01, 0.3, 30)  # all points where hard rods and the linear law are the same
    y = 1 - x + 1e-4 * np.random.default_rng(1).normal(size=30)
    result = models.fit("hard_rod", x, y)
    assert result.notes == ("d and l cannot be told apart by these data.",)
    assert result.errors["d"] == result.errors["l"] == math.inf
    assert result.extinction == pytest.approx(1, abs=0.01)
    assert 0 < result.errors["extinction"] < 0.01  # d + l is known
    assert "not determined" in str(result)


def test_a_parameter_that_the_data_do_not_determine_is_named() -> None:
    x = np.linspace(0.05, 4, 50)
    y = np.exp(-2 * x) + NOISE * np.random.default_rng(2).normal(size=50)
    for data in (y, np.exp(-2 * x)):
        result = models.fit("gamma", x, data)
        assert result.parameters["alpha"] > 100
        assert result.errors["alpha"] == math.inf
        assert "alpha is not determined by these data" in result.notes[0]
        assert abs(result.sigma_t - 2) < max(4 * result.errors["sigma_t"], 1e-6)


def test_a_parameter_at_its_limit_is_named() -> None:
    x, y = gamma_data()
    result = models.fit("hard_rod", x, y)
    assert result.parameters["d"] == 0
    assert math.isnan(result.errors["d"])
    assert "d is at the limit of its range." in result.notes
    assert result.errors["l"] > 0


def test_as_many_points_as_parameters_leave_no_errors() -> None:
    x, y = gamma_data(0)
    result = models.fit("gamma", x[[10, 40]], y[[10, 40]])
    assert result.parameters["alpha"] == pytest.approx(0.6)
    assert math.isnan(result.errors["alpha"])
    assert "no errors can be given" in result.notes[0]
    assert models.fit("gamma", x[[10, 40]], y[[10, 40]], sigma=0.01).errors["alpha"] > 0


# ------------------------------------------------------------------------------- what is refused

X, Y = [0.5, 1.0, 2.0, 4.0], [0.6, 0.4, 0.2, 0.1]
REFUSED: dict[str, tuple[Callable[[], Any], str]] = {
    "model": (lambda: models.fit("gama", X, Y), "model is 'gama': it must be one of"),
    "fixed": (
        lambda: models.fit("gamma", X, Y, fixed={"b": 1}),
        "gamma has no parameter 'b': its parameters are alpha",
    ),
    "start": (lambda: models.fit("gamma", X, Y, start={"b": 1}), "gamma has no parameter 'b'"),
    "fixed value": (lambda: models.fit("gamma", X, Y, fixed={"alpha": -1}), "Gamma.alpha is -1"),
    "nothing to fit": (lambda: models.fit("constant", X, Y), "constant does not depend on tau"),
    "nothing left": (
        lambda: models.fit("gamma", X, Y, sigma_t=1, fixed={"alpha": 1}),
        "gamma has nothing left to fit: all its parameters are held",
    ),
    "no function": (lambda: models.fit("custom", X, Y), "Custom.ff is missing"),
    "no table": (lambda: models.fit("tabulated", X, Y), "Tabulated needs either a filename or"),
    "no law": (lambda: models.fit("ensemble", X, Y), "Ensemble.law is ''"),
    "length": (lambda: models.fit("gamma", X, Y[:3]), r"ff has shape \(3,\): it must be \(4,\)"),
    "shape": (lambda: models.fit("gamma", [X], [Y]), r"tau has shape \(1, 4\)"),
    "number": (lambda: models.fit("gamma", 1.0, 0.5), r"tau has shape \(\): .* \(points,\)"),
    "words": (lambda: models.fit("gamma", "far", Y), "tau is 'far': it must be a sequence"),
    "too few": (
        lambda: models.fit("gamma", X[:1], Y[:1]),
        r"gamma has 2 parameters to fit, more than there are points \(1\)",
    ),
    "negative tau": (
        lambda: models.fit("gamma", [-1, 1, 2, 3], Y),
        "point 0: tau is -1, it must be a finite number >= 0",
    ),
    "no tau": (lambda: models.fit("gamma", [0, 0, 0], [1, 1, 1]), "tau has no value > 0"),
    "infinite tau": (lambda: models.fit("gamma", [1, 2, 3, math.inf], Y), "point 3: tau is inf"),
    "nan": (lambda: models.fit("gamma", X, [0.6, math.nan, 0.2, 0.1]), "point 1: ff is nan"),
    "percent": (lambda: models.fit("gamma", X, [60, 40, 20, 10]), r"ff is 60, .* in \[0, 1\]"),
    "negative ff": (lambda: models.fit("gamma", X, [0.6, 0.4, 0.2, -0.2]), "point 3: ff is -0.2"),
    "above its noise": (
        lambda: models.fit("gamma", X, [1.05, 0.4, 0.2, 0.1], sigma=0.005),
        "point 0: ff is 1.05",
    ),
    "sigma": (lambda: models.fit("gamma", X, Y, sigma=[1, 0, 1, 1]), "point 1: sigma is 0"),
    "sigma_t": (lambda: models.fit("gamma", X, Y, sigma_t=-1), "sigma_t is -1: it must be"),
    "sigma_t word": (lambda: models.fit("gamma", X, Y, sigma_t="free"), "sigma_t is 'free'"),  # type: ignore[arg-type]
}


@pytest.mark.parametrize("case", REFUSED)
def test_errors_say_what_to_change(case: str) -> None:
    call, message = REFUSED[case]
    with pytest.raises(ValueError, match=message):
        call()


def test_noise_beyond_the_range_of_a_transmittance_is_admitted() -> None:
    models.fit("gamma", X, [1.02, 0.4, 0.2, -0.01])
    models.fit("gamma", X, [1.2, 0.4, 0.2, -0.1], sigma=0.05)


# ------------------------------------------------------------------------------- what is shown


def test_a_fit_prints_its_values_with_two_digits_of_the_error() -> None:
    result = models.fit("gamma", *gamma_data())
    text = str(result)
    assert text.startswith("gamma, fitted to 50 points: rms residual 0.00")
    assert re.search(r"^  alpha +0\.\d{4} ± 0\.00\d\d$", text, re.MULTILINE)
    assert re.search(r"^  sigma_t +\d\.\d{3} ± 0\.0\d\d$", text, re.MULTILINE)
    assert re.fullmatch(
        r"Fit\(gamma: alpha=0.\d+ ± [\d.]+, sigma_t=.* ± .*, residual=0.00\d+\)", repr(result)
    )


@pytest.mark.parametrize(
    ("value", "error", "shown"),
    [
        (3, None, ("3", "")),
        (2.5, None, ("2.5", "")),
        (1.23456, 0.0123, ("1.235", "0.012")),
        (1234.5, 56.7, ("1234", "57")),
        (1e-7, 2e-9, ("1.000e-07", "2e-09")),
        (3.2e9, 4e7, ("3.2e+09", "4e+07")),
        (1.0, math.inf, ("1", "not determined")),
        (0.0, math.nan, ("0", "at its limit")),
    ],
)
def test_numbers_are_shown_to_two_digits_of_their_error(
    value: float, error: float | None, shown: tuple[str, str]
) -> None:
    text = with_error(value, error)
    assert [word and float(word) if word[:1].isdigit() else word for word in text] == [
        word and float(word) if word[:1].isdigit() else word for word in shown
    ]


@pytest.mark.parametrize("name", ["gamma", "hard_rod", "erlang", "exponential_mixture", "mixture"])
def test_the_xml_is_a_medium_with_the_fitted_transmittance(name: str) -> None:
    x, y = gamma_data()
    result = models.fit(name, x, y)
    inside = result.to_xml("    ")
    scene = (
        '<scene version="3.0.0"><shape type="sphere"><bsdf type="null"/>'
        f'<medium type="nonexp_homogeneous" name="interior">\n{inside}\n</medium></shape></scene>'
    )
    medium = mi.load_string(scene).shapes()[0].interior_medium()
    assert medium is not None
    assert inside.splitlines()[
        0
    ] == f'    <float name="sigma_t" value="{result.sigma_t:.7g}"/>' or (
        result.sigma_t == 1 and 'value="1.0"' in inside
    )
    assert f'type="transmittance_{name}"' in inside


def test_a_fit_shows_itself_in_one_line_and_as_a_table() -> None:
    result = models.fit("exponential_mixture", *gamma_data())
    assert "\n" not in repr(result)
    shown = result._repr_html_()
    for name, value, error in result.rows():
        assert f"<tr><td>{name}</td><td>{value}</td><td>" in shown and error in shown
    ill = models.fit("hard_rod", *gamma_data())
    assert ill.notes and all(f"<p>{note}</p>" in ill._repr_html_() for note in ill.notes)


@pytest.mark.parametrize("what", ["fit", "plot", "custom", "numpy"])
def test_an_llvm_that_would_abort_is_named(what: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "llvm_problem", lambda: "LLVM is version 15: install LLVM 17")
    monkeypatch.setattr(dr, "has_backend", lambda backend: backend == dr.JitBackend.LLVM)
    law = models.create("gamma")
    calls: dict[str, Callable[[], Any]] = {
        "fit": lambda: models.fit("gamma", X, Y),
        "plot": lambda: plotting.plot_model(law),
        "custom": lambda: models.create("custom", ff="nonexp.models.custom:wigner"),
        "numpy": lambda: law.ff([0.5, 1]),
    }
    with pytest.raises(machine.MachineError, match="LLVM is version 15: install LLVM 17"):
        calls[what]()
    assert law.ff(0.5) == pytest.approx(1.25**-2)  # which needs none


# ------------------------------------------------------------------------------- comparison


def test_models_are_compared_best_first() -> None:
    names = ["linear", "constant", "gamma", "exponential"]
    fits, refused = fitting.compare(names, *gamma_data(), fixed={"b": 3.0})
    assert [result.name for result in fits] == ["gamma", "exponential", "linear"]
    assert fits == sorted(fits, key=lambda result: result.aic)
    assert fits[2].parameters == {"b": 3.0}
    assert list(refused) == ["constant"]


@pytest.mark.thorough
def test_of_models_that_fit_alike_the_simpler_is_the_better() -> None:
    x = np.linspace(0, 4, 60)
    for sigma in (None, NOISE):
        noise = NOISE * np.random.default_rng(1).normal(size=60)
        fits, _ = fitting.compare(
            ["erlang", "gamma", "exponential"], x, np.exp(-x) + noise, sigma=sigma
        )
        assert fits[0].name == "exponential"
        assert fits[1].aic - fits[0].aic < 4
    fits, _ = fitting.compare(["gamma", "hard_rod", "exponential"], x, np.exp(-x))
    assert fits[0].name == "exponential"


# ------------------------------------------------------------------------------- tables


@pytest.mark.parametrize(
    "text",
    [
        "0.5,0.6\n1,0.4\n2,0.2\n",
        "distance, ff\n0.5, 0.6\n1, 0.4\n2, 0.2",
        "# made today\n\n0.5 0.6\n1\t0.4\n2   0.2\n",
        "\ufefftau;T\n0.5;0.6\n1;0.4\n2;0.2\n",
        '"x","y"\r\n0.5,"0.6"\r\n1,0.4\r\n2,0.2\r\n',
    ],
)
def test_tables_are_read(tmp_path: Path, text: str) -> None:
    path = tmp_path / "data.csv"
    path.write_bytes(text.encode())
    x, y, sigma = fitting.read_table(path)
    assert (x.tolist(), y.tolist(), sigma) == ([0.5, 1, 2], [0.6, 0.4, 0.2], None)


def test_standard_deviations_are_read(tmp_path: Path) -> None:
    (tmp_path / "data.csv").write_text("1,0.4,0.01\n2,0.2,0.02\n")
    np.savez(tmp_path / "data.npz", distance=[1, 2], ff=[0.4, 0.2], sigma=[0.01, 0.02])
    for name in ("data.csv", "data.npz"):
        _, y, sigma = fitting.read_table(tmp_path / name)
        assert sigma is not None
        assert (y.tolist(), sigma.tolist()) == ([0.4, 0.2], [0.01, 0.02])


# What tables look like that other programs write; all of the same three points.
OTHERS = {
    "unsorted": "2,0.2\n0.5,0.6\n1,0.4\n",
    "index of pandas": ",tau,ff\n0,0.5,0.6\n1,1.0,0.4\n2,2.0,0.2\n",
    "index, other titles": ",a,b\n0,0.5,0.6\n1,1.0,0.4\n2,2.0,0.2\n",
    "index, read again": "Unnamed: 0,x,y\n0,0.5,0.6\n1,1.0,0.4\n2,2.0,0.2\n",
    "index of a selection": ",x,y\n3,0.5,0.6\n7,1.0,0.4\n8,2.0,0.2\n",
    "index without titles": "0,0.5,0.6\n1,1.0,0.4\n2,2.0,0.2\n",
    "index in tabs": "\ttau\tff\n0\t0.5\t0.6\n1\t1.0\t0.4\n2\t2.0\t0.2\n",
    "rows of R": '"tau" "ff"\n"1" 0.5 0.6\n"2" 1 0.4\n"3" 2 0.2\n',
    "decimal commas": "tau;ff\n0,5;0,6\n1;0,4\n2;0,2\n",
    "decimal commas, blanks": "0,5 0,6\n1,0 0,4\n2,0 0,2\n",
    "decimal commas, quotes": '"0,5","0,6"\n"1","0,4"\n"2","0,2"\n',
    "units": "depth,transmittance\nmm,1\n0.5,0.6\n1,0.4\n2,0.2\n",
    "units in brackets": "depth;transmittance\n[mm];[]\n0.5;0.6\n1;0.4\n2;0.2\n",
    "text column": "a,0.5,0.6\nb,1,0.4\nc,2,0.2\n",
    "text column, titles": "sample,tau,ff\na,0.5,0.6\nb,1,0.4\nc,2,0.2\n",
    "other order": "transmittance,distance [mm]\n0.6,0.5\n0.4,1\n0.2,2\n",
    "one title known": "T;tau\n0.6;0.5\n0.4;1\n0.2;2\n",
    "other columns": "run,pf,ff,depth,sigma_t\n7,1,0.6,0.5,3\n7,.5,0.4,1,3\n7,.1,0.2,2,3\n",
    "errors of the distance": "a,distance error,b\n0.5,.1,0.6\n1,.1,0.4\n2,.1,0.2\n",
    "titles of savetxt": "# ff tau\n0.6 0.5\n0.4 1\n0.2 2\n",
    "last separators": "tau,ff,\n0.5,0.6,\n1,0.4,\n2,0.2,\n",
    "empty rows": "tau,ff\n0.5,0.6\n1,0.4\n2,0.2\n,\n,\n",
}


@pytest.mark.parametrize("case", OTHERS)
def test_tables_of_other_programs_are_read(tmp_path: Path, case: str) -> None:
    path = tmp_path / "data.csv"
    path.write_text(OTHERS[case])
    x, y, sigma = fitting.read_table(path)
    assert (x.tolist(), y.tolist(), sigma) == ([0.5, 1, 2], [0.6, 0.4, 0.2], None)
    law = models.create("tabulated", filename=path)  # it is the same reader
    np.testing.assert_allclose(law.ff(x), y, rtol=1e-6)


@pytest.mark.parametrize(
    "title", ["sigma", "stderr", "std", "standard deviation", "ff_err", "Uncertainty (1 sd)"]
)
def test_standard_deviations_are_found_by_title(tmp_path: Path, title: str) -> None:
    path = tmp_path / "data.csv"
    path.write_text(f"{title},tau,ff\n.02,2,0.2\n.01,1,0.4\n")
    x, y, sigma = fitting.read_table(path)
    assert sigma is not None
    assert (x.tolist(), y.tolist(), sigma.tolist()) == ([1, 2], [0.4, 0.2], [0.01, 0.02])


def test_a_distance_that_counts_is_no_index(tmp_path: Path) -> None:
    path = tmp_path / "data.csv"
    for head in ("", "distance,ff,sigma\n", "depth,a,b\n"):
        path.write_text(head + "0,1,.01\n1,.5,.02\n2,.3,.03\n")
        x, y, sigma = fitting.read_table(path)
        assert sigma is not None
        assert (x.tolist(), y.tolist()) == ([0, 1, 2], [1, 0.5, 0.3])
        assert sigma.tolist() == [0.01, 0.02, 0.03]


def test_units_in_the_encoding_of_spreadsheets_are_read(tmp_path: Path) -> None:
    path = tmp_path / "data.csv"
    path.write_bytes("depth;ff\nµm;\n0,5;0,6\n".encode("latin-1"))
    assert fitting.read_table(path)[0].tolist() == [0.5]


BAD_TABLES = {
    "index alone": (",ff\n0,0.9\n1,0.5\n", "line 2 has 1 columns of numbers"),
    "two distances": ("tau,depth,ff\n1,1,.5\n", "'tau' and 'depth' could both be tau"),
    "named elsewhere": ("a,b,ff\n1,2,.5\n", "column 'ff' is ff, but no title says which is tau"),
    "points and commas": ("0.5;0,6\n1.5;0,4\n", "decimal points and decimal commas"),
    "commas between commas": ("0,5,0,6\n1,5,0,4\n", "line 1 has 4 columns of numbers"),
    "missing": ("tau,ff\n1,\n2,0.5\n", "line 2 has '' for ff: it must be a number"),
    "titles": ("tau,ff,a,b\n1,0.5\n", "line 2 has 2 columns, but there are 4 titles"),
    "word": ("1,0.5\n2,half\n", "bad.csv: line 2 has 'half' for ff: it must be a number"),
    "one column": ("1\n2\n", r"bad.csv: line 1 has 1 columns of numbers .* there must be 2 or 3"),
    "four columns": ("1 2 3 4\n", "line 1 has 4 columns of numbers"),
    "ragged": ("1,0.5\n2,0.4,0.1\n", "line 2 has 3 columns, line 1 has 2"),
    "empty": ("# nothing\n", "bad.csv: it holds no numbers"),
    "titles only": ("tau,ff\n", "bad.csv: it holds no numbers"),
    "two lines of titles": ("tau,ff\nmm,1\nx,y\n1,0.5\n", "line 2 has 'mm' for tau: it must be"),
    "percent": (
        "tau,ff\n# in mm\n1,0.9\n2,50\n",
        "bad.csv: line 4: ff is 50, .* ff is 'ff'",
    ),
    "nan": ("1,nan\n", "bad.csv: line 1: ff is nan"),
    "negative": ("1,0.5\n-2,0.6\n", "bad.csv: line 2: tau is -2"),
    "sigma": ("1,0.5,0\n", "bad.csv: line 1: sigma is 0"),
}


@pytest.mark.parametrize("case", BAD_TABLES)
def test_bad_tables_are_refused_with_the_line(tmp_path: Path, case: str) -> None:
    text, message = BAD_TABLES[case]
    (tmp_path / "bad.csv").write_text(text)
    with pytest.raises(ValueError, match=message):
        fitting.read_table(tmp_path / "bad.csv")


def test_files_that_are_no_tables_are_refused(tmp_path: Path) -> None:
    with pytest.raises(OSError, match=r"gone\.csv: there is no such file"):
        fitting.read_table(tmp_path / "gone.csv")
    with pytest.raises(OSError, match="it is a folder"):
        fitting.read_table(tmp_path)
    (tmp_path / "image.csv").write_bytes(b"\x89PNG\xff")
    with pytest.raises(ValueError, match=r"image\.csv: it is not a text file"):
        fitting.read_table(tmp_path / "image.csv")
    (tmp_path / "text.npz").write_text("1,0.5")
    with pytest.raises(ValueError, match=r"text\.npz: it is not an NPZ file"):
        fitting.read_table(tmp_path / "text.npz")
    np.savez(tmp_path / "names.npz", x=[1, 2], y=[0.5, 0.2])
    with pytest.raises(ValueError, match=r"names\.npz: it has the arrays x, y: it must have tau"):
        fitting.read_table(tmp_path / "names.npz")
    np.savez(tmp_path / "shape.npz", tau=[1, 2], ff=[0.5])
    with pytest.raises(ValueError, match=r"shape\.npz: ff has shape \(1,\): it must be \(2,\)"):
        fitting.read_table(tmp_path / "shape.npz")
