"""Laws whose flights from a particle end at, or begin beyond, a certain length: power, linear,
quadratic, pulse, hard_rod. Their limits and samples.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import drjit as dr
import numpy as np
import pytest
from drjit.llvm.ad import Float, Float64
from measure import largest_kernel
from stability_reference import exact, exact_places, reference
from tiers import quick

from nonexp import models

LAWS = ("ff", "fp", "pf", "pp")
DRAWS = 2**20

POWERS = [
    {"n": n, "b": b}
    for n in (1, 1 + 2**-23, 1.001, 1.3, 2, 2.5, 3, 100, 1e4, 1e6)
    for b in (n, 0.01, 1e3)
]
PULSES = [
    {"a": a, "b": b, "n": n}
    for n in (1, 2, 3, 7, 41, 100, 1000)
    for a, b in ((0, 2), (0.3, 1.9), (0, 1e-3), (100, 1000))
]
PULSE_CASES = [("pulse", p) for p in PULSES]
RODS = [
    {"d": core, "l": mean}
    for core, mean in (
        (0, 1),
        (0, 1e-6),
        (1e-6, 1),
        (1, 1e-6),
        (0.3, 7.7),
        (1e4, 1e-3),
        (1e-8, 1e-8),
    )
]
EXTREMES = (
    [("power", p) for p in POWERS]
    + [("linear", {"b": b}) for b in (1e-4, 0.41, 1e4)]
    + [("quadratic", {"b": b}) for b in (1e-4, 0.41, 1e4)]
    + [("pulse", p) for p in PULSES]
    + [("hard_rod", p) for p in RODS]
)


def name(case: tuple[str, dict[str, float]]) -> str:
    return "-".join([case[0], *(f"{k}={v:g}" for k, v in case[1].items())])


extremes = pytest.mark.parametrize("case", EXTREMES, ids=name)


def held(case: tuple[str, dict[str, float]], kind: Any = Float) -> Any:
    """The model as a scene holds it: parameters are arrays that a kernel knows nothing about."""
    key, parameters = case
    made = {k: v if (key, k) == ("pulse", "n") else kind(v) for k, v in parameters.items()}
    dr.make_opaque(*made.values())
    return models.create(key, **made)


def stream(*values: Any) -> Callable[[], Any]:
    """Draws that return one given value after the other."""
    left: Iterator[Any] = iter(values)
    return lambda: next(left)


# ------------------------------------------------------------------------------- limits


def assert_near(model: Any, limit: Any, within: float, law: str, tau: Any) -> None:
    got, want = (np.array(getattr(m, law)(Float64(tau))) for m in (model, limit))
    np.testing.assert_allclose(got, want, rtol=0, atol=within)


@pytest.mark.parametrize(("n", "key"), [(1, "linear"), (2, "quadratic")])
def test_power_is_linear_and_quadratic(n: int, key: str) -> None:
    u = Float(np.arange(0, 2**23, 997) / 2**23)
    tau = Float(np.append(np.linspace(0, 3, 1000), [1.72, 1e8, np.inf]))
    named = held((key, {"b": 1.72}))
    general = held(("power", {"n": n, "b": 1.72}))
    static = models.create("power", n=n, b=named.b)
    for law in LAWS:
        want = np.array(getattr(named, law)(tau))
        np.testing.assert_array_equal(np.array(getattr(static, law)(tau)), want)
        got = np.array(getattr(general, law)(tau))
        np.testing.assert_allclose(got, want, rtol=2e-6)
    for sample in ("sample_f", "sample_p"):
        want = np.array(getattr(named, sample)(lambda: u))
        np.testing.assert_array_equal(np.array(getattr(static, sample)(lambda: u)), want)
        got = np.array(getattr(general, sample)(lambda: u))
        np.testing.assert_allclose(got, np.broadcast_to(want, got.shape), rtol=5e-7)
    assert [float(dr.slice(p)) for _, p in general.atoms] == [1.0 if n == 1 else 0.0]
    assert len(named.atoms) == (n == 1)
    assert np.all(np.array(general.sample_p(lambda: u)) == np.float32(1.72)) == (n == 1)


@pytest.mark.parametrize("n", [100.0, 1e4, 1e6])
def test_power_tends_to_the_exponential_law(n: float) -> None:
    tau = np.geomspace(1e-8, 1e3, 400)
    power, exponential = models.create("power", n=n), models.create("exponential")
    assert power.sigma_bar == 1
    for law in LAWS:
        assert_near(power, exponential, 2 / n, law, tau)
    u = Float64(np.arange(0.001, 0.99, 0.001))
    for sample in ("sample_f", "sample_p"):
        got, want = (np.array(getattr(m, sample)(lambda: u)) for m in (power, exponential))
        np.testing.assert_allclose(got, want, rtol=3 / n)


def test_pulse_of_one_length_is_linear() -> None:
    tau = np.append(np.linspace(0, 3, 1000), [1.1, 1e8])
    pulse, linear = models.create("pulse", a=0.5, b=1.75, n=1), models.create("linear", b=1.125)
    assert pulse.atoms == linear.atoms
    for law in LAWS:
        assert_near(pulse, linear, 1e-15, law, tau)


@pytest.mark.parametrize("n", [10, 100, 1000])
def test_pulse_tends_to_the_quadratic_law(n: int) -> None:
    """As fast as a polyline through, and steps around, what they approximate."""
    tau = np.linspace(0, 4, 12345)
    pulse, quadratic = models.create("pulse", a=0, b=3, n=n), models.create("quadratic", b=3)
    assert_near(pulse, quadratic, 0.2501 / n**2, "ff", tau)
    assert_near(pulse, quadratic, 0.5001 / n, "pf", tau)


@pytest.mark.parametrize("scale", [1e-6, 0.3, 1e4])
def test_hard_rod_without_a_core_is_exponential(scale: float) -> None:
    tau = np.geomspace(1e-8, 1e3, 400)
    rod, exponential = models.create("hard_rod", d=0, l=scale), models.create("exponential")
    assert rod.sigma_bar * scale == pytest.approx(1, rel=1e-15)
    for law, unit in (("ff", 1), ("fp", scale), ("pf", 1), ("pp", scale)):
        got = unit * np.array(getattr(rod, law)(Float64(tau * scale)))
        np.testing.assert_allclose(got, np.array(getattr(exponential, law)(Float64(tau))), 1e-12)
    u = Float(np.arange(2**12) / 2**12)
    want = scale * np.array(exponential.sample_f(lambda: u))
    for sample in (rod.sample_f, rod.sample_p):
        np.testing.assert_allclose(np.array(sample(lambda: u)), want, rtol=1e-6)
    assert_near(models.create("hard_rod", d=1e-6, l=1), exponential, 2e-6, "ff", tau)


def test_hard_rod_tends_to_the_linear_law() -> None:
    tau = np.linspace(0, 2, 1000)
    rod, linear = models.create("hard_rod", d=1.0, l=1e-6), models.create("linear", b=1.0)
    assert_near(rod, linear, 1e-6, "ff", tau)
    assert_near(rod, linear, 1e-12, "pf", tau[np.abs(tau - 1) > 4e-5])
    u = Float(np.arange(2**12) / 2**12)
    np.testing.assert_allclose(np.array(rod.sample_p(lambda: u)), 1, atol=2e-5)
    np.testing.assert_allclose(np.array(rod.sample_f(lambda: u)), np.array(u), atol=2e-6)


# ------------------------------------------------------------------------------- samples

INVERSIONS = [
    ("linear", {"b": 1.72}, "f"),
    ("quadratic", {"b": 0.41}, "f"),
    ("quadratic", {"b": 0.41}, "p"),
    *(("power", {"n": n, "b": b}, "f") for n in (1, 1.3, 2, 7.5, 1e4) for b in (n, 0.37)),
    *(("power", {"n": n, "b": b}, "p") for n in (2, 2.5, 7.5, 1e4, 1e6) for b in (n, 0.37)),
    *(("hard_rod", p, "f") for p in RODS),
    *(("hard_rod", p, "p") for p in RODS if p["d"] < 10 * p["l"]),  # else depths are too coarse
]


@pytest.mark.parametrize(("key", "parameters", "origin"), INVERSIONS)
def test_distribution_function_undoes_inversion(key: str, parameters: Any, origin: str) -> None:
    model = held((key, parameters))
    law = reference(model)
    ends = np.concatenate([np.arange(9), 2**23 - 1 - np.arange(9)])
    u = np.append(ends, np.linspace(9, 2**23 - 10, 300).astype(int)) / 2**23
    tau = getattr(model, f"sample_{origin}")(stream(Float(u)))
    survival = law.ff if origin == "f" else law.pf
    got = [float(1 - survival(exact(t))) for t in np.array(tau)]
    np.testing.assert_allclose(got, u, rtol=0, atol=4 * 2**-24)


@pytest.mark.parametrize("case", quick(PULSE_CASES, PULSE_CASES[8:10].__contains__), ids=name)
def test_pulse_picks_length_biased_atoms(case: Any) -> None:
    """The share of each atom in a dense regular grid of random numbers, from both origins."""
    model = held(case)
    places = np.array([float(where) for where in exact_places(model)])
    u = Float((np.arange(DRAWS) + 0.5) / DRAWS)
    for tau, weight in (
        (model.sample_f(stream(u, Float(0.5))) * 2, places),
        (model.sample_p(stream(u)), np.ones(len(places))),
    ):
        drawn = np.array(tau, dtype=float)
        which = np.searchsorted(places, drawn)
        np.testing.assert_array_equal(places[which], drawn)
        share = np.bincount(which, minlength=len(places)) / DRAWS
        np.testing.assert_allclose(share, weight / weight.sum(), rtol=0, atol=3 / DRAWS)


@pytest.mark.thorough
@pytest.mark.parametrize("case", [("pulse", p) for p in PULSES], ids=name)
def test_pulse_survival_drops_at_the_very_atoms(case: Any) -> None:
    model = held(case)
    n = model.n
    at = np.array([float(where) for where in exact_places(model)], dtype=np.float32)
    after = (n - 1 - np.arange(n)) / n
    np.testing.assert_allclose(np.array(model.pf(Float(at))), after, rtol=2e-7, atol=0)
    before = np.array(model.pf(Float(np.nextafter(at, np.float32(0)))))
    np.testing.assert_allclose(before, after + 1 / n, rtol=2e-7)


@extremes
@pytest.mark.parametrize("u", [0.0, 1 - 2**-23])
def test_ends_of_the_random_numbers(case: Any, u: float) -> None:
    model = held(case)
    f, p = (float(exact(sample(lambda: Float(u)))) for sample in (model.sample_f, model.sample_p))
    assert np.isfinite([f, p]).all()
    assert (f == 0) == (u == 0) and p >= 0
    if case[0] in ("power", "linear", "quadratic"):
        end = float(exact(model.b))
        assert f < end and (p == end if float(exact(model.n)) == 1 else p < end)


# ------------------------------------------------------------------------------- parameters


@pytest.mark.parametrize(
    ("key", "parameters", "message"),
    [
        ("power", {"n": 0.5}, r"Power\.n is 0\.5: it must be a finite number >= 1"),
        ("power", {"n": Float(0.5)}, r"Power\.n is 0\.5: it must be"),
        ("power", {"b": 0}, r"Power\.b is 0: it must be a finite number > 0"),
        ("pulse", {"n": 0}, r"Pulse\.n is 0: it must be a whole number 1 to 1000"),
        ("pulse", {"n": 2.5}, r"Pulse\.n is 2\.5: it must be a whole number 1 to 1000"),
        ("pulse", {"n": 1001}, r"Pulse\.n is 1001: it must be"),
        ("pulse", {"a": -0.1}, r"Pulse\.a is -0\.1: it must be a finite number >= 0"),
        ("pulse", {"a": 2}, r"Pulse\.b is 2: it must be a finite number > Pulse\.a = 2"),
        ("pulse", {"a": Float(3)}, r"Pulse\.b is 2: it must be a finite number > Pulse\.a = 3"),
        ("hard_rod", {"d": -1}, r"HardRod\.d is -1: it must be a finite number >= 0"),
        ("hard_rod", {"l": 0}, r"HardRod\.l is 0: it must be a finite number > 0"),
    ],
)
def test_bad_parameters_are_named(key: str, parameters: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        models.create(key, **parameters)


def test_end_of_power_follows_the_exponent() -> None:
    assert models.create("power", n=7).b == 7
    assert models.create("power", n=7, b=2).sigma_bar == 3.5


def test_one_kernel_serves_all_exponents() -> None:
    """Parameters are data: nothing of their values gets into the program."""
    tau = dr.opaque(Float, 0) + dr.linspace(Float, 0, 4, 100)
    laws = [held(("power", {"n": n, "b": 2.0})) for n in (1.0, 2.0, 3.7)]
    kernels = [largest_kernel(lambda law=law: dr.eval(law.ff(tau))) for law in laws]
    assert len({kernel["hash"] for kernel in kernels}) == 1
