"""Images with connections through glass against images without, which find light by chance.

Where light is found by chance alone it is of some size, so that the reference converges; points and
directions are compared with small lamps and narrow skies instead.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from build import FURNACE, ball, medium, perspective, scene, stock
from measure import assert_same, passes, radiance
from scipy.stats import sem
from test_refractive import glass, mesh_ball, round_ball, sky
from test_scene_needs import assert_can_be_frozen, traced
from tiers import THOROUGH, quick, thorough

from nonexp.integrators.needs import SceneNeeds

GRID = 3
PLACE = mi.ScalarTransform4f()
Parts = dict[str, Any]


def panel(size: float = 2.5, **kw: Any) -> Parts:
    """A square light above, facing down."""
    to_world = PLACE.translate([0.4, 2.2, 0.6]).rotate([1, 0, 0], 90).scale(size)
    emitter = {"type": "area", "radiance": {"type": "rgb", "value": [2.0, 1.5, 1.0]}}
    return {"type": "rectangle", "to_world": to_world, "emitter": emitter, **kw}


def bulb(centre: list[float], radius: float, value: float = 4.0, **kw: Any) -> Parts:
    emitter = {"type": "area", "radiance": value}
    return {"type": "sphere", "center": centre, "radius": radius, "emitter": emitter, **kw}


def fog(law: str = "exponential", sigma_t: Any = 1.5, albedo: float = 0.9, **kw: Any) -> Parts:
    parameters = {"gamma": {"alpha": 0.4}}.get(law, {})
    return medium(law, parameters, sigma_t=sigma_t, albedo=albedo, **kw)


def thing(bsdf: Any, radius: float = 0.4) -> Parts:
    return round_ball(bsdf, radius, center=[0.1, -0.2, 0.2])


GOLD = {"type": "roughconductor", "material": "Au", "alpha": 0.15}
GREY = {"type": "diffuse", "reflectance": 0.6}
FLOOR = {
    "type": "rectangle",
    "to_world": PLACE.translate([0, -1.05, 0]).rotate([1, 0, 0], -90).scale(4),
    "bsdf": GREY,
}
CAMERA = perspective([0, 0.8, 4], [0, 0, 0], 26)
REF = {"type": "ref", "id": "air"}


def image(count: int, seed: int, nee: str, parts: Parts, **kw: Any) -> Any:
    integrator = {"type": "nonexp_volpath", "refractive_nee": nee, **kw}
    return passes(scene(integrator, **{"sensor": CAMERA, **parts}), count, seed, GRID)


def same(
    within: float, effort: int, make: Callable[[], Parts], nee: str = "auto", **kw: Any
) -> None:
    """With connections through glass and without; ``within`` * 2 ** 0.5 states the power."""
    without = image(512 * effort, 1, "off", make(), **kw)
    assert SceneNeeds.of(scene(**make()), None, nee).lobes
    assert_same(image(192 * effort, 2, nee, make(), **kw), without, within * (2 / effort) ** 0.5)


# ------------------------------------------------------------------------------- what is inside

REDDISH = {"type": "rgb", "value": [2.5, 1.2, 0.4]}


def pattern() -> Parts:
    """A colourful texture. Made anew each time: spectral modes change a bitmap that they load."""
    values = np.random.default_rng(6).random((4, 8, 3)).astype(np.float32)
    return {"type": "bitmap", "bitmap": mi.Bitmap(values)}


CUBE = PLACE.translate([-0.5, -0.5, -0.5])


def cloud() -> Parts:
    values = mi.VolumeGrid(np.random.default_rng(7).random((3, 3, 3, 1)).astype(np.float32))
    grid = {"type": "gridvolume", "grid": values, "to_world": PLACE.translate(-1).scale(2)}
    return {"type": "heterogeneous", "sigma_t": grid, "scale": 2.0, "albedo": 0.9}


CASES: dict[str, tuple[float, Callable[[], Parts]]] = {
    "exponential, gold": (
        0.05,
        lambda: {"lobe": ball(fog(), glass()), "gold": thing(GOLD), "lamp": panel()},
    ),
    "gamma, diffuse": (
        0.05,
        lambda: {"lobe": ball(fog("gamma"), glass()), "grey": thing(GREY), "lamp": panel()},
    ),
    "linear, sky": (
        0.06,
        lambda: {"lobe": ball(fog("linear"), glass()), "gold": thing(GOLD), "sky": sky()},
    ),
    "gamma, mesh, gold": (
        0.06,
        lambda: {
            "lobe": mesh_ball(glass(), True, interior=fog("gamma")),
            "gold": thing(GOLD),
            "lamp": panel(),
        },
    ),
    "linear, mesh, sky": (
        0.06,
        lambda: {"lobe": mesh_ball(glass(), interior=fog("linear")), "sky": sky()},
    ),
    "no medium": (
        0.05,
        lambda: {"lobe": round_ball(glass()), "grey": thing(GREY, 0.6), "lamp": panel()},
    ),
    "small lamp": (
        0.25,
        lambda: {"lobe": ball(fog("gamma"), glass()), "lamp": bulb([0.7, 2, 1], 0.4)},
    ),
    "chromatic": (
        0.06,
        lambda: {
            "lobe": ball(fog("gamma", REDDISH), glass()),
            "gold": thing(GOLD),
            "lamp": panel(),
        },
    ),
    "chromatic, blobs inside and outside": (
        0.06,
        lambda: {
            "fog": {**fog("gamma", REDDISH), "id": "air"},
            "lobe": ball(REF, glass()),
            "blob": {**ball(fog("linear", 3.0), radius=0.4), "exterior": REF},
            "cover": {**ball(fog(sigma_t=0.6), radius=0.5), "center": [0.2, 1.6, 0.3]},
            "lamp": panel(),
        },
    ),
    "medium on both sides": (
        0.1,
        lambda: {
            "air": {**fog("gamma", 0.2), "id": "air"},
            "lobe": {**ball(fog("linear"), glass(), 0.9), "exterior": REF},
            "room": ball(REF, radius=2.0),
            "grey": thing(GREY),
            "lamp": panel(),
        },
    ),
    "nested": (
        0.1,
        lambda: {
            "fog": {**fog("gamma", 1.0), "id": "air"},
            "lobe": ball(REF, glass()),
            "inner": {**ball(fog("linear", 3.0), glass(1.9), 0.5), "exterior": REF},
            "lamp": panel(),
        },
    ),
    "nested, a lamp between": (
        0.1,
        lambda: {
            "lobe": round_ball(glass(1.3)),
            "inner": {**ball(fog("gamma", 3.0), glass(), 0.3), "center": [-0.4, -0.4, 0]},
            "bulb": bulb([0.3, 0.2, 0.2], 0.5, 0.5, bsdf={"type": "diffuse", "reflectance": 0.9}),
            "lamp": panel(),
        },
    ),
    "two side by side": (
        0.1,
        lambda: {
            "left": {**ball(fog("gamma"), glass(), 0.5), "center": [-0.5, 0, 0]},
            "right": {**ball(fog("linear", 3.0), glass(1.8), 0.4), "center": [0.45, 0, 0.1]},
            "lamp": panel(),
        },
    ),
    "sphere and mesh": (
        0.1,
        lambda: {
            "left": {**ball(fog("gamma"), glass(), 0.5), "center": [-0.5, 0, 0]},
            "right": mesh_ball(
                glass(1.8), True, interior=fog(), to_world=PLACE.translate([0.5, 0, 0]).scale(0.45)
            ),
            "floor": FLOOR,
            "lamp": panel(),
        },
    ),
    "lamps inside and outside": (
        0.06,
        lambda: {
            "fog": {**fog("gamma"), "id": "air"},
            "lobe": ball(REF, glass()),
            "bulb": {**bulb([0.3, 0.2, 0.3], 0.2, 3.0), "exterior": REF},
            "gold": thing(GOLD, 0.3),
            "lamp": panel(),
        },
    ),
    "coloured glass": (
        0.06,
        lambda: {
            "lobe": ball(fog("gamma"), glass(specular_transmittance=pattern())),
            "lamp": panel(),
        },
    ),
    "bubble": (
        0.06,
        lambda: {"lobe": ball(fog("gamma"), glass(1 / 1.33)), "grey": thing(GREY), "sky": sky()},
    ),
    "cube": (
        0.1,
        lambda: {
            "lobe": {
                "type": "cube",
                "to_world": PLACE.rotate([0, 1, 0], 30).scale(0.6),
                "bsdf": glass(),
                "interior": fog("gamma"),
            },
            "lamp": panel(),
        },
    ),
    "water": (
        0.1,
        lambda: {
            "water": {
                "type": "rectangle",
                "to_world": PLACE.rotate([1, 0, 0], -90).scale(6),
                "bsdf": glass(1.33),
                "interior": fog("gamma", 0.7),
            },
            "ground": {
                "type": "rectangle",
                "to_world": PLACE.translate([0, -1, 0]).rotate([1, 0, 0], -90).scale(6),
                "bsdf": GREY,
            },
            "lamp": panel(2.0),
        },
    ),
    "cloud": (0.1, lambda: {"lobe": ball(cloud(), glass()), "gold": thing(GOLD), "lamp": panel()}),
    "the medium does not connect": (
        0.1,
        lambda: {
            "lobe": ball(fog("gamma", sample_emitters=False), glass()),
            "grey": thing(GREY),
            "lamp": panel(),
        },
    ),
    "mirrored lamp": (
        0.1,
        lambda: {
            "sensor": perspective([0, 0, 4], [0, 0, 0], 26),
            "lobe": ball(fog("gamma"), glass(1.8)),
            "bulb": bulb([1.5, 1, 5], 2, 20.0),
            "sky": sky(),
            "cover": {**ball(fog(sigma_t=2.0), radius=0.3), "center": [-0.2, 0.9, 2.2]},
        },
    ),
    "eye inside": (
        0.06,
        lambda: {
            "fog": {**fog("gamma"), "id": "air"},
            "sensor": {**perspective([0, 0, 0.8], [0, 0, 0], 60), "medium": REF},
            "lobe": ball(REF, glass()),
            "gold": thing(GOLD),
            "lamp": panel(),
            "floor": FLOOR,
        },
    ),
}


@pytest.mark.parametrize("case", quick(CASES, {"exponential, gold"}.__contains__))
def test_same_image_as_without(case: str, effort: int) -> None:
    within, parts = CASES[case]
    same(within, effort, parts)


@THOROUGH
def test_same_image_as_volpath(effort: int) -> None:
    """Exponential media, in Mitsuba's own integrator."""

    def parts(make: Callable[..., Parts]) -> Parts:
        inside = make(sigma_t=1.5, albedo=0.9)
        return {"lobe": ball(inside, glass()), "gold": thing(GOLD), "lamp": panel()}

    built = scene("volpath", sensor=CAMERA, **parts(stock))
    right = passes(built, 768 * effort, 1, GRID)
    for make in (stock, lambda **kw: {"type": "nonexp_homogeneous", **kw}):
        assert_same(image(256 * effort, 2, "auto", parts(make)), right, 0.06 / effort**0.5)


def mirror_hall() -> Parts:
    """Light that comes back from the glass, through it, out of it, and straight to the eye."""
    return {
        "lobe": ball(fog("gamma"), glass(1.8)),
        "grey": thing(GREY),
        "lamp": panel(),
        "bulb": bulb([1.5, 1, 5], 1.5),
        "lantern": bulb([0.5, 0.5, 1.5], 0.2, 1.0),
    }


@pytest.mark.parametrize("depth", [*thorough(1, 2), 3, *thorough(4, 5)])
def test_depths_are_exact(depth: int, effort: int) -> None:
    hide = depth % 2 == 0
    same(0.08, effort, mirror_hall, max_depth=depth, hide_emitters=hide)


@THOROUGH
@pytest.mark.parametrize("law", ["exponential", "gamma"])
def test_index_matched_glass_is_no_glass(law: str, effort: int) -> None:
    """As behind a boundary that is not there, where connections are straight."""
    images = []
    for seed, bsdf in enumerate((glass(1.0), {"type": "null"})):
        parts = {"lobe": ball(fog(law), bsdf), "gold": thing(GOLD), "lamp": panel()}
        images.append(image(256 * effort, seed, "auto", {**parts, "small": bulb([0, 2, 0], 0.01)}))
    assert_same(*images, 0.06 / effort**0.5)


@THOROUGH
@pytest.mark.parametrize("variant", ["llvm_ad_mono", "llvm_ad_spectral"], indirect=True)
def test_other_variants(variant: str, effort: int) -> None:
    images = []
    for seed, (nee, count) in enumerate((("off", 1024), ("auto", 384))):
        parts = {
            "lobe": ball(fog("gamma", REDDISH), glass(specular_transmittance=pattern())),
            "gold": thing(GOLD),
            "lamp": panel(),
        }
        images.append(image(count * effort, seed, nee, parts))
    assert_same(*images, 0.1 / effort**0.5)


# ------------------------------------------------------------------------------- points, directions


def shadowed(law: str) -> Parts:
    """Eye and fog in glass, before a large thing: no path without scattering gets out to a lamp."""
    return {
        "fog": {**fog(law), "id": "air"},
        "sensor": {**perspective([0, 0.3, 0.75], [0, 0, 0], 30), "medium": REF},
        "lobe": ball(REF, glass()),
        "grey": round_ball(GREY, 0.5),
    }


SINGLE = 3
"""Depth of the path eye - fog or thing - glass - lamp. A real lamp is also found by longer ones."""


def assert_near(a: Any, b: Any) -> None:
    """Within 3 %, and 6 % for each block: for a part of the light chance must find another way
    through the glass than connections do, and hardly ever does where the lamp is tiny. Standard
    errors are a fifth of these bounds at most."""
    for axis, bound in (((0,), 0.006), ((), 0.012)):
        error = np.hypot(*(sem(v.mean(axis=axis), axis=-1) for v in (a, b)))
        assert np.all(error < bound * a.mean()), np.max(error / a.mean())
    assert min(a.mean(), b.mean()) > 0.01
    assert a.mean() == pytest.approx(b.mean(), rel=0.03)
    np.testing.assert_allclose(a.mean(axis=1), b.mean(axis=1), rtol=0.06)


@pytest.mark.parametrize("law", ["exponential", *thorough("linear")])
def test_a_point_is_a_tiny_lamp(law: str, effort: int) -> None:
    where, radius = [0.7, 1.9, 0.6], 0.02
    point = {"type": "point", "position": where, "intensity": 3.0}
    tiny = bulb(where, radius, 3.0 / (np.pi * radius**2))
    a = image(512 * effort, 1, "on", {**shadowed(law), "lamp": point}, max_depth=SINGLE)
    b = image(512 * effort, 2, "on", {**shadowed(law), "lamp": tiny}, max_depth=SINGLE)
    assert_near(a, b)


@THOROUGH
def test_a_spot_is_a_point_in_its_cone() -> None:
    """What a spot sends depends on where its light meets the glass, not on what is behind that."""
    where = [0.0, 1.5, 0.0]
    point = {"type": "point", "position": where, "intensity": 3.0}
    aim = PLACE.look_at(where, [0, 0, 0], [0, 0, 1])
    spot = {"type": "spot", "to_world": aim, "intensity": 3.0}
    wide = {**spot, "cutoff_angle": 80.0, "beam_width": 79.0}
    # From here the ball is seen under 41.8 degrees; a cone of 20 meets it within 0.56 of its axis.
    narrow = {**spot, "cutoff_angle": 20.0, "beam_width": 19.9}
    lamps = (point, wide, narrow)
    a, b, c = (image(64, 1, "on", {**shadowed("gamma"), "lamp": lamp}) for lamp in lamps)
    np.testing.assert_allclose(a, b, rtol=1e-3)
    assert np.all(c <= a * (1 + 1e-5))
    assert 0.02 * a.mean() < c.mean() < 0.8 * a.mean()


@THOROUGH
def test_the_sun_is_a_far_disk(effort: int) -> None:
    direction, distance, radius = np.array([-0.3, -1, -0.4]), 100.0, 2.0
    direction /= np.linalg.norm(direction)
    sun = {"type": "directional", "direction": list(direction), "irradiance": 2.0}
    place = PLACE.look_at(list(-distance * direction), [0, 0, 0], [0, 0, 1]).scale(radius)
    value = 2.0 * distance**2 / (np.pi * radius**2)
    disk = {"type": "disk", "to_world": place, "emitter": {"type": "area", "radiance": value}}
    a = image(128 * effort, 1, "on", {**shadowed("linear"), "lamp": sun}, max_depth=SINGLE)
    b = image(128 * effort, 2, "on", {**shadowed("linear"), "lamp": disk}, max_depth=SINGLE)
    assert_near(a, b)


# ------------------------------------------------------------------------------- their use


def lobes(nee: str, parts: Parts) -> int:
    return len(SceneNeeds.of(scene(**parts), None, nee).lobes)


def lobe_of(bsdf: Any, **kw: Any) -> Parts:
    return {"lobe": {**ball(fog("gamma"), bsdf), **kw}, "lamp": panel()}


def faceted() -> Parts:
    shape = mesh_ball(glass(), interior=fog("gamma"), face_normals=True)
    return {"lobe": shape, "lamp": panel()}


def instanced() -> Parts:
    group = {"type": "shapegroup", "ball": ball(fog("gamma"), glass())}
    copy = {"type": "instance", "group": {"type": "ref", "id": "group"}}
    return {"group": group, "copy": copy, "lamp": panel()}


FALLBACKS: dict[str, Callable[[], Parts]] = {
    "faceted mesh": faceted,
    "rough": lambda: lobe_of({"type": "roughdielectric"}),
    "thin": lambda: lobe_of({"type": "thindielectric"}),
    "flipped": lambda: lobe_of(glass(), flip_normals=True),
    "instance": instanced,
    "masked": lambda: lobe_of({"type": "mask", "opacity": 0.5, "bsdf": glass()}),
}


@pytest.mark.parametrize("case", quick(FALLBACKS, "rough".__eq__))
def test_other_glass_is_left_to_chance(case: str) -> None:
    """The kernel, and so the image, is that of ``off``."""
    parts = {"sensor": CAMERA, **FALLBACKS[case]()}
    found = {}
    for nee in ("off", "auto", "on"):
        built = scene({"type": "nonexp_volpath", "refractive_nee": nee}, **parts)
        found[nee] = radiance(built, 16, 1)
        assert np.all(np.isfinite(found[nee]))
        np.testing.assert_array_equal(found[nee], found["off"])
    assert lobes("on", parts) == 0


EMPTY = {"lobe": round_ball(glass()), "lamp": panel()}
SILENT = {"lobe": ball(fog("gamma", sample_emitters=False), glass()), "lamp": panel()}
UNIFORM = {"lobe": ball(fog("gamma"), glass()), "grey": thing(GREY), "sky": FURNACE}
BESIDE = {**EMPTY, "grey": {**thing(GREY), "center": [3, 0, 0]}}
MIRROR = {**EMPTY, "silver": thing({"type": "conductor"})}
FULL = {"lobe": ball(fog("gamma"), glass()), "lamp": panel()}
FILLED = {**EMPTY, "grey": thing(GREY)}
UNLIT = {"lobe": ball(fog("gamma"), glass())}


def test_auto_uses_them_where_they_help() -> None:
    for parts in (EMPTY, SILENT, UNIFORM, BESIDE, MIRROR):
        assert lobes("auto", parts) == 0 and lobes("on", parts) == 1
    for parts in (FULL, FILLED, {**UNIFORM, "lamp": panel()}, {**SILENT, "grey": thing(GREY)}):
        assert lobes("auto", parts) == 1
    for parts in (FULL, FILLED, EMPTY):
        assert lobes("off", parts) == 0
    for nee in ("auto", "on"):
        assert lobes(nee, UNLIT) == 0
    # Of two lobes the one that holds something.
    assert lobes("auto", {**FULL, "pearl": round_ball(glass(), 0.2, center=[2, 0, 0])}) == 1


@pytest.mark.parametrize("value", ["maybe", "", 1, True])
def test_bad_values_are_refused(value: Any) -> None:
    with pytest.raises(Exception, match=r"refractive_nee is .*must be auto, on or off") as caught:
        mi.load_dict({"type": "nonexp_volpath", "refractive_nee": value})
    (sentence,) = (line for line in str(caught.value).splitlines() if "must be auto" in line)
    assert repr(value) in sentence


@THOROUGH
def test_the_kernel_holds_them_only_where_they_are_used() -> None:
    def kernel(nee: str, parts: Parts) -> Any:
        integrator = {"type": "nonexp_volpath", "refractive_nee": nee}
        return traced(scene(integrator, sensor=CAMERA, **parts))

    for parts in (EMPTY, UNIFORM, SILENT):
        off = kernel("off", parts)
        assert kernel("auto", parts) == off
        assert "refraction" not in off.loops
    used = kernel("auto", FULL)
    assert "refraction" in used.loops and used.operations > kernel("off", FULL).operations
    assert "refraction" in kernel("on", EMPTY).loops
    assert "refraction" not in kernel("off", FULL).loops


@THOROUGH
@pytest.mark.parametrize("shape", ["sphere", "mesh"])
def test_a_render_can_be_frozen(shape: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Meshes are left to chance there: nothing to search in can be built while recording."""
    inside = fog("gamma")
    lobe = ball(inside, glass()) if shape == "sphere" else mesh_ball(glass(), interior=inside)
    parts = {"sensor": CAMERA, "lobe": lobe, "gold": thing(GOLD), "lamp": panel()}
    built = scene(**parts)
    assert SceneNeeds.of(built).lobes
    integrator = {"type": "nonexp_volpath", "refractive_nee": "off"}
    right = built if shape == "sphere" else scene(integrator, **parts)
    assert_can_be_frozen(built, right, monkeypatch)


def slope(nee: str, key: str, parts: Parts, spp: int) -> Any:
    """Derivative of the image by a parameter, blockwise."""
    built = scene({"type": "nonexp_volpath", "refractive_nee": nee}, sensor=CAMERA, **parts)
    parameters = mi.traverse(built)
    dr.enable_grad(parameters[key])
    parameters.update()
    rendered = mi.render(built, parameters, spp=spp, seed=1 if nee == "off" else 2)
    dr.forward(parameters[key])
    slopes = np.array(dr.grad(rendered))
    assert np.all(np.isfinite(slopes))
    return slopes.mean(axis=2).ravel()


@THOROUGH
@pytest.mark.parametrize(
    "key",
    [
        "lobe.interior_medium.albedo.value.value",
        "gold.bsdf.specular_reflectance.value",
        "lamp.emitter.radiance.value",
        "lobe.bsdf.specular_transmittance.value",
    ],
)
def test_derivatives(key: str, effort: int) -> None:
    """Those of paths found by chance, within 5 standard errors, each below a fifth of it."""
    if effort == 1:
        pytest.skip("only with --full")
    metal = {**GOLD, "specular_reflectance": 0.8}
    clear = glass(specular_transmittance=0.9)
    parts = {"lobe": ball(fog("gamma"), clear), "gold": thing(metal), "lamp": panel()}
    off, auto = slope("off", key, parts, 256), slope("auto", key, parts, 64)
    # Neighbouring pixels differ, so that this is no less than the error of the mean.
    error = np.hypot(off.std(), auto.std()) / 8
    assert error < 0.2 * off.mean()
    assert abs(off.mean() - auto.mean()) < 5 * error
