"""Heterogeneous media and microflakes: as Mitsuba renders them, alone and beside ours."""

from __future__ import annotations

import math
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from build import FURNACE, LAMP, ball, beam, medium, perspective, scene, stock
from measure import assert_mean, assert_same, passes
from tiers import THOROUGH, thorough

from nonexp import models

RGB = {"type": "rgb", "value": [0.9, 0.7, 0.5]}


def grid(channels: int = 1, half: float = 1.0, flat: Any = None) -> dict[str, Any]:
    """Random extinction (or ``flat``) over a cube of half-width ``half``."""
    values = np.random.default_rng(5).random((6, 6, 6, channels)).astype(np.float32)
    values = values if flat is None else np.full_like(values, 1) * np.float32(flat)
    place = mi.ScalarTransform4f().translate([-half] * 3).scale(2 * half)
    return {"type": "gridvolume", "grid": mi.VolumeGrid(values), "to_world": place}


def cloud(**kw: Any) -> dict[str, Any]:
    return {"type": "heterogeneous", "sigma_t": grid(), "scale": 4.0, "albedo": RGB, **kw}


def flakes(*upper: float) -> dict[str, Any]:
    """``sggx`` of the same matrix (xx, yy, zz, xy, xz, yz) everywhere."""
    values = np.tile(np.array(upper, dtype=np.float32), (2, 2, 2, 1))
    return {"type": "sggx", "S": {"type": "gridvolume", "grid": mi.VolumeGrid(values)}}


ANISOTROPIC = (1.0, 0.2, 0.1, 0.1, 0.05, 0.0)


def parts(inside: Any, boundary: str = "null") -> dict[str, Any]:
    camera = perspective([0, 0.4, 3], [0, 0, 0], 50)
    return {"sensor": camera, "ball": ball(inside, boundary), "lamp": LAMP, "sky": FURNACE}


@pytest.mark.thorough
@pytest.mark.parametrize("boundary", ["null", *thorough("dielectric")])
@pytest.mark.parametrize(
    "inside",
    [
        cloud(),
        *thorough(
            cloud(sample_emitters=False, phase={"type": "hg", "g": 0.6}),
            cloud(sigma_t=grid(half=0.5)),
            cloud(phase=flakes(*ANISOTROPIC)),
            stock(sigma_t=2.0, albedo=RGB, phase=flakes(*ANISOTROPIC)),
            stock(sigma_t=2.0, albedo=grid()),
        ),
    ],
    ids=[
        "grid",
        "no connections",
        "smaller than the ball",
        "flakes",
        "homogeneous flakes",
        "albedo",
    ],
)
def test_grey_media_against_volpath(inside: Any, boundary: str) -> None:
    right = passes(scene("volpath", **parts(inside, boundary)), 2**6, 1, 3)
    # Mitsuba's sggx does not sample what it evaluates: their mean directions differ. Inside
    # glass volpath only samples, and so must ours for the same image.
    ours = {"type": "nonexp_volpath", "refractive_nee": "off"}
    integrator = ours if "sggx" in str(inside) else "nonexp_volpath"
    assert_same(passes(scene(integrator, **parts(inside, boundary)), 2**6, 2, 3), right, 0.05)


@THOROUGH
@pytest.mark.parametrize("variant", ["llvm_ad_rgb", "llvm_ad_spectral"], indirect=True)
@pytest.mark.parametrize("boundary", ["null", "dielectric"])
def test_coloured_grids_against_volpathmis(variant: str, boundary: str) -> None:
    inside = cloud(sigma_t=grid(3))
    right = passes(scene("volpathmis", **parts(inside, boundary)), 2**9, 1)
    assert_same(passes(scene(**parts(inside, boundary)), 2**9, 2), right, 0.05)


@THOROUGH
@pytest.mark.parametrize("boundary", ["null", "dielectric"])
def test_a_constant_grid_is_a_homogeneous_medium(boundary: str) -> None:
    for value in ([0.6], [0.8, 0.5, 0.1]):
        sigma_t = {"type": "rgb", "value": value} if len(value) == 3 else value[0]
        flat = cloud(sigma_t=grid(len(value), 1.1, value), scale=3.0)
        even = medium(sigma_t=sigma_t, scale=3.0, albedo=RGB)
        right = passes(scene(**parts(even, boundary)), 640, 1, channels=True)
        got = passes(scene(**parts(flat, boundary)), 640, 2, channels=True)
        for channel in range(3):
            assert_same(got[channel], right[channel], 0.05)


@THOROUGH
def test_an_invisible_surface_in_a_coloured_cloud_changes_nothing() -> None:
    ref = {"type": "ref", "id": "cloud"}
    place = mi.ScalarTransform4f().translate([0, 0, 0.2]).scale(0.6)
    within = {"bsdf": {"type": "null"}, "interior": ref, "exterior": ref}
    cut = {"cut": {"type": "rectangle", "to_world": place, **within}}
    whole, halves = (
        scene(cloud={**cloud(sigma_t=grid(3)), "id": "cloud"}, **parts(ref), **more)
        for more in ({}, cut)
    )
    right = passes(whole, 2**8, 1, channels=True)
    got = passes(halves, 2**8, 2, channels=True)
    for channel in range(3):
        assert_same(got[channel], right[channel], 0.05)


@THOROUGH
def test_grid_and_own_media_in_one_scene() -> None:
    """A cloud, a microflake ball and a glass ball, all exponential, in fog: several at once."""

    def several(fog: Any, glass: Any) -> dict[str, Any]:
        place, ref = mi.ScalarTransform4f(), {"type": "ref", "id": "fog"}
        cloudy = ball(cloud(sigma_t=grid(half=0.4)), radius=0.4)
        flaky = ball(stock(sigma_t=3.0, albedo=0.8, phase=flakes(*ANISOTROPIC)), radius=0.3)
        return {
            "fog": {**fog, "id": "fog"},
            "outer": ball(ref, radius=1.5),
            "a": {**cloudy, "exterior": ref},
            "b": {**flaky, "to_world": place.translate([0.8, 0, 0]), "exterior": ref},
            "c": {
                **ball(glass, "dielectric", 0.3),
                "to_world": place.translate([-0.8, 0, 0]),
                "exterior": ref,
            },
            "sensor": perspective([0, 0.4, 4], [0, 0, 0], 40),
            "lamp": LAMP,
            "sky": FURNACE,
        }

    fog, glass = {"sigma_t": 0.4, "albedo": 0.9}, {"sigma_t": 5.0, "albedo": 0.7}
    right = passes(scene("volpath", **several(stock(**fog), stock(**glass))), 2**6, 1, 3)
    ours = scene(**several(medium(**fog), medium(**glass)))
    assert_same(passes(ours, 2**6, 2, 3), right, 0.05)


@pytest.mark.parametrize("law", [*thorough("exponential", "linear", "quadratic"), "gamma"])
def test_microflakes_scale_extinction_by_their_projected_area(law: str) -> None:
    """Along z the projected area is the root of S_zz, whatever the law."""
    inside = medium(law, sigma_t=1.0, albedo=0.0, phase=flakes(0.9, 0.5, 0.16, 0, 0, 0))
    expected = models.create(law).ff(2 * math.sqrt(0.16))
    got = passes(scene(sensor=beam(), ball=ball(inside), sky=FURNACE), 2**12, 3)
    assert_mean(got, float(expected), 0.05)


@THOROUGH
def test_microflakes_of_one_channel_each() -> None:
    """volpathmis is 1 % off here; grey renders of each channel are the reference."""
    colour = {"type": "rgb", "value": [0.9, 0.5, 0.2]}
    kw = {"scale": 3.0, "albedo": 0.8, "phase": flakes(*ANISOTROPIC)}
    got = passes(scene(**parts(medium(sigma_t=colour, **kw))), 2**8, 2, channels=True)
    for channel, sigma_t in ((0, 0.9), (2, 0.2)):
        alone = passes(scene("volpath", **parts(stock(sigma_t=sigma_t, **kw))), 2**8, 1)
        assert_same(got[channel], alone, 0.05)


def test_microflakes_that_vary_in_space_are_refused() -> None:
    phase = {"type": "sggx", "S": {"type": "gridvolume", "grid": grid(6)["grid"]}}
    with pytest.raises(RuntimeError, match=r"phase\.S\S* varies in space"):
        mi.load_dict(medium(phase=phase))
