"""Derivatives of images: exact values, differences of renders, and what is refused."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from build import (
    FURNACE,
    LAMP,
    MODELS,
    QUICK,
    ball,
    box,
    law,
    medium,
    model_id,
    orthographic,
    perspective,
    scene,
    square_film,
    stock,
)
from tiers import THOROUGH, quick, thorough

import nonexp
from nonexp import inverse, models
from nonexp.integrators.replay import replay

LONG = {"type": "nonexp_volpath", "rr_depth": 1000}
SIGMA, ALBEDO = (
    "ball.interior_medium.sigma_t.value.value",
    "ball.interior_medium.albedo.value.value",
)
SIGMAS = 5.0
"""Standard errors that a comparison may be off: of a hundred, one in 2e4 fails by chance."""


def attached(parameters: Any, *names: str) -> list[Any]:
    """Scene parameters with gradients."""
    for name in names:
        value = type(parameters[name])(dr.detach(parameters[name]))
        dr.enable_grad(value)
        parameters[name] = value
    parameters.update()
    return [parameters[name] for name in names]


def means(made: Any, names: list[str], spp: int, seeds: int) -> Any:
    """Derivatives of the mean of the image, backward: (seeds, names)."""
    parameters = mi.traverse(made)
    found = []
    for seed in range(seeds):
        values = attached(parameters, *names)
        dr.backward(dr.mean(mi.render(made, parameters, spp=spp, seed=seed), axis=None))
        found.append([float(np.sum(np.array(dr.grad(value)))) for value in values])
    for name in names:
        parameters[name] = type(parameters[name])(dr.detach(parameters[name]))
    parameters.update()
    return np.array(found)


def assert_near(samples: Any, expected: Any, within: float, error: Any = 0.0) -> None:
    """The mean of samples is expected; a relative error of ``within`` would be found."""
    own = samples.std(axis=0, ddof=1) / math.sqrt(len(samples))
    error = np.hypot(own, error)
    assert np.all(SIGMAS * error <= within * np.abs(expected)), f"too weak: {error / expected}"
    scores = (samples.mean(axis=0) - expected) / error
    assert np.all(np.abs(scores) < SIGMAS), (samples.mean(axis=0), expected, scores)


# ---------------------------------------------------------------------- exact values


@pytest.mark.parametrize(
    ("albedo", "by_sigma", "by_albedo"),
    [(0.5, -0.19466, 0.42045), *thorough((0.9, -0.04925, 0.50002), several=True)],
)
def test_an_erlang_ball(albedo: float, by_sigma: float, by_albedo: float) -> None:
    """Mean over the square around it, under a white sky, by extinction and albedo."""
    inside = medium("erlang", {"k": 2, "rate": 1.0}, sigma_t=1.0, albedo=albedo)
    made = scene(LONG, sensor=orthographic(), ball=ball(inside), sky=FURNACE)
    found = means(made, [SIGMA, ALBEDO], 2**10, 6)
    assert_near(found, np.array([by_sigma, by_albedo]), 0.06)


@pytest.mark.parametrize(
    ("case", "exact"),
    [
        (("exponential", {}), -0.25394),
        (("gamma", {"alpha": 0.5}), -0.14472),
        *thorough((("erlang", {"k": 2, "rate": 1.0}), -0.29529), several=True),
    ],
)
def test_an_absorbing_ball(case: Any, exact: float) -> None:
    inside = medium(*case, sigma_t=1.0, albedo=0.0)
    made = scene(LONG, sensor=orthographic(), ball=ball(inside), sky=FURNACE)
    assert_near(means(made, [SIGMA], 2**10, 6), np.array([exact]), 0.05)


def _claimed() -> list[Any]:
    return [case for case in QUICK if law(case).jumps is not None]


@pytest.mark.parametrize(
    "case",
    quick(_claimed(), lambda case: case[0] in ("gamma", "davis_weinstein", "quadratic")),
    ids=model_id,
)
def test_a_white_furnace_does_not_depend_on_extinction(case: Any) -> None:
    """Every law that claims derivatives. One path per pixel: no mean is taken off."""
    inside = medium(*case, sigma_t=1.5, albedo=1.0, sample_emitters=False)
    camera = orthographic() | {"film": square_film(128)}
    integrator = {"type": "nonexp_volpath", "rr_depth": 1000, "max_depth": 200}
    made = scene(integrator, sensor=camera, ball=ball(inside), sky=FURNACE)
    found = means(made, [SIGMA], 1, 4)[:, 0]
    error = found.std(ddof=1) / 2
    assert error < 0.02
    assert abs(found.mean()) < 6 * error + 1e-3


@pytest.mark.parametrize("case", MODELS, ids=model_id)
def test_laws_that_claim_none_are_refused(case: Any) -> None:
    model = law(case)
    if model.jumps is not None or float(model.sigma_bar) == 0:
        return
    made = scene(sensor=orthographic(), ball=ball(medium(*case)), sky=FURNACE)
    parameters = mi.traverse(made)
    attached(parameters, SIGMA)
    image = mi.render(made, parameters, spp=1)
    with pytest.raises(ValueError, match=r"no derivative by ball.*sigma_t.*inverse.differences"):
        dr.backward(image)


def test_a_law_that_declares_nothing_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(type(law(("gamma", {}))), "jumps", nonexp.Transmittance.jumps)
    made = scene(sensor=orthographic(), ball=ball(gamma()), sky=FURNACE)
    parameters = mi.traverse(made)
    attached(parameters, LAW)
    with pytest.raises(ValueError, match=r"no derivative by .*alpha: flights of Gamma .* declared"):
        dr.backward(mi.render(made, parameters, spp=1))


# ---------------------------------------------------------------------- against differences

CAMERA = {"sensor": perspective([0, 0.5, 4], [0, 0, 0], 40)}
FLOOR = {
    "type": "rectangle",
    "to_world": mi.ScalarTransform4f().translate([0, -1.2, 0]).rotate([1, 0, 0], -90).scale(3),
    "bsdf": {"type": "diffuse", "reflectance": 0.5},
}
GAMMA = {"alpha": 1.5}
RGB = {"type": "rgb", "value": [0.5, 1.0, 2.0]}


def gamma(**kw: Any) -> dict[str, Any]:
    return medium("gamma", GAMMA, **{"sigma_t": 1.5, "albedo": 0.8, **kw})


def varied(**kw: Any) -> dict[str, Any]:
    values = np.random.default_rng(1).random((4, 4, 4)).astype(np.float32)
    place = mi.ScalarTransform4f().translate([-1] * 3).scale(2)
    grid = {"type": "gridvolume", "grid": mi.VolumeGrid(values), "to_world": place}
    fog = gamma() | {"type": "nonexp_heterogeneous", "sigma_t": grid, "scale": 3.0}
    return fog | kw


def boxed(inside: Any) -> dict[str, Any]:
    return box(inside, [-1, -1, -1], [1, 1, 1])


def quadratic(**kw: Any) -> dict[str, Any]:
    return medium("quadratic", {"b": 1.5}, **{"sigma_t": 1.5, "albedo": 0.8, **kw})


SAME = {"type": "ref", "id": "same"}
TABLE = {"tau": (0.5, 1.0, 2.0), "ff": (0.65, 0.4, 0.1)}
LAW = "ball.interior_medium.transmittance.alpha"
END = "ball.interior_medium.transmittance.b"
CASES: dict[str, tuple[dict[str, Any], list[str]]] = {
    "ball": (
        {"ball": ball(gamma(phase={"type": "hg", "g": 0.3})), "lamp": LAMP, "floor": FLOOR},
        [
            SIGMA,
            ALBEDO,
            LAW,
            "ball.interior_medium.phase_function.g",
            "floor.bsdf.reflectance.value",
            "lamp.emitter.radiance.value",
        ],
    ),
    "null surfaces": ({"ball": boxed(gamma()), "lamp": LAMP, "floor": FLOOR}, [SIGMA, ALBEDO, LAW]),
    "glass": ({"ball": ball(gamma(), "dielectric"), "lamp": LAMP}, [SIGMA, ALBEDO]),
    "chromatic": (
        {"ball": boxed(gamma(sigma_t=RGB)), "lamp": LAMP, "sky": FURNACE},
        [SIGMA, ALBEDO, LAW],
    ),
    "two media": (
        {
            "ball": ball(gamma(), radius=0.7) | {"center": [-0.6, 0, 0]},
            "other": ball(medium("erlang", sigma_t=2.0), radius=0.5) | {"center": [0.9, 0, 0]},
            "sky": FURNACE,
        },
        [SIGMA, ALBEDO, "other.interior_medium.sigma_t.value.value"],
    ),
    "emission": (
        {"ball": ball(gamma(emission=2.0)), "floor": FLOOR},
        [SIGMA, ALBEDO, LAW, "ball.interior_medium.emission.value.value"],
    ),
    "stock": ({"ball": ball(stock(sigma_t=1.5, albedo=0.8)), "sky": FURNACE}, [SIGMA, ALBEDO]),
    "grid": (
        {"ball": boxed(varied()), "sky": FURNACE},
        ["ball.interior_medium.scale", ALBEDO, LAW],
    ),
    "dark lamps": (
        {
            "ball": ball(gamma(), "dielectric"),
            "lamp": LAMP | {"emitter": {"type": "area", "radiance": 0.0}},
            "bulb": {"type": "point", "position": [0, 2, 1], "intensity": 0.0},
            "sky": FURNACE,
        },
        ["lamp.emitter.radiance.value", "bulb.intensity.value"],
    ),
    "tinted pane": (
        {
            "ball": boxed(gamma(id="same")),
            "pane": {
                "type": "rectangle",
                "bsdf": {"type": "thindielectric", "specular_transmittance": 0.3},
                "interior": SAME,
                "exterior": SAME,
            },
            "sky": FURNACE,
        },
        [f"pane.interior_medium.{part}.value.value" for part in ("sigma_t", "albedo")],
    ),
    "jump": (
        {"ball": ball(quadratic()), "lamp": LAMP, "floor": FLOOR},
        [SIGMA, ALBEDO, END, "floor.bsdf.reflectance.value"],
    ),
    "jump, chromatic, null surfaces": (
        {
            "ball": boxed(medium("hard_rod", {"d": 0.4, "l": 0.6}, sigma_t=RGB, id="same")),
            "cut": box(SAME, [-0.5] * 3, [0.5] * 3) | {"exterior": SAME},
            "lamp": LAMP,
            "sky": FURNACE,
        },
        [f"cut.interior_medium.{part}" for part in ("sigma_t.value.value", "transmittance.d")],
    ),
    "jumps, two media": (
        {
            "ball": ball(medium("tabulated", TABLE, sigma_t=1.5, albedo=0.9), radius=0.7)
            | {"center": [-0.6, 0, 0]},
            "other": ball(quadratic(), radius=0.5) | {"center": [0.9, 0, 0]},
            "sky": FURNACE,
        },
        [SIGMA, "other.interior_medium.sigma_t.value.value"],
    ),
    "jump, glass": ({"ball": ball(quadratic(), "dielectric"), "lamp": LAMP}, [SIGMA, END]),
    "jump, grid": (
        {"ball": boxed(varied(transmittance=quadratic()["transmittance"])), "sky": FURNACE},
        ["ball.interior_medium.scale", ALBEDO],
    ),
}


@pytest.mark.parametrize("name", quick(CASES, lambda name: name == "grid"))
def test_differences_agree(name: str) -> None:
    """Central differences with common seeds, of parameters that move by a twentieth."""
    parts, names = CASES[name]
    integrator = {"type": "nonexp_volpath", "rr_depth": 100, "max_depth": 12}
    made = scene(integrator, **CAMERA, **parts)
    found = means(made, names, 128, 6)
    for name, mine in zip(names, found.T, strict=True):
        runs = (
            inverse.differences(made, name, step=0.05, spp=256, runs=1, seed=s)
            for s in range(100, 106)
        )
        both = np.array([one.value.mean() for (one,) in runs]), mine
        error = math.hypot(*(part.std(ddof=1) / math.sqrt(6) for part in both))
        assert abs(both[0].mean() - mine.mean()) < SIGMAS * error, (name, *both)


@pytest.mark.parametrize(
    "kind", thorough("cut", "connected", "nearest, in glass", "chromatic", "jumps")
)
def test_derivatives_by_voxels(kind: str) -> None:
    """Of some voxels, empty ones too, and of all together, against differences."""
    parts, name = voxels(kind)
    integrator = {"type": "nonexp_volpath", "rr_depth": 100, "max_depth": 6}
    made = scene(integrator, **CAMERA, **parts)
    parameters = mi.traverse(made)
    name = next(key for key in parameters.keys() if key.endswith(name))
    base = np.array(parameters[name])
    spots = [(0, 0, 0, 0), (1, 2, 1, 0)]
    changes = [np.ones_like(base)]
    for spot in spots:
        changes.append(np.zeros_like(base))
        changes[-1][spot] = 1
    gradients = []
    for seed in range(8):
        (value,) = attached(parameters, name)
        dr.backward(dr.mean(mi.render(made, parameters, spp=128, seed=seed), axis=None))
        gradient = np.array(dr.grad(value)).reshape(base.shape)
        gradients.append([np.sum(gradient * change) for change in changes])
    for mine, change in zip(np.array(gradients).T, changes, strict=True):
        theirs, step = [], 0.05
        for seed in range(8):
            images = []
            for sign in (1, 0):
                parameters[name] = mi.TensorXf((base + sign * step * change).astype(np.float32))
                parameters.update()
                images.append(np.array(mi.render(made, spp=512, seed=100 + seed)).mean())
            theirs.append((images[0] - images[1]) / step)
        error = math.hypot(mine.std(ddof=1), np.std(theirs, ddof=1)) / math.sqrt(8)
        # One-sided: a voxel cannot be less than empty. Where hardly a path comes, differences show
        # nothing at all.
        slack = 0.1 * abs(mine.mean()) + 1e-6
        assert abs(mine.mean() - np.mean(theirs)) <= SIGMAS * error + slack, (mine, theirs)


def voxels(kind: str) -> tuple[dict[str, Any], str]:
    values = np.random.default_rng(4).random((3, 4, 5)).astype(np.float32)
    values[0, 0, 0] = 0
    place = mi.ScalarTransform4f().translate([-1] * 3).scale(2)
    filtering = "nearest" if "nearest" in kind else "trilinear"
    grid = {
        "type": "gridvolume",
        "grid": mi.VolumeGrid(values),
        "to_world": place,
        "filter_type": filtering,
    }
    inside = varied(sigma_t=grid, scale=2.0) | {"id": "cloud"}
    if kind == "chromatic":
        inside["extinction"] = RGB
    elif kind == "jumps":
        inside["transmittance"] = models.to_dict(models.create("tabulated", **TABLE))
    name = "sigma_t.data"
    parts: dict[str, Any] = {"ball": boxed(inside), "sky": FURNACE}
    if kind == "cut":
        parts["cut"] = {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().rotate([0.3, 1, 0], 50).scale(0.6),
            "bsdf": {"type": "null"},
            "interior": {"type": "ref", "id": "cloud"},
            "exterior": {"type": "ref", "id": "cloud"},
        }
    elif "glass" in kind:
        parts = {"ball": ball(inside, "dielectric"), "lamp": LAMP}
    elif kind == "connected":
        parts |= {"floor": FLOOR, "lamp": LAMP}
    return parts, name


# ---------------------------------------------------------------------- the replay itself


@pytest.mark.parametrize(
    "name", thorough("null surfaces", "ball", "glass", "chromatic", "grid", "jump")
)
def test_forward_and_backward_agree_on_the_same_paths(name: str) -> None:
    parts, names = CASES[name]
    made = scene({"type": "nonexp_volpath", "max_depth": 8}, **CAMERA, **parts)
    parameters = mi.traverse(made)
    weight = mi.TensorXf(np.random.default_rng(2).random((8, 8, 3)).astype(np.float32))
    (value,) = attached(parameters, names[0])
    dr.backward(dr.sum(weight * mi.render(made, parameters, spp=16, seed=3), axis=None))
    backward = float(np.sum(np.array(dr.grad(value))))
    (found,) = inverse.jacobian(made, names[0], spp=16, runs=1, seed=3)
    forward = float(np.sum(np.array(weight) * found.value))
    assert forward == pytest.approx(backward, rel=1e-5)


def test_paths_are_replayed_to_the_bit() -> None:
    parts, names = CASES["null surfaces"]
    made = scene({"type": "nonexp_volpath", "max_depth": 8}, **CAMERA, **parts)
    parameters = mi.traverse(made)
    attached(parameters, *names)
    again = replay(made.integrator(), made, 0)
    again.render_backward(made, parameters, mi.TensorXf(np.ones((8, 8, 3))), spp=16)
    assert dr.all(again.residual == 0, axis=None)


@THOROUGH
def test_what_depends_on_parameters_of_its_own() -> None:
    """Parameters that are computed from others, in both modes."""
    parts, _ = CASES["ball"]
    made = scene({"type": "nonexp_volpath", "max_depth": 4}, **CAMERA, **parts)
    parameters = mi.traverse(made)
    root = mi.Float(0.75)
    dr.enable_grad(root)
    parameters[SIGMA] = 2 * root
    parameters.update()
    dr.backward(dr.mean(mi.render(made, parameters, spp=16, seed=3), axis=None))
    (direct,) = inverse.jacobian(made, SIGMA, spp=16, runs=1, seed=3)
    assert dr.grad(root)[0] == pytest.approx(2 * direct.value.mean(), rel=1e-4)


# ---------------------------------------------------------------------- what is refused


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("lamp.to_world", "it would move what paths meet"),
        *thorough(
            ("third.interior_medium.sigma_t.data", "its channels are multiples of one grid"),
            ("glass.bsdf.specular_transmittance.value", "single directions"),
            ("fog.interior_medium.albedo.value.value", "only nonexp's media and homogeneous ones"),
            several=True,
        ),
    ],
)
def test_parameters_without_derivatives_are_refused(name: str, message: str) -> None:
    cloud = varied() | {"type": "heterogeneous"}
    del cloud["transmittance"]
    coloured = {"type": "gridvolume", "grid": mi.VolumeGrid(np.ones((2, 2, 2, 3), np.float32))}
    made = scene(
        sensor=orthographic(),
        ball=boxed(varied()),
        lamp=LAMP,
        glass={"type": "sphere", "bsdf": {"type": "dielectric", "specular_transmittance": 0.9}},
        fog=boxed(cloud),
        third=boxed(varied(sigma_t=coloured)),
    )
    parameters = mi.traverse(made)
    attached(parameters, name)
    image = mi.render(made, parameters, spp=1)
    with pytest.raises(ValueError, match=f"no derivative by {name}.*{message}"):
        dr.backward(image)


@THOROUGH
def test_scenes_with_memory_are_refused() -> None:
    mixed = {"type": "nonexp_binary_mixture", "sigma_t": "1, 2", "chord": "1, 1"}
    other = ball(mixed, radius=0.3) | {"center": [0, 0, 2]}
    made = scene(sensor=orthographic(), ball=ball(gamma()), other=other, lamp=LAMP)
    chord = next(key for key in mi.traverse(made).keys() if "chord" in key)
    for name in (ALBEDO, chord):
        parameters = mi.traverse(made)
        attached(parameters, name)
        with pytest.raises(ValueError, match="no derivative by"):
            dr.backward(mi.render(made, parameters, spp=1))
        parameters[name] = type(parameters[name])(dr.detach(parameters[name]))
        parameters.update()
    parameters = mi.traverse(made)
    (light,) = attached(parameters, "lamp.emitter.radiance.value")
    dr.backward(dr.mean(mi.render(made, parameters, spp=64), axis=None))
    (exact,) = inverse.differences(made, "lamp.emitter.radiance.value", spp=64, runs=1)
    gradient = float(np.sum(np.array(dr.grad(light))))
    assert gradient == pytest.approx(exact.value.mean(), rel=0.1)


def test_names_and_numbers_are_checked() -> None:
    made = scene(sensor=orthographic(), ball=ball(gamma()), sky=FURNACE)
    with pytest.raises(KeyError, match=r"the scene has no parameter 'ball\.sigma'"):
        inverse.jacobian(made, "ball.sigma")
    with pytest.raises(ValueError, match="runs is 0: it must be at least 1"):
        inverse.differences(made, SIGMA, runs=0)
    (found,) = inverse.jacobian(made, SIGMA, spp=4, runs=2)
    assert found.value.shape == found.stderr.shape == (8, 8, 3)
    assert dr.grad_enabled(mi.traverse(made)[SIGMA]) is False


@pytest.mark.parametrize("variant", thorough("llvm_ad_spectral", "llvm_ad_mono"), indirect=True)
def test_other_variants(variant: str) -> None:
    """Forward and backward, by a colour too; a medium with a jump, so that paths are forced."""
    inside = quadratic(sigma_t=RGB) | {"albedo": {"type": "rgb", "value": [0.9, 0.7, 0.5]}}
    parts = {"ball": ball(inside), "lamp": LAMP, "floor": FLOOR}
    made = scene({"type": "nonexp_volpath", "max_depth": 6}, **CAMERA, **parts)
    parameters = mi.traverse(made)
    keys = [key for key in parameters.keys() if "medium" in key and "floor" not in key]
    names = [key for key in keys if key.endswith(("scale", ".b")) or "albedo" in key]
    assert len(names) == 3
    for name in names:
        (value,) = attached(parameters, name)
        image = mi.render(made, parameters, spp=16, seed=3)
        dr.backward(dr.mean(image, axis=None))
        backward = float(np.sum(np.array(dr.grad(value))))
        parameters[name] = type(value)(dr.detach(value))
        parameters.update()
        (found,) = inverse.jacobian(made, name, spp=16, runs=1, seed=3)
        assert found.value.mean() == pytest.approx(backward, rel=2e-5), name
