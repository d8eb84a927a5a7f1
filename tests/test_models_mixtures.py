"""Mixtures: weights, choice of a component, Levermore and Pomraning's law, nesting in scenes."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from build import FURNACE, MODELS, QUICK, ball, beam, perspective, scene
from drjit.llvm.ad import PCG32, Float, Float64
from measure import FALSE_ALARM, assert_mean, largest_kernel, radiance
from scipy import integrate, stats
from stability_reference import reference
from tiers import quick

from nonexp import models
from nonexp.models import to_dict, to_xml
from nonexp.models.constant import Constant
from nonexp.models.exponential import Exponential
from nonexp.models.exponential_mixture import ExponentialMixture
from nonexp.models.gamma import Gamma
from nonexp.models.linear import Linear
from nonexp.models.mixture import Mixture
from nonexp.models.quadratic import Quadratic
from nonexp.testing.arrays import with_arrays
from nonexp.transmittance import Transmittance
from nonexp.transmittance.choice import pick

VACUUM = ExponentialMixture((2.0, 0.0), (3.0, 1.0))
WIDE = ExponentialMixture((1e-4, 1.0, 1e4))
UNEVEN = ExponentialMixture((1e4, 1e-4, 0.3), (1.0, 1e4, 1e-3))
MANY = ExponentialMixture(tuple(10 ** (k / 2 - 4) for k in range(17)))
BLEND = Mixture((Exponential(), Linear(2.0)), (1.0, 3.0))
ALL_KINDS = Mixture(
    (Mixture((Gamma(0.5), Quadratic(3.0), WIDE), (1, 3, 2)), Linear(0.7), BLEND, Constant())
)
CASES = [VACUUM, WIDE, UNEVEN, MANY, BLEND, ALL_KINDS, Mixture((UNEVEN, Gamma(1e4)), (1e-3, 1e3))]
every_case = pytest.mark.parametrize("model", CASES, ids=lambda m: f"{type(m).__name__}")
both_origins = pytest.mark.parametrize("origin", ["f", "p"])

# ------------------------------------------------------------------------ ends


@every_case
def test_laws_end_in_their_limits(model: Transmittance) -> None:
    limit = float(reference(model).end)
    for tau in (math.inf, Float([3e38, math.inf]), Float64([1e300, math.inf])):
        np.testing.assert_allclose(np.array(model.ff(tau)), limit, rtol=1e-6)
        for density in (model.pf, model.pp):
            np.testing.assert_allclose(np.array(density(tau)), 0, atol=1e-38)


def test_gradients_are_finite_at_infinity() -> None:
    sigma = [Float(2), Float(0)]
    weight = [Float(3), Float(1)]
    dr.enable_grad(sigma, weight)
    model = ExponentialMixture(sigma, weight)
    for law in (model.ff, model.pf, model.pp):
        tau = Float([0, 1, dr.inf])
        dr.backward(dr.select(dr.isfinite(tau), law(tau), 0))
    assert np.all(np.isfinite([dr.grad(x)[0] for x in (*sigma, *weight)]))


# ------------------------------------------------------------------------ samples


@pytest.mark.parametrize("kind", [Float, Float64])
def test_choice_has_the_right_frequencies(kind: Any) -> None:
    shares = [0.0, 3.0, 1e-3, 0.0, 2.0, 0.5, 0.0]
    count = 2**20
    generator = PCG32(count, 5)
    draw = generator.next_float32 if kind is Float else generator.next_float64
    picked = np.array(pick(draw, [kind(s) for s in shares], range(len(shares))), dtype=int)
    seen = np.bincount(picked, minlength=len(shares))
    expected = np.array(shares) / sum(shares) * count
    positive = expected > 0
    assert np.all(seen[~positive] == 0)
    assert stats.chisquare(seen[positive], expected[positive]).pvalue > FALSE_ALARM


def test_choice_resolves_shares_below_the_step_of_random_numbers() -> None:
    """A share of 1e-9 lies wholly within the first, or the last, of 2^23 random numbers."""
    fine = np.arange(0, 2**23, 8) / 2**23
    for end, first in ((0, 0.0), (2, 1 - 2**-23)):
        draws = iter([Float(first), Float(fine)])
        shares = [Float(1e-9), Float(1), Float(1e-9)]
        picked = np.array(pick(lambda draws=draws: next(draws), shares, [0.0, 1.0, 2.0]))
        assert np.mean(picked == end) == pytest.approx(1e-9 * 2**23, rel=1e-3)
        assert np.mean(picked == 1) == pytest.approx(1 - 1e-9 * 2**23, rel=1e-3)


@pytest.mark.parametrize("u", [0.0, 2.0**-23, 0.5, 1 - 2.0**-23])
@pytest.mark.parametrize("v", [0.0, 0.5, 1 - 2.0**-23])
def test_a_share_of_zero_is_never_picked(u: float, v: float) -> None:
    for shares in ([0, 1, 0], [0, 0, 1e-30], [1e30, 0, 0], [0, 0.1, 0, 0.7, 0.2, 0]):
        for kind in (float, Float):
            draws = iter([kind(u), kind(v)])
            picked = pick(
                lambda draws=draws: next(draws), [kind(s) for s in shares], range(len(shares))
            )
            assert shares[int(picked if kind is float else picked[0])] > 0


@pytest.mark.parametrize("model", CASES[:6], ids=lambda m: f"{type(m).__name__}")
@both_origins
def test_ends_of_the_random_numbers(model: Transmittance, origin: str) -> None:
    for kind, last in ((Float, 1 - 2.0**-23), (Float64, 1 - 2.0**-53), (float, 1 - 2.0**-53)):
        for u in (0.0, last):
            tau = getattr(model, f"sample_{origin}")(lambda kind=kind, u=u: kind(u))
            tau = float(dr.detach(tau)[0]) if dr.is_array_v(tau) else tau
            assert tau >= 0
            assert (tau == 0) == (u == 0) or origin == "p"


def test_the_number_of_draws_is_fixed() -> None:
    def count(model: Transmittance, origin: str, first: float) -> int:
        draws = iter(range(100))
        getattr(model, f"sample_{origin}")(lambda: Float(first + 0 * next(draws)))
        return next(draws)

    for origin in "fp":
        assert count(ExponentialMixture((3.0,)), origin, 0.1) == 1
        assert count(Mixture((Exponential(),)), origin, 0.1) == 1
        assert count(WIDE, origin, 0.1) == count(WIDE, origin, 0.9) == 3
        assert count(Mixture((WIDE, WIDE, Exponential())), origin, 0.5) == 5


# ------------------------------------------------------------------------ identities


def same_laws(a: Transmittance, b: Transmittance, rtol: float = 1e-13) -> None:
    tau = Float64(np.concatenate([[0], np.geomspace(1e-6, 1e3, 200)]))
    assert a.sigma_bar == pytest.approx(b.sigma_bar, rel=rtol)
    for law in ("ff", "fp", "pf", "pp"):
        left, right = (np.broadcast_to(np.array(getattr(m, law)(tau)), (201,)) for m in (a, b))
        np.testing.assert_allclose(left, right, rtol=rtol, atol=1e-300)


@pytest.mark.parametrize(("key", "parameters"), quick(MODELS, QUICK.__contains__, several=True))
def test_a_mixture_of_one_is_that_model(key: str, parameters: dict[str, Any]) -> None:
    model = models.create(key, **parameters)
    if isinstance(model, Constant):
        with pytest.raises(ValueError, match="mean extinction of Mixture is 0: it must be"):
            Mixture((model,))
        return
    same_laws(Mixture((model,), (7.0,)), model)
    assert Mixture((model,)).kinks == model.kinks
    assert [t for t, _ in Mixture((model,)).atoms] == [t for t, _ in model.atoms]
    assert [p for _, p in Mixture((model,)).atoms] == pytest.approx([p for _, p in model.atoms])
    for origin in "fp":
        sample = f"sample_{origin}"
        got, true = (
            np.array(getattr(m, sample)(PCG32(64).next_float32)) for m in (Mixture((model,)), model)
        )
        np.testing.assert_array_equal(got, true)


def test_exponential_mixtures() -> None:
    one = ExponentialMixture((1.0,))
    same_laws(one, Exponential())
    same_laws(ExponentialMixture((0.7, 0.7, 0.7), (1, 2, 5)), ExponentialMixture((0.7,)))
    same_laws(ExponentialMixture.double(0.2, 1.8), ExponentialMixture())
    assert ExponentialMixture.double(0.5, 3.0).ff(1.0) == pytest.approx(
        (math.exp(-0.5) + math.exp(-3)) / 2, rel=1e-15
    )
    sampled = ExponentialMixture((0.5,)).sample_p(PCG32(64).next_float32)
    np.testing.assert_array_equal(sampled, 2 * one.sample_p(PCG32(64).next_float32))


def test_weights_count_by_their_ratios_and_are_equal_by_default() -> None:
    same_laws(
        ExponentialMixture((1, 2, 6), (1, 2, 1)), ExponentialMixture((1, 2, 6), (50, 100, 50))
    )
    same_laws(ExponentialMixture((1, 2, 6)), ExponentialMixture((1, 2, 6), "1 1 1"))
    three = (Gamma(), Linear(), Quadratic())
    same_laws(Mixture(three), Mixture(three, (0.2, 0.2, 0.2)))
    assert Mixture(three).weight == (1, 1, 1)
    same_laws(Mixture(three, (0, 2, 0)), Linear())


def test_a_mixture_in_a_mixture_is_a_mixture_of_all() -> None:
    inner = ExponentialMixture((1.0, 4.0), (3.0, 1.0))
    outer = Mixture((Mixture((inner, ExponentialMixture((0.0, 9.0)))), Exponential()), (1, 3))
    flat = ExponentialMixture((1, 4, 0, 9, 1), (3 / 32, 1 / 32, 1 / 16, 1 / 16, 3 / 4))
    same_laws(outer, flat)


def test_a_mixture_of_flights() -> None:
    """pf = sum u_i pf_i for weights u_i / sigma_bar_i."""
    parts, shares = (Linear(0.5), Quadratic(3.0), ExponentialMixture((4.0,))), (0.2, 0.5, 0.3)
    weights = tuple(float(u / m.sigma_bar) for u, m in zip(shares, parts, strict=True))
    model = Mixture(parts, weights)
    for tau in (0.0, 0.3, 0.7, 2.0, 5.0):
        mean = sum(u * float(m.pf(tau)) for u, m in zip(shares, parts, strict=True))
        assert model.pf(tau) == pytest.approx(mean, rel=1e-14)


def test_atoms_and_kinks_are_united_in_order() -> None:
    model = Mixture((Linear(2.0), Quadratic(1.0), Linear(0.5), Mixture((Linear(2.0), Gamma()))))
    assert list(model.kinks) == sorted({0.5, 2.0, *Quadratic(1.0).kinks})
    # Shares of sigma_bar: 1/2, 2, 2 and 3/4, of which a third is the inner atom's.
    assert [t for t, _ in model.atoms] == [0.5, 2.0]
    assert [p for _, p in model.atoms] == pytest.approx([2 / 5.25, 0.75 / 5.25])
    narrow, _ = with_arrays(model, Float)
    np.testing.assert_allclose([(t[0], p[0]) for t, p in narrow.atoms], model.atoms, rtol=1e-6)


# ------------------------------------------------------------------------ Levermore and Pomraning

MARKOV = [
    (10.0, 0.1, 1.0, 3.0),
    (0.1, 10.0, 1.0, 3.0),
    (2.0, 0.0, 0.3, 0.2),
    (1.0, 1.0, 0.5, 2.0),
    (100 / 99, 10 / 99, 99 / 100, 101 / 20),
    (1e3, 1e-3, 1e-2, 10.0),
]


@pytest.mark.parametrize("setting", MARKOV)
def test_levermore_solves_the_coupled_equations(setting: tuple[float, ...]) -> None:
    sigma, chord = np.array(setting[:2]), np.array(setting[2:])
    matrix = np.array(
        [[-sigma[0] - 1 / chord[0], 1 / chord[1]], [1 / chord[0], -sigma[1] - 1 / chord[1]]]
    )
    model = ExponentialMixture.levermore(*setting)
    at = np.linspace(0, 5 / float(model.sigma_bar), 30)
    solved = integrate.solve_ivp(
        lambda t, y: matrix @ y,
        (0, at[-1]),
        chord / chord.sum(),
        "Radau",
        at,
        rtol=1e-10,
        atol=1e-13,
        jac=matrix,
    )
    np.testing.assert_allclose(model.ff(Float64(at)), solved.y.sum(axis=0), rtol=1e-7)
    assert model.sigma_bar == pytest.approx(sigma @ chord / chord.sum(), rel=1e-13)


@pytest.mark.parametrize("setting", MARKOV[:3])
def test_levermore_is_the_mean_over_random_chords(setting: tuple[float, ...]) -> None:
    sigma, chord = np.array(setting[:2]), np.array(setting[2:])
    model = ExponentialMixture.levermore(*setting)
    random = np.random.default_rng(11)
    for end in (0.2, 1.0, 3.0):
        material = (random.random(200_000) > chord[0] / chord.sum()).astype(int)
        left, depth = np.full(len(material), end), np.zeros(len(material))
        while np.any(left > 0):
            step = np.minimum(random.exponential(chord[material]), left)
            depth += sigma[material] * step
            left -= step
            material = 1 - material
        assert_mean(np.exp(-depth), float(model.ff(end)), within=0.15)


def test_limits_of_levermore() -> None:
    fine = ExponentialMixture.levermore(3.0, 1.0, 1e-9, 3e-9)
    assert fine.ff(1.0) == pytest.approx(math.exp(-1.5), rel=1e-7)
    coarse = ExponentialMixture.levermore(3.0, 1.0, 1e9, 3e9)
    assert coarse.ff(1.0) == pytest.approx(0.25 * math.exp(-3) + 0.75 * math.exp(-1), rel=1e-7)
    same_laws(ExponentialMixture.levermore(2.0, 2.0, 1.0, 3.0), ExponentialMixture((2.0,)), 1e-12)


def test_levermore_is_differentiable() -> None:
    setting = MARKOV[0]
    arrays = [Float64(v) for v in setting]
    dr.enable_grad(arrays)
    dr.backward(ExponentialMixture.levermore(*arrays).ff(Float64(0.8)))
    for i, v in enumerate(setting):
        high, low = (
            ExponentialMixture.levermore(*setting[:i], v * f, *setting[i + 1 :]).ff(0.8)
            for f in (1 + 1e-5, 1 - 1e-5)
        )
        assert dr.grad(arrays[i])[0] == pytest.approx((high - low) / (2e-5 * v), rel=1e-6)


# ------------------------------------------------------------------------ what is refused


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: ExponentialMixture((1, 2), (1, 2, 3)),
            "ExponentialMixture.weight holds 3 numbers: it must hold as many as sigma (2)",
        ),
        (
            lambda: ExponentialMixture(Float(1, 2), Float(1)),
            "ExponentialMixture.weight holds 1 numbers: it must hold as many as sigma (2)",
        ),
        (lambda: ExponentialMixture(()), "ExponentialMixture.sigma is empty: it must hold"),
        (lambda: ExponentialMixture("1, -2"), "ExponentialMixture.sigma[1] is -2: it must be"),
        (lambda: ExponentialMixture((1, math.inf)), "ExponentialMixture.sigma[1] is inf"),
        (lambda: ExponentialMixture((1,), (-1,)), "ExponentialMixture.weight[0] is -1: it must"),
        (lambda: ExponentialMixture((1, 2), (0, 0)), "ExponentialMixture.weight holds only zeros"),
        (lambda: ExponentialMixture((1, 2), Float(0, 0)), "weight holds only zeros: at least one"),
        (lambda: ExponentialMixture((0, 0)), "mean extinction of ExponentialMixture is 0: it must"),
        (lambda: ExponentialMixture((0, 2), (1, 0)), "mean extinction of ExponentialMixture is 0"),
        (lambda: ExponentialMixture(Float(0, 0)), "mean extinction of ExponentialMixture is 0"),
        (lambda: ExponentialMixture((Float(3e38),), (10.0,)), "mean extinction of"),
        (lambda: ExponentialMixture.double(-1, 2), "ExponentialMixture.sigma[0] is -1: it must"),
        (lambda: ExponentialMixture.levermore(1, -1, 1, 1), "levermore: sigma1 is -1: it must be"),
        (lambda: ExponentialMixture.levermore(1, 1, 0, 1), "levermore: chord0 is 0: it must be"),
        (lambda: ExponentialMixture.levermore(0, 0, 1, 1), "mean extinction of"),
        (lambda: Mixture(()), "Mixture.models is empty: it must hold at least one model"),
        (lambda: Mixture((Linear(), 3)), "Mixture.models[1] is 3: it must be a model"),
        (
            lambda: Mixture((Linear(), Gamma()), (1,)),
            "Mixture.weight holds 1 numbers: it must hold as many as models (2)",
        ),
        (lambda: Mixture((Linear(), Gamma()), (0, 0)), "Mixture.weight holds only zeros"),
        (lambda: Mixture((Constant(),)), "mean extinction of Mixture is 0: it must be"),
        (lambda: Mixture((Constant(), Linear()), (1, 0)), "mean extinction of Mixture is 0"),
    ],
)
def test_bad_input_is_named(make: Callable[[], Transmittance], message: str) -> None:
    with pytest.raises(ValueError) as error:
        make()
    assert message in str(error.value)
    assert "\n" not in str(error.value)


# ------------------------------------------------------------------------ in scenes

XML = """<scene version="3.0.0"><shape type="sphere" id="ball">
  <medium type="nonexp_homogeneous" name="interior">
    <texture type="transmittance_mixture" name="transmittance">
      <string name="weight" value="1, 3"/>
      <texture type="transmittance_exponential"/>
      <texture type="transmittance_linear"> <float name="b" value="2"/> </texture>
    </texture>
  </medium> </shape></scene>"""


def medium(model: Transmittance, **kw: Any) -> dict[str, Any]:
    return {"type": "nonexp_homogeneous", "transmittance": to_dict(model), **kw}


def model_of(scene: Any) -> Transmittance:
    law: Transmittance = scene.shapes()[0].interior_medium().model
    return law


def test_components_are_nested_textures_in_order() -> None:
    law = model_of(mi.load_string(XML))
    assert [type(m) for m in law.models] == [Exponential, Linear]
    assert law.ff(mi.Float(1.0))[0] == pytest.approx(BLEND.ff(1.0))
    # Names do not sort as positions do, neither as words nor beyond the tenth.
    for name in ("model_{}", "x{}", "{:c}"):
        keys = [name.format(*([122 - i] if "c" in name else [i])) for i in range(13)]
        nested = {key: to_dict(Linear(1.0 + i)) for i, key in enumerate(keys)}
        law = mi.load_dict({"type": "transmittance_mixture", **nested}).model
        assert [m.b[0] for m in law.models] == [1 + i for i in range(13)]
    linear = '<texture type="transmittance_linear" {}><float name="b" value="{}"/></texture>'
    shared = "".join(linear.format(f'id="law{i}"', i + 1) for i in range(12))
    mixed = "".join(
        f'<ref id="law{i}"/>' if i % 2 else linear.format("", i + 1) for i in reversed(range(12))
    )
    text = f"""<scene version="3.0.0">{shared}<shape type="sphere">
        <medium type="nonexp_homogeneous" name="interior">
        <texture type="transmittance_mixture" name="transmittance">{mixed}</texture>
        </medium></shape></scene>"""
    assert [m.b[0] for m in model_of(mi.load_string(text)).models] == list(range(12, 0, -1))


@pytest.mark.parametrize("model", [*CASES, ExponentialMixture(), Mixture()])
def test_dictionaries_and_xml_hold_the_whole_model(model: Transmittance) -> None:
    text = f"""<scene version="3.0.0"><shape type="sphere">
        <medium type="nonexp_homogeneous" name="interior">{to_xml(model)}</medium>
        </shape></scene>"""
    narrow, _ = with_arrays(model, Float)
    tau = mi.Float([0, 1e-3, 0.3, 1, 5, 1e3])
    for loaded in (mi.load_dict(to_dict(model)).model, model_of(mi.load_string(text))):
        for law in ("ff", "pf", "pp"):
            got, true = (np.array(getattr(m, law)(tau)) for m in (loaded, narrow))
            np.testing.assert_allclose(got, true, rtol=2e-6)
        assert to_dict(loaded) == to_dict(narrow)


def test_parameters_of_components_can_be_read_and_changed() -> None:
    nested = Mixture((Mixture((Gamma(3.0), ExponentialMixture())), Linear(2.0)), (1.0, 3.0))
    built = scene(ball={"type": "sphere", "interior": medium(nested)})
    parameters = mi.traverse(built)
    root = "ball.interior_medium.transmittance."
    assert {key.removeprefix(root) for key in parameters.keys() if key.startswith(root)} == {
        "weight",
        "model_0.weight",
        "model_0.model_0.alpha",
        "model_0.model_1.sigma",
        "model_0.model_1.weight",
        "model_1.b",
    }

    def expect(model: Transmittance) -> None:
        for tau in (0.3, 1.7, 4.0):
            assert model_of(built).ff(mi.Float(tau))[0] == pytest.approx(model.ff(tau), rel=1e-6)

    expect(nested)
    parameters[root + "model_1.b"] = mi.Float(4.0)
    parameters.update()
    expect(Mixture((nested.models[0], Linear(4.0)), (1, 3)))
    parameters[root + "model_0.model_1.sigma"] = mi.Float([0.5, 0.0])
    parameters[root + "model_0.model_0.alpha"] = mi.Float(0.5)
    parameters.update()
    inner = Mixture((Gamma(0.5), ExponentialMixture((0.5, 0.0))))
    expect(Mixture((inner, Linear(4.0)), (1, 3)))
    parameters[root + "weight"] = mi.Float([2.0, 1.0])
    parameters.update()
    expect(Mixture((inner, Linear(4.0)), (2, 1)))

    for key, value, message in (
        ("model_1.b", [-1.0], "Linear.b is -1"),
        ("model_0.model_1.sigma", [0.0, 0.0], "mean extinction of ExponentialMixture is 0"),
        ("model_0.model_1.sigma", [1.0, 2.0, 3.0], "weight holds 2 numbers: it must hold as many"),
        ("model_0.model_1.weight", [1.0, -1.0], r"ExponentialMixture.weight\[1\] is -1"),
        ("weight", [0.0, 0.0], "Mixture.weight holds only zeros"),
        ("weight", [1.0], "Mixture.weight holds 1 numbers"),
    ):
        before = np.array(parameters[root + key])
        parameters[root + key] = mi.Float(value)
        with pytest.raises(ValueError, match=message):
            parameters.update()
        np.testing.assert_array_equal(parameters[root + key], before)
        expect(Mixture((inner, Linear(4.0)), (2, 1)))
        parameters.update()
    parameters[root + "model_1.b"] = mi.Float(1.0)
    parameters.update()
    expect(Mixture((inner, Linear(1.0)), (2, 1)))


def test_a_refused_weight_leaves_the_components_accepted_with_it() -> None:
    texture = mi.load_dict(to_dict(Mixture((ExponentialMixture(), Linear()))))
    parameters = mi.traverse(texture)
    parameters["model_0.sigma"] = mi.Float([3.0, 5.0])
    parameters["weight"] = mi.Float([0.0, 0.0])
    with pytest.raises(ValueError, match="only zeros"):
        parameters.update()
    assert [s[0] for s in texture.model.models[0].sigma] == list(parameters["model_0.sigma"])


def test_default_components_have_parameters_too() -> None:
    texture = mi.load_dict({"type": "transmittance_mixture"})
    parameters = mi.traverse(texture)
    parameters["model_1.b"] = mi.Float(2.0)
    parameters["weight"] = mi.Float([1.0, 3.0])
    parameters.update()
    assert texture.model.ff(mi.Float(1.0))[0] == pytest.approx(BLEND.ff(1.0))


def test_gradients_reach_nested_parameters() -> None:
    model = Mixture((ExponentialMixture((0.5, 3.0), (2.0, 1.0)), Linear(2.0)), (1.0, 3.0))
    built = scene(ball={"type": "sphere", "interior": medium(model)})
    parameters = mi.traverse(built)
    keys = [key for key in parameters.keys() if ".transmittance." in key]
    for key in keys:
        dr.enable_grad(parameters[key])
    parameters.update()
    dr.backward(model_of(built).ff(mi.Float(0.7)))
    got = {key.rpartition("transmittance.")[2]: parameters[key].grad for key in keys}
    wide, leaves = with_arrays(model, Float64)
    dr.enable_grad(*leaves.values())
    dr.backward(wide.ff(Float64(0.7)))
    for key, entries in got.items():
        path = key.replace("model_0.", "models[0].").replace("model_1.", "models[1].")
        names = [path] if path in leaves else [f"{path}[{i}]" for i in range(len(entries))]
        true = [leaves[name].grad[0] for name in names]
        np.testing.assert_allclose(entries, true, rtol=1e-4)
    assert len(got) == 4


def test_two_media_of_which_one_a_mixture() -> None:
    front, back = Mixture((WIDE, BLEND)), Gamma(0.7)
    one = {**ball(medium(front, albedo=0.0), radius=0.5), "center": [0, 0, 1]}
    two = {**ball(medium(back, albedo=0.0), radius=0.5), "center": [0, 0, -1]}
    samples = radiance(scene(sensor=beam(), one=one, two=two, sky=FURNACE), 2**18, 1)
    assert_mean(samples, float(front.ff(1.0) * back.ff(1.0)), within=0.05)


def test_other_weights_and_extinctions_need_no_other_kernel() -> None:
    inside = medium(Mixture((ExponentialMixture(), Linear())))
    built = scene(sensor=perspective([0, 0, 4], [0, 0, 0]), ball=ball(inside), sky=FURNACE)
    parameters = mi.traverse(built)
    root = "ball.interior_medium.transmittance."
    hashes = set()
    for numbers in ([1.0, 2.0], [2.0, 1.0], [0.0, 1.0]):
        parameters[root + "weight"] = mi.Float(numbers)
        parameters[root + "model_0.sigma"] = mi.Float(numbers)
        parameters.update()
        hashes.add(largest_kernel(lambda: radiance(built, 16, 1))["hash"])
    assert len(hashes) == 1


def test_components_nest_in_every_variant_also_after_others() -> None:
    scene = {"type": "transmittance_mixture", "a": {"type": "transmittance_linear", "b": 2.0}}
    for variant in ("llvm_ad_rgb", "llvm_ad_spectral", "llvm_ad_rgb", "llvm_ad_mono"):
        mi.set_variant(variant)
        assert float(mi.load_dict(scene).model.sigma_bar[0]) == 0.5
        assert len(mi.load_dict({"type": "transmittance_mixture"}).model.models) == 2
