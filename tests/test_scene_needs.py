"""What the integrator reads off a scene, and that the kernel holds no more than that."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from build import FURNACE, ball, medium, perspective, scene, stock
from measure import radiance

from nonexp.integrators.scene_needs import SceneNeeds

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
        smooth_boundaries=False,
        null_surfaces=False,
        emitters=False,
        hittable_emitters=False,
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
        (False, {"ball": {**ball(medium(), "dielectric"), "type": "cube"}, "lamp": LAMP}),
        (False, {"ball": {**ball(medium(), "dielectric"), "type": "disk"}, "lamp": LAMP}),
    ],
)
def test_sealed_media(sealed: bool, parts: dict[str, Any]) -> None:
    parts["ball"].pop("radius") if parts["ball"]["type"] != "sphere" else None
    assert bool(needs(**parts).sealed) == sealed


def test_the_sensors_medium_is_not_sealed() -> None:
    parts = {
        "fog": {**medium(), "id": "fog"},
        "ball": ball({"type": "ref", "id": "fog"}, "dielectric"),
        "camera": {**perspective([0, 0, 0], [0, 0, 1]), "medium": {"type": "ref", "id": "fog"}},
    }
    assert not needs(**parts).sealed


# ------------------------------------------------------------------------------- the kernel


def operations(integrator: str = "nonexp_volpath", **parts: Any) -> int:
    """Operations in the kernel that traces the paths."""
    built = scene(integrator, sensor=perspective([0, 0, 4], [0, 0, 0]), **parts)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        radiance(built, 16, 1)
        counts = [k["operation_count"] for k in dr.kernel_history([dr.KernelType.JIT])]
    return max(counts)


GLASS = {"type": "sphere", "bsdf": {"type": "dielectric"}}


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


def test_sealed_medium_needs_no_connections_through_it() -> None:
    without = medium(sample_emitters=False)
    counts = [operations(ball=ball(m, "dielectric"), lamp=LAMP) for m in (medium(), without)]
    assert counts[0] == counts[1] < operations(ball=ball(medium(), "roughdielectric"), lamp=LAMP)


def test_null_surfaces_cost_only_where_there_are_some() -> None:
    diffuse = {"type": "sphere", "bsdf": {"type": "diffuse"}}
    opaque = {"type": "sphere", "bsdf": {"type": "mask", "opacity": 0.5, "bsdf": diffuse["bsdf"]}}
    assert operations(ball=diffuse, lamp=LAMP) < operations(ball=opaque, lamp=LAMP)


def test_fewer_operations_than_volpath() -> None:
    for boundary in ("dielectric", "null"):
        ours = operations(ball=ball(medium(), boundary), lamp=LAMP)
        assert ours < 0.8 * operations("volpath", ball=ball(stock(), boundary), lamp=LAMP)


def test_parameters_do_not_change_the_kernel() -> None:
    built = scene(
        sensor=perspective([0, 0, 4], [0, 0, 0]),
        ball=ball(medium("gamma", {"alpha": 2.0}, sigma_t=1.0)),
        lamp=LAMP,
    )
    parameters = mi.traverse(built)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        hashes = set()
        for alpha in (2.0, 3.0, 0.7):
            parameters["ball.interior_medium.transmittance.alpha"] = alpha
            parameters["ball.interior_medium.sigma_t.value.value"] = alpha
            parameters.update()
            dr.kernel_history_clear()
            radiance(built, 16, 1)
            kernels = dr.kernel_history([dr.KernelType.JIT])
            hashes.add(max(kernels, key=lambda k: k["operation_count"])["hash"])
    assert len(hashes) == 1


def test_a_render_can_be_frozen() -> None:
    built = scene(
        sensor=perspective([0, 0, 4], [0, 0, 0]),
        ball=ball(medium("gamma", {"alpha": 2.0}, sigma_t=1.0)),
        lamp=LAMP,
    )

    @dr.freeze
    def frozen(built: Any, seed: mi.UInt32) -> mi.TensorXf:
        return mi.render(built, spp=4, seed=seed)

    for seed in range(3):
        replayed = np.array(frozen(built, mi.UInt32(seed)))
        np.testing.assert_array_equal(replayed, np.array(mi.render(built, spp=4, seed=seed)))
