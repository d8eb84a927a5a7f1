"""Media on grids: exact values, homogeneous media of the same density, and Mitsuba's own."""

from __future__ import annotations

import functools
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
    NO_ROULETTE,
    QUICK,
    Case,
    ball,
    box,
    medium,
    model_id,
    orthographic,
    perspective,
    scene,
)
from measure import assert_mean, assert_same, largest_kernel, passes, radiance
from tiers import THOROUGH, quick, thorough

from nonexp import models
from nonexp.integrators import rays
from nonexp.integrators.needs import SceneNeeds

EMISSION_ALONE = {"type": "nonexp_volpath", "max_depth": 1}
"""Sees the emission of first collisions."""


def grid(values: Any, half: float = 1.0, place: Any = None, **kw: Any) -> dict[str, Any]:
    """A grid over a cube of half-width ``half``."""
    place = place or mi.ScalarTransform4f()
    place = place @ mi.ScalarTransform4f().translate([-half] * 3).scale(2 * half)
    data = mi.VolumeGrid(np.asarray(values, dtype=np.float32))
    return {"type": "gridvolume", "grid": data, "to_world": place, **kw}


def varied(
    density: Any, model: str = "exponential", parameters: dict[str, Any] | None = None, **kw: Any
) -> dict[str, Any]:
    transmittance = models.to_dict(models.create(model, **(parameters or {})))
    if not isinstance(density, dict):
        density = grid(density)
    return {
        "type": "nonexp_heterogeneous",
        "sigma_t": density,
        "transmittance": transmittance,
        **kw,
    }


def noise(*shape: int, seed: int = 5) -> Any:
    return np.random.default_rng(seed).random(shape or (6, 6, 6)).astype(np.float32)


def around(inside: Any, bsdf: str = "null", **parts: Any) -> dict[str, Any]:
    camera = perspective([0, 0.4, 3], [0, 0, 0], 50)
    return {"sensor": camera, "ball": ball(inside, bsdf), "lamp": LAMP, "sky": FURNACE, **parts}


# ---------------------------------------------------------------------- exact values


@pytest.mark.parametrize("case", quick(QUICK, lambda case: case in QUICK[::4]), ids=model_id)
def test_a_constant_grid_is_a_homogeneous_medium(case: Case) -> None:
    """Path by path, but for those where rounding decides. Chromatic, so that densities count."""
    colour = {"type": "rgb", "value": [1.0, 0.6, 0.2]}
    key, parameters = case
    options = {"type": "nonexp_volpath", "max_depth": 20}
    homogeneous = medium(
        key, parameters, sigma_t={"type": "rgb", "value": [1.5, 0.9, 0.3]}, albedo=0.8
    )
    same = varied(
        grid(np.full((3, 2, 5), 0.5), half=1.2),
        key,
        parameters,
        scale=3.0,
        extinction=colour,
        albedo=0.8,
        tracking="regular",
    )
    expected = radiance(scene(options, **around(homogeneous)), 2**14, 1, channels=True)
    got = radiance(scene(options, **around(same)), 2**14, 1, channels=True)
    assert np.mean(np.isclose(got, expected, rtol=1e-3, atol=1e-6)) > 0.998
    assert abs(got.mean() - expected.mean()) < 0.002 * expected.mean()


def ramp(key: str, parameters: dict[str, Any], across: bool, **kw: Any) -> dict[str, Any]:
    # Voxels with centres at -1 and 1 hold 0 and 1.
    inside = varied(grid([[[0, 1]] * 2] * 2, half=2.0), key, parameters, scale=1.5, **kw)
    side = (0.0, 0.0, 1.0) if across else (-1.0, 0.0, 0.0)
    return {
        "sensor": orthographic(1.0 if across else 1e-4, 5.0, side),
        "cube": box(inside, [-1, -1, -1], [1, 1, 1]),
    }


@pytest.mark.parametrize(
    ("key", "parameters", "across", "along", "x"),
    [
        ("exponential", {}, 0.31674, 0.22313, 0.10357),
        ("gamma", {"alpha": 1.0}, 0.46210, 0.40000, 0.04696),
        ("linear", {"b": 4.0}, 0.62500, 0.62500, 0.12500),
    ],
)
@pytest.mark.parametrize("tracking", ["auto", "regular"])
def test_a_ramp(
    key: str, parameters: dict[str, Any], across: float, along: float, x: float, tracking: str
) -> None:
    """Density rises linearly: transmittance across and along it, and where flights end."""
    for share, is_across in ((across, True), (along, False)):
        dark = ramp(key, parameters, is_across, albedo=0.0, tracking=tracking)
        light = radiance(scene(DRAWN, **dark, sky=FURNACE), 2**16, 3)
        assert_mean(light, share, 0.06)
    # Light that falls off with x: means of x and 1, as differences of two emissions.
    bright = grid([[[0, 1]] * 2] * 2, half=2.0)
    glowing = ramp(key, parameters, False, albedo=0.0, emission=bright, tracking=tracking)
    # (1 + x) / 2 is emitted at the first collision, if there is one.
    mean = (x + 1 - along) / 2
    assert_mean(radiance(scene(EMISSION_ALONE, **glowing), 2**16, 4), mean, 0.06)


def test_emission_of_a_ball() -> None:
    """linear(b=3) in a ball of radius 1 that emits and does not scatter: 4/9 over its disc."""
    for inside in (
        medium("linear", {"b": 3.0}, sigma_t=1.0, albedo=0.0, emission=1.0),
        varied(np.ones((2, 2, 2)), "linear", {"b": 3.0}, albedo=0.0, emission=1.0),
    ):
        parts = {"sensor": orthographic(), "ball": ball(inside)}
        assert_mean(radiance(scene(**parts), 2**16, 5), math.pi / 4 * 4 / 9, 0.05)


@pytest.mark.parametrize(("albedo", "absorbed"), [(0.5, 0.29863205), (0.9, 0.06514779)])
def test_emission_of_an_erlang_ball_is_what_it_absorbs(albedo: float, absorbed: float) -> None:
    """Kirchhoff's law, with scattering; the absorbed shares are exact (docs/theory.md)."""
    inside = varied(
        np.ones((3, 3, 3)), "erlang", {"k": 2, "rate": 1.0}, albedo=albedo, emission=1.0
    )
    parts = {"sensor": orthographic(), "ball": ball(inside)}
    light = radiance(scene(NO_ROULETTE, **parts), 2**18, 6)
    assert_mean(light, math.pi / 4 * absorbed, 0.05)


@pytest.mark.parametrize("case", quick(QUICK[::3], lambda case: case in QUICK[::6]), ids=model_id)
@pytest.mark.parametrize("kind", ["heterogeneous", *thorough("homogeneous")])
def test_thermal_equilibrium(case: Case, kind: str) -> None:
    """Everything emits 1: each path without connections and roulette carries exactly 1."""
    key, parameters = case
    common = {"albedo": noise(4, 4, 4), "emission": 1.0, "sample_emitters": False}
    common["albedo"] = grid(common["albedo"])
    if kind == "homogeneous":
        inside = medium(key, parameters, sigma_t=2.0, **common)
    else:
        inside = varied(noise(), key, parameters, scale=4.0, **common)
    parts = around(inside)
    del parts["lamp"]
    light = radiance(scene(NO_ROULETTE, **parts), 2**12, 7)
    assert np.all(np.abs(light - 1) < 2e-5)


def test_absorption_does_not_know_the_scale() -> None:
    """A grid stretched by 3 along the view, its optical depth kept: the same image."""
    images = []
    for stretch in (1.0, 3.0):
        place = mi.ScalarTransform4f().scale([1, 1, stretch])
        inside = varied(grid(noise(), place=place), "gamma", scale=4 / stretch, albedo=0.0)
        inside["tracking"] = "regular"
        images.append(np.array([_through(inside, x, stretch) for x in (-0.7, 0.1, 0.4)]))
    assert np.allclose(images[0], images[1], rtol=1e-5)


def _through(inside: dict[str, Any], x: float, half: float) -> float:
    """Transmittance along z, by a shadow ray: light of a tiny sun on a white diffuse floor."""
    floor = {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().translate([x, 0.3, -half - 1]).scale(1e-3),
        "bsdf": {"type": "diffuse", "reflectance": 1.0},
    }
    parts = {
        "sensor": {
            "type": "orthographic",
            "to_world": mi.ScalarTransform4f()
            .look_at([x, 0.3, -half - 0.5], [x, 0.3, -half - 1], [0, 1, 0])
            .scale([1e-4, 1e-4, 1]),
            "film": perspective([0] * 3, [1] * 3)["film"],
            "near_clip": 0.01,
        },
        "floor": floor,
        "cube": box(inside, [-1, -1, -half], [1, 1, half]),
        "sun": {"type": "directional", "direction": [0, 0, -1], "irradiance": math.pi},
    }
    return float(radiance(scene({"type": "nonexp_volpath", "max_depth": 2}, **parts), 4, 1).mean())


# ---------------------------------------------------------------------- what changes nothing


@pytest.mark.parametrize(
    ("key", "tracking"),
    [("linear", "auto"), *thorough(("gamma", "regular"), ("gamma", "delta"), several=True)],
)
def test_invisible_surfaces_change_nothing(key: str, tracking: str) -> None:
    """Inside a medium on a grid, and around it."""
    inside = {"id": "cloud"} | varied(noise(), key, scale=4.0, albedo=0.8, tracking=tracking)
    cut = {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().rotate([0.3, 1, 0], 50).scale(0.68),
        "bsdf": {"type": "null"},
        "interior": {"type": "ref", "id": "cloud"},
        "exterior": {"type": "ref", "id": "cloud"},
    }
    whole = passes(scene(**around(inside)), 2**10, 1, 3)
    parts = around(inside)
    assert_same(passes(scene(**parts, cut=cut), 2**10, 2, 3), whole, 0.05)


@pytest.mark.parametrize(
    "case", [("exponential", {}), *thorough(("gamma", {"alpha": 0.5}))], ids=model_id
)
@pytest.mark.parametrize("colour", [False, *thorough(True)], ids=["grey", "chromatic"])
def test_both_ways_of_tracking_agree(case: Case, colour: bool) -> None:
    key, parameters = case
    kw: dict[str, Any] = {"scale": 4.0, "albedo": 0.8}
    if colour:
        kw["extinction"] = {"type": "rgb", "value": [0.2, 1, 2]}
    walked, tracked = (
        passes(scene(**around(varied(noise(), key, parameters, tracking=t, **kw))), 2**10, i, 3)
        for i, t in enumerate(("regular", "delta"))
    )
    assert_same(walked, tracked, 0.05)


@THOROUGH
@pytest.mark.parametrize(
    "case",
    [
        ("ensemble", {"law": "lognorm", "args": (1.0, 0.0, 0.6)}),
        ("mixture", {"models": (models.create("gamma"), models.create("constant"))}),
    ],
    ids=["ensemble", "mixture"],
)
def test_mixtures_of_exponentials_by_null_collisions(case: Case) -> None:
    key, parameters = case
    walked, tracked = (
        passes(
            scene(**around(varied(noise(), key, parameters, tracking=t, scale=4.0, albedo=0.8))),
            2**9,
            i,
            3,
        )
        for i, t in enumerate(("regular", "delta"))
    )
    assert_same(walked, tracked, 0.07)


# ---------------------------------------------------------------------- against Mitsuba


def stock(ours: dict[str, Any]) -> dict[str, Any]:
    dropped = ("transmittance", "extinction", "tracking")
    return {k: v for k, v in ours.items() if k not in dropped} | {"type": "heterogeneous"}


PLAIN = varied(noise(), scale=4.0, albedo={"type": "rgb", "value": [0.9, 0.7, 0.5]})


@pytest.mark.parametrize(
    "inside",
    [
        PLAIN,
        *thorough(
            PLAIN | {"phase": {"type": "hg", "g": 0.6}, "sample_emitters": False},
            PLAIN | {"sigma_t": grid(noise(), filter_type="nearest", wrap_mode="repeat")},
            PLAIN | {"sigma_t": grid(noise(3, 9, 5), half=0.4)},
            PLAIN | {"albedo": grid(noise())},
        ),
    ],
    ids=["grid", "no connections", "nearest", "smaller than the ball", "albedo"],
)
def test_exponential_grids_against_volpath(inside: dict[str, Any]) -> None:
    """By walks: null collisions are compared with them."""
    right = passes(scene("volpath", **around(stock(inside))), 2**9, 1, 3)
    inside = inside | {"tracking": "regular"}
    assert_same(passes(scene("nonexp_volpath", **around(inside)), 2**9, 2, 3), right, 0.085)


@functools.cache
def coloured_by_volpathmis() -> Any:
    inside = stock(varied(coloured(), scale=4.0, albedo=0.8))
    return passes(scene("volpathmis", **around(inside)), 2**9, 1, 3, channels=True)


def coloured() -> dict[str, Any]:
    return grid(noise()[..., None] * np.array([1.0, 0.5, 0.2], dtype=np.float32))


@THOROUGH
@pytest.mark.parametrize("tracking", ["regular", "delta"])
def test_coloured_grids_against_volpathmis(tracking: str) -> None:
    """Three channels that are multiples of one grid; the same by the colour of ``extinction``."""
    inside = varied(coloured(), scale=4.0, albedo=0.8, tracking=tracking)
    colour = {"type": "rgb", "value": [1.0, 0.5, 0.2]}
    ours = varied(noise(), scale=4.0, albedo=0.8, tracking=tracking, extinction=colour)
    for seed, one in enumerate((inside, ours), 2):
        got = passes(scene(**around(one)), 2**9, seed, 3, channels=True)
        for a, b in zip(got, coloured_by_volpathmis(), strict=True):
            assert_same(a, b, 0.12)


@THOROUGH
@pytest.mark.parametrize("tracking", ["regular", "delta"])
def test_media_of_all_kinds_together(tracking: str) -> None:
    """Two grids, one with a camera inside, beside homogeneous and stock media, in glass too."""
    got = passes(scene(**kinds(dict, "nonexp_homogeneous", tracking=tracking)), 2**9, 2, 3)
    assert_same(got, all_kinds_by_volpath(), 0.1)


@functools.cache
def all_kinds_by_volpath() -> Any:
    return passes(scene("volpath", **kinds(stock, "homogeneous")), 2**9, 1, 3)


def kinds(make: Any, homogeneous: str, **kw: Any) -> dict[str, Any]:
    first = varied(noise(), scale=2.0, albedo=0.9, **kw)
    second = varied(grid(noise(3, 4, 5), half=0.5), scale=5.0, albedo=0.5)
    return {
        "haze": make(first) | {"id": "haze"},
        "sensor": perspective([0, 0.1, 0.8], [0, 0, 0], 70)
        | {"medium": {"type": "ref", "id": "haze"}},
        "outer": ball({"type": "ref", "id": "haze"}),
        "inner": {
            "type": "cube",
            "to_world": mi.ScalarTransform4f().scale(0.35),
            "bsdf": {"type": "null"},
            "interior": make(second),
            "exterior": {"type": "ref", "id": "haze"},
        },
        "drop": {
            "type": "sphere",
            "center": [0.5, -0.5, 0],
            "radius": 0.2,
            "bsdf": {"type": "dielectric"},
            "interior": {"type": homogeneous, "sigma_t": 3.0, "albedo": 0.8},
            "exterior": {"type": "ref", "id": "haze"},
        },
        "lamp": LAMP,
        "sky": FURNACE,
    }


@THOROUGH
def test_bent_connections_through_a_grid() -> None:
    """In smooth glass with a lamp: as without them."""
    inside = varied(noise(), "linear", {"b": 1.5}, scale=4.0, albedo=0.9)
    parts = around(inside, "dielectric")
    without = scene({"type": "nonexp_volpath", "refractive_nee": "off"}, **parts)
    bent = scene({"type": "nonexp_volpath", "refractive_nee": "on"}, **parts)
    assert_same(passes(bent, 2**11, 2, 3), passes(without, 2**11, 1, 3), 0.1)


@pytest.mark.parametrize("variant", thorough("llvm_ad_spectral", "llvm_ad_mono"), indirect=True)
def test_other_variants(variant: str) -> None:
    assert variant
    inside = varied(noise(), scale=4.0, albedo=0.8)
    if mi.is_spectral:
        inside["extinction"] = {"type": "rgb", "value": [0.4, 0.8, 1.6]}
    got = passes(scene(**around(inside | {"emission": 0.5})), 2**10, 2, 3)
    again = passes(scene(**around(inside | {"emission": 0.5, "tracking": "delta"})), 2**10, 3, 3)
    assert_same(got, again, 0.08)


def test_a_ball_of_grid_throws_a_shadow() -> None:
    """Connections from a floor past a ball that cuts the grid's corners off."""
    inside = varied(np.ones((3, 3, 3)), "gamma", scale=2.0, albedo=0.5, tracking="regular")
    same = medium("gamma", sigma_t=2.0, albedo=0.5)
    camera = perspective([0, 2, 4], [0, -1, 0], 60)
    sun = {"type": "directional", "direction": [0, -1, 0], "irradiance": 3.0}
    parts = {"sensor": camera, "floor": GROUND, "sun": sun}
    expected = radiance(scene(ball=ball(same, radius=0.9), **parts), 2**14, 1)
    got = radiance(scene(ball=ball(inside, radius=0.9), **parts), 2**14, 1)
    assert np.mean(np.isclose(got, expected, rtol=1e-3, atol=1e-5)) > 0.95
    assert abs(got.mean() - expected.mean()) < 0.01 * expected.mean()


# ---------------------------------------------------------------------- the boundary left out


def cube(inside: Any, **kw: Any) -> dict[str, Any]:
    return {"cube": box(inside, [-1, -1, -1], [1, 1, 1]) | kw}


GROUND = {
    "type": "rectangle",
    "to_world": mi.ScalarTransform4f().translate([0, -1, 0]).rotate([1, 0, 0], -90).scale(4),
    "bsdf": {"type": "diffuse"},
}
THING = {"type": "sphere", "radius": 0.4, "bsdf": {"type": "diffuse", "reflectance": 0.7}}
CAMERA = {"sensor": perspective([0, 1, 5], [0, 0, 0], 40)}


def test_an_invisible_boundary_around_a_grid_is_left_out() -> None:
    inside = varied(noise())

    def shell(hides: bool = False, **parts: Any) -> Any:
        return SceneNeeds.of(scene(**parts), hides=hides).shell

    small = varied(grid(noise(), half=0.5))
    turned = mi.ScalarTransform4f().rotate([1, 1, 0], 30)
    assert shell(**cube(inside), ground=GROUND, thing=THING)
    assert shell(ball=ball(inside, radius=1.74))
    assert shell(**cube(varied(grid(noise(), half=0.5, place=turned))))
    assert not shell(ball=ball(inside)), "it cuts the grid's corners off"
    assert not shell(**cube(varied(grid(noise(), half=0.9, place=turned))))
    assert not shell(**cube(inside), hides=True)
    assert not shell(**cube(inside), thing=ball(medium(), radius=0.1))
    assert not shell(**cube(inside, bsdf={"type": "thindielectric"}))
    assert not shell(**cube(inside, exterior=medium()))
    assert not shell(**cube(inside, flip_normals=True))
    assert not shell(**cube(medium())), "without a grid it is the boundary that counts"
    assert shell(**cube(small), sensor=perspective([0, 0, 3], [0, 0, 0]))
    lost = perspective([0, 0, 0.5], [0, 0, 0])
    assert not shell(**cube(small), sensor=lost), "this sensor's rays start in vacuum"
    named = {"id": "cloud"} | inside
    found = {**lost, "medium": {"type": "ref", "id": "cloud"}}
    assert shell(cloud=named, **cube({"type": "ref", "id": "cloud"}), sensor=found)


@THOROUGH
@pytest.mark.parametrize("key", ["linear", "gamma"])
def test_leaving_it_out_changes_nothing(key: str) -> None:
    """Beside a second medium, far away, it stays. With a floor that touches it, and inside."""
    inside = varied(noise(), key, scale=4.0, albedo=0.8)
    parts = {**CAMERA, **cube(inside), "ground": GROUND, "thing": THING, "lamp": LAMP}
    parts["sky"] = FURNACE
    far = {"far": ball(medium(), radius=0.1) | {"center": [0, 0, 90]}}
    assert SceneNeeds.of(scene(**parts)).shell
    assert not SceneNeeds.of(scene(**parts, **far)).shell
    got, right = passes(scene(**parts), 2**8, 1, 3), passes(scene(**parts, **far), 2**8, 2, 3)
    assert_same(got, right, 0.1)


@THOROUGH
@pytest.mark.parametrize("key", ["linear"])
def test_a_lamp_inside(key: str) -> None:
    """Connections end within the grid: as in a homogeneous medium of the same density."""
    lamp = {
        "type": "sphere",
        "center": [0.4, 0.5, 0.0],
        "radius": 0.2,
        "emitter": {"type": "area", "radiance": 4.0},
    }
    parts = {**CAMERA, "lamp": lamp, "thing": THING, "ground": GROUND}
    inside = varied(np.ones((2, 3, 4)), key, scale=1.5, albedo=0.9)
    same = medium(key, sigma_t=1.5, albedo=0.9)
    got = passes(scene(**parts, **cube(inside)), 2**10, 1, 3)
    assert_same(got, passes(scene(**parts, **cube(same)), 2**10, 2, 3), 0.16)


def test_a_moved_thing_is_noticed_where_it_is_left_out() -> None:
    made = scene(**CAMERA, **cube(varied(noise())), thing=GROUND, sky=FURNACE)
    before = radiance(made, 2**8, 1).mean()
    parameters = mi.traverse(made)
    parameters["thing.to_world"] = mi.Transform4f().translate([0, 0, 50])
    parameters.update()
    assert abs(radiance(made, 2**8, 1).mean() - before) > 0.01


# ---------------------------------------------------------------------- known faults of others


@pytest.mark.parametrize("model", ["exponential", "linear"])
def test_a_single_dense_voxel_leaves_no_spots_around_it(model: str) -> None:
    """A 1 x 1 x 1 grid of extinction 1000, dark, in a larger cube: outside all is white, also
    right along its faces, and inside all is black."""
    inside = varied(grid(np.full((1, 1, 1), 1e3), half=0.5), model, albedo=0.0)
    cube = {"cube": box(inside, [-1, -1, -1], [1, 1, 1]), "sky": FURNACE}
    film = {"type": "hdrfilm", "width": 64, "height": 64, "rfilter": {"type": "box"}}
    camera = orthographic(1.0) | {"film": film}
    image = np.array(mi.render(scene(sensor=camera, **cube), spp=64))[..., 0]
    middle = np.zeros((64, 64), dtype=bool)
    middle[16:48, 16:48] = True
    assert np.all(image[~middle] == 1) and np.all(image[middle] < 1e-3)


def test_density_ends_at_the_rotated_cube() -> None:
    """Mitsuba's ends at the box around it; ours does not fill the corners."""
    place = mi.ScalarTransform4f().rotate([0, 0, 1], 45)
    inside = varied(grid(np.full((2, 2, 2), 50.0), half=0.5, place=place), albedo=0.0)
    cube = {"cube": box(inside, [-1, -1, -1], [1, 1, 1]), "sky": FURNACE}
    film = {"type": "hdrfilm", "width": 64, "height": 64, "rfilter": {"type": "box"}}
    camera = orthographic(1.0) | {"film": film}
    image = np.array(mi.render(scene(sensor=camera, **cube), spp=16))[..., 0]
    y, x = (np.mgrid[:64, :64] + 0.5) / 32 - 1
    distance = (np.abs(x) + np.abs(y)) * math.sqrt(0.5)
    assert np.all(image[distance > 0.54] == 1) and np.all(image[distance < 0.46] < 1e-3)


# ---------------------------------------------------------------------- parameters


def built(**kw: Any) -> Any:
    return mi.load_dict(varied(kw.pop("sigma_t", noise()), **kw))


def test_parameters_are_where_mitsuba_has_them() -> None:
    parameters = mi.traverse(built(emission=1.0))
    constants = (f"{name}.value.value" for name in ("albedo", "emission", "extinction"))
    assert {"sigma_t.data", "scale", *constants} <= set(parameters.keys())


def test_updates_are_those_of_a_new_medium() -> None:
    made = scene(**around(varied(noise(), "gamma", {"alpha": 2.0}, scale=3.0, albedo=0.5)))
    parameters = mi.traverse(made)
    new = noise(4, 5, 7, seed=9)
    keys = {key.partition("ball.interior_medium.")[2]: key for key in parameters.keys()}
    parameters[keys["sigma_t.data"]] = mi.TensorXf(new[..., None])
    parameters[keys["scale"]] = 5.0
    parameters[keys["albedo.value.value"]] = 0.9
    parameters[keys["transmittance.alpha"]] = 0.4
    parameters.update()
    fresh = scene(**around(varied(new, "gamma", {"alpha": 0.4}, scale=5.0, albedo=0.9)))
    assert np.array_equal(radiance(made, 2**7, 1), radiance(fresh, 2**7, 1))


@pytest.mark.parametrize("tracking", ["regular", *thorough("delta")])
def test_a_render_can_be_frozen(tracking: str) -> None:
    """And replayed with another grid of the same size."""
    inside = varied(noise(), "gamma", scale=3.0, albedo=0.8, tracking=tracking)
    made = scene(**CAMERA, ball=ball(inside), far=THING | {"center": [0, 9, 0]}, sky=FURNACE)
    parameters = mi.traverse(made)
    (data,) = (key for key in parameters.keys() if key.endswith("sigma_t.data"))

    @dr.freeze
    def frozen(made: Any, seed: mi.UInt32) -> mi.TensorXf:
        return mi.render(made, spp=4, seed=seed)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rays, "MOST_SPHERES", 0)  # frozen functions do not tell spheres apart
        for seed in range(3):
            replayed = np.array(frozen(made, mi.UInt32(seed)))
            assert np.array_equal(replayed, np.array(mi.render(made, spp=4, seed=seed)))
            parameters[data] = parameters[data] * 1.5
            parameters.update()


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (np.full((2, 2, 2), -1.0), "sigma_t.data holds -1: densities must be finite numbers >= 0"),
        (np.array([[[1, np.nan]]]), "sigma_t.data holds nan"),
        (np.array([[[1, np.inf]]]), "sigma_t.data holds inf"),
        (np.zeros((0, 2, 2)), r"sigma_t.data has the shape \(0, 2, 2, 1\)"),
        (noise(2, 2, 2, 3), "3 channels that are not multiples of one grid"),
        (np.full((2, 2, 2), 3e38), "sigma_t .* is inf"),
    ],
    ids=["negative", "nan", "inf", "empty", "channels", "overflow"],
)
def test_bad_grids_are_refused(values: Any, message: str) -> None:
    with pytest.raises(RuntimeError, match=message):
        built(sigma_t=values, scale=10.0)


def test_a_refused_update_leaves_the_grid() -> None:
    made = built(scale=2.0)
    parameters = mi.traverse(made)
    before = np.array(parameters["sigma_t.data"])
    parameters["sigma_t.data"] = mi.TensorXf(-before)
    with pytest.raises(ValueError, match=r"sigma_t\.data holds -"):
        parameters.update()
    assert np.array_equal(np.array(mi.traverse(made)["sigma_t.data"]), before)
    point = mi.Point3f(0.1, 0.2, 0.3)
    assert made.density.lookup(point)[0] > 0


@pytest.mark.parametrize(
    ("kw", "message"),
    [
        ({"tracking": "ratio"}, "tracking is 'ratio': it must be auto, regular or delta"),
        (
            {"model": "linear", "tracking": "delta"},
            "tracking is 'delta': it must be 'regular' or 'auto'",
        ),
        ({"sigma_x": 1.0}, "nonexp_heterogeneous has no parameter 'sigma_x'"),
        ({"emission": -1.0}, "emission is -1: it must be a finite number >= 0"),
        ({"extinction": -1.0}, "extinction is -1: it must be a finite number >= 0"),
        (
            {"extinction": grid(noise())},
            "extinction is a GridVolume: it must be constant in space",
        ),
        ({"to_world": mi.ScalarTransform4f()}, "to_world goes with filename"),
    ],
)
def test_bad_parameters_are_refused(kw: dict[str, Any], message: str) -> None:
    with pytest.raises(RuntimeError, match=message):
        built(**kw)


def test_a_singular_transform_is_refused() -> None:
    flat = mi.ScalarTransform4f().scale([1, 1, 0])
    with pytest.raises(RuntimeError, match=r"sigma_t\.to_world is singular"):
        built(sigma_t=grid(noise(), place=flat))


def test_a_constvolume_is_the_same_everywhere() -> None:
    """Mitsuba's heterogeneous confines it to a unit cube."""
    inside = varied({"type": "constvolume", "value": 2.0}, "gamma", scale=1.5, albedo=0.8)
    same = medium("gamma", sigma_t=3.0, albedo=0.8)
    got = radiance(scene(**around(inside)), 2**10, 1)
    assert np.array_equal(got, radiance(scene(**around(same)), 2**10, 1))


def test_an_empty_grid_is_no_medium() -> None:
    empty = scene(**around(varied(np.zeros((4, 4, 4)))))
    nothing = scene(**around(medium(sigma_t=0.0)))

    def operations(made: Any) -> Any:
        return largest_kernel(lambda: dr.eval(mi.render(made, spp=4)))["operation_count"]

    assert operations(empty) == operations(nothing)


def test_a_rule_decides_how_flights_are_drawn() -> None:
    thin, thick = (built(sigma_t=noise(16, 16, 16), scale=s) for s in (0.01, 100.0))
    assert thin.tracked and not thick.tracked
    assert "tentative collisions" in thin.choice.reason
    assert not built(model="linear", scale=0.01).tracked
    assert built(tracking="delta", scale=1e3).tracked
