"""nonexp_volpath against exact results, for every model."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from build import (
    FURNACE,
    MODELS,
    NO_ROULETTE,
    ball,
    beam,
    medium,
    model_id,
    orthographic,
    perspective,
    scene,
    square_film,
    stock,
)
from measure import FALSE_ALARM, assert_mean, assert_same, passes, radiance
from scipy import integrate, special, stats

import nonexp
from nonexp import models

every_model = pytest.mark.parametrize("case", MODELS, ids=model_id)


def law(case: tuple[str, dict[str, Any]]) -> Any:
    return models.create(case[0], **case[1])


def breaks(model: Any, low: float, high: float) -> list[float] | None:
    """Where the model's functions jump, for numerical quadrature."""
    where = [float(tau) for tau, _ in model.atoms]
    if hasattr(model, "b"):
        where.append(float(model.b))
    return [tau for tau in where if low < tau < high] or None


# ------------------------------------------------------------------------------- transmittance


@every_model
def test_share_of_light_that_crosses_is_ff(case: Any) -> None:
    """Counted escapes of 2^18 single rays through the middle of an absorbing ball."""
    model = law(case)
    for depth in (0.1, 1.3):
        inside = medium(*case, sigma_t=depth / 2, albedo=0.0)
        samples = radiance(scene(sensor=beam(), ball=ball(inside), sky=FURNACE), 2**18, 3)
        assert set(np.unique(samples)) <= {0.0, 1.0}
        crossing = int(samples.sum())
        expected = min(float(model.ff(depth)), 1.0)
        assert stats.binomtest(crossing, samples.size, expected).pvalue > FALSE_ALARM


@every_model
def test_absorbing_ball_seen_from_afar(case: Any) -> None:
    """Mean transmittance over the disc: (1/2R^2) times the integral of ff(t) t over [0, 2R]."""
    model = law(case)
    radius = 1.7
    inside = medium(*case, sigma_t=1.0, albedo=0.0)
    parts = {"ball": ball(inside, radius=radius), "sky": FURNACE}
    samples = radiance(scene(sensor=orthographic(radius), **parts), 2**18, 4)
    chords, _ = integrate.quad(
        lambda t: float(model.ff(t)) * t, 0, 2 * radius, points=breaks(model, 0, 2 * radius)
    )
    # The film is a square: 1 - pi/4 of it looks past the ball.
    expected = 1 - math.pi / 4 + math.pi / 4 * chords / (2 * radius**2)
    assert_mean(samples, expected, 0.03)


@every_model
@pytest.mark.parametrize("connecting", [True, False], ids=["shadow rays", "flights"])
def test_single_scattering_in_a_ball(case: Any, connecting: bool, effort: int) -> None:
    """A ray through the middle, two flights: ff + c/2 int fp(s) int pf(exit(s, mu)) dmu ds.

    With connections pf is evaluated along shadow rays; without, flights from particles escape
    with that probability.
    """
    model = law(case)
    radius, sigma_t, albedo = 1.0, 1.3, 0.8
    inside = medium(*case, sigma_t=sigma_t, albedo=albedo, sample_emitters=connecting)
    integrator = {"type": "nonexp_volpath", "max_depth": 2}
    parts = {"sensor": beam(), "ball": ball(inside, radius=radius), "sky": FURNACE}
    got = passes(scene(integrator, **parts), 2**13 * effort, 5)

    nodes, weights = np.polynomial.legendre.leggauss(400)

    def exits(s: float) -> float:
        r = abs(s - radius)
        length = -r * nodes + np.sqrt(radius**2 - (r**2) * (1 - nodes**2))
        return float(np.dot(weights, [float(model.pf(sigma_t * t)) for t in length]) / 2)

    grid = np.linspace(0, 2 * radius, 801)
    density = [sigma_t * float(model.fp(sigma_t * s)) * exits(s) for s in grid[1:-1]]
    ends = [sigma_t * float(model.fp(sigma_t * s)) * exits(s) for s in (1e-7, 2 * radius - 1e-7)]
    scattered = integrate.trapezoid([ends[0], *density, ends[1]], grid)
    expected = float(model.ff(2 * radius * sigma_t)) + albedo * scattered
    assert_mean(got, expected, 0.02 / effort**0.5)


# ------------------------------------------------------------------------------- many collisions


@every_model
@pytest.mark.parametrize("boundary", ["null", "dielectric"])
def test_white_furnace_without_connections_is_exact(case: Any, boundary: str) -> None:
    inside = medium(*case, sigma_t=3.0, albedo=1.0, sample_emitters=False)
    parts = {"sensor": orthographic(1.1), "ball": ball(inside, boundary), "sky": FURNACE}
    samples = radiance(scene(NO_ROULETTE, **parts), 2**14, 6)
    # A refraction in and one out round twice each; ten internal reflections add no more.
    np.testing.assert_allclose(samples, 1, rtol=0 if boundary == "null" else 2e-6)


@every_model
def test_white_furnace_with_connections_and_roulette(case: Any) -> None:
    sigma_t = 3 / (float(law(case).sigma_bar) or 1)
    inside = medium(*case, sigma_t=sigma_t, albedo=1.0, phase={"type": "hg", "g": 0.5})
    parts = {"sensor": orthographic(1.1), "ball": ball(inside), "sky": FURNACE}
    assert_mean(passes(scene(**parts), 2**10, 7), 1.0, 0.05)


def collisions(case: Any, sigma_t: float, count: int, seed: int) -> Any:
    """Collisions per path in a ball lit from everywhere, read off albedo 1/2: L = 2^-n."""
    inside = medium(*case, sigma_t=sigma_t, albedo=0.5, sample_emitters=False)
    parts = {"sensor": orthographic(1.0), "ball": ball(inside), "sky": FURNACE}
    samples = radiance(scene(NO_ROULETTE, **parts), count, seed)
    assert np.all(samples > 0)
    n = -np.log2(samples)
    np.testing.assert_allclose(n, np.round(n), atol=1e-5)
    return np.round(n)


@every_model
def test_mean_number_of_collisions(case: Any, effort: int) -> None:
    """sigma_bar 4V/S per ray that enters: 4R/3 mean extinctions, whatever the law."""
    model = law(case)
    if not model.sigma_bar:
        pytest.skip("nothing collides")
    sigma_t = 1.5 / float(model.sigma_bar)
    n = collisions(case, sigma_t, 2**17 * effort, 8)
    assert_mean(n, math.pi / 4 * 1.5 * 4 / 3, 0.05 / effort**0.5)


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


@pytest.mark.parametrize("rr_depth", [2, 1_000_000])
def test_derivative_by_albedo_also_through_roulette(rr_depth: int) -> None:
    """Radiance is the mean of c^n over the number of collisions, its derivative that of n c^(n-1);
    n is known, path by path, from albedo 1/2."""
    case, sigma_t, albedo = ("gamma", {"alpha": 2.0}), 4.0, 0.9
    n = collisions(case, sigma_t, 2**18, 50)
    expected = n * albedo ** (n - 1)

    inside = medium(*case, sigma_t=sigma_t, albedo=albedo, sample_emitters=False)
    parts = {"sensor": orthographic(1.0), "ball": ball(inside), "sky": FURNACE}
    built = scene({"type": "nonexp_volpath", "rr_depth": rr_depth}, **parts)
    parameters = mi.traverse(built)
    key = "ball.interior_medium.albedo.value.value"
    dr.enable_grad(parameters[key])
    parameters.update()
    image = mi.render(built, parameters, spp=2048, seed=51)
    dr.forward(parameters[key])
    slopes = np.array(dr.grad(image)).ravel()
    assert np.all(np.isfinite(slopes))
    assert abs(slopes.mean() / expected.mean() - 1) < 0.03


# ------------------------------------------------------------------------------- ensembles


@pytest.mark.parametrize("alpha", [0.7, 2.0])
def test_gamma_is_the_average_of_exponential_media(alpha: float, effort: int) -> None:
    """Absorbing ball crossed once: gamma = mean of Mitsuba's exponential renders, extinction drawn
    from a gamma law (its quadrature nodes, so that nothing is drawn twice)."""

    def build(inside: Any, integrator: str) -> Any:
        return scene(
            integrator, sensor=perspective([0, 0, 4], [0, 0, 0]), ball=ball(inside), sky=FURNACE
        )

    ours = build(medium("gamma", {"alpha": alpha}, sigma_t=0.9, albedo=0.0), "nonexp_volpath")
    nodes, weights = special.roots_genlaguerre(10, alpha - 1)
    weights = weights / weights.sum()
    theirs = build(stock(sigma_t=1.0, albedo=0.0), "volpath")
    parameters = mi.traverse(theirs)
    average = 0
    for i, (node, weight) in enumerate(zip(nodes, weights, strict=True)):
        parameters["ball.interior_medium.sigma_t.value.value"] = 0.9 * node / alpha
        parameters.update()
        average += weight * passes(theirs, 512 * effort, 100 + i, 6)
    assert_same(passes(ours, 2048 * effort, 11, 6), average, 0.02 / effort**0.5)


# ------------------------------------------------------------------------------- reciprocity


def plate(where: list[float], towards: list[float], **kw: Any) -> dict[str, Any]:
    to_world = mi.ScalarTransform4f().look_at(where, towards, [0, 1, 0.1]).scale(0.35)
    black = {"type": "diffuse", "reflectance": 0.0}
    return {"type": "rectangle", "to_world": to_world, "bsdf": black, **kw}


@every_model
def test_exchanging_light_and_detector_changes_nothing(case: Any, effort: int) -> None:
    """One plate stands in the medium, one outside, at other distances and angles."""
    model = law(case)
    sigma_t = 1.2 / (float(model.sigma_bar) or 1.0)
    fog = {"type": "ref", "id": "fog"}
    inner = {"where": [0.2, -0.5, 0.1], "towards": [0.6, 0.6, 0.5]}
    outer = {"where": [0.3, 1.6, 0.4], "towards": [-0.3, 0.0, 0.1]}
    light = {"emitter": {"type": "area", "radiance": 1.0}}

    def meter(**kw: Any) -> dict[str, Any]:
        return {"sensor": {"type": "irradiancemeter", "film": square_film(1), **kw}}

    def flux(inside: dict[str, Any], outside: dict[str, Any], seed: int) -> Any:
        built = scene(
            fog={**medium(*case, sigma_t=sigma_t, albedo=0.9), "id": "fog"},
            ball=ball(fog),
            inner=plate(**inner, **inside),
            outer=plate(**outer, **outside),
        )
        return passes(built, 2**13 * effort, seed)

    forward = flux(meter(medium=fog), light, 12)
    backward = flux(light, meter(), 13)
    assert_same(forward, backward, 0.15 / effort**0.5)


# ------------------------------------------------------------------------------- null surfaces


def cut(case: Any, cuts: bool, **kw: Any) -> Any:
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


@every_model
def test_invisible_surface_inside_a_medium_changes_nothing(case: Any, effort: int) -> None:
    settings = {"sigma_t": 1.5, "albedo": 0.8}
    whole = passes(scene(**cut(case, False, **settings)), 512 * effort, 14, 5)
    parts = passes(scene(**cut(case, True, **settings)), 512 * effort, 15, 5)
    assert_same(whole, parts, 0.04 / effort**0.5)


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


@every_model
def test_nothing_arrives_from_infinity_through_an_unbounded_medium(case: Any) -> None:
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
        assert lit == (law(case).sigma_bar == 0)


@every_model
def test_a_hidden_emitter_in_the_medium_hides_nothing(case: Any) -> None:
    """The flight goes on behind it, with the depth up to it already used."""
    model = law(case)
    fog = {"type": "ref", "id": "fog"}
    depth = 0.7
    lamp, wall = (mi.ScalarTransform4f().translate([0, 0, z]) for z in (-1, -2))
    light = {"type": "area", "radiance": 1.0}
    built = scene(
        {"type": "nonexp_volpath", "hide_emitters": True},
        fog={**medium(*case, sigma_t=depth / 3, albedo=0.0), "id": "fog"},
        sensor={**orthographic(1e-4, 1.0), "near_clip": 1e-5, "medium": fog},
        lamp={"type": "rectangle", "to_world": lamp, "emitter": light, "bsdf": {"type": "diffuse"}},
        wall={"type": "rectangle", "to_world": wall, "bsdf": {"type": "diffuse"}},
        sun={"type": "point", "position": [0, 0, -1.5], "intensity": 1.0},
    )
    arrive = float(model.ff(depth))
    samples = radiance(built, 2**17, 31)
    shown = samples[samples > 0]
    # The wall connects to one of two emitters, and finds the lamp's back half of the time.
    assert stats.binomtest(shown.size, samples.size, arrive / 2).pvalue > FALSE_ALARM
    expected = 2 * 0.5 / math.pi * 0.5**-2 * float(model.ff(depth / 6))
    np.testing.assert_allclose(shown, expected, rtol=1e-4)


# ------------------------------------------------------------------------------- several media


def row_of_balls(cases: list[Any], depth: float, albedo: float, **kw: Any) -> dict[str, Any]:
    place = mi.ScalarTransform4f()
    return {
        f"ball {i}": {
            **ball(medium(*case, sigma_t=depth / 0.8, albedo=albedo, **kw), radius=0.4),
            "to_world": place.translate([0, 0, i - 1.5]),
        }
        for i, case in enumerate(cases)
    }


FOUR = [("linear", {"b": 2.0}), ("gamma", {"alpha": 0.5}), ("quadratic", {}), ("exponential", {})]


@pytest.mark.parametrize("light", ["flights", "shadow rays"])
def test_transmittances_of_media_in_a_row_multiply(light: str) -> None:
    """Each stretch of one medium begins anew at a fixed point: the product of the four ff."""
    depth = 0.6
    expected = math.prod(float(law(case).ff(depth)) for case in FOUR)
    parts = row_of_balls(FOUR, depth, 0.0)
    if light == "flights":
        samples = radiance(scene(sensor=beam(), sky=FURNACE, **parts), 2**19, 18)
        assert set(np.unique(samples)) <= {0.0, 1.0}
        assert_mean(samples, expected, 0.05)
    else:
        place = mi.ScalarTransform4f().translate([0, 0, -3])
        built = scene(
            sensor=perspective([0, 0, -2.5], [0, 0, -3], 0.01),
            floor={"type": "rectangle", "to_world": place, "bsdf": {"type": "diffuse"}},
            lamp={"type": "directional", "direction": [0, 0, -1], "irradiance": 1.0},
            **parts,
        )
        samples = radiance(built, 2**10, 18)
        np.testing.assert_allclose(samples, expected * 0.5 / math.pi, rtol=1e-3)


def test_white_furnace_with_several_media() -> None:
    parts = row_of_balls(FOUR, 2.0, 1.0, sample_emitters=False)
    built = scene(NO_ROULETTE, sensor=perspective([3, 2, 2], [0, 0, 0]), sky=FURNACE, **parts)
    np.testing.assert_array_equal(radiance(built, 2**15, 19), 1)


# ------------------------------------------------------------------------------- scale


HALF_SPACE = [(0.5, 0.115225878, 0.146544381), (0.9, 0.414947479, 0.478024489)]
"""Classical half-space, isotropic scattering: albedo, at normal incidence, under a white sky."""


@every_model
@pytest.mark.parametrize("radius", [0.01, 1.0, 1e4])
def test_shadow_ray_through_a_ball_at_any_scale(case: Any, radius: float) -> None:
    """Exact to float32 although rays start off the surface by 1e-4 and more."""
    model = law(case)
    depth = 0.6
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
    built = scene(sensor=camera, ball=ball(inside, radius=radius), sky=FURNACE)
    assert_mean(radiance(built, 2**21, 21), 0.25, 0.01)


@pytest.mark.parametrize("sigma_t", [1e3, 3e3])
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
            integrator = mi.load_dict({"type": "nonexp_volpath"})
            light, _, _ = integrator.sample(scene(wall=wall), sampler, ray, fog)
            assert light[0][0] == seen
    finally:
        del models.registry["fixed"]
