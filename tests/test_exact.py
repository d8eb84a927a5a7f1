"""nonexp_volpath against exact results, for every model.

Without --full models are rendered on one example of each kind (``build.RENDERED``), with --quick on
one example (``build.QUICK``); in costly tests on one example and on those of two models.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from build import (
    DRAWN,
    FURNACE,
    MODELS,
    NO_ROULETTE,
    QUICK,
    RENDERED,
    SHUTTER,
    Case,
    ball,
    beam,
    box,
    heavy_tailed,
    law,
    medium,
    model_id,
    orthographic,
    perspective,
    recorder,
    scene,
    square_film,
    stock,
)
from drjit.llvm import Float64
from measure import assert_mean, assert_same, assert_share, passes, radiance
from scipy import stats
from tiers import THOROUGH, quick, thorough

import nonexp
from nonexp import models
from nonexp.testing import renders
from nonexp.testing.renders import quadrature, unit


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """A test with an argument ``case`` runs on every model."""
    if "case" in metafunc.fixturenames:
        few = getattr(metafunc.function, "few_laws", False)
        cases = QUICK if few else RENDERED
        cases = MODELS if metafunc.config.getoption("--full") else cases
        chosen = [case for case in QUICK if not few or case[0] in FEW]
        metafunc.parametrize("case", quick(cases, chosen.__contains__), ids=model_id)


FEW = ("linear", "gamma")
"""An atom, and the heaviest tail."""


def on_few_laws(test: Any) -> Any:
    """A costly test runs on one example of each model, with --quick on few models only."""
    test.few_laws = True
    return test


def values(function: Callable[[Any], Any], tau: Any) -> Any:
    """A model's function, in double precision."""
    return np.array(function(Float64(np.ravel(tau)))).reshape(np.shape(tau))


# ------------------------------------------------------------------------------- transmittance


def test_share_of_light_that_crosses_is_ff(case: Case) -> None:
    """Counted escapes of 2^18 single rays through the middle of an absorbing ball."""
    renders.share_that_crosses(law(case))


@on_few_laws
def test_absorbing_ball_seen_from_afar(case: Case) -> None:
    """Mean transmittance over the disc: (1/2R^2) times the integral of ff(t) t over [0, 2R]."""
    model = law(case)
    radius, sigma_t = 0.85, unit(model)
    inside = medium(*case, sigma_t=sigma_t, albedo=0.0)
    parts = {"ball": ball(inside, radius=radius), "sky": FURNACE}
    samples = radiance(scene(sensor=orthographic(radius), **parts), 2**18, 4)
    tau, weight = quadrature(model, 0, 2 * radius * sigma_t)
    chords = np.dot(weight, values(model.ff, tau) * tau) / sigma_t**2
    # The film is a square: 1 - pi/4 of it looks past the ball.
    expected = 1 - math.pi / 4 + math.pi / 4 * chords / (2 * radius**2)
    assert_mean(samples, expected, 0.03)


@pytest.mark.parametrize("connecting", [True, False], ids=["shadow rays", "flights"])
def test_single_scattering_in_a_ball(case: Case, connecting: bool, effort: int) -> None:
    """A ray through the middle, two flights: ff + c/2 int fp(s) int pf(exit(s, mu)) dmu ds.

    With connections pf is evaluated along shadow rays; without, flights from particles escape
    with that probability.
    """
    got, expected = renders.single_scattering(law(case), connecting, 2**11 * effort)
    assert_mean(got, expected, 0.02 / effort**0.5)


@on_few_laws
@pytest.mark.parametrize("mu", [(1.0, 0.5), (0.3, 0.8)])
def test_single_scattering_from_a_half_space(case: Case, mu: tuple[float, float]) -> None:
    """BRDF c sigma_bar/(4 pi u v) times the integral of pf(z/u) pf(z/v) over depths z."""
    model = law(case)
    if not model.sigma_bar:
        pytest.skip("nothing collides")
    (v, u), albedo = mu, 0.7
    camera = orthographic(1e-3, side=(math.sqrt(1 - v**2), 0, v))
    sun = {"type": "directional", "direction": [math.sqrt(1 - u**2), 0.0, -u]}
    inside = medium(*case, sigma_t=10 * unit(model), albedo=albedo)
    integrator = {"type": "nonexp_volpath", "max_depth": 2}
    fog = box(inside, [-40, -40, -80], [40, 40, 0])
    samples = radiance(scene(integrator, sensor=camera, fog=fog, sun=sun), 2**18, 22)

    z, weight = quadrature(model, 0, *np.geomspace(1e-2, 1e4, 20) * unit(model), units=mu)
    integral = np.dot(weight, values(model.pf, z / u) * values(model.pf, z / v))
    expected = albedo * float(model.sigma_bar) / (4 * math.pi * v) * integral
    # Close below the surface one shadow ray in 10^4 misses it, by Embree's rounding.
    assert_mean(samples, expected, 0.03, rounding=1e-4)


# ------------------------------------------------------------------------------- many collisions


@on_few_laws
@pytest.mark.parametrize("boundary", ["null", "dielectric"])
def test_white_furnace_without_connections_is_exact(case: Case, boundary: str) -> None:
    samples = renders.exact_furnace(law(case), boundary)
    # A refraction in and one out round twice each; ten internal reflections add no more.
    np.testing.assert_allclose(samples, 1, rtol=0 if boundary == "null" else 2e-6)


@on_few_laws
def test_white_furnace_with_connections_and_roulette(case: Case) -> None:
    renders.white_furnace(law(case))


def collisions(case: Case, sigma_t: float, count: int, seed: int) -> Any:
    """Collisions per path in a ball lit from everywhere, read off albedo 1/2: L = 2^-n."""
    inside = medium(*case, sigma_t=sigma_t, albedo=0.5, sample_emitters=False)
    parts = {"sensor": orthographic(1.0), "ball": ball(inside), "sky": FURNACE}
    samples = radiance(scene(NO_ROULETTE, **parts), count, seed)
    assert np.all(samples > 0)
    n = -np.log2(samples)
    np.testing.assert_allclose(n, np.round(n), atol=1e-5)
    return np.round(n)


def test_mean_number_of_collisions(case: Case, effort: int) -> None:
    """sigma_bar 4V/S per ray that enters: 4R/3 mean extinctions, whatever the law."""
    model = law(case)
    if not model.sigma_bar:
        pytest.skip("nothing collides")
    n = collisions(case, 1.5 * unit(model), 2**17 * effort, 8)
    assert_mean(n, math.pi / 4 * 1.5 * 4 / 3, 0.05 / effort**0.5)


@pytest.mark.thorough
@on_few_laws
def test_collisions_spread_evenly_over_any_body_lit_from_everywhere(
    case: Case, effort: int
) -> None:
    """A part of volume V sees sigma_bar 4V/S collisions per ray that enters: path length 4V/S."""
    model = law(case)
    if not model.sigma_bar:
        pytest.skip("nothing collides")
    phase = recorder(lambda p: dr.all(abs(p) < 0.3), lambda p: dr.all(p > 0.2))
    settings = {"albedo": 1.0, "sample_emitters": False, "phase": phase}
    inside = medium(*case, sigma_t=1.5 * unit(model), **settings)
    shell = {
        "type": "sphere",
        "radius": 1.0,
        "flip_normals": True,
        "bsdf": {"type": "null"},
        "sensor": {"type": "irradiancemeter", "film": square_film(1), **SHUTTER},
    }
    built = scene(
        # One path in 10^7 slips out through an edge of the cube and would collide for ever.
        {**NO_ROULETTE, "max_depth": 1000},
        body=box(inside, [-0.5] * 3, [0.5] * 3),
        shell=shell,
        sky=FURNACE,
    )
    count = 2**19 * effort
    radiance(built, count, 60)
    for sums, volume in zip(phase.sums(), [1.0, 0.6**3, 0.3**3], strict=True):
        expected = 1.5 * 4 * volume / (4 * math.pi)  # per ray from the shell, of surface 4 pi
        assert_mean(sums / (count / sums.size), expected, 0.1 / (volume * effort) ** 0.5)


@on_few_laws
def test_positions_of_the_first_collisions_from_a_fixed_point(case: Case, effort: int) -> None:
    """Directions are isotropic, so characteristic functions multiply and squares of flights add.

    With k in units of the mean free path, E[sinc(k r_n)] = F P^(n-1), where F and P are the means
    of sinc(k X) over the first and the following flights (flights that never end count 0), and
    E[r_n^2] = E[X_1^2] + (n-1) E[X^2].
    """
    model = law(case)
    if not model.sigma_bar:
        pytest.skip("nothing collides")
    last, k = 4, 1.3

    def sinc(p: Any) -> Any:
        x = k * dr.norm(p)
        return dr.select(x < 1e-3, 1.0, dr.select(x < 1e6, dr.sin(x) / x, 0.0))

    phase = recorder(sinc, dr.squared_norm)
    fog = medium(*case, sigma_t=unit(model), albedo=1.0, sample_emitters=False, phase=phase)
    camera = {"near_clip": 1e-6, "far_clip": 1e30, "medium": fog, **SHUTTER}
    built = scene(
        {**NO_ROULETTE, "max_depth": last + 1},
        sensor={**perspective([0, 0, 0], [0, 0, 1]), **camera},
        sky=FURNACE,
    )
    count = 2**18 * effort
    radiance(built, count, 61)
    n, waves, squares = phase.sums() / (count / phase.sums().shape[1])

    start = 1 - float(model.ff(dr.inf))
    assert_mean(n, start * last, 0.05)

    # Means over flights from survival functions: E[w] = w(0) + the integral of w' times them.
    def means(tau: Any, weight: Any, derivative: Any) -> tuple[float, float]:
        ending = values(model.ff, tau) - float(model.ff(dr.inf))
        return np.dot(weight, ending * derivative), np.dot(
            weight, values(model.pf, tau) * derivative
        )

    tau, weight = quadrature(model, *np.linspace(0, 300, 1001) * unit(model))
    x = k * tau / unit(model)
    first, rest = means(tau, weight, (np.cos(x) - np.sin(x) / x) / tau)
    first, rest = start + first, 1 + rest
    assert_mean(waves, first * sum(rest**i for i in range(last)), 0.1)
    if not heavy_tailed(model):
        tau, weight = quadrature(model, 0, *np.geomspace(1e-3, 1e6, 40) * unit(model))
        first, rest = means(tau, weight, 2 * tau / unit(model) ** 2)
        expected = last * first + start * last * (last - 1) / 2 * rest
        assert_mean(squares, expected, 0.3 / effort**0.5)


def test_linear_ball_smaller_than_its_flight_scatters_once_at_most() -> None:
    """A particle flies b: out of any ball with 2R <= b. Absorbed: (1-c) 4R/3b over the disc."""
    n = collisions(("linear", {"b": 2.0}), 1.0, 2**18, 9)
    assert set(np.unique(n)) == {0.0, 1.0}
    assert_mean(n, math.pi / 4 * 4 / (3 * 2.0), 0.03)


@pytest.mark.parametrize("albedo", [0.1, 0.2, 0.3])
def test_hardly_any_light_crosses_a_thousand_mean_free_paths(albedo: float) -> None:
    """Paths from the middle of a ball that wander without a surface end by absorption."""
    inside = medium("gamma", {"alpha": 2.0}, sigma_t=1000.0, albedo=albedo)
    parts = {
        "sensor": {**perspective([0, 0, 0], [0, 0, 1]), "medium": {"type": "ref", "id": "fog"}},
        "fog": {**inside, "id": "fog"},
        "ball": ball({"type": "ref", "id": "fog"}),
        "light": {
            "type": "sphere",
            "radius": 50.0,
            "flip_normals": True,
            "emitter": {"type": "area", "radiance": 1.0},
        },
    }
    samples = radiance(scene(**parts), 2**12, 10)
    assert np.mean(samples) < 1e-2


@THOROUGH
@pytest.mark.parametrize("rr_depth", [2, 1_000_000])
def test_derivative_by_albedo_also_through_roulette(rr_depth: int) -> None:
    """Radiance is the mean of c^n over the number of collisions, its derivative that of n c^(n-1);
    n is known, path by path, from albedo 1/2. Longer paths, whose loops Dr.Jit compiles step by
    step, are left out. Finds a bias of 3.5 %, 7 standard errors, with a probability above 0.9."""
    case, sigma_t, albedo, longest = ("gamma", {"alpha": 2.0}), 4.0, 0.9, 8
    n = collisions(case, sigma_t, 2**18, 50)
    expected = np.where(n < longest, n * albedo ** (n - 1), 0)
    assert 0.02 < np.mean(n >= longest) < 0.2

    inside = medium(*case, sigma_t=sigma_t, albedo=albedo, sample_emitters=False)
    parts = {"sensor": orthographic(1.0), "ball": ball(inside), "sky": FURNACE}
    integrator = {"type": "nonexp_volpath", "rr_depth": rr_depth, "max_depth": longest}
    built = scene(integrator, **parts)
    parameters = mi.traverse(built)
    key = "ball.interior_medium.albedo.value.value"
    dr.enable_grad(parameters[key])
    parameters.update()
    slopes = []
    for seed in range(32):
        image = mi.render(built, parameters, spp=64, seed=seed)
        dr.forward(parameters[key])
        slopes.append(np.array(dr.grad(image)).mean())
    error = np.hypot(stats.sem(slopes), stats.sem(expected.ravel()))
    assert error < 0.005 * expected.mean()
    assert abs(np.mean(slopes) - expected.mean()) < 5 * error


# ----------------------------------------------------------------------------- diffusive transport


ERLANG = ("erlang", {"k": 2, "rate": 1.0})
"""Transport by this law is exactly diffusive: closed forms with s = sqrt(1 - albedo)."""


@pytest.mark.parametrize(
    ("albedo", "absorbed"), [(0.5, 0.29863205), (0.9, 0.06514779), (0.99, 0.00665115)]
)
@pytest.mark.parametrize("connecting", [True, False], ids=["shadow rays", "flights"])
def test_erlang_ball(albedo: float, absorbed: float, connecting: bool, effort: int) -> None:
    """Absorption 2(1+R)(sR cosh sR - sinh sR) / (R^2 (sinh sR + s cosh sR)), here with R = 1."""
    inside = medium(*ERLANG, sigma_t=1.0, albedo=albedo, sample_emitters=connecting)
    parts = {"sensor": orthographic(1.0), "ball": ball(inside), "sky": FURNACE}
    lost = 1 - passes(scene(NO_ROULETTE, **parts), 2**13 * effort, 23)
    within = 0.5 if connecting and albedo > 0.9 else 0.1
    assert_mean(lost, math.pi / 4 * absorbed, within / effort**0.5)


def slab(inside: Any, thickness: float, lit_from: str) -> Any:
    """A slab, a detector for all light that leaves its top, a white sky above or below it."""
    wide = 1e3 * thickness
    turn = mi.ScalarTransform4f().translate([0, 0, 0.01 * thickness]).rotate([1, 0, 0], 180)
    floor = mi.ScalarTransform4f().translate([0, 0, -2 * thickness]).scale(10 * wide)
    light = {"type": "area", "radiance": 1.0 if lit_from == "below" else 0.0}
    parts = {"sky": FURNACE} if lit_from == "above" else {}
    return scene(
        NO_ROULETTE,
        meter={
            "type": "rectangle",
            "to_world": turn.scale(1e-3 * thickness),
            "bsdf": {"type": "null"},
            "sensor": {"type": "irradiancemeter", "film": square_film(1)},
        },
        slab=box(inside, [-wide, -wide, -thickness], [wide, wide, 0]),
        floor={"type": "rectangle", "to_world": floor, "emitter": light},
        **parts,
    )


@pytest.mark.parametrize(
    ("albedo", "thickness"), [(0.5, 0.6), *thorough((0.9, 3.0), (1.0, 5.0), several=True)]
)
def test_erlang_slab_under_a_white_sky(albedo: float, thickness: float, effort: int) -> None:
    """Reflected c (1 - E^2)/D and transmitted 4 s E/D, with E = exp(-sL) and
    D = (1+s)^2 - (1-s)^2 E^2; L/(L+2) and 2/(L+2) where nothing is absorbed."""
    if albedo == 1:
        reflected, transmitted = thickness / (thickness + 2), 2 / (thickness + 2)
    else:
        s = math.sqrt(1 - albedo)
        e = math.exp(-s * thickness)
        d = (1 + s) ** 2 - ((1 - s) * e) ** 2
        reflected, transmitted = albedo * (1 - e**2) / d, 4 * s * e / d
    inside = medium(*ERLANG, sigma_t=1.0, albedo=albedo, sample_emitters=False)
    for lit_from, expected in (("above", reflected), ("below", transmitted)):
        samples = radiance(slab(inside, thickness, lit_from), 2**17 * effort, 24)
        assert_mean(samples, math.pi * expected, 0.06 / effort**0.5)


@pytest.mark.thorough
@pytest.mark.parametrize("albedo", [*thorough(0.5), 0.9])
@pytest.mark.parametrize("mu", [*thorough(1.0), 0.4, *thorough(None)])
def test_erlang_half_space(albedo: float, mu: float | None, effort: int) -> None:
    """Albedo (1-s)(2+s mu) / 2(1+s mu)^2 of a beam, (1-s)/(1+s) under a white sky."""
    s = math.sqrt(1 - albedo)
    inside = medium(*ERLANG, sigma_t=1.0, albedo=albedo, sample_emitters=False)
    if mu is None:
        built = slab(inside, 1e3, "above")
        expected = math.pi * (1 - s) / (1 + s)
    else:
        camera = orthographic(1e-3, side=(math.sqrt(1 - mu**2), 0, mu))
        fog = box(inside, [-1e3, -1e3, -1e3], [1e3, 1e3, 0])
        built = scene(NO_ROULETTE, sensor=camera, fog=fog, sky=FURNACE)
        expected = (1 - s) * (2 + s * mu) / (2 * (1 + s * mu) ** 2)
    assert_mean(radiance(built, 2**14 * effort, 25), expected, 0.08 / effort**0.5)


# ------------------------------------------------------------------------------- ensembles


def extinctions(case: Case) -> tuple[Any, Any]:
    """Values and weights that stand for the extinctions whose mean of exponentials a law is."""
    key, given = case
    if "sigma" in given or key == "exponential_mixture":
        model = law(case)
        sigma, weight = np.array(model.sigma), np.array(model.weight or [1.0] * len(model.sigma))
    else:
        if key == "gamma":
            distribution = stats.gamma(given["alpha"], scale=1 / given["alpha"])
        else:
            distribution = getattr(stats, given["law"])(*given["args"])
        u, weight = np.polynomial.legendre.leggauss(16)
        sigma = distribution.ppf((1 + u) / 2)
    return sigma, weight / weight.sum()


ENSEMBLES = [("gamma", {"alpha": 0.7}), ("gamma", {"alpha": 2.0})] + [
    case for case in MODELS if case[0] in ("ensemble", "exponential_mixture")
]


@pytest.mark.thorough
@pytest.mark.parametrize("average", quick(ENSEMBLES, ENSEMBLES[:1].__contains__), ids=model_id)
def test_law_is_the_average_of_exponential_media(average: Case, effort: int) -> None:
    """Absorbing ball crossed once: the mean of Mitsuba's exponential renders, extinction drawn from
    the law of extinction (its quadrature nodes, so that nothing is drawn twice)."""

    def build(inside: Any, integrator: str) -> Any:
        return scene(
            integrator, sensor=perspective([0, 0, 4], [0, 0, 0]), ball=ball(inside), sky=FURNACE
        )

    sigma, weight = extinctions(average)
    np.testing.assert_allclose(
        np.exp(-sigma * 1.8) @ weight, float(law(average).ff(1.8)), rtol=1e-3
    )
    theirs = build(stock(sigma_t=1.0, albedo=0.0), "volpath")
    parameters = mi.traverse(theirs)
    mean = 0
    for i, (value, share) in enumerate(zip(sigma, weight, strict=True)):
        parameters["ball.interior_medium.sigma_t.value.value"] = max(0.9 * value, 1e-9)
        parameters.update()
        mean += share * passes(theirs, 16 * effort, 100 + i, 6)
    ours = build(medium(*average, sigma_t=0.9, albedo=0.0), "nonexp_volpath")
    assert_same(passes(ours, 256 * effort, 11, 6), mean, 0.02 / effort**0.5)


# ------------------------------------------------------------------------------- laws that coincide


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("one", "other"),
    [
        (("power", {"n": 1.0, "b": 1.5}), ("linear", {"b": 1.5})),
        *thorough(
            (("power", {"n": 2.0}), ("quadratic", {})),
            (("erlang", {"k": 1}), ("exponential", {})),
            (("hard_rod", {"d": 0.0, "l": 1.0}), ("exponential", {})),
            (("hard_rod", {"d": 1.0, "l": 1e-6}), ("linear", {"b": 1.0})),
            (("pulse", {"a": 0.5, "b": 1.5, "n": 1}), ("linear", {"b": 1.0})),
            (("pulse", {"a": 0.0, "b": 2.0, "n": 1000}), ("quadratic", {})),
            (("gamma", {"alpha": 1e6}), ("exponential", {})),
            (("davis_weinstein", {"h": 1.0, "c": 3.0}), ("gamma", {"alpha": 1 / 9})),
            (("ensemble", {"law": "gamma", "args": (2.0, 0.0, 0.5)}), ("gamma", {"alpha": 2.0})),
            (("exponential_mixture", {"sigma": (1.0, 1.0)}), ("exponential", {})),
            several=True,
        ),
    ],
    ids=model_id,
)
def test_laws_that_coincide_render_alike(one: Case, other: Case, effort: int) -> None:
    """Multiple scattering, with connections and without."""
    place = mi.ScalarTransform4f().translate([0, 3, 0])
    lamp = {"type": "sphere", "to_world": place, "emitter": {"type": "area", "radiance": 10.0}}
    for connecting in (True, False):
        settings = {"sigma_t": 1.7, "albedo": 0.9, "sample_emitters": connecting}
        images = [
            passes(
                scene(
                    sensor=orthographic(1.0),
                    ball=ball(medium(*case, **settings)),
                    lamp=lamp,
                    sky={"type": "constant", "radiance": 0.3},
                ),
                256 * effort,
                seed,
                4,
            )
            for seed, case in ((26, one), (27, other))
        ]
        assert_same(*images, 0.1 / effort**0.5)


# ------------------------------------------------------------------------------- reciprocity


@pytest.mark.thorough
@on_few_laws
def test_exchanging_light_and_detector_changes_nothing(case: Case, effort: int) -> None:
    """One plate stands in the medium, one outside, at other distances and angles."""
    forward, backward = renders.exchange(law(case), 2**13 * effort)
    assert_same(forward, backward, 0.15 / effort**0.5)


# ------------------------------------------------------------------------------- null surfaces


def cut(case: Case, cuts: bool, **kw: Any) -> Any:
    """A ball of medium, with or without invisible surfaces inside it."""
    fog = {"type": "ref", "id": "fog"}
    parts: dict[str, Any] = {
        "fog": {**medium(*case, **kw), "id": "fog"},
        "ball": ball(fog),
        "sensor": orthographic(1.0),
        "sky": {"type": "constant", "radiance": 0.2},
        "lamp": {"type": "point", "position": [0.5, 2.0, 1.0], "intensity": 10.0},
    }
    if cuts:
        place = mi.ScalarTransform4f()
        parts["same medium on both sides"] = {
            "type": "sphere",
            "radius": 0.6,
            "bsdf": {"type": "null"},
            "interior": fog,
            "exterior": fog,
        }
        parts["no medium named"] = {
            "type": "rectangle",
            "to_world": place.translate([0, 0.1, 0]).rotate([1, 0, 0], 70).scale(0.5),
            "bsdf": {"type": "mask", "opacity": 0.0, "nested": {"type": "diffuse"}},
        }
    return parts


@on_few_laws
def test_invisible_surface_inside_a_medium_changes_nothing(case: Case, effort: int) -> None:
    settings = {"sigma_t": 1.5 * unit(law(case)), "albedo": 0.8}
    whole = passes(scene(**cut(case, False, **settings)), 64 * effort, 14, 3)
    parts = passes(scene(**cut(case, True, **settings)), 64 * effort, 15, 3)
    assert_same(whole, parts, 0.06 / effort**0.5)


def test_linear_slab_of_depth_one_is_opaque_however_cut() -> None:
    """The classical mistake: two halves of ff = 1/2 each let a quarter through."""
    case = ("linear", {"b": 1.0})
    for connecting in (True, False):
        parts = cut(case, True, sigma_t=0.501, albedo=0.0, sample_emitters=connecting)
        samples = radiance(scene(**{**parts, "sensor": beam()}), 2**16, 16)
        assert np.all(samples == 0)
    # The lamp's shadow rays from a floor behind the ball, through all boundaries.
    parts = cut(case, True, sigma_t=0.501, albedo=0.0)
    parts["lamp"] = {"type": "point", "position": [0, 0, 3], "intensity": 10.0}
    parts["floor"] = {"type": "rectangle", "to_world": mi.ScalarTransform4f().translate([0, 0, -2])}
    parts["sensor"] = perspective([0, 0, -1.5], [0, 0, -2], 1)
    del parts["sky"]
    assert np.all(radiance(scene(**parts), 2**12, 17) == 0)


# ------------------------------------------------------------------------------- unbounded media


@on_few_laws
def test_nothing_arrives_from_infinity_through_an_unbounded_medium(case: Case) -> None:
    """Neither by escape nor by connection, from a floor or from a collision; but in vacuum."""
    fog = {"type": "ref", "id": "fog"}
    place = mi.ScalarTransform4f()
    for sky in (FURNACE, {"type": "directional", "direction": [0, 0, -1]}):
        built = scene(
            fog={**medium(*case, sigma_t=0.1, albedo=0.5), "id": "fog"},
            sensor={**perspective([0, 0, 4], [0, 0, 0], 90), "medium": fog, "far_clip": 1e30},
            floor={"type": "rectangle", "to_world": place.scale(0.5), "bsdf": {"type": "diffuse"}},
            sky=sky,
        )
        lit = radiance(built, 2**12, 30).max() > 0
        assert lit == (law(case).ff(dr.inf) > 0)


@on_few_laws
def test_a_hidden_emitter_in_the_medium_hides_nothing(case: Case) -> None:
    """The flight goes on behind it, with the depth up to it already used."""
    model = law(case)
    fog = {"type": "ref", "id": "fog"}
    depth = 0.7 * unit(model)
    lamp, wall = (mi.ScalarTransform4f().translate([0, 0, z]) for z in (-1, -2))
    light = {"type": "area", "radiance": 1.0}
    built = scene(
        {**DRAWN, "hide_emitters": True},
        fog={**medium(*case, sigma_t=depth / 3, albedo=0.0), "id": "fog"},
        sensor={**orthographic(1e-4, 1.0), "near_clip": 1e-5, "medium": fog},
        lamp={"type": "rectangle", "to_world": lamp, "emitter": light, "bsdf": {"type": "diffuse"}},
        wall={"type": "rectangle", "to_world": wall, "bsdf": {"type": "diffuse"}},
        sun={"type": "point", "position": [0, 0, -1.5], "intensity": 1.0},
    )
    arrive = float(model.ff(depth))
    samples = radiance(built, 2**17, 31)
    # The wall connects to one of two emitters, and finds the lamp's back half of the time.
    assert_share((samples > 0).astype(float), arrive / 2)
    expected = 2 * 0.5 / math.pi * 0.5**-2 * float(model.ff(depth / 6))
    np.testing.assert_allclose(samples[samples > 0], expected, rtol=1e-4)


# ------------------------------------------------------------------------------- several media


def row_of_balls(depth: float, **kw: Any) -> dict[str, Any]:
    """Every model in a ball of its own, along the z axis; ``depth`` in mean free paths."""
    place = mi.ScalarTransform4f()
    return {
        f"ball {i}": {
            **ball(medium(*case, sigma_t=depth / 0.8 * unit(law(case)), **kw), radius=0.4),
            "to_world": place.translate([0, 0, i - len(RENDERED) / 2]),
        }
        for i, case in enumerate(RENDERED)
    }


@pytest.mark.thorough
@pytest.mark.parametrize("light", ["flights", "shadow rays"])
def test_transmittances_of_media_in_a_row_multiply(light: str) -> None:
    """Each stretch of one medium begins anew at a fixed point: the product of all ff."""
    depth, end = 0.1, len(RENDERED) / 2 + 2
    expected = math.prod(float(law(case).ff(depth * unit(law(case)))) for case in RENDERED)
    parts = row_of_balls(depth, albedo=0.0)
    if light == "flights":
        samples = radiance(scene(DRAWN, sensor=beam(end), sky=FURNACE, **parts), 2**19, 18)
        assert set(np.unique(samples)) <= {0.0, 1.0}
        assert_mean(samples, expected, 0.05)
    else:
        place = mi.ScalarTransform4f().translate([0, 0, -end])
        built = scene(
            sensor=perspective([0, 0, 0.5 - end], [0, 0, -end], 0.01),
            floor={"type": "rectangle", "to_world": place, "bsdf": {"type": "diffuse"}},
            lamp={"type": "directional", "direction": [0, 0, -1], "irradiance": 1.0},
            **parts,
        )
        samples = radiance(built, 2**10, 18)
        np.testing.assert_allclose(samples, expected * 0.5 / math.pi, rtol=1e-3)


def test_white_furnace_with_several_media() -> None:
    """Also with those far away: rays enter whatever ball they meet next."""
    middle = perspective([3, 2, 2], [0, 0, 0], 90)
    parts = row_of_balls(2.0, albedo=1.0, sample_emitters=False)
    built = scene(NO_ROULETTE, sensor=middle, sky=FURNACE, **parts)
    np.testing.assert_array_equal(radiance(built, 2**15, 19), 1)


@pytest.mark.parametrize(
    ("outer", "inner"), [("erlang", "linear"), ("linear", "gamma"), ("gamma", "quadratic")]
)
def test_collisions_spread_evenly_over_nested_media(outer: str, inner: str, effort: int) -> None:
    """Each part of volume V sees sigma_bar 4V/S collisions: a flight that crosses a boundary begins
    anew at a fixed point, whatever it was before."""
    phases = [recorder(), recorder()]
    shells = [
        {
            "id": f"{name} {i}",
            **medium(name, sigma_t=1.5, albedo=1.0, sample_emitters=False, phase=p),
        }
        for i, (name, p) in enumerate(zip((outer, inner), phases, strict=True))
    ]
    out, core = ({"type": "ref", "id": shell["id"]} for shell in shells)
    built = scene(
        NO_ROULETTE,
        **{shell["id"]: shell for shell in shells},
        sensor={**orthographic(1.0), **SHUTTER},
        ball=ball(out),
        core={**ball(core, radius=0.6), "exterior": out},
        sky=FURNACE,
    )
    count = 2**18 * effort
    np.testing.assert_array_equal(radiance(built, count, 62), 1)
    for phase, volume in zip(phases, (1 - 0.6**3, 0.6**3), strict=True):
        sums = phase.sums()[0] / (count / 64)
        assert_mean(sums, math.pi / 4 * 1.5 * 4 / 3 * volume, 0.1 / effort**0.5)


# ------------------------------------------------------------------------------- scale


HALF_SPACE = [(0.5, 0.115225878, 0.146544381), (0.9, 0.414947479, 0.478024489)]
"""Classical half-space, isotropic scattering: albedo, at normal incidence, under a white sky."""


@on_few_laws
@pytest.mark.parametrize("radius", [0.01, 1.0, 1e4])
def test_shadow_ray_through_a_ball_at_any_scale(case: Case, radius: float) -> None:
    """Exact to float32 although rays start off the surface by 1e-4 and more."""
    model = law(case)
    depth = 0.6 * unit(model)
    place = mi.ScalarTransform4f()
    floor = place.translate([0, 0, -3 * radius]).scale(radius)
    built = scene(
        sensor={
            **perspective([0, 0, -2 * radius], [0, 0, -3 * radius], 0.01),
            "near_clip": 0.1 * radius,
            "far_clip": 10 * radius,
        },
        ball=ball(medium(*case, sigma_t=depth / (2 * radius), albedo=0.0), radius=radius),
        floor={"type": "rectangle", "to_world": floor, "bsdf": {"type": "diffuse"}},
        lamp={"type": "directional", "direction": [0, 0, -1], "irradiance": 1.0},
    )
    expected = float(model.ff(depth)) * 0.5 / math.pi
    np.testing.assert_allclose(radiance(built, 16, 20), expected, rtol=2e-5, atol=1e-12)


@pytest.mark.parametrize("radius", [0.004, 1e4])
def test_flights_through_a_ball_at_any_scale(radius: float) -> None:
    """A ray starts 1e-4 or more inside the surface; its flight starts on it."""
    inside = medium("quadratic", {}, sigma_t=0.5 / radius, albedo=0.0)
    camera = orthographic(1e-4 * radius, 2 * radius)
    built = scene(DRAWN, sensor=camera, ball=ball(inside, radius=radius), sky=FURNACE)
    assert_mean(radiance(built, 2**21, 21), 0.25, 0.01)


@pytest.mark.parametrize("sigma_t", [1e3, *thorough(3e3)])
@pytest.mark.parametrize(("albedo", "normal", "sky"), HALF_SPACE)
def test_dense_ball_is_a_half_space(
    sigma_t: float, albedo: float, normal: float, sky: float
) -> None:
    """Although a mean free path is as short as the distance by which rays stand off surfaces.

    A beam in the middle finds the albedo at normal incidence, the whole disc the white-sky one.
    """
    parts = {"ball": ball(medium(sigma_t=sigma_t, albedo=albedo)), "sky": FURNACE}
    assert_mean(radiance(scene(sensor=beam(), **parts), 2**20, 40), normal, 0.015)
    disc = radiance(scene(sensor=orthographic(1.0), **parts), 2**20, 41)
    assert_mean(disc, 1 - math.pi / 4 * (1 - sky), 0.015)


def test_flight_through_many_invisible_surfaces_keeps_its_length() -> None:
    """Twenty crossings, at each of which the ray starts anew 1e-4 further on."""
    radius = 0.05
    fog = {"type": "ref", "id": "fog"}
    shells = {
        f"shell {i}": {**ball(fog, radius=radius * (i + 1) / 11), "exterior": fog}
        for i in range(10)
    }
    built = scene(
        DRAWN,
        fog={**medium("linear", {"b": 1.0}, sigma_t=0.25 / radius, albedo=0.0), "id": "fog"},
        ball=ball(fog, radius=radius),
        sensor=orthographic(1e-3 * radius, 2 * radius),
        sky=FURNACE,
        **shells,
    )
    assert_mean(radiance(built, 2**20, 41), 0.5, 0.01)


def test_collision_and_surface_at_the_same_distance_is_a_collision() -> None:
    """The survival functions say so: pf(b) = 0 for linear(b)."""

    @dataclasses.dataclass(frozen=True, eq=False)
    class Fixed(nonexp.Transmittance):
        """Every flight is b long, also the first: no admissible law, but an exact tie."""

        b: Any = nonexp.parameter(1.0)
        sigma_bar = 1.0
        ff = pf = pp = lambda self, tau: tau
        sample_f = sample_p = lambda self, draw: self.b

    model = law(("linear", {"b": 1.5}))
    assert (model.pf(1.5), model.pf(np.nextafter(1.5, 0))) == (0, 1)

    place = mi.ScalarTransform4f().translate([0, 0, -1.5])
    wall = {"type": "rectangle", "to_world": place, "emitter": {"type": "area", "radiance": 1.0}}
    ray = mi.RayDifferential3f([0, 0, 0], [0, 0, -1], 0.0, [])
    distance = np.float32(scene(wall=wall).ray_intersect(ray).t[0])
    models.register(Fixed, "fixed")
    try:
        for depth, seen in ((distance, 0), (np.nextafter(distance, np.float32(2)), 1)):
            fog = mi.load_dict(medium("fixed", {"b": float(depth)}, albedo=0.0))
            sampler = mi.load_dict({"type": "independent"})
            sampler.seed(0, 1)
            integrator = mi.load_dict(DRAWN)
            light, _, _ = integrator.sample(scene(wall=wall), sampler, ray, fog)
            assert light[0][0] == seen
    finally:
        del models.registry["fixed"]
