"""What the integrator reads off a scene, and that the kernel holds no more than that."""

from __future__ import annotations

import gc
import re
import tempfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from build import FURNACE, ball, box, medium, perspective, scene, stock
from measure import largest_kernel, radiance
from tiers import thorough

from nonexp import models
from nonexp.integrators import rays
from nonexp.integrators.needs import SceneNeeds

LAMP = {
    "type": "sphere",
    "center": [0, 3, 0],
    "radius": 0.2,
    "emitter": {"type": "area", "radiance": 1.0},
}


def needs(**parts: Any) -> SceneNeeds:
    return SceneNeeds.of(scene(**parts))


def test_an_empty_scene_needs_nothing() -> None:
    assert needs(camera=perspective([0, 0, 4], [0, 0, 0])) == SceneNeeds(
        media=(),
        sealed=(),
        smooth_surfaces=False,
        smooth_boundaries=False,
        null_surfaces=False,
        emitters=False,
        hittable_emitters=False,
        delta_emitters=False,
        infinite_emitters=False,
    )


def test_emitters() -> None:
    point, sun = {"type": "point"}, {"type": "directional"}
    assert needs(a=point).emitters and not needs(a=point).hittable_emitters
    assert needs(a=LAMP).hittable_emitters and not needs(a=LAMP).infinite_emitters
    assert needs(a=sun).infinite_emitters and not needs(a=sun).hittable_emitters
    assert needs(a=FURNACE).infinite_emitters and needs(a=FURNACE).hittable_emitters


def test_surfaces() -> None:
    assert needs(a=ball(medium())).null_surfaces
    assert not needs(a=ball(medium(), "dielectric")).null_surfaces
    assert needs(a=ball(medium(), "roughdielectric")).smooth_boundaries
    assert not needs(a=ball(medium(), "dielectric")).smooth_boundaries
    mask = {"type": "mask", "opacity": 0.5, "nested": {"type": "diffuse"}}
    assert needs(a={"type": "rectangle", "bsdf": mask}).null_surfaces
    group = {"type": "shapegroup", "ball": ball(medium())}
    copy = {"type": "instance", "group": {"type": "ref", "id": "group"}}
    found = needs(group=group, copy=copy)
    assert found.null_surfaces and len(found.media) == 1


def pierced(shape: dict[str, Any], missing: int) -> dict[str, Any]:
    """A tetrahedron without its last faces, as a mesh with three vertices per face."""
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], dtype=float)
    faces = [[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]][: 4 - missing]
    lines = [f"v {x} {y} {z}" for face in faces for x, y, z in corners[face]]
    lines += [f"f {3 * i + 1} {3 * i + 2} {3 * i + 3}" for i in range(len(faces))]
    path = Path(tempfile.mkdtemp()) / "tetrahedron.obj"
    path.write_text("\n".join(lines), encoding="utf-8")
    return {**shape, "type": "obj", "filename": str(path)}


@pytest.mark.parametrize(
    ("sealed", "parts"),
    [
        (True, {"ball": ball(medium(), "dielectric"), "lamp": LAMP}),
        (True, {"ball": ball(stock(), "dielectric"), "sky": FURNACE}),
        (True, {"ball": ball(medium(), "roughdielectric"), "sun": {"type": "directional"}}),
        (False, {"ball": ball(medium(), "null"), "lamp": LAMP}),
        (False, {"ball": {**ball(medium(), "dielectric"), "flip_normals": True}, "lamp": LAMP}),
        (False, {"ball": ball(medium(), "dielectric", radius=3.5), "lamp": LAMP}),
        (False, {"ball": ball(medium(), "dielectric"), "lamp": {"type": "point"}}),
        (True, {"ball": {**ball(medium(), "dielectric"), "type": "cube"}, "lamp": LAMP}),
        (True, {"ball": pierced(ball(medium(), "dielectric"), 0), "lamp": LAMP}),
        (False, {"ball": pierced(ball(medium(), "dielectric"), 1), "lamp": LAMP}),
        (False, {"ball": {**ball(medium(), "dielectric"), "type": "disk"}, "lamp": LAMP}),
    ],
)
def test_sealed_media(sealed: bool, parts: dict[str, Any]) -> None:
    if parts["ball"]["type"] != "sphere":
        parts["ball"].pop("radius", None)
    assert bool(needs(**parts).sealed) == sealed


def test_the_sensors_medium_is_not_sealed() -> None:
    parts = {
        "fog": {**medium(), "id": "fog"},
        "ball": ball({"type": "ref", "id": "fog"}, "dielectric"),
        "camera": {**perspective([0, 0, 0], [0, 0, 1]), "medium": {"type": "ref", "id": "fog"}},
    }
    assert not needs(**parts).sealed


# ------------------------------------------------------------------------------- the kernel


@dataclass
class Kernel:
    """What the kernel that traces the paths is made of."""

    operations: int
    loops: set[str]
    calls: Counter[str]
    """indirect calls in the program by what is called: ``Emitter::eval()``, or a label"""
    functions: int
    """distinct functions behind these calls"""


def traced(built: Any) -> Kernel:
    largest = largest_kernel(lambda: radiance(built, 16, 1))
    program = largest["ir"].getvalue()
    return Kernel(
        largest["operation_count"],
        set(re.findall(r"; Symbolic loop: nonexp: (.*)", program)),
        Counter(re.findall(r"; Call: (.*)", program)),
        len(set(re.findall(r"func_[0-9a-f]+", program))),
    )


def kernel(integrator: str | dict[str, Any] = "nonexp_volpath", **parts: Any) -> Kernel:
    gc.collect()  # calls are dispatched over all objects that are still there
    return traced(scene(integrator, sensor=perspective([0, 0, 4], [0, 0, 0]), **parts))


def operations(integrator: str | dict[str, Any] = "nonexp_volpath", **parts: Any) -> int:
    return kernel(integrator, **parts).operations


GLASS = {"type": "sphere", "bsdf": {"type": "dielectric"}}
STRAIGHT = {"type": "nonexp_volpath", "refractive_nee": "off"}
GOLD = {"type": "sphere", "center": [0, 0, 3], "bsdf": {"type": "conductor", "material": "Au"}}
DIFFUSE = {"type": "sphere", "center": [0, -5, 0], "bsdf": {"type": "diffuse"}}


def test_no_medium_no_trace_of_one() -> None:
    bare = operations(ball=GLASS, lamp=LAMP)
    for nothing in (
        medium("constant", {}),
        medium(sigma_t=0.0),
        medium("gamma", {}, scale=0.0),
        stock(sigma_t=0.0),
    ):
        assert operations(ball=ball(nothing, "dielectric"), lamp=LAMP) == bare
    assert operations(ball=ball(medium(), "dielectric"), lamp=LAMP) > bare


@pytest.mark.thorough
def test_sealed_medium_needs_no_connections_through_it() -> None:
    inside = (medium(), medium(sample_emitters=False))
    counts = [operations(STRAIGHT, ball=ball(m, "dielectric"), lamp=LAMP) for m in inside]
    assert counts[0] == counts[1] < operations(ball=ball(medium(), "roughdielectric"), lamp=LAMP)


@pytest.mark.thorough
def test_null_surfaces_cost_only_where_there_are_some() -> None:
    diffuse = {"type": "sphere", "bsdf": {"type": "diffuse"}}
    opaque = {"type": "sphere", "bsdf": {"type": "mask", "opacity": 0.5, "bsdf": diffuse["bsdf"]}}
    assert operations(ball=diffuse, lamp=LAMP) < operations(ball=opaque, lamp=LAMP)


@pytest.mark.thorough
def test_fewer_operations_than_volpath() -> None:
    for boundary in ("dielectric", "null"):
        ours = operations(STRAIGHT, ball=ball(medium(), boundary), lamp=LAMP)
        assert ours < 0.8 * operations("volpath", ball=ball(stock(), boundary), lamp=LAMP)


def test_parameters_do_not_change_the_kernel() -> None:
    built = scene(
        sensor=perspective([0, 0, 4], [0, 0, 0]),
        ball=ball(medium("gamma", {"alpha": 2.0}, sigma_t=1.0)),
        lamp=LAMP,
    )
    parameters = mi.traverse(built)
    hashes = set()
    for alpha in (2.0, 3.0, 0.7):
        parameters["ball.interior_medium.transmittance.alpha"] = alpha
        parameters["ball.interior_medium.sigma_t.value.value"] = alpha
        parameters.update()
        hashes.add(largest_kernel(lambda: radiance(built, 16, 1))["hash"])
    assert len(hashes) == 1


def assert_can_be_frozen(built: Any, right: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """A frozen render, and its replays, are renders of ``right`` to the last bit.

    Frozen functions do not tell spheres from other shapes, so that here nothing does.
    """
    monkeypatch.setattr(rays, "MOST_SPHERES", 0)

    @dr.freeze
    def frozen(built: Any, seed: mi.UInt32) -> mi.TensorXf:
        return mi.render(built, spp=4, seed=seed)

    for seed in range(3):
        replayed = np.array(frozen(built, mi.UInt32(seed)))
        np.testing.assert_array_equal(replayed, np.array(mi.render(right, spp=4, seed=seed)))


@pytest.mark.parametrize(
    "model", ["gamma", *thorough("davis_weinstein", "ensemble", "tabulated", "mixture")]
)
def test_a_render_can_be_frozen(model: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where the model looks into tables."""
    parameters = dict(models.registry[model].examples[0])
    camera = perspective([0, 0, 4], [0, 0, 0])
    fog = box(medium(model, parameters, sigma_t=1.0), [-1, -1, -1], [1, 1, 1])
    built = scene(sensor=camera, box=fog, lamp=LAMP)
    assert_can_be_frozen(built, built, monkeypatch)


def fog(model: str = "exponential", **kw: Any) -> dict[str, Any]:
    return {"ball": ball(medium(model, **kw)), "lamp": LAMP}


@pytest.mark.thorough
def test_scenes_that_are_gone_leave_nothing_behind() -> None:
    """Neither fog, whose shadow rays need a second scene, nor glass through which rays bend."""
    alone = operations(**fog())
    others = {"sky": FURNACE, "tube": {"type": "cylinder", "bsdf": {"type": "plastic"}}}
    lobe = {"type": "cylinder", "bsdf": {"type": "dielectric"}, "interior": medium("linear")}
    assert operations(**fog("gamma"), **others) > alone
    assert operations("nonexp_volpath", lobe=lobe, lamp=LAMP, **others) > alone
    assert operations(**fog()) == alone


@pytest.mark.thorough
def test_grey_extinction_holds_no_spectra() -> None:
    """However it is written; colour costs a tenth more at least, and only then."""
    grey = operations(**fog(sigma_t=0.7))
    assert operations(**fog(sigma_t={"type": "rgb", "value": [0.7, 0.7, 0.7]})) == grey
    assert operations(**fog(sigma_t={"type": "rgb", "value": [0.7, 0.7, 0.1]})) > 1.1 * grey


@pytest.mark.thorough
def test_tracking_only_for_heterogeneous_media() -> None:
    values = mi.VolumeGrid(np.ones((2, 2, 2, 1), dtype=np.float32))
    cloud = {"type": "heterogeneous", "sigma_t": {"type": "gridvolume", "grid": values}}
    for inside in (medium(), stock()):
        assert kernel(ball=ball(inside), lamp=LAMP).loops == {"path"}
    tracking = {"path", "shadow ray", "delta tracking", "ratio tracking"}
    assert kernel(ball=ball(cloud), lamp=LAMP).loops == tracking


@pytest.mark.thorough
def test_shadow_rays_without_null_surfaces_are_occlusion_tests() -> None:
    rough = {"type": "roughdielectric"}
    assert kernel(ball=ball(medium(), rough), lamp=LAMP).loops == {"path"}
    fog = box(medium(), [-1, -1, -1], [1, 1, 1])
    assert kernel(box=fog, lamp=LAMP).loops == {"path", "shadow ray"}


@pytest.mark.thorough
def test_shadow_rays_do_not_walk_past_a_single_ball() -> None:
    assert kernel(ball=ball(medium()), lamp=LAMP).loops == {"path"}
    two = {"other": {**ball(medium()), "center": [3, 0, 0]}}
    assert kernel(ball=ball(medium()), lamp=LAMP, **two).loops == {"path", "shadow ray"}
    inner = {"inner": ball(None, radius=0.5)}
    inner["inner"].pop("interior")
    assert kernel(ball=ball(medium()), lamp=LAMP, **inner).loops == {"path", "shadow ray"}


@pytest.mark.thorough
def test_no_connections_where_nothing_could_use_them() -> None:
    """Smooth glass and gold only, and a medium that does not connect."""
    inside = medium(sample_emitters=False)
    parts = {"ball": ball(inside, "dielectric"), "gold": GOLD, "sky": FURNACE}
    quiet = kernel(**parts).calls
    assert "Emitter::eval()" in quiet
    assert not {"Emitter::sample_direction()", "Emitter::pdf_direction()"} & set(quiet)
    assert "Emitter::sample_direction()" in kernel(**parts, floor=DIFFUSE).calls


def test_points_and_directions_are_not_looked_for_on_surfaces() -> None:
    calls = kernel(floor=DIFFUSE, lamp={"type": "point", "position": [0, 3, 0]}).calls
    assert "Emitter::sample_direction()" in calls and "Emitter::eval()" not in calls
    assert "Emitter::eval()" in kernel(floor=DIFFUSE, lamp=LAMP).calls


@pytest.mark.thorough
def test_no_medium_is_called_in_the_scene_of_one() -> None:
    """One medium is called directly, several through an index, those of other scenes never."""

    def balls(*insides: Any) -> dict[str, Any]:
        shapes = {f"b{i}": {**ball(m), "center": [3 * i, 0, 0]} for i, m in enumerate(insides)}
        return {**shapes, "lamp": LAMP}

    laws = [medium("exponential"), medium("gamma"), medium("linear"), medium("quadratic")]
    alone = kernel(**balls(laws[0]))
    kept = scene(**balls(*laws))
    assert kernel(**balls(laws[0])) == alone
    assert not [call for call in alone.calls if "Medium" in call or "Phase" in call]
    functions = [kernel(**balls(*laws[:n])).functions for n in (2, 3, 4)]
    # A flight and a survival for each law; equal phase functions are one.
    assert np.all(np.diff(functions) == 2), functions
    assert kept is not None


def test_updates_change_what_is_traced() -> None:
    """Needs are looked up anew for every render."""
    camera = perspective([0, 0, 4], [0, 0, 0])
    built = scene(sensor=camera, **fog(sigma_t={"type": "rgb", "value": [0.7, 0.7, 0.7]}))
    parameters = mi.traverse(built)
    (key,) = (k for k in parameters.keys() if k.endswith("sigma_t.value.value"))

    def after(*value: float) -> Kernel:
        parameters[key] = mi.Color3f(*value)
        parameters.update()
        return traced(built)

    grey = traced(built)
    assert after(0.7, 0.7, 0.1).operations > 1.1 * grey.operations
    assert after(0, 0, 0).operations < 0.8 * grey.operations
    assert after(0.5, 0.5, 0.5) == grey


def test_glass_that_grows_around_a_lamp_is_open_to_it() -> None:
    built = scene(ball=ball(medium(), "dielectric"), lamp=LAMP)
    parameters = mi.traverse(built)
    assert SceneNeeds.of(built).sealed
    parameters["ball.to_world"] = mi.Transform4f().scale(4.0)
    parameters.update()
    assert not SceneNeeds.of(built).sealed
