"""Expected values in place of draws: without bias, and only where the scene analysis says so."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from build import (
    DRAWN,
    FURNACE,
    LAMP,
    QUICK,
    Case,
    ball,
    beam,
    box,
    law,
    medium,
    model_id,
    orthographic,
    perspective,
    scene,
    stock,
)
from drjit.llvm import Float64
from measure import assert_mean, assert_same, largest_kernel, passes, radiance
from tiers import THOROUGH, quick, thorough

from nonexp.integrators.expected import Rule
from nonexp.integrators.media import scene_media
from nonexp.integrators.needs import SceneNeeds
from nonexp.models.exponential_mixture import ExponentialMixture

ON = {"type": "nonexp_volpath", "expected_emission": "on"}
FEW = [case for case in QUICK if case[0] in ("linear", "gamma", "pulse", "mixture")]
"""Atoms, a heavy tail, and a law made of others."""

CLEAR = {"albedo": 0.0}


def rgb(*values: float) -> dict[str, Any]:
    return {"type": "rgb", "value": list(values)}


def unit(case: Case) -> float:
    return 1 / (float(law(case).sigma_bar) or 1.0)


# ------------------------------------------------------------------------------- the rule


@pytest.mark.parametrize("keep", [0.0, 1e-6, 0.3, 0.999, 1.0])
def test_the_rule_is_without_bias_and_its_weights_are_small(keep: float) -> None:
    """Also past surfaces inside one medium, where q is that of the first stretch."""
    first = np.concatenate([[0, 1, 1e-30], np.linspace(0.01, 0.99, 50)])
    for later in (1.0, 0.7, 0.0):
        survived = first * later
        rule = Rule.of(Float64(keep), Float64(first), Float64(0.5))
        q, reached = np.array(rule.q), np.array(rule.reached(Float64(survived)))
        collides, passing = (
            np.array(rule.weight(there, Float64(survived))) for there in (True, False)
        )
        possible = q > 0
        # What is drawn times its weight is what would be drawn without the rule.
        np.testing.assert_allclose(q[possible] * collides[possible], 1, rtol=1e-12)
        np.testing.assert_allclose(reached * passing, survived, atol=1e-15)
        np.testing.assert_allclose(reached, 1 - q * (1 - survived), atol=1e-12)
        assert np.all(passing <= 1 + 1e-12)
        assert np.all(keep * collides[possible] <= 1 + 1e-12)
    if keep == 1:
        np.testing.assert_array_equal(q, 1)


# ------------------------------------------------------------------------------- exact values


@pytest.mark.parametrize("case", quick(FEW, FEW[:1].__contains__), ids=model_id)
def test_absorption_has_no_noise(case: Case) -> None:
    """A ray through an absorbing ball before a sky (test_exact.py has all laws)."""
    model, sigma_t = law(case), 0.7 * unit(case)
    inside = medium(*case, sigma_t=sigma_t, **CLEAR)
    one = radiance(scene(ON, sensor=beam(), ball=ball(inside), sky=FURNACE), 256, 1)
    np.testing.assert_allclose(one, float(model.ff(2 * sigma_t)), rtol=2e-5, atol=1e-7)


def nested(case: Case, **kw: Any) -> dict[str, Any]:
    """A ball with a smaller one of the same medium in it, and a lamp within that."""
    fog = {"type": "ref", "id": "fog"}
    lamp = mi.ScalarTransform4f().translate([0, 0, -0.1]).scale(0.4)
    return {
        "fog": {**medium(*case, **kw), "id": "fog"},
        "ball": ball(fog),
        "core": {**ball(fog, radius=0.6), "exterior": fog},
        "lamp": {
            "type": "rectangle",
            "to_world": lamp,
            "bsdf": {"type": "diffuse", "reflectance": 0.0},
            "emitter": {"type": "area", "radiance": 3.0},
        },
    }


@pytest.mark.parametrize(
    ("case", "colour"),
    [(FEW[0], True), *thorough((FEW[1], False), (FEW[-1], True), several=True)],
)
def test_absorption_has_no_noise_past_invisible_surfaces(case: Case, colour: bool) -> None:
    """Three of them before a lamp that stands in the medium."""
    model, sigma_t = law(case), [0.7 * unit(case), 0.4 * unit(case), 0.1 * unit(case)]
    given = rgb(*sigma_t) if colour else sigma_t[0]
    built = scene(ON, sensor=beam(), **nested(case, sigma_t=given, **CLEAR))
    samples = radiance(built, 64, 2, channels=True)
    for channel, sigma in zip(samples, sigma_t if colour else [sigma_t[0]] * 3, strict=True):
        expected = 3 * float(model.ff(1.1 * sigma))
        np.testing.assert_allclose(channel, expected, rtol=3e-5, atol=1e-6)


def erlang_absorbs(albedo: float, radius: float) -> float:
    """Of light on a ball, by erlang(2, 1) with extinction 1, where albedo < 1."""
    x = math.sqrt(1 - albedo) * radius
    sinh, cosh = math.sinh(x), math.cosh(x)
    above = 2 * (1 + radius) * (x * cosh - sinh)
    return above / (radius**2 * (sinh + x / radius * cosh))


@pytest.mark.parametrize(
    ("sigma_t", "albedo", "connecting", "whole"),
    [
        ((2.0, 1.0, 0.4), 0.2, True, False),
        *thorough(
            ((1.0, 1.0, 1.0), 0.2, True, False),
            ((1.5, 1.0, 0.6), 0.3, False, True),
            several=True,
        ),
    ],
)
def test_an_erlang_ball(
    sigma_t: tuple[float, ...], albedo: float, connecting: bool, whole: bool, effort: int
) -> None:
    """All orders of scattering, with the rule, also where flights go on past a surface within."""
    settings = {"sigma_t": rgb(*sigma_t), "albedo": albedo, "sample_emitters": connecting}
    inside = medium("erlang", {"k": 2, "rate": 1.0}, **settings)
    parts = {"ball": ball(inside)} if whole else nested_ball(inside)
    built = scene({**ON, "rr_depth": 1000}, sensor=orthographic(), sky=FURNACE, **parts)
    lost = 1 - passes(built, 2**10 * effort, 3, channels=True)
    for channel, sigma in zip(lost, sigma_t, strict=True):
        expected = math.pi / 4 * erlang_absorbs(albedo, sigma)
        assert_mean(channel, expected, 0.15 / effort**0.5)


@THOROUGH
@pytest.mark.parametrize("colour", [False, True])
def test_a_mask_around_a_lamp(colour: bool, effort: int) -> None:
    """A flight may scatter on a surface inside its medium, or go on past it to the lamp."""
    mask = {"type": "mask", "opacity": 0.3, "nested": {"type": "diffuse"}}
    sigma_t = rgb(2.0, 0.5, 0.8) if colour else 1.5
    images = []
    for seed, integrator in enumerate((ON, DRAWN)):
        parts = nested(("gamma", {"alpha": 0.7}), sigma_t=sigma_t, albedo=0.15)
        parts["core"]["bsdf"] = mask
        built = scene(integrator, sensor=orthographic(0.3), **parts)
        images.append(passes(built, 2**9 * effort, seed, channels=True).reshape(3, -1))
    assert_same(*images, 0.1 / effort**0.5)


@pytest.mark.parametrize("variant", thorough("llvm_ad_spectral"), indirect=True)
def test_wavelengths(variant: str) -> None:
    assert variant
    parts = nested(("gamma", {"alpha": 2.0}), sigma_t=rgb(0.9, 0.4, 0.2), albedo=0.15)
    images = [
        passes(scene(kind, sensor=orthographic(0.3), **parts), 2**9, seed)
        for seed, kind in enumerate((ON, DRAWN))
    ]
    assert_same(*images, 0.1)


# ------------------------------------------------------------------------------- beside draws


def lamp_in_fog(camera_inside: bool = True, **kw: Any) -> dict[str, Any]:
    """A glossy ball and a lamp in fog."""
    fog = {"type": "ref", "id": "fog"}
    camera = perspective([0.5, 0.6, 2.0], [0, 0.5, 0], 60)
    metal = {"type": "roughconductor", "alpha": 0.2}
    return {
        "fog": {**medium(**kw), "id": "fog"},
        "bounds": {**ball(fog, radius=3.0)},
        "sensor": {**camera, "medium": fog} if camera_inside else camera,
        "ball": {"type": "sphere", "radius": 0.5, "bsdf": metal},
        "lamp": {**LAMP, "center": [-0.3, 1.2, -0.4]},
        "sky": {"type": "constant", "radiance": 0.1},
    }


@THOROUGH
@pytest.mark.parametrize(
    ("options", "albedo"),
    [
        ({"max_depth": 1}, 0.2),
        ({"max_depth": 3, "hide_emitters": True}, 0.2),
        ({"max_depth": 4, "rr_depth": 1}, 0.8),
    ],
)
def test_depths_and_hidden_emitters(options: dict[str, Any], albedo: float, effort: int) -> None:
    parts = lamp_in_fog(model="gamma", sigma_t=rgb(0.8, 0.3, 0.1), albedo=albedo)
    images = [
        passes(scene({**kind, **options}, **parts), 2**9 * effort, seed, channels=True)[:, 0]
        for seed, kind in enumerate((ON, DRAWN))
    ]
    assert_same(*images, 0.4 / effort**0.5)


@THOROUGH
@pytest.mark.parametrize("albedo", [0.2, 0.7])
def test_colour_within_a_ball_of_light(albedo: float, effort: int) -> None:
    """Paths without connections: emission weighs what the channels did before."""
    settings = {"sigma_t": rgb(1.5, 0.7, 0.3), "albedo": albedo, "sample_emitters": False}
    fog = {"type": "ref", "id": "fog"}
    black = {"type": "diffuse", "reflectance": 0.0}
    light = {"type": "area", "radiance": 1.0}
    parts = {
        "fog": {**medium("gamma", {"alpha": 1.5}, **settings), "id": "fog"},
        "sensor": {**perspective([0, 0, 0], [0, 0, 1]), "medium": fog},
        "shell": {"type": "sphere", "flip_normals": True, "bsdf": black, "emitter": light},
    }
    images = [
        passes(scene(kind, **parts), 2**9 * effort, seed, channels=True).reshape(3, -1)
        for seed, kind in enumerate((ON, DRAWN))
    ]
    assert_same(*images, 0.04 / effort**0.5)


def test_the_share_of_a_pixel_that_is_covered(effort: int) -> None:
    """Alpha is the chance of a collision, though not all collisions are kept."""
    model, count = law(("linear", {"b": 2.0})), 2**15 * effort
    for albedo in (0.0, 0.2):
        inside = medium("linear", {"b": 2.0}, sigma_t=0.4, albedo=albedo)
        sun = {"type": "point", "position": [0, 3, 0]}
        built = scene(ON, sensor=beam(), **nested_ball(inside), sun=sun)
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(5, count)
        sensor = built.sensors()[0]
        ray, _ = sensor.sample_ray_differential(0.0, 0.5, sampler.next_2d(), sampler.next_2d())
        _, alpha, _ = built.integrator().sample(built, sampler, ray, None, True)
        assert_mean(np.array(alpha, dtype=float), 1 - float(model.ff(0.8)), 0.05)


def nested_ball(inside: dict[str, Any]) -> dict[str, Any]:
    fog = {"type": "ref", "id": "fog"}
    core = {**ball(fog, radius=0.6), "exterior": fog}
    return {"fog": {**inside, "id": "fog"}, "ball": ball(fog), "core": core}


# ------------------------------------------------------------------------------- other media


def ramp(case: Case, **kw: Any) -> dict[str, Any]:
    """A cube of side 2, whose density rises from 0 to 1 along z."""
    values = np.linspace(0, 1, 8, dtype=np.float32)[:, None, None, None] * np.ones((1, 4, 4, 1))
    place = mi.ScalarTransform4f().translate([-1] * 3).scale(2)
    grid = mi.VolumeGrid(values.astype(np.float32))
    density = {"type": "gridvolume", "grid": grid, "to_world": place}
    return {**medium(*case, **kw), "type": "nonexp_heterogeneous", "sigma_t": density}


@THOROUGH
@pytest.mark.parametrize("case", FEW[-1:], ids=model_id)
def test_absorption_by_a_grid_has_no_noise(case: Case) -> None:
    """The column is 1 whether or not a flight has collided before its end."""
    inside = ramp(case, extinction=0.8 * unit(case), tracking="regular", **CLEAR)
    for parts in ({"ball": box(inside, [-1.2] * 3, [1.2] * 3)}, nested_cube(inside)):
        samples = radiance(scene(ON, sensor=beam(), sky=FURNACE, **parts), 64, 6)
        np.testing.assert_allclose(samples, float(law(case).ff(0.8 * unit(case))), rtol=1e-4)


def nested_cube(inside: dict[str, Any]) -> dict[str, Any]:
    fog = {"type": "ref", "id": "fog"}
    core = {**ball(fog, radius=0.6), "exterior": fog}
    outer = box(fog, [-1.2] * 3, [1.2] * 3)
    return {"fog": {**inside, "id": "fog"}, "outer": outer, "core": core}


@THOROUGH
def test_memory() -> None:
    """Of a mixture of two materials that only absorbs: its transmittance."""
    pair = {"sigma_t": "0.2, 1.5", "chord": "0.8, 0.2", "albedo": 0.0}
    parts = nested_ball({"type": "nonexp_binary_mixture", **pair})
    samples = radiance(scene(ON, sensor=beam(), sky=FURNACE, **parts), 64, 7)
    exact = float(ExponentialMixture.levermore(0.2, 1.5, 0.8, 0.2).ff(2.0))
    np.testing.assert_allclose(samples, exact, rtol=2e-5)


def row(tracking: str) -> dict[str, Any]:
    """Media of all kinds in a row before a lamp and a sky."""
    place = mi.ScalarTransform4f()
    grid = ramp(("exponential", {}), extinction=0.8, albedo=0.3, tracking=tracking)
    memory = {"type": "nonexp_binary_mixture", "sigma_t": "0.2, 1.5", "chord": "0.8, 0.2"}
    insides = [
        medium("linear", {"b": 1.3}, sigma_t=rgb(0.5, 1.0, 0.5), albedo=0.1),
        grid,
        {**memory, "albedo": 0.4},
        stock(sigma_t=0.7, albedo=0.2),
        medium("gamma", sigma_t=0.7, albedo=0.9),
    ]
    parts = {
        f"box {i}": {
            "type": "cube",
            "to_world": place.translate([0, 0, 2.4 * (i - 2)]),
            "bsdf": {"type": "null"},
            "interior": inside,
        }
        for i, inside in enumerate(insides)
    }
    return {**parts, "lamp": {**LAMP, "center": [0, 1.8, -2]}, "sky": FURNACE}


@THOROUGH
def test_media_of_all_kinds_together(effort: int) -> None:
    """Tracked ones are left to their draws."""
    camera = perspective([0.5, 0.4, 8], [0, 0, 0], 25)
    images = [
        passes(scene(kind, sensor=camera, **row("delta")), 2**7 * effort, seed, 2)
        for seed, kind in enumerate((ON, DRAWN))
    ]
    assert_same(*images, 0.06 / effort**0.5)


# ------------------------------------------------------------------------------- the decisions


def decided(wanted: str = "auto", **parts: Any) -> list[tuple[bool, float, float | None]]:
    """For each medium: expects emission, how far, and the rule's parameter."""
    built = scene(**parts)
    start = built.sensors()[0].get_medium() if built.sensors() else None
    found = SceneNeeds.of(built, start, expected=wanted).expected
    return [(one.emission, one.far, one.keep) for one in found]


def test_the_scene_decides() -> None:
    room = lamp_in_fog(model="linear", albedo=0.75)
    del room["bounds"]
    dark = lamp_in_fog(model="linear", albedo=rgb(0.1, 0.1, 0.2))
    assert decided(**room) == [(True, 2.0, None)]
    assert decided("on", **room) == [(True, math.inf, None)]
    assert decided("off", **room) == decided("off", **dark) == []
    assert decided(**dark) == [(True, math.inf, pytest.approx(0.6))]
    assert decided(**lamp_in_fog(model="linear", albedo=0.9)) == []
    glow = lamp_in_fog(model="linear", albedo=0.2, emission=0.1)
    assert decided(**glow) == [(True, 2.0, None)]  # collisions are worth more than their albedo
    # Behind a boundary without a lamp inside no emission is met: only the rule is left.
    sky = {"sky": FURNACE}
    for bsdf in ("null", "dielectric"):
        assert decided(ball=ball(medium(albedo=0.9), bsdf), **sky) == []
        closed = decided(ball=ball(medium(albedo=0.0), bsdf), **sky)
        assert closed == [(False, math.inf, 0.0)]
    lit = {"lamp": {**LAMP, "center": [0, 0, 0]}, "ball": ball(medium(albedo=0.5))}
    assert decided(**lit) == [(True, 2.0, None)]
    lit["lamp"] = {"type": "point", "position": [0, 0, 0]}
    assert decided(**lit) == []
    for dark_one in (stock(albedo=0.2), ramp(("linear", {}), albedo=0.2, tracking="regular")):
        ((_, _, keep),) = decided(ball=ball(dark_one), **sky)
        assert keep == pytest.approx(0.6)


def test_tracked_media_are_left_to_draws() -> None:
    built = scene(ball=ball(ramp(("gamma", {}), albedo=0.2, tracking="delta")), sky=FURNACE)
    needs = SceneNeeds.of(built)
    media = scene_media(needs.media, needs.sealed, expected=needs.expected)
    assert needs.expected and media is not None and not media.looks


@pytest.mark.parametrize("bsdf", ["null", *thorough("dielectric")])
def test_nothing_is_left_of_it_where_it_is_not_used(bsdf: str) -> None:
    """The same kernel, and the same image to the last bit."""
    parts = {"ball": ball(medium("gamma", albedo=0.75), bsdf), "lamp": LAMP, "sky": FURNACE}
    camera = perspective([0, 0, 4], [0, 0, 0])
    built = scene(sensor=camera, **parts)
    drawing = mi.load_dict(DRAWN)
    images, operations = [], []
    for integrator in (built.integrator(), drawing):
        images.append(np.array(mi.render(built, integrator=integrator, spp=4, seed=8)))
        kernel = largest_kernel(lambda i=integrator: dr.eval(i.render(built, spp=4, seed=8)))
        operations.append(kernel["operation_count"])
    np.testing.assert_array_equal(*images)
    assert operations[0] == operations[1]


def test_an_albedo_that_changes_is_noticed() -> None:
    built = scene(sensor=beam(), ball=ball(medium(albedo=0.9, sigma_t=0.5)), sky=FURNACE)
    parameters = mi.traverse(built)
    assert not SceneNeeds.of(built).expected
    parameters["ball.interior_medium.albedo.value.value"] = 0.0
    parameters.update()
    np.testing.assert_allclose(radiance(built, 64, 9), math.exp(-1), rtol=1e-5)


@THOROUGH
def test_derivatives_draw_everything() -> None:
    """Replayed paths are those of analog flights, whatever the parameter says."""
    slopes = []
    for integrator in (ON, DRAWN):
        built = scene(integrator, **lamp_in_fog(model="gamma", sigma_t=0.4, albedo=0.2))
        parameters = mi.traverse(built)
        key = "fog.sigma_t.value.value"
        dr.enable_grad(parameters[key])
        parameters.update()
        image = mi.render(built, parameters, spp=4, seed=3)
        dr.backward(dr.mean(image, axis=None))
        slopes.append(float(dr.grad(parameters[key])[0]))
    assert slopes[0] == slopes[1] != 0
