"""The ensemble: any law of extinction, against closed forms in 60 digits."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from build import DRAWN, FURNACE, ball, beam, medium, scene
from drjit.llvm.ad import PCG32, Float, Float64
from measure import FALSE_ALARM, assert_share, radiance
from scipy import stats
from stability_reference import exact, reference
from tiers import quick

from nonexp.models import create, to_dict
from nonexp.models.ensemble import Ensemble
from nonexp.numerics.laplace import AliasTable
from nonexp.transmittance.parameters import number

CASES: dict[str, dict[str, Any]] = {
    "gamma 2": {"law": "gamma", "args": (2, 0, 0.5)},
    "gamma 0.3": {"law": "gamma", "args": (0.3, 0, 4)},
    "gamma 1000": {"law": "gamma", "args": (1000, 0, 0.0009765625)},
    "expon": {"law": "expon"},
    "uniform": {"law": "uniform", "args": (0, 2)},
    "beta 2 5": {"law": "beta", "args": (2, 5)},
    "beta .5 .5": {"law": "beta", "args": (0.5, 0.5)},
    "loguniform": {"law": "loguniform", "args": (2**-10, 8)},
    "pareto": {"law": "pareto", "args": (2.5,)},
    "pareto, E[S^2] infinite": {"law": "pareto", "args": (1.5,)},
    "truncnorm": {"law": "truncnorm", "args": (-2, 2, 1, 0.5)},
    "triang": {"law": "triang", "args": (0.5,)},
    "invgauss": {"law": "invgauss", "args": (1.0,)},
    "lognorm 0.5": {"law": "lognorm", "args": (0.5,)},
    "lognorm 2": {"law": "lognorm", "args": (2,)},
    "weibull 0.5": {"law": "weibull_min", "args": (0.5,)},
    "poisson": {"law": "poisson", "args": (3,)},
    "binom": {"law": "binom", "args": (4, 0.25)},
    "Dirac": {"sigma": (1,)},
    "clear part": {"sigma": (0, 0.5, 3), "weight": (1, 3, 1)},
    "steps": {"sigma": (1, 0.125, 1e-6), "weight": (1, 1e-9, 1e-20)},
    "many": {"sigma": tuple(np.linspace(0.25, 4, 999)), "weight": (1,) * 999},
}
QUICK = {"gamma 2", "pareto, E[S^2] infinite", "lognorm 2", "poisson", "clear part"}
every_case = pytest.mark.parametrize("name", quick(CASES, QUICK.__contains__))


@cache
def model(name: str) -> Any:
    return create("ensemble", **CASES[name])


@every_case
def test_values_agree_with_closed_forms(name: str) -> None:
    """Over 16 decades: the quadrature to 1e-10, its interpolation to the bar of each precision."""
    law = model(name)
    closed = reference(law)
    assert law.sigma_bar == pytest.approx(float(closed.sigma_bar), rel=1e-11)
    tau = np.geomspace(1e-8, 1e8, 9 if name == "many" else 49).astype(np.float32)
    for kernel in ("ff", "pf", "pp"):
        function = getattr(law, kernel)
        right = [getattr(closed, kernel)(exact(t)) for t in tau]
        seen = np.array([value > 1e-30 for value in right])
        right = np.array([float(value) for value in right])
        plain = np.array([function(float(t)) for t in tau])
        wide = np.array(function(Float64(tau.astype(float))))
        narrow = np.array(function(Float(tau)), dtype=float)
        unit = (1 + np.abs(np.log(right[seen]))) * right[seen]
        assert np.all(np.abs(plain - right)[seen] <= 1e-10 * right[seen])
        assert np.all(np.abs(wide - right)[seen] <= 1e-10 * unit)
        assert np.all(np.abs(narrow - right)[seen] <= 2e-6 * unit)
        assert np.all(np.concatenate([plain, wide, narrow]) >= 0)
        assert np.all(narrow[~seen] < 2e-30)
        if kernel != "pp":
            assert np.all(np.concatenate([plain, wide, narrow]) <= 1)


@every_case
def test_tables_agree_with_the_sum_everywhere(name: str) -> None:
    """Also between the depths of the test above, and at the seams of the table."""
    law = model(name)
    seams = 2.0 ** np.arange(-30, 36, 1 / 8)
    tau = np.concatenate([np.geomspace(1e-8, 1e8, 1500), seams, np.nextafter(seams, 0)])
    tau = np.sort(tau.astype(np.float32))
    for function in (law.ff, law.pf, law.pp):
        right = np.array([function(float(t)) for t in tau])
        seen = (right > 1e-30) & (tau < 2**34)
        wide = np.array(function(Float64(tau.astype(float))))
        narrow = np.array(function(Float(tau)), dtype=float)
        unit = (1 + np.abs(np.log(right[seen]))) * right[seen]
        assert np.all(np.abs(wide - right)[seen] <= 2e-12 * unit)
        assert np.all(np.abs(narrow - right)[seen] <= 2e-6 * unit)
        assert np.all(np.diff(wide) <= 1e-12 * wide[1:])


@every_case
def test_ends(name: str) -> None:
    law = model(name)
    clear = float(reference(law).end)
    for kind in (float, Float, Float64):
        nothing, endless = kind(0), kind(math.inf)
        assert law.ff(nothing) == law.pf(nothing) == 1
        assert number(law.ff(endless)) == pytest.approx(clear, rel=1e-6, abs=1e-13)
        assert law.pf(endless) == law.pp(endless) == 0
    tau = Float([0, 1e-45, 1e-38, 1e-20, 1e-9, 2e10, 1e20, 3.4e38, dr.inf])
    for function in (law.ff, law.pf, law.pp):
        value = np.array(function(tau))
        assert np.all(np.isfinite(value) & (value >= 0))
        assert np.all(np.diff(value) <= 2e-7 * value[1:])


@pytest.mark.parametrize("kind", [Float, Float64])
def test_not_a_number_stays_one(kind: Any) -> None:
    value = np.array(model("gamma 2").ff(kind([math.nan, 1, -1])))
    assert np.isnan(value[0])
    assert value[1] == pytest.approx(4 / 9, rel=1e-6)


@pytest.mark.parametrize("scale", [1e-10, 1e-5, 1e3])
def test_nothing_exceeds_one_near_nothing(scale: float) -> None:
    law = create("ensemble", law="expon", args=(0, scale))
    tau = np.geomspace(1e-14, 1e-6, 2000)
    for function in (law.ff, law.pf):
        assert np.all(np.array(function(Float64(tau))) <= 1)
        assert np.all(np.array(function(Float(tau))) <= 1)
        assert max(function(float(t)) for t in tau[::40]) <= 1


@pytest.mark.parametrize("shape", [0.3, 2.0, 30.0])
def test_ensemble_of_gamma_laws_is_the_gamma_model(shape: float) -> None:
    ensemble = create("ensemble", law="gamma", args=(shape, 0, 1 / shape))
    gamma = create("gamma", alpha=shape)
    assert ensemble.sigma_bar == pytest.approx(1, rel=1e-13)
    for tau in np.geomspace(1e-6, 1e6, 30):
        for law in ("ff", "fp", "pf", "pp"):
            right = getattr(gamma, law)(tau)
            assert getattr(ensemble, law)(tau) == pytest.approx(right, rel=1e-11)


def test_one_value_is_the_exponential_law() -> None:
    law, exponential = create("ensemble", sigma=(1,)), create("exponential")
    tau = Float(np.geomspace(1e-3, 60, 200))
    for name in ("ff", "pf", "pp"):
        got, right = getattr(law, name)(tau), getattr(exponential, name)(tau)
        np.testing.assert_allclose(got, right, rtol=3e-5)
    draws = iter((Float(0.3), Float(0.9), Float(0.5)))
    assert number(law.sample_f(lambda: next(draws))) == pytest.approx(math.log(2), rel=1e-6)


@every_case
def test_gradients_by_depth(name: str) -> None:
    law = model(name)
    closed: Any = reference(law)
    some = [1e-6, 0.3, 40.0] if name == "many" else [1e-6, 1e-3, 0.1, 1, 12, 40, 1e5]
    depths = np.array(some, dtype=np.float32)
    for order, function in enumerate((law.ff, law.pf, law.pp)):
        tau = Float(depths)
        dr.enable_grad(tau)
        value = function(tau)
        dr.backward(value)
        for t, gradient, y in zip(depths, tau.grad, value, strict=True):
            mean = closed.sigma_bar if order else 1
            right = float(-closed.moment(order + 1, exact(t)) / mean)
            assert gradient == pytest.approx(right, rel=1e-4, abs=1e-4 * y + 1e-37)


@pytest.mark.parametrize("law", ["ff", "pf", "pp"])
@pytest.mark.parametrize("name", ["gamma 0.3", "clear part", "pareto, E[S^2] infinite"])
def test_gradients_are_finite_everywhere(name: str, law: str) -> None:
    tau = Float([0, 1e-40, 1e-8, 1, 1e8, 1e30, 3.4e38, dr.inf])
    dr.enable_grad(tau)
    dr.backward(getattr(model(name), law)(tau))
    assert np.all(np.isfinite(tau.grad))


# ------------------------------------------------------------------------------------- sampling

DRAWS = 2**20


def flights(law: Any, origin: str, seed: int) -> Any:
    generator = PCG32(DRAWS, seed)
    sample = getattr(law, f"sample_{origin}")(generator.next_float32)
    tau = np.array(sample, dtype=float)
    assert tau.shape == (DRAWS,)
    assert np.all(tau >= 0)
    return tau


@every_case
@pytest.mark.parametrize("origin", ["f", "p"])
def test_flights_follow_the_transmittance(name: str, origin: str) -> None:
    law = model(name)
    survival = law.ff if origin == "f" else law.pf
    tau = flights(law, origin, 11)
    beyond = survival(math.inf)
    assert stats.binomtest(np.count_nonzero(tau == math.inf), DRAWS, beyond).pvalue > FALSE_ALARM

    def cdf(t: Any) -> Any:
        return (1 - np.array(survival(Float64(t)))) / (1 - beyond)

    assert stats.kstest(tau[tau < math.inf], cdf).pvalue > FALSE_ALARM


@pytest.mark.parametrize("name", ["uniform", "lognorm 0.5", "loguniform", "pareto"])
def test_flights_carry_the_moments_of_the_law(name: str) -> None:
    """E[exp(-x tau)] is E[S/(S+x)] from a surface; the mean after a collision is 1/sigma_bar."""
    parameters = CASES[name]
    law, extinction = model(name), getattr(stats, parameters["law"])(*parameters["args"])
    tau = flights(law, "f", 12)
    expected = extinction.expect(lambda s: s / (s + 0.7), epsabs=1e-10)
    seen = np.exp(-0.7 * tau)
    assert abs(seen.mean() - expected) < 4.5 * seen.std() / DRAWS**0.5
    if name != "uniform":  # its flights have no variance
        tau = flights(law, "p", 13)
        assert abs(tau.mean() * extinction.mean() - 1) < 4.5 * tau.std() / tau.mean() / DRAWS**0.5


def test_python_numbers_are_sampled_alike() -> None:
    law = model("clear part")
    for u in (0.0, 0.1, 0.5, 0.9, 1 - 2**-23):
        plain = iter([u, 0.25, 0.5])
        narrow = iter([Float(u), Float(0.25), Float(0.5)])
        got = law.sample_f(plain.__next__)
        assert got == pytest.approx(number(law.sample_f(narrow.__next__)), rel=1e-6)
        assert next(plain, None) is next(narrow, None) is None


def test_rare_values_are_drawn_as_often_as_they_should() -> None:
    weight = (0.7, 0.2, 0.1 - 1e-5 - 1e-9, 1e-5, 0.0, 1e-9)
    values = Float64(np.arange(6.0))
    choice = AliasTable(range(6), weight)
    count, rounds = 2**22, 4
    hits = np.zeros(6)
    generator = PCG32(count, 3)
    for _ in range(rounds):
        drawn = choice(generator.next_float32(), generator.next_float32())
        hits += np.bincount(np.array(drawn, dtype=int), minlength=len(values))
    for hit, probability in zip(hits, weight, strict=True):
        assert stats.binomtest(int(hit), count * rounds, probability).pvalue > FALSE_ALARM
    corners = [0, 2**-23, 1 - 2**-23]
    first, second = np.meshgrid(np.concatenate([corners, np.arange(8) / 8]), corners)
    drawn = np.array(choice(Float(first.ravel()), Float(second.ravel())))
    assert not np.any(drawn == 4)
    # A value next to impossible must not come with the probability of a zero.
    assert AliasTable([1.0, 2.0], [1.0, 1e-30])(Float(0.5), Float(0)) == 1


# --------------------------------------------------------------------------- laws and parameters


@pytest.mark.parametrize(
    ("law", "args"),
    [
        ("lognorm", (1e-7,)),
        ("lognorm", (0.01, 0, 5)),
        ("gamma", (0.01,)),
        ("gamma", (1e6, 0, 1e-6)),
        ("beta", (0.05, 0.05, 0.5, 2)),
        ("weibull_min", (5,)),
        ("invgamma", (4,)),
        ("burr12", (10, 4)),
        ("halfnorm", ()),
        ("trapezoid", (0.2, 0.8)),
        ("uniform", (3, 1e-12)),
        ("truncnorm", (-10 / 3, 3, 1, 0.3)),  # begins at -1e-16
        ("lomax", (3,)),
        ("nbinom", (0.4, 0.4)),
        ("geom", (0.5,)),
        ("randint", (2, 9)),
    ],
)
def test_mean_of_many_laws(law: str, args: tuple[float, ...]) -> None:
    ensemble = create("ensemble", law=law, args=args)
    assert ensemble.sigma_bar == pytest.approx(float(getattr(stats, law).mean(*args)), rel=1e-7)
    assert 0 < ensemble.ff(1.0) < 1


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({}, "Ensemble.law is '' and sigma has 0 values: exactly one of the two must be given"),
        ({"law": "gamma", "args": (2,), "sigma": (1,)}, "exactly one of the two must be given"),
        ({"law": "gama", "args": (2,)}, "Ensemble.law is 'gama': it must name .* such as gamma"),
        ({"law": "rv_continuous"}, "Ensemble.law is 'rv_continuous': it must name"),
        ({"law": "lognorm"}, r"Ensemble.args has 0 numbers: lognorm takes s\[, loc, scale\]"),
        ({"law": "expon", "args": (1, 2, 3)}, r"expon takes \[loc, scale\]"),
        ({"law": "poisson", "args": (3, 0, 1)}, r"3 numbers: poisson takes mu\[, loc\]"),
        ({"law": "lognorm", "args": (-1,)}, r"Ensemble.args is \(-1\): lognorm does not allow"),
        ({"law": "gamma", "args": (2, 0, 0)}, r"args is \(2, 0, 0\): gamma does not allow"),
        ({"law": "gamma", "args": (math.nan,)}, r"Ensemble.args\[0\] is nan: it must be"),
        ({"law": "norm"}, r"Ensemble.law norm\(\) begins at -inf: extinction must be >= 0"),
        ({"law": "uniform", "args": (-1, 2)}, r"law uniform\(-1, 2\) begins at -1: extinction"),
        ({"law": "pareto", "args": (1,)}, r"Ensemble.law pareto\(1\) has no finite mean"),
        ({"law": "halfcauchy"}, "no finite mean"),
        ({"law": "zipf", "args": (1.5,)}, "takes more than 8192 values"),
        ({"law": "gamma", "args": (2, 0, 1e-30)}, "cannot be integrated: .* adds up to 0"),
        ({"sigma": (1, 2), "weight": (1,)}, "Ensemble.weight holds 1 numbers"),
        ({"sigma": (1, 2), "weight": (0, 0)}, "Ensemble.weight holds only zeros"),
        ({"sigma": (1, 2), "weight": (1, -1)}, r"Ensemble.weight\[1\] is -1: it must be"),
        ({"sigma": (1, -2)}, r"Ensemble.sigma\[1\] is -2: it must be"),
        ({"sigma": (0,)}, "Ensemble.sigma has mean 0: it must be"),
        ({"sigma": range(9000)}, "Ensemble.sigma has 9000 values: at most 8192"),
        ({"law": "expon", "weight": (1,)}, "Ensemble.weight belongs to sigma"),
        ({"sigma": (1,), "args": (1,)}, "Ensemble.args belongs to law"),
    ],
)
def test_bad_parameters_are_named(parameters: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        create("ensemble", **parameters)


def test_equal_weights_are_the_default() -> None:
    even = create("ensemble", sigma=(0.2, 1.8))
    assert even.ff(3.0) == create("ensemble", sigma=(0.2, 1.8), weight=(7, 7)).ff(3.0)


@pytest.mark.thorough
def test_models_can_be_made_in_threads() -> None:
    def make(shape: float) -> float:
        return float(create("ensemble", law="gamma", args=(shape, 0, 1 / shape)).ff(Float(2.0))[0])

    shapes = [0.5, 1, 2, 4] * 3
    with ThreadPoolExecutor(4) as pool:
        values = list(pool.map(make, shapes))
    assert values == pytest.approx([(1 + 2 / k) ** -k for k in shapes], rel=1e-6)


# ------------------------------------------------------------------------------------- in scenes

XML = """
<scene version="3.0.0">
  <medium type="nonexp_homogeneous">
    <texture type="transmittance_ensemble" name="transmittance">{}</texture>
  </medium>
</scene>
"""


@pytest.mark.parametrize(
    "words",
    [
        {"law": "lognorm", "args": "0.5, 0, 1"},
        {"law": "poisson", "args": "1.5"},
        {"law": "expon"},
        {"sigma": "0, 0.5, 3", "weight": "1, 3, 1"},
    ],
)
def test_scene_files_make_the_same_model(words: dict[str, str]) -> None:
    def numbers(text: str) -> Any:
        return tuple(float(word) for word in text.split(","))

    parameters = {k: v if k == "law" else numbers(v) for k, v in words.items()}
    direct = create("ensemble", **parameters)
    assert to_dict(direct)["type"] == "transmittance_ensemble"
    lines = "".join(f'<string name="{k}" value="{v}"/>' for k, v in words.items())
    assert mi.load_string(XML.format(lines)) is not None
    for texture in (
        mi.load_dict({"type": "transmittance_ensemble", **words}),
        mi.load_dict(to_dict(direct)),
    ):
        assert isinstance(texture.model, Ensemble)
        assert texture.model.ff(0.8) == pytest.approx(direct.ff(0.8), rel=1e-12)


def test_parameters_can_be_changed_in_a_scene() -> None:
    texture = mi.load_dict({"type": "transmittance_ensemble", "law": "gamma", "args": "2, 0, 0.5"})
    params = mi.traverse(texture)
    params["args"] = mi.Float(4, 0, 0.25)
    params.update()
    assert texture.model.ff(2.0) == pytest.approx(1.5**-4, rel=1e-6)
    params["args"] = mi.Float(4, -1, 0.25)
    with pytest.raises(ValueError, match="extinction must be >= 0"):
        params.update()


@pytest.mark.parametrize("name", ["lognorm 0.5", "clear part"])
def test_light_that_crosses_a_ball(name: str) -> None:
    """Counted escapes of single rays through an absorbing ball of depth 1.6."""
    law = model(name)
    inside = medium("ensemble", CASES[name], sigma_t=0.8, albedo=0.0)
    samples = radiance(scene(DRAWN, sensor=beam(), ball=ball(inside), sky=FURNACE), 2**17, 5)
    assert_share(samples, law.ff(1.6))
