"""Whole renders under stress: scale, density, albedo, depth, thin and touching media, long paths.

Every render ends, is finite, and has a known answer as far as single precision and Mitsuba's rays
carry: a ray that leaves a surface starts 1e-4 (1 + |p|) scene units off it. What is smaller than
that is lost (in Mitsuba's own integrators too), and a mean free path shorter than the spacing of
coordinates, 6e-8 |p|, cannot be walked.
"""

from __future__ import annotations

import math
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from build import (
    DRAWN,
    FURNACE,
    NO_ROULETTE,
    SHUTTER,
    Case,
    ball,
    beam,
    box,
    law,
    medium,
    model_id,
    orthographic,
    perspective,
    recorder,
    scene,
)
from measure import assert_mean, assert_same, assert_share, passes, radiance
from scipy import stats
from tiers import THOROUGH, quick, thorough

pytestmark = pytest.mark.thorough

TABLE = {"tau": (0.0, 0.5, 1.0, 2.0), "ff": (1.0, 0.6, 0.35, 0.1)}
LAWS: list[Case] = [
    ("exponential", {}),
    ("gamma", {"alpha": 0.3}),
    ("linear", {"b": 1.5}),
    ("erlang", {"k": 2}),
    ("tabulated", TABLE),
]
"""Memoryless, heavy-tailed, Dirac, sums of several random numbers, looked up."""

every_law = pytest.mark.parametrize("case", quick(LAWS, LAWS[1:3].__contains__), ids=model_id)

ENDS = {**NO_ROULETTE, "max_depth": 100_000}
"""No roulette, and still an end for a path that rounding has let out of its medium."""


def physical(samples: Any) -> Any:
    """Finite and not negative."""
    assert np.all(np.isfinite(samples))
    assert np.all(samples >= 0)
    return samples


# ------------------------------------------------------------------------------- scale


def world(case: Case, scale: float, **kw: Any) -> Any:
    """A ball in a white sky, all lengths times ``scale``."""
    camera = {**orthographic(scale, 5 * scale), "near_clip": 0.01 * scale, "far_clip": 20 * scale}
    inside = medium(*case, sigma_t=2 / scale, albedo=0.8, **kw)
    return scene(sensor=camera, ball=ball(inside, radius=scale), sky=FURNACE)


@every_law
@pytest.mark.parametrize("scale", [*thorough(0.1, 1e3), 1e6, *thorough(1e8)])
def test_scaled_scene_is_the_same_image(case: Case, scale: float, effort: int) -> None:
    one, scaled = (
        passes(world(case, s), 512 * effort, seed, 3) for s, seed in ((1.0, 1), (scale, 2))
    )
    assert_same(one, physical(scaled), 0.04 / effort**0.5)


@every_law
@pytest.mark.parametrize("scale", [1e-12, *thorough(1e-6), 1e-3, *thorough(1e-2, 1e2)])
@pytest.mark.parametrize("connecting", [True, False], ids=["shadow rays", "flights"])
def test_scaled_scene_takes_the_same_paths(case: Case, scale: float, connecting: bool) -> None:
    """Same random numbers: only rounding differs, which sends few paths another way."""
    one, scaled = (
        radiance(world(case, s, sample_emitters=connecting), 2**16, 3) for s in (1.0, scale)
    )
    assert abs(physical(scaled).mean() / one.mean() - 1) < 2e-3


# ------------------------------------------------------------------------------- density


@every_law
@pytest.mark.parametrize("connecting", [True, False], ids=["shadow rays", "flights"])
def test_hardly_any_medium(case: Case, connecting: bool) -> None:
    for sigma_t, lost in ((0.0, 0.0), (1e-8, 1e-3)):
        inside = medium(*case, sigma_t=sigma_t, albedo=0.5, sample_emitters=connecting)
        built = scene(sensor=orthographic(1.2), ball=ball(inside), sky=FURNACE)
        assert physical(radiance(built, 2**14, 5)).mean() >= 1 - lost


@every_law
@pytest.mark.parametrize("sigma_t", [*thorough(1e4), 1e8, *thorough(1e20)])
def test_opaque_medium(case: Case, sigma_t: float) -> None:
    """What crosses is ff, and it reflects at most the albedo of its collisions."""
    for albedo in (0.0, 0.5):
        for connecting in (True, False):
            inside = medium(*case, sigma_t=sigma_t, albedo=albedo, sample_emitters=connecting)
            for fog in (ball(inside), box(inside, [-1, -1, -1], [1, 1, 0])):
                samples = physical(radiance(scene(sensor=beam(), fog=fog, sky=FURNACE), 2**14, 6))
                crossing = float(law(case).ff(sigma_t))
                assert samples.mean() <= albedo + 2 * crossing


HALF_SPACE = [(0.5, 0.146544381), (0.9, 0.478024489), (0.99, 0.794563653)]


@pytest.mark.parametrize(
    ("albedo", "reflected"), quick(HALF_SPACE, HALF_SPACE[:1].__contains__, True)
)
def test_ball_of_ten_thousand_mean_free_paths_is_a_half_space(
    albedo: float, reflected: float
) -> None:
    """Albedo under a white sky: exponential, and erlang with its closed form."""
    s = math.sqrt(1 - albedo)
    erlang: Case = ("erlang", {"k": 2, "rate": 1.0})
    for case, expected in ((LAWS[0], reflected), (erlang, (1 - s) / (1 + s))):
        inside = medium(*case, sigma_t=1e4, albedo=albedo)
        samples = radiance(
            scene(sensor=orthographic(1.0), ball=ball(inside), sky=FURNACE), 2**19, 7
        )
        assert_mean(samples, 1 - math.pi / 4 * (1 - expected), 0.03, rounding=1e-3)


# ------------------------------------------------------------------------------- albedo and depth


@every_law
@pytest.mark.parametrize("albedo", [0.0, 1.0])
@pytest.mark.parametrize("max_depth", [-1, 0, 1])
@pytest.mark.parametrize("connecting", [True, False], ids=["shadow rays", "flights"])
def test_ends_of_albedo_and_depth(
    case: Case, albedo: float, max_depth: int, connecting: bool
) -> None:
    """No path, or none that scatters: what crosses is ff; else a furnace."""
    inside = medium(*case, sigma_t=0.4, albedo=albedo, sample_emitters=connecting)
    integrator = {**DRAWN, "max_depth": max_depth}
    built = scene(integrator, sensor=beam(), ball=ball(inside), sky=FURNACE)
    samples = physical(radiance(built, 2**15, 8))
    if max_depth == 0:
        assert np.all(samples == 0)
    elif albedo == 0 or max_depth == 1:
        assert_share(samples, float(law(case).ff(0.8)))
    else:
        assert_mean(samples, 1.0, 0.1)


# ------------------------------------------------------------------------------- boundaries


@every_law
@pytest.mark.parametrize("thickness", [*thorough(1e-2), 1.2e-4, *thorough(1e-5)])
def test_thin_slab(case: Case, thickness: float) -> None:
    """Down to about the distance by which rays stand off its faces."""
    for depth in (1e-3, 0.7):
        absorbing = medium(*case, sigma_t=depth / thickness, albedo=0.0)
        fog = box(absorbing, [-1, -1, -thickness], [1, 1, 0])
        samples = radiance(scene(DRAWN, sensor=beam(), fog=fog, sky=FURNACE), 2**15, 9)
        assert_share(samples, float(law(case).ff(depth)))
    white = medium(*case, sigma_t=0.7 / thickness, albedo=1.0, sample_emitters=False)
    fog = box(white, [-1, -1, -thickness], [1, 1, 0])
    assert np.all(radiance(scene(ENDS, sensor=beam(), fog=fog, sky=FURNACE), 2**14, 10) == 1)


@every_law
@pytest.mark.parametrize("thickness", [*thorough(1e-6), 1e-7])
def test_slab_thinner_than_the_offset_of_rays_makes_no_light(case: Case, thickness: float) -> None:
    """Rays that enter it stand behind it, in the medium for all they know."""
    for albedo in (0.0, 1.0):
        inside = medium(*case, sigma_t=0.7 / thickness, albedo=albedo)
        fog = box(inside, [-1, -1, -thickness], [1, 1, 0])
        samples = physical(radiance(scene(sensor=beam(), fog=fog, sky=FURNACE), 2**14, 11))
        assert samples.mean() <= 1 + 5 * stats.sem(samples.ravel())


@every_law
@pytest.mark.parametrize("depth", [*thorough(0.0), 1e-7, *thorough(1e-5)])
def test_camera_on_the_boundary(case: Case, depth: float) -> None:
    """Looking in, from as far below the surface."""
    fog = {"type": "ref", "id": "fog"}
    camera = {**perspective([0, 0, 1 - depth], [0, 0, 0], 0.01), "near_clip": 1e-6, "medium": fog}
    built = scene(
        DRAWN,
        sensor=camera,
        fog={**medium(*case, sigma_t=0.4, albedo=0.0), "id": "fog"},
        ball=ball(fog),
        sky=FURNACE,
    )
    samples = radiance(built, 2**15, 12)
    assert_share(samples, float(law(case).ff(0.8)))


def lamp(z: float) -> dict[str, Any]:
    to_world = mi.ScalarTransform4f().translate([0, 0, z]).scale(3)
    light = {"type": "area", "radiance": 1.0}
    return {"type": "rectangle", "to_world": to_world, "emitter": light}


@every_law
@pytest.mark.parametrize("sunk", [*thorough(1e-2), 1e-5, *thorough(1e-7, 0.0)])
@pytest.mark.parametrize("connecting", [True, False], ids=["shadow rays", "flights"])
def test_medium_that_stands_on_a_lamp(
    case: Case, sunk: float, connecting: bool, effort: int
) -> None:
    """A box on a luminous floor shows what it shows when it sinks in a little.

    Where the faces coincide a ray may meet either first: light can get lost, but none is made.
    """
    settings = {"albedo": 0.9, "sigma_t": 0.7, "sample_emitters": connecting}

    def build(gap: float) -> Any:
        fog = box(medium(*case, **settings), [-1, -1, -1 - gap], [1, 1, 0])
        return scene(
            {"type": "nonexp_volpath", "max_depth": 3}, sensor=beam(), fog=fog, lamp=lamp(-1)
        )

    got, expected = (
        passes(build(gap), 256 * effort, seed) for gap, seed in ((sunk, 13), (0.01, 14))
    )
    if sunk:
        assert_same(physical(got), expected, 0.1 / effort**0.5)
    else:
        assert physical(got).mean() < expected.mean() + 5 * stats.sem(expected.ravel())


@every_law
def test_point_light_on_the_boundary(case: Case, effort: int) -> None:
    """Single scattering is continuous as the light passes through the surface."""

    def build(r: float) -> Any:
        inside = medium(*case, sigma_t=1.0, albedo=1.0)
        bulb = {"type": "point", "position": [0, r, 0], "intensity": 1.0}
        integrator = {"type": "nonexp_volpath", "max_depth": 2}
        return scene(integrator, sensor=orthographic(0.7), ball=ball(inside), bulb=bulb)

    outside = passes(build(1.0005), 512 * effort, 15)
    for r in (1.0, 1 - 1e-6):
        assert_same(outside, physical(passes(build(r), 512 * effort, 16)), 0.2 / effort**0.5)


@every_law
def test_grazing_views(case: Case) -> None:
    """A slab seen at cosines down to 1e-6, a ball's rim down to 1e-4 radii from its edge."""
    mu = 0.01
    absorbing = medium(*case, sigma_t=mu, albedo=0.0)
    camera = orthographic(1e-6, side=(math.sqrt(1 - mu**2), 0, mu))
    fog = box(absorbing, [-100, -100, -0.5], [100, 100, 0])
    samples = radiance(scene(DRAWN, sensor=camera, fog=fog, sky=FURNACE), 2**15, 17)
    assert_share(samples, float(law(case).ff(0.5)))

    white = medium(*case, sigma_t=1.0, albedo=1.0, sample_emitters=False)
    for mu in (1e-3, 1e-6):
        camera = orthographic(1e-6, side=(math.sqrt(1 - mu**2), 0, mu))
        fog = box(white, [-100, -100, -0.5], [100, 100, 0])
        assert np.all(radiance(scene(ENDS, sensor=camera, fog=fog, sky=FURNACE), 2**12, 18) == 1)
    for rim in (1e-2, 1e-4):
        half = math.sqrt(1 - (1 - rim) ** 2)
        camera = orthographic(1e-6)
        camera["to_world"] = mi.ScalarTransform4f().translate([1 - rim, 0, 0]) @ camera["to_world"]
        fog = ball(medium(*case, sigma_t=1 / half, albedo=1.0, sample_emitters=False))
        assert np.all(radiance(scene(ENDS, sensor=camera, fog=fog, sky=FURNACE), 2**12, 19) == 1)


# ------------------------------------------------------------------------------- long paths


@THOROUGH
@pytest.mark.parametrize("case", LAWS[:4], ids=model_id)
def test_path_of_a_million_collisions(case: Case) -> None:
    """From the middle of a white ball of a thousand mean free paths; no roulette, no limit.

    A random walk of steps of mean square m2 leaves after (sigma R)^2/m2 collisions on average.
    """
    m2 = {"exponential": 2.0, "linear": 1.5**2, "erlang": 1.5}.get(case[0])
    depth = 1000 * math.sqrt((m2 or 2.0) / 1.1)
    phase, fog = recorder(), {"type": "ref", "id": "fog"}
    settings = {"albedo": 1.0, "sample_emitters": False, "phase": phase}
    camera = {**perspective([0, 0, 0], [0, 0, 1]), "near_clip": 1e-6, "medium": fog, **SHUTTER}
    built = scene(
        {"type": "nonexp_volpath", "rr_depth": 2**31 - 1},
        sensor=camera,
        fog={**medium(*case, sigma_t=depth, **settings), "id": "fog"},
        ball=ball(fog),
        sky=FURNACE,
    )
    count = 32
    assert np.all(radiance(built, count, 20) == 1)
    collisions = phase.sums().sum() / count
    if m2:
        assert collisions == pytest.approx(depth**2 / m2, rel=0.6)  # 5 standard errors
        assert collisions * count > 1e6


@every_law
def test_white_paths_end_by_roulette(case: Case) -> None:
    """Also in a medium without end, which they cannot leave."""
    fog = {"type": "ref", "id": "fog"}
    built = scene(
        sensor={**perspective([0, 0, 0], [0, 0, 1]), "medium": fog, "far_clip": 1e30},
        fog={**medium(*case, sigma_t=1e3, albedo=1.0), "id": "fog"},
        sky=FURNACE,
    )
    assert np.all(physical(radiance(built, 2**16, 21)) == 0)
