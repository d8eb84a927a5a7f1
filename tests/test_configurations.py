"""Whatever else a scene may hold: boundaries, sensors, phase functions, integrators around ours.

Exponential media against Mitsuba's volpath; other laws with connections against without, which are
two independent estimators of the same light.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from build import FURNACE, LAMP, ball, look_at, medium, perspective, scene, stock
from measure import PASSES, assert_same, passes
from tiers import THOROUGH, quick

FLOOR = {
    "type": "rectangle",
    "to_world": mi.ScalarTransform4f().translate([0, -1.2, 0]).rotate([1, 0, 0], -90).scale(3),
    "bsdf": {"type": "twosided", "bsdf": {"type": "diffuse"}},
}
REF = {"type": "ref", "id": "fog"}
Make = Callable[..., dict[str, Any]]


def ours(**kw: Any) -> dict[str, Any]:
    return {"type": "nonexp_homogeneous", **kw}


def around(**parts: Any) -> dict[str, Any]:
    camera = perspective([0, 0.6, 4], [0, 0, 0])
    return {"sensor": camera, "lamp": LAMP, "sky": {"type": "constant", "radiance": 0.5}, **parts}


def lamps_inside(make: Make) -> dict[str, Any]:
    """An area light and a point light in index-matched fog."""
    fog = {**make(sigma_t=0.8, albedo=0.8), "id": "fog"}
    bulb = {"type": "sphere", "center": [0.3, 0.2, 0], "radius": 0.1, "exterior": REF}
    bulb["emitter"] = {"type": "area", "radiance": 20.0}
    point = {"type": "point", "position": [-0.4, 0, 0.2], "intensity": 1.0, "medium": REF}
    return around(fog=fog, ball=ball(REF), bulb=bulb, point=point)


def touching(make: Make) -> dict[str, Any]:
    """Two boxes of different fog that share a wall, an invisible one or one of glass."""
    place = mi.ScalarTransform4f()
    red = {**make(sigma_t=1.5, albedo={"type": "rgb", "value": [0.9, 0.3, 0.3]}), "id": "red"}
    blue = {**make(sigma_t=0.7, albedo={"type": "rgb", "value": [0.3, 0.4, 0.9]}), "id": "blue"}
    parts = {"red": red, "blue": blue}
    null = {"type": "null"}
    for side, name in ((-1, "red"), (1, "blue")):
        for axis, turn in enumerate(([0, 1, 0], [1, 0, 0], [0, 0, 1])):
            for sign in (-1, 1):
                if axis == 0 and sign == -side:
                    continue
                move = [0.5 * side, 0, 0]
                move[axis] += 0.5 * sign
                rotate = (
                    place.rotate([0, 1, 0], 90.0 * sign)
                    if axis == 0
                    else place.rotate([1, 0, 0], -90.0 * sign)
                    if axis == 1
                    else place.rotate([0, 1, 0], 0.0 if sign == 1 else 180.0)
                )
                parts[f"{name} {turn} {sign}"] = {
                    "type": "rectangle",
                    "to_world": place.translate(move) @ rotate @ place.scale(0.5),
                    "bsdf": null,
                    "interior": {"type": "ref", "id": name},
                }
    parts["wall"] = {
        "type": "rectangle",
        "to_world": place.rotate([0, 1, 0], 90).scale(0.5),
        "bsdf": null,
        "interior": {"type": "ref", "id": "red"},
        "exterior": {"type": "ref", "id": "blue"},
    }
    return around(**parts)


def lobe(make: Make, bsdf: dict[str, Any], **kw: Any) -> dict[str, Any]:
    return around(ball=ball(make(sigma_t=1.5, albedo=0.8, **kw), bsdf), floor=FLOOR)


def holes(**nested: Any) -> dict[str, Any]:
    """A boundary that is there for a third of the rays, in a pattern."""
    board = {"type": "checkerboard", "color0": 0.6, "color1": 0.1}
    return {"type": "mask", "opacity": board, "nested": nested}


def albedo_grid() -> dict[str, Any]:
    values = np.random.default_rng(3).random((4, 4, 4, 3)).astype(np.float32)
    place = mi.ScalarTransform4f().translate([-1, -1, -1]).scale(2)
    return {"type": "gridvolume", "grid": mi.VolumeGrid(values), "to_world": place}


def tabulated_phase() -> dict[str, Any]:
    return {"type": "tabphase", "values": "0.1, 0.2, 0.3, 0.8, 2.0"}


CASES: dict[str, Callable[[Make], dict[str, Any]]] = {
    "lamps inside": lamps_inside,
    "touching": touching,
    "opacity mask": lambda make: lobe(make, holes(type="diffuse")),
    "mask of rough glass": lambda make: lobe(make, holes(type="roughdielectric")),
    "thin dielectric": lambda make: lobe(make, {"type": "thindielectric"}),
    "rough, coloured": lambda make: lobe(
        make, {"type": "roughdielectric", "alpha": 0.3, "specular_transmittance": 0.7}
    ),
    "principled": lambda make: lobe(make, {"type": "principled", "spec_trans": 0.8}),
    "volume albedo": lambda make: around(ball=ball(make(sigma_t=1.5, albedo=albedo_grid()))),
    "tabphase": lambda make: lobe(make, {"type": "null"}, phase=tabulated_phase()),
}


@pytest.mark.parametrize("case", quick(CASES, {"lamps inside", "opacity mask"}.__contains__))
def test_same_image_as_volpath(case: str, effort: int) -> None:
    count = (2**10 if case == "lamps inside" else 2**6) * effort
    right = passes(scene("volpath", **CASES[case](stock)), count, 1, 3)
    got = passes(scene("nonexp_volpath", **CASES[case](ours)), count, 2, 3)
    assert_same(got, right, (0.08 if case == "lamps inside" else 0.04) / effort**0.5)


# ------------------------------------------------------------------------------- sensors


def film(**kw: Any) -> dict[str, Any]:
    return {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}, **kw}


def renders(integrator: str, make: Make, sensors: dict[str, Any], index: int) -> Any:
    """Means over 4 x 4 pixels of PASSES renders of one sensor."""
    parts = {**lobe(make, {"type": "null"}), **sensors}
    if "sensor" not in sensors:
        del parts["sensor"]
    built = scene(integrator, **parts)
    images = [np.array(mi.render(built, sensor=index, spp=4, seed=s)) for s in range(PASSES)]
    values = np.mean(images, axis=3)
    height, width = values.shape[1:]
    values = values[:, : height // 4 * 4, : width // 4 * 4]
    values = values.reshape(PASSES, height // 4, 4, width // 4, 4).mean(axis=(2, 4))
    return values.reshape(PASSES, -1).T


def eye(x: float = 0.0) -> Any:
    return look_at([x, 0.6, 4], [0, 0, 0])


SENSORS: dict[str, tuple[dict[str, Any], int]] = {
    "thinlens": (
        {
            "sensor": {
                "type": "thinlens",
                "to_world": eye(),
                "aperture_radius": 0.2,
                "focus_distance": 4.0,
                "film": film(),
            }
        },
        0,
    ),
    "crop window": (
        {
            "sensor": {
                "type": "perspective",
                "fov": 40,
                "to_world": eye(),
                "film": film(crop_width=8, crop_height=8, crop_offset_x=5, crop_offset_y=4),
            }
        },
        0,
    ),
    "batch": (
        {
            "sensor": {
                "type": "batch",
                "film": film(width=32),
                "a": {"type": "perspective", "to_world": eye(), "film": film()},
                "b": {"type": "perspective", "to_world": eye(2.0), "film": film()},
            }
        },
        0,
    ),
    "second of two": (
        {
            "a": {"type": "perspective", "to_world": eye(), "film": film()},
            "b": {"type": "perspective", "to_world": eye(2.0), "film": film()},
        },
        1,
    ),
}


@THOROUGH
@pytest.mark.parametrize("name", SENSORS)
def test_sensors(name: str) -> None:
    sensors, index = SENSORS[name]
    right = renders("volpath", stock, sensors, index)
    assert_same(renders("nonexp_volpath", ours, sensors, index)[:, ::-1], right, 0.05)


# ------------------------------------------------------------------------------- around ours


@THOROUGH
def test_aovs_of_the_aov_integrator() -> None:
    """Depth and normals are those of any other integrator, the image is ours."""

    def image(inner: str, make: Make) -> Any:
        outer = {"type": "aov", "aovs": "dd:depth,nn:sh_normal", "inner": {"type": inner}}
        return np.array(mi.render(scene(outer, **lobe(make, {"type": "null"})), spp=64, seed=1))

    got, right = image("nonexp_volpath", ours), image("volpath", stock)
    assert got.shape == right.shape
    np.testing.assert_allclose(got[..., 3:], right[..., 3:], rtol=1e-5, atol=1e-6)
    plain = np.array(mi.render(scene(**lobe(ours, {"type": "null"})), spp=64, seed=1))
    assert np.mean(got[..., :3]) == pytest.approx(np.mean(plain), rel=0.05)


def test_second_moments_by_the_moment_integrator() -> None:
    built = scene(
        {"type": "moment", "inner": {"type": "nonexp_volpath"}}, **lobe(ours, {"type": "null"})
    )
    image = np.array(mi.render(built, spp=256, seed=1))
    assert image.shape[-1] > 3
    mean, second = image[..., 3:6], image[..., 6:9]
    assert np.all(np.isfinite(image))
    assert np.all(second >= mean**2 * (1 - 1e-3))


# ------------------------------------------------------------------------------- the matrix

BOUNDARIES = ["null", "dielectric", "roughdielectric"]
# Large enough to be found without connections.
LIGHTS = {"area": {**LAMP, "center": [0, 4.5, 0], "radius": 3.0}, "sky": FURNACE}
LAWS = {"exponential": {}, "linear": {}, "quadratic": {}, "gamma": {"alpha": 0.4}}
PHASES = {"isotropic": {"type": "isotropic"}, "hg": {"type": "hg", "g": 0.5}}
VARIANTS = ["llvm_ad_rgb", "llvm_ad_mono", "llvm_ad_spectral"]
MATRIX = list(itertools.product(BOUNDARIES, LIGHTS, LAWS, PHASES, VARIANTS))


def reduced(number: int) -> bool:
    """A twelfth of the matrix, in which each two values of any two columns meet."""
    b, e, m, p, v = np.unravel_index(number, (3, 2, 4, 2, 3))
    return bool((b + m) % 3 == v and (b // 2 + m) % 2 == p and (b + e + m) % 2 == 0)


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "number" in metafunc.fixturenames:
        full = metafunc.config.getoption("--full")
        chosen = [n for n in range(len(MATRIX)) if full or reduced(n)]
        metafunc.parametrize("number", chosen, ids=lambda n: "-".join(MATRIX[n]))


def test_with_and_without_connections(number: int) -> None:
    """The same light for every boundary, light, law, phase function and variant."""
    boundary, light, law, phase, variant = MATRIX[number]
    mi.set_variant(variant)
    means = []
    for seed, connects in enumerate((True, False)):
        inside = medium(
            law,
            LAWS[law],
            sigma_t=1.2,
            albedo={"type": "rgb", "value": [0.9, 0.7, 0.5]},
            phase=PHASES[phase],
            sample_emitters=connects,
        )
        camera = perspective([0, 0.4, 3], [0, 0, 0], 50)
        built = scene(sensor=camera, ball=ball(inside, boundary), light=LIGHTS[light])
        # Light from a lamp through rough glass is noisy.
        noisy = (boundary, light) == ("roughdielectric", "area")
        count = 2**7 if light == "sky" else 2**12 if noisy else 2**11
        means.append(passes(built, count, seed))
    # A lamp seen through glass is found by chance alone, in small shares of the view.
    assert_same(*means, 0.25 if (boundary, light) == ("dielectric", "area") else 0.15)
