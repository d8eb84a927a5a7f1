"""Extinction that differs between channels: each channel must look as if it were alone.

The reference for one channel is the grey medium with that channel's extinction and albedo, which
involves no spectral sampling at all; for the exponential law it is rendered by Mitsuba's volpath.
"""

from __future__ import annotations

import math
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from build import (
    FURNACE,
    LAMP,
    NO_ROULETTE,
    ball,
    beam,
    medium,
    orthographic,
    perspective,
    scene,
    stock,
)
from measure import assert_mean, assert_same, passes, radiance
from scipy import integrate
from tiers import THOROUGH, quick

from nonexp import models

EXTINCTION = (3.0, 1.5, 0.4)
ALBEDO = (0.9, 0.7, 0.5)


def rgb(values: Any) -> dict[str, Any]:
    return {"type": "rgb", "value": [float(v) for v in values]}


def coloured(model: str, parameters: dict[str, Any] | None = None, **kw: Any) -> Any:
    """The medium of three extinctions; with ``channel=c`` the grey one of channel c."""
    channel = kw.pop("channel", None)
    sigma_t, albedo = kw.pop("sigma_t", EXTINCTION), kw.pop("albedo", ALBEDO)
    if channel is None:
        return medium(model, parameters, sigma_t=rgb(sigma_t), albedo=rgb(albedo), **kw)
    return medium(model, parameters, sigma_t=sigma_t[channel], albedo=albedo[channel], **kw)


def plain(inside: Any, boundary: str) -> dict[str, Any]:
    camera = perspective([0, 0.4, 3], [0, 0, 0], 50)
    return {"sensor": camera, "ball": ball(inside, boundary), "lamp": LAMP, "sky": FURNACE}


def cut_in_two(inside: Any) -> dict[str, Any]:
    """An invisible surface within the medium."""
    inside, ref = {**inside, "id": "inside"}, {"type": "ref", "id": "inside"}
    place = mi.ScalarTransform4f().translate([0, 0, 0.2]).scale(0.6)
    within = {"bsdf": {"type": "null"}, "interior": ref, "exterior": ref}
    cut = {"type": "rectangle", "to_world": place, **within}
    return {"medium": inside, **plain(ref, "null"), "cut": cut}


def in_fog(inside: Any) -> dict[str, Any]:
    """The ball in another medium, grey and of another law."""
    fog = {**medium("gamma", {"alpha": 0.5}, sigma_t=0.6, albedo=0.7), "id": "fog"}
    ref = {"type": "ref", "id": "fog"}
    parts = plain(inside, "null")
    parts["ball"] = {**parts["ball"], "radius": 0.6, "exterior": ref}
    return {"fog": fog, **parts, "outer": ball(ref)}


SCENES = {
    "null": lambda inside: plain(inside, "null"),
    "dielectric": lambda inside: plain(inside, "dielectric"),
    "rough": lambda inside: plain(inside, "roughdielectric"),
    "cut": cut_in_two,
    "fog": in_fog,
}
LAWS = [("exponential", {}), ("linear", {}), ("quadratic", {}), ("gamma", {"alpha": 0.3})]


@pytest.mark.parametrize("place", quick(SCENES, "null".__eq__))
@pytest.mark.parametrize("law", quick(LAWS, LAWS[1::2].__contains__), ids=lambda law: law[0])
def test_each_channel_is_what_it_were_alone(law: Any, place: str, effort: int) -> None:
    """Finds a bias of 4 % in a channel (exponential at null surfaces and linear in all: 2 channels
    with their own collision distances each)."""
    build = SCENES[place]
    count = 2**9 * effort
    together = passes(scene(**build(coloured(*law))), count, 1, channels=True)
    for channel in (0, 2):
        alone = passes(scene(**build(coloured(*law, channel=channel))), count, 2, channels=True)
        assert_same(together[channel], alone[channel], 0.05 / effort**0.5)


@THOROUGH
@pytest.mark.parametrize("boundary", ["null", "dielectric"])
@pytest.mark.parametrize("connects", [True, False])
def test_exponential_channels_against_volpath(boundary: str, connects: bool) -> None:
    """Ours, and Mitsuba's homogeneous medium in our integrator, against grey stock renders.

    Not against ``volpathmis``, which is wrong where the extinction of one channel is zero: there,
    the others come out too dark.
    """
    extinction = (2.5, 1.0, 0.0)
    kw = {"sample_emitters": connects, "phase": {"type": "hg", "g": 0.5}}
    sigma_t = {"sigma_t": rgb(e / 5 for e in extinction), "scale": 5.0}
    coloured = [make(**sigma_t, albedo=rgb(ALBEDO), **kw) for make in (medium, stock)]
    got = [passes(scene(**plain(inside, boundary)), 2**9, 2, channels=True) for inside in coloured]
    for channel in range(3):
        grey = stock(sigma_t=extinction[channel], albedo=ALBEDO[channel], **kw)
        right = passes(scene("volpath", **plain(grey, boundary)), 2**9, 1, channels=True)
        for image in got:
            assert_same(image[channel], right[channel], 0.05)


@pytest.mark.thorough
@pytest.mark.parametrize("variant", ["llvm_ad_spectral"], indirect=True)
@pytest.mark.parametrize("boundary", quick(["null", "dielectric"], "null".__eq__))
def test_hero_wavelengths_against_volpathmis(variant: str, boundary: str) -> None:
    """Mean over the wavelengths that a path carries.

    Stock refuses an rgb extinction above 1, ours scales it: the same spectrum in both.
    """
    kw = {"albedo": rgb(ALBEDO), "phase": {"type": "hg", "g": 0.5}}
    reference = stock(sigma_t=rgb(e / 3 for e in EXTINCTION), scale=3.0, **kw)
    right = passes(scene("volpathmis", **plain(reference, boundary)), 2**9, 1)
    for inside in (medium(sigma_t=rgb(EXTINCTION), **kw), reference):
        assert_same(passes(scene(**plain(inside, boundary)), 2**9, 2), right, 0.05)


@pytest.mark.parametrize("variant", ["llvm_ad_mono"], indirect=True)
def test_mono_has_one_channel(variant: str) -> None:
    inside = medium(sigma_t=rgb(EXTINCTION))
    assert not mi.load_dict(inside).chromatic
    assert np.all(np.isfinite(radiance(scene(**plain(inside, "null")), 64, 1)))


def test_absorbing_ball_per_channel() -> None:
    """(1/2R^2) times the integral of ff(sigma_t t) t over [0, 2R], for every law and channel."""
    radius = 1.3
    for name, parameters in LAWS:
        model = models.create(name, **parameters)
        inside = coloured(name, parameters, albedo=(0.0, 0.0, 0.0))
        built = scene(sensor=orthographic(radius), ball=ball(inside, radius=radius), sky=FURNACE)
        samples = radiance(built, 2**17, 4, channels=True)
        for channel, sigma_t in enumerate(EXTINCTION):
            end = 2 * radius * sigma_t
            area, _ = integrate.quad(lambda t, m=model: float(m.ff(t)) * t, 0, end, limit=200)
            expected = 1 - math.pi / 4 + math.pi / 4 * area / (2 * (radius * sigma_t) ** 2)
            assert_mean(samples[channel], expected, 0.05)


def test_linear_ball_with_exactly_one_scattering_per_channel() -> None:
    """Absorbed share (1-c) 4 R sigma_t/(3b) as long as 2 R sigma_t <= b."""
    extinction, b = (1.0, 0.6, 0.1), 2.0
    inside = coloured("linear", {"b": b}, sigma_t=extinction, sample_emitters=False)
    built = scene(NO_ROULETTE, sensor=orthographic(1.0), ball=ball(inside), sky=FURNACE)
    samples = radiance(built, 2**17, 5, channels=True)
    for got, sigma_t, albedo in zip(samples, extinction, ALBEDO, strict=True):
        absorbed = (1 - albedo) * 4 * sigma_t / (3 * b)
        assert_mean(got, 1 - math.pi / 4 * absorbed, 0.02)


@pytest.mark.parametrize("law", quick(LAWS, LAWS[1:2].__contains__), ids=lambda law: law[0])
def test_white_furnace_per_channel(law: Any) -> None:
    inside = coloured(*law, albedo=(1.0, 1.0, 1.0))
    built = scene(sensor=orthographic(1.1), ball=ball(inside), sky=FURNACE)
    for got in passes(built, 2**11, 6, channels=True):
        assert_mean(got, 1.0, 0.05)


def test_equal_extinctions_share_an_atom() -> None:
    """Two of three channels collide at the same distance: each path weighs them alike."""
    inside = coloured("linear", sigma_t=(2.0, 2.0, 0.7), albedo=(1.0, 1.0, 1.0))
    built = scene(NO_ROULETTE, sensor=beam(), ball=ball(inside), sky=FURNACE)
    first, second, third = radiance(built, 2**12, 7, channels=True)
    np.testing.assert_allclose(first, second, rtol=1e-5)
    assert not np.allclose(first, third)


def test_a_zero_channel_passes_unhindered() -> None:
    inside = coloured("quadratic", sigma_t=(2.0, 1.0, 0.0), albedo=(0.0, 0.0, 0.0))
    built = scene(sensor=beam(), ball=ball(inside), sky=FURNACE)
    assert_mean(radiance(built, 2**16, 8, channels=True)[2], 1.0, 0.05)


@THOROUGH
def test_extinction_can_gain_and_lose_its_colour() -> None:
    built = scene(**plain(medium(sigma_t=rgb([1, 1, 1]), albedo=0.5), "null"))
    parameters = mi.traverse(built)
    (key,) = (k for k in parameters.keys() if k.endswith("sigma_t.value.value"))
    for value in ([2.0, 1.0, 0.5], [1.5, 1.5, 1.5]):
        parameters[key] = mi.Color3f(value)
        parameters.update()
        got = passes(built, 2**9, 2, channels=True)
        for channel in range(3):
            grey = medium(sigma_t=value[channel], albedo=0.5)
            right = passes(scene(**plain(grey, "null")), 2**9, 1, channels=True)
            assert_same(got[channel], right[channel], 0.05)
