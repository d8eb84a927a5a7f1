"""Small scenes after public bug reports: each once gave a wrong image, or none."""

from __future__ import annotations

import multiprocessing
import subprocess
import sys
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from build import medium, perspective, scene
from tiers import quick, thorough

from nonexp.integrators import report
from nonexp.integrators.needs import SceneNeeds, forgotten_media

if mi.variant() is None:
    mi.set_variant("llvm_ad_rgb")  # in a process of its own
T = mi.ScalarTransform4f()
NULL = {"type": "null"}
FLOOR = {
    "type": "rectangle",
    "to_world": T.translate([0, -1.2, 0]).rotate([1, 0, 0], -90).scale(4),
    "bsdf": {"type": "diffuse", "reflectance": 0.6},
}
LAMP = {
    "type": "rectangle",
    "to_world": T.translate([0, 1.9, 0]).rotate([1, 0, 0], 90).scale(0.6),
    "emitter": {"type": "area", "radiance": 5.0},
}


def mean(integrator: str, spp: int, seeds: int = 4, depth: int = 12, **parts: Any) -> Any:
    """Mean of the image, by channel, and its standard error."""
    built = scene(**parts, integrator={"type": integrator, "max_depth": depth})
    images = [
        np.array(mi.render(built, spp=spp, seed=k))[..., :3].mean((0, 1)) for k in range(seeds)
    ]
    return np.mean(images, axis=0), np.std(images, axis=0, ddof=1) / np.sqrt(seeds)


# ------------------------------------------------------------------------------ loops end


def _within(seconds: float, name: str) -> float:
    """The mean of one of the scenes below, in a process that is ended if it does not end."""
    context = multiprocessing.get_context("spawn")
    pipe, theirs = context.Pipe(duplex=False)
    process = context.Process(target=_endless, args=(theirs, name), daemon=True)
    process.start()
    try:
        assert pipe.poll(seconds), "the render does not end"
        value: float = pipe.recv()
    finally:
        process.kill()
        process.join()
    return value


def _endless(pipe: Any, name: str) -> None:
    mi.set_variant("llvm_ad_rgb")
    mi.set_log_level(mi.LogLevel.Error)
    film = {"type": "hdrfilm", "width": 64, "height": 64, "rfilter": {"type": "box"}}
    rest: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "nonexp_volpath", "max_depth": 16},
        "camera": {
            "type": "perspective",
            "to_world": T.look_at([0, 0, 4], [0, 0, 0], [0, 1, 0]),
            "film": film,
        },
    }
    lamp = {"type": "area"}
    mask = {"type": "mask", "opacity": 0.3, "nested": {"type": "diffuse"}}
    fog = {"type": "sphere", "bsdf": NULL, "interior": {"type": "homogeneous"}}
    side = T.translate([0, 0, -1]).scale(2)
    parts = {
        "lamp": {"ball": {**fog, "emitter": lamp}},
        "mask": {"ball": fog, "lamp": {"type": "rectangle", "bsdf": mask, "emitter": lamp}},
        "plane": {
            "wall": {"type": "rectangle", "to_world": side},
            "lamp": {"type": "rectangle", "to_world": side, "bsdf": NULL, "emitter": lamp},
            "ball": fog,
        },
    }[name]
    image = np.array(mi.render(mi.load_dict({**rest, **parts}), spp=64))
    pipe.send(float(image[..., :3].mean()))


@pytest.mark.parametrize(
    ("name", "value"),
    [("lamp", 0.5595), *thorough(("mask", None), ("plane", None), several=True)],
)
def test_render_ends(name: str, value: float | None) -> None:
    """Targets of shadow rays on surfaces that let light through, and walls in such a plane."""
    found = _within(120, name)
    assert np.isfinite(found) and found > 0
    if value is not None:
        assert found == pytest.approx(value, abs=0.003)


@pytest.mark.thorough
def test_a_lamp_with_a_mask_is_as_by_mitsuba() -> None:
    mask = {"type": "mask", "opacity": 0.3, "nested": {"type": "diffuse"}}
    lamp = {**LAMP, "bsdf": mask}
    fog = {"type": "sphere", "bsdf": NULL, "interior": {"type": "homogeneous", "albedo": 0.8}}
    rest = {
        "camera": perspective([0, 0.3, 5], [0, 0, 0]),
        "lamp": lamp,
        "floor": FLOOR,
        "ball": fog,
    }
    ours, error = mean("nonexp_volpath", 256, **rest)
    theirs, their_error = mean("volpath", 256, **rest)
    assert np.all(np.abs(ours - theirs) < 5 * np.hypot(error, their_error) + 1e-3 * theirs)


# ------------------------------------------------------------------------------ cameras inside


@pytest.mark.parametrize("shape", ("sphere", "cube"))
def test_a_camera_in_fog_that_it_does_not_refer_to(shape: str) -> None:
    """Its rays and the shadow rays of what they hit are in vacuum until they leave the shape."""
    camera = {**perspective([0, 0, 0.5], [0, 0, 0]), "fov": 10, "near_clip": 0.01}
    value, _ = mean(
        "nonexp_volpath",
        64,
        depth=4,
        camera=camera,
        light={"type": "point", "position": [0, 3, 3], "intensity": 20.0},
        fog={"type": shape, "bsdf": NULL, "interior": medium(sigma_t=1.0, albedo=0.0)},
        wall={"type": "rectangle", "to_world": T.scale(0.5)},
    )
    exact = 20 / 18 * np.cos(np.pi / 4) * 0.5 / np.pi  # in the middle
    np.testing.assert_allclose(value, exact, rtol=2e-3)


@pytest.mark.parametrize("shape", ("sphere", "cube", "rectangle"))
def test_a_camera_in_fog_is_told(shape: str) -> None:
    fog = {"type": shape, "bsdf": NULL, "interior": medium()}
    inside, outside = perspective([0.2, 0.3, 0.5], [0, 0, 0]), perspective([0, 0, 4], [0, 0, 0])
    found = forgotten_media(scene(camera=inside, fog=fog))
    assert len(found) == (0 if shape == "rectangle" else 1)
    assert not forgotten_media(scene(camera=outside, fog=fog))
    shared = {"type": "ref", "id": "shared"}
    knows = {"camera": {**inside, "medium": shared}, "fog": {**fog, "interior": shared}}
    assert not forgotten_media(scene(shared={**medium(), "id": "shared"}, **knows))
    rows = {row.question: row.answer for row in report.findings(scene(camera=inside, fog=fog))}
    told = rows["sensors in a medium that they do not refer to"]
    assert told == "none" if shape == "rectangle" else told.startswith("camera in ")


# ------------------------------------------------------------------------------ silent surfaces


def _flat(kind: str, nested: dict[str, Any]) -> dict[str, Any]:
    """A BSDF that bends no normal, and tells nothing of what passes its nested one."""
    up = np.full((4, 4, 3), (0.5, 0.5, 1.0), dtype=np.float32)
    if kind == "normalmap":
        texture = {"type": "bitmap", "bitmap": mi.Bitmap(up), "raw": True}
        return {"type": kind, "normalmap": texture, "nested": nested}
    texture = {"type": "bitmap", "bitmap": mi.Bitmap(up[..., :1] * 0), "raw": True}
    return {"type": kind, "arbitrary": texture, "nested": nested}


LEAVES = {
    "mask": {"type": "mask", "opacity": 0.3, "nested": {"type": "diffuse"}},
    "blend": {"type": "blendbsdf", "weight": 0.4, "a": {"type": "diffuse"}, "b": NULL},
    "thin": {"type": "thindielectric"},
    "null": NULL,
}


@pytest.mark.parametrize(
    ("around", "leaf"),
    quick(
        [*(("normalmap", leaf) for leaf in LEAVES), ("bumpmap", "mask"), ("mixed", "mask")],
        lambda case: case == ("normalmap", "mask"),
        several=True,
    ),
)
def test_surfaces_that_do_not_tell_what_passes(around: str, leaf: str) -> None:
    """A leaf under a lamp is as by ``path``, which asks no surface what passes."""
    nested = LEAVES[leaf]
    if around == "mixed":  # one half tells, the other does not
        bsdf = {"type": "blendbsdf", "weight": 0.5, "a": _flat("normalmap", nested), "b": nested}
    else:
        bsdf = _flat(around, nested)
    to_world = T.translate([0, 0.6, 0]).rotate([1, 0, 0], 90).scale(1.5)
    rest = {
        "camera": perspective([0, 0.3, 5], [0, 0, 0]),
        "lamp": LAMP,
        "floor": FLOOR,
        "leaf": {"type": "rectangle", "to_world": to_world, "bsdf": bsdf},
    }
    assert SceneNeeds.of(scene(**rest)).silent
    ours, error = mean("nonexp_volpath", 1024, depth=8, **rest)
    theirs, their_error = mean("path", 1024, depth=8, **rest)
    noise = np.hypot(error, their_error)
    assert np.all(noise < 0.04 * theirs)  # it was 46 % too dark
    assert np.all(np.abs(ours - theirs) < 5 * noise)


@pytest.mark.parametrize("leaf", LEAVES)
def test_surfaces_that_tell_are_asked(leaf: str) -> None:
    built = scene(leaf={"type": "rectangle", "bsdf": LEAVES[leaf]}, lamp=LAMP)
    assert not SceneNeeds.of(built).silent


# ------------------------------------------------------------------------------ bounds are bounds


@pytest.mark.parametrize("variant", ("llvm_ad_rgb", "llvm_ad_spectral"), indirect=True)
def test_majorant_of_a_coloured_volume(variant: str) -> None:
    colour = {"type": "rgb", "value": [0.5, 0.4, 0.3]}
    volume = {"type": "constvolume", "value": colour, "to_world": T.translate(-0.5)}
    fog = {"type": "heterogeneous", "albedo": 0.0, "scale": 5.0, "sigma_t": volume}
    film = {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}}
    look = T.look_at([0, 0, 5], [0, 0, 0], [0, 1, 0]).scale(0.3)
    value, error = mean(
        "nonexp_volpath",
        4096,
        camera={"type": "orthographic", "to_world": look, "film": film},
        box={"type": "cube", "to_world": T.scale(0.5), "bsdf": NULL, "interior": fog},
        sky={"type": "constant"},
    )
    rgb = np.exp(-5 * np.array([0.5, 0.4, 0.3]))
    exact = rgb if variant.endswith("rgb") else [0.0786, 0.1347, 0.2209]
    assert np.all(error < 0.02 * rgb)
    assert np.all(np.abs(value - exact) < 5 * error + 5e-4)


# ------------------------------------------------------------------------------ derivatives


BACKWARD = """
import drjit as dr, mitsuba as mi, nonexp
mi.set_variant("llvm_ad_rgb")
wall = {"type": "rectangle", "bsdf": {"type": "diffuse"}}
lamp = {"type": "point", "position": [0, 0, 5]}
scene = {"type": "scene", "i": {"type": "nonexp_volpath"}, "c": {"type": "perspective"}}
built = mi.load_dict({**scene, "wall": wall, "lamp": lamp})
parameters = mi.traverse(built)
dr.enable_grad(parameters["wall.bsdf.reflectance.value"])
parameters.update()
dr.backward(dr.mean(built.integrator().render(built, spp=1), axis=None))
"""


@pytest.mark.thorough
def test_a_derivative_that_fails_ends_with_its_message() -> None:
    """Reverse mode through a symbolic loop: an exception, and no crash at exit."""
    done = subprocess.run([sys.executable, "-c", BACKWARD], capture_output=True, text=True)
    assert done.returncode == 1
    assert "max_iterations" in done.stderr


@pytest.mark.thorough
@pytest.mark.parametrize("mode", ("forward", "backward"))
def test_derivatives_through_an_evaluated_loop(mode: str) -> None:
    """As by Mitsuba's path tracer, with the same random numbers."""
    found = []
    with dr.scoped_set_flag(dr.JitFlag.SymbolicLoops, False):
        for integrator in ("nonexp_volpath", "path"):
            built = scene(
                camera=perspective([0, 0, 4], [0, 0, 0]),
                wall={"type": "rectangle", "bsdf": {"type": "diffuse"}},
                light={"type": "point", "position": [0, 0, 5]},
                integrator={"type": integrator, "max_depth": 3},
            )
            parameters, x = mi.traverse(built), mi.Float(0.1)
            dr.enable_grad(x)
            parameters["wall.bsdf.reflectance.value"] += x
            parameters.update()
            image = dr.mean(built.integrator().render(built, spp=16), axis=None)
            if mode == "forward":
                dr.forward(x)
                found.append(float(dr.grad(image).array[0]))
            else:
                dr.backward(image)
                found.append(float(dr.grad(x)[0]))
    assert found[0] == pytest.approx(found[1], rel=0.02)
    assert found[0] > 0
