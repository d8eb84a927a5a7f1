"""Exponential media through nonexp_volpath against Mitsuba's own volpath, block by block."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from build import scene, stock
from measure import assert_same, passes
from tiers import THOROUGH, quick, thorough

from nonexp.testing.exponential import CASES, COUNT, GRID, POWER, lobe, nested

pytestmark = pytest.mark.thorough


def both(
    build: Callable[..., dict[str, Any]],
    count: int,
    grid: int = GRID,
    depth: int = -1,
    refractive_nee: str = "auto",
    **kw: Any,
) -> tuple[Any, Any]:
    options = {"max_depth": depth, "refractive_nee": refractive_nee, **kw}
    ours = scene({"type": "nonexp_volpath", **options}, **build(drop_in))
    theirs = scene({"type": "volpath", "max_depth": depth, **kw}, **build(stock))
    return passes(ours, count, 1, grid), passes(theirs, count, 2, grid)


def drop_in(**kw: Any) -> Any:
    """Our medium as one writes Mitsuba's: without a nested law, exponential by default."""
    return {"type": "nonexp_homogeneous", **kw}


@pytest.mark.parametrize("case", quick(CASES, {"null-area", "dielectric-constant"}.__contains__))
def test_same_image_as_volpath(case: str, effort: int) -> None:
    within = POWER.get(case, 0.012) / effort**0.5
    # Mitsuba has no way to find a point light through glass.
    nee = "off" if case == "dielectric-point" else "auto"
    assert_same(*both(CASES[case], COUNT.get(case, 512) * effort, refractive_nee=nee), within)


@THOROUGH
def test_stock_media_beside_ours_render_as_they_are(effort: int) -> None:
    ours = scene("nonexp_volpath", **nested(drop_in, stock))
    theirs = scene("volpath", **nested(stock, stock))
    a, b = passes(ours, 64 * effort, 3, GRID), passes(theirs, 64 * effort, 4, GRID)
    assert_same(a, b, POWER["nested"] / effort**0.5)


@THOROUGH
def test_stock_media_alone_render_as_they_are(effort: int) -> None:
    ours = scene("nonexp_volpath", **lobe(stock, "null", "area"))
    theirs = scene("volpath", **lobe(stock, "null", "area"))
    a, b = passes(ours, 1024 * effort, 5, GRID), passes(theirs, 1024 * effort, 6, GRID)
    assert_same(a, b, 0.012 / effort**0.5)


@pytest.mark.parametrize("depth", [*thorough(0, 1), 2, *thorough(3)])
@pytest.mark.parametrize("hide", [False, True], ids=["shown", "hidden"])
def test_depth_and_hidden_emitters_as_mitsuba_counts_them(depth: int, hide: bool) -> None:
    """Seen from below, so that the lamp stands before the sky and above the fog."""

    def build(make: Callable[..., Any]) -> dict[str, Any]:
        parts = lobe(make, "null", "area")
        lamp = mi.ScalarTransform4f().translate([0.3, 0.5, 2.0]).scale(0.4)
        parts["emitter"]["to_world"] = lamp
        parts["emitter"]["flip_normals"] = False
        return {**parts, "sky": {"type": "constant", "radiance": 0.5}}

    a, b = both(build, 200, depth=depth, hide_emitters=hide)
    assert_same(a, b, 0.02)


@THOROUGH
@pytest.mark.parametrize("case", ["null-area", "dielectric-constant", "camera inside, area"])
@pytest.mark.parametrize("variant", ["llvm_ad_mono", "llvm_ad_spectral"], indirect=True)
def test_same_image_in_other_variants(variant: str, case: str) -> None:
    within = 3 * POWER.get(case, 0.012)
    assert_same(*both(CASES[case], 192), within)


@pytest.mark.parametrize("far", [*thorough(3.5), 4.2, *thorough(1e4)])
@pytest.mark.parametrize("where", ["null-constant", *thorough("camera inside, area")])
def test_far_clip_as_mitsuba_takes_it(where: str, far: float) -> None:
    def build(make: Callable[..., Any]) -> dict[str, Any]:
        parts = CASES[where](make)
        parts["sensor"]["far_clip"] = far
        return parts

    count, within = (16, 0.02) if where == "null-constant" else (256, 0.05)
    assert_same(*both(build, count), within)


BACKS = ["diffuse", "plastic", "roughconductor", "dielectric", "null"]


@pytest.mark.parametrize("hide", [*thorough(False), True], ids=["shown", "hidden"])
def test_alpha_as_mitsuba_counts_it(hide: bool) -> None:
    """Also on the back of one-sided surfaces, which scatter nothing: each covers four pixels."""
    place = mi.ScalarTransform4f()
    corners = [(1.3, 0.9), (1.3, 0.1), (1.3, -0.7), (-1.3, 0.9), (-1.3, 0.1)]
    backs = {
        bsdf: {
            "type": "rectangle",
            "to_world": place.translate([x, y, 0.3]).rotate([0, 1, 0], 180).scale(0.35),
            "bsdf": {"type": bsdf},
        }
        for bsdf, (x, y) in zip(BACKS, corners, strict=True)
    }

    def opacity(make: Callable[..., Any], integrator: str) -> Any:
        parts = {**lobe(make, "null", "area"), **backs}
        camera = parts["sensor"]
        camera["film"] = {**camera["film"], "pixel_format": "rgba", "width": 16, "height": 16}
        built = scene({"type": integrator, "hide_emitters": hide}, **parts)
        return np.array(mi.render(built, spp=1024, seed=3))[:, :, 3]

    ours, theirs = opacity(drop_in, "nonexp_volpath"), opacity(stock, "volpath")
    both = (ours + theirs) / 2
    error = np.sqrt((both * (1 - both) + 1e-6) / 1024 * 2)
    # 5.5 sigma over 256 pixels: 1e-5. Finds a pixel's alpha off by 0.15, on edges too.
    assert np.max(np.abs(ours - theirs) / error) < 5.5


@pytest.mark.parametrize("phase", [*thorough("isotropic", "rayleigh", "hg"), "blendphase"])
def test_phase_functions(phase: str) -> None:
    given: dict[str, Any] = {"type": phase}
    if phase == "hg":
        given["g"] = -0.6
    if phase == "blendphase":
        forward, backward = {"type": "hg", "g": 0.8}, {"type": "hg", "g": -0.4}
        given = {"type": phase, "weight": 0.3, "forward": forward, "backward": backward}

    def build(make: Callable[..., Any]) -> dict[str, Any]:
        parts = lobe(make, "null", "directional")
        parts["lobe"]["interior"]["phase"] = given
        return parts

    assert_same(*both(build, 512), within=0.02)
