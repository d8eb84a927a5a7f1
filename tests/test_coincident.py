"""Surfaces that lie in one place: the image does not depend on their order, nor on the view."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from build import DRAWN, medium, perspective, scene

from nonexp import models
from nonexp.integrators import report
from nonexp.integrators.coincident import coincident
from nonexp.integrators.needs import SceneNeeds

T = mi.ScalarTransform4f()
NULL = {"type": "null"}
FLOOR = {
    "type": "rectangle",
    "to_world": T.rotate([1, 0, 0], -90).scale(4),
    "bsdf": {"type": "diffuse", "reflectance": 0.6},
}
LAMP = {
    "type": "rectangle",
    "to_world": T.translate([0, 3, 0]).rotate([1, 0, 0], 90).scale(0.6),
    "emitter": {"type": "area", "radiance": 5.0},
}


def box(place: Any, size: Any = 1.0, **parts: Any) -> dict[str, Any]:
    """A cube between -size/2 and size/2 about a place."""
    to_world = T.translate(place).scale(
        np.multiply(0.5, size).tolist() if np.ndim(size) else size / 2
    )
    return {"type": "cube", "to_world": to_world, "bsdf": NULL, **parts}


def along(axis: list[float], size: float = 0.2) -> dict[str, Any]:
    """Parallel rays against an axis."""
    up = [0, 1, 0] if axis[1] == 0 else [1, 0, 0]
    look = T.look_at([4 * v for v in axis], [0, 0, 0], up)
    film = {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}}
    return {"type": "orthographic", "to_world": look @ T.scale([size, size, 1]), "film": film}


def means(spp: int, seeds: int = 4, **parts: Any) -> tuple[float, float]:
    """Mean of the image and its standard error."""
    built = scene(**parts)
    images = [np.array(mi.render(built, spp=spp, seed=k))[..., :3].mean() for k in range(seeds)]
    return float(np.mean(images)), float(np.std(images, ddof=1) / np.sqrt(seeds))


def assert_same(a: tuple[float, float], b: tuple[float, float]) -> None:
    """Equal to 4.5 standard errors (t distribution of few images), and these below 1.5 %."""
    error = np.hypot(a[1], b[1])
    assert error < 0.015 * b[0]
    assert abs(a[0] - b[0]) < 4.5 * error + 1e-5 * b[0], (a, b)


def shuffled(parts: dict[str, Any], reverse: bool) -> dict[str, Any]:
    return dict(reversed(parts.items())) if reverse else parts


BOXES = {
    "one": box([-0.5, 0, 0], interior=medium(sigma_t=0.5, albedo=0.0)),
    "two": box([0.5, 0, 0], interior=medium(sigma_t=1.0, albedo=0.0)),
}


@pytest.mark.parametrize("axis", ([1, 0, 0], [-1, 0, 0]), ids=("right", "left"))
def test_boxes_of_any_law_and_colour(axis: list[float]) -> None:
    """A flight starts anew at the shared face: transmittances from fixed point to fixed point."""
    extinctions = {"one": [0.5, 0.3, 0.1], "two": [1.0, 0.2, 0.6]}
    laws = {"one": ("linear", {"b": 2.0}), "two": ("gamma", {"alpha": 0.5})}
    parts, exact = {}, np.ones(3)
    for name, (law, parameters) in laws.items():
        sigma_t = {"type": "rgb", "value": extinctions[name]}
        interior = medium(law, parameters, sigma_t=sigma_t, albedo=0.0)
        parts[name] = {**BOXES[name], "interior": interior}
        exact *= models.create(law, **parameters).ff(np.array(extinctions[name]))
    built = scene(DRAWN, camera=along(axis), sky={"type": "constant"}, **parts)
    image = np.array(mi.render(built, spp=4096))[..., :3]
    error = image.reshape(-1, 3).std(axis=0) / 8
    assert np.all(error < 0.01 * exact)
    assert np.all(np.abs(image.mean((0, 1)) - exact) < 4.5 * error)


@pytest.mark.parametrize("reverse", (False, True))
@pytest.mark.parametrize("axis", ([1, 0, 0], [-1, 0, 0]), ids=("right", "left"))
def test_boxes_that_share_a_face(axis: list[float], reverse: bool) -> None:
    built = scene(camera=along(axis), sky={"type": "constant"}, **shuffled(dict(BOXES), reverse))
    image = np.array(mi.render(built, spp=4096))[..., :3]
    exact = np.exp(-1.5)
    error = np.sqrt(exact * (1 - exact) / (64 * 4096))
    assert abs(image.mean() - exact) < 4 * error
    assert error < 0.004 * exact  # one box alone would transmit .37 or .61


@pytest.mark.parametrize("reverse", (False, True))
def test_shadow_rays_through_boxes_that_share_a_face(reverse: bool) -> None:
    """A white wall behind two boxes, lit by a lamp at the camera through them: no noise but that
    of the lamp's points, which are far away."""
    lamp = {"type": "point", "position": [200, 0, 0], "intensity": 4e4}
    wall = {"type": "rectangle", "to_world": T.translate([-1.5, 0, 0]).rotate([0, 1, 0], 90)}
    look = T.look_at([-1.4, 0, 0], [-1.5, 0, 0], [0, 1, 0]) @ T.scale([0.01, 0.01, 1])
    camera = {**along([0, 0, 1], 0.01), "to_world": look, "near_clip": 1e-3}
    built = scene(camera=camera, lamp=lamp, wall=wall, **shuffled(dict(BOXES), reverse))
    image = np.array(mi.render(built, spp=16))[..., :3].mean()
    free = 4e4 / 201.5**2 * 0.5 / np.pi
    assert image / free == pytest.approx(np.exp(-1.5), rel=1e-3)


@pytest.mark.parametrize("reverse", (False, True))
def test_a_twin_without_a_medium_changes_nothing(reverse: bool) -> None:
    fog = box([0, 1, 0], [2, 1.4, 2], interior=medium(sigma_t=0.8, albedo=0.9))
    rest = {"camera": perspective([0, 2, 5], [0, 1, 0]), "lamp": LAMP, "floor": FLOOR}
    twin = shuffled({"twin": box([0, 1, 0], [2, 1.4, 2]), "fog": fog}, reverse)
    alone = means(256, fog=fog, **rest)
    assert_same(means(256, **twin, **rest), alone)


@pytest.mark.parametrize("reverse", (False, True))
@pytest.mark.parametrize("law", ("exponential", "linear"))
def test_fog_on_the_ground(law: str, reverse: bool) -> None:
    """As the same fog a thousandth above the ground."""
    interior = medium(law, sigma_t=1.5, albedo=0.8)
    rest = {"camera": perspective([0, 1.5, 5], [0, 0.7, 0]), "lamp": LAMP}
    on = shuffled({"fog": box([0, 0.5, 0], interior=interior), "floor": FLOOR}, reverse)
    above = {"fog": box([0, 0.501, 0], interior=interior), "floor": FLOOR}
    assert_same(means(512, **on, **rest), means(512, **above, **rest))


@pytest.mark.thorough
@pytest.mark.parametrize("reverse", (False, True))
def test_a_lamp_on_the_face_of_fog(reverse: bool) -> None:
    interior = medium(sigma_t=1.0, albedo=0.8)
    rest = {"camera": perspective([0, 1.5, 5], [0, 0.7, 0]), "floor": FLOOR}

    def parts(height: float) -> dict[str, Any]:
        to_world = T.translate([0, height, 0]).rotate([1, 0, 0], 90).scale(0.3)
        lamp = {"type": "rectangle", "to_world": to_world, "emitter": LAMP["emitter"]}
        return {"fog": box([0, 0.55, 0], interior=interior), "lamp": lamp}

    assert_same(
        means(1024, **shuffled(parts(1.05), reverse), **rest), means(1024, **parts(1.049), **rest)
    )


@pytest.mark.thorough
@pytest.mark.parametrize("reverse", (False, True))
def test_liquid_in_a_glass(reverse: bool) -> None:
    """A liquid with boundaries of its own fills a body of glass: as the body with the medium."""
    liquid = medium("quadratic", sigma_t=2.0, albedo=0.9)
    sky = {"type": "constant"}
    rest = {"camera": perspective([0, 0.6, 4], [0, 0, 0]), "sky": sky, "lamp": LAMP}
    glass = {"type": "dielectric", "int_ior": 1.3}
    two = {"glass": {**box([0, 0, 0]), "bsdf": glass}, "liquid": box([0, 0, 0], interior=liquid)}
    one = {"glass": {**box([0, 0, 0], interior=liquid), "bsdf": glass}}
    assert_same(means(256, **shuffled(two, reverse), **rest), means(256, **one, **rest))


@pytest.mark.thorough
def test_a_sphere_and_its_twin() -> None:
    ball = {"type": "sphere", "bsdf": NULL, "interior": medium(sigma_t=1.0, albedo=0.9)}
    rest = {
        "camera": perspective([0, 0.5, 4], [0, 0, 0]),
        "lamp": LAMP,
        "sky": {"type": "constant"},
    }
    alone = means(256, ball=ball, **rest)
    assert_same(means(256, twin={"type": "sphere", "bsdf": NULL}, ball=ball, **rest), alone)


def test_one_medium_in_two_boxes_that_touch() -> None:
    """Mitsuba makes one mesh of them. Nothing is lost at the shared face, and flights go on."""
    shared = {"type": "ref", "id": "fog"}
    parts = {"one": box([-0.5, 0, 0], interior=shared), "two": box([0.5, 0, 0], interior=shared)}
    built = scene(
        fog={**medium("linear", {"b": 2.5}, sigma_t=0.75, albedo=0.0), "id": "fog"},
        camera=along([1, 0, 0]),
        sky={"type": "constant"},
        **parts,
    )
    (only,) = built.shapes()
    assert [mesh for mesh, _ in SceneNeeds.of(built).coincident.doubled] == [only]
    image = np.array(mi.render(built, spp=4096))[..., :3]
    exact = 1 - 1.5 / 2.5
    assert abs(image.mean() - exact) < 4 * np.sqrt(exact * (1 - exact) / (64 * 4096))


# ------------------------------------------------------------------------------ what is found


def found(**parts: Any) -> set[frozenset[str]]:
    pairs = SceneNeeds.of(scene(**parts)).coincident.pairs
    return {frozenset(shape.id() for shape in pair) for pair in pairs}


def test_pairs_that_coincide() -> None:
    interior = medium()
    assert found(**BOXES) == {frozenset(("one", "two"))}
    fog = box([0, 0.5, 0], interior=interior)
    assert found(fog=fog, floor=FLOOR) == {frozenset(("fog", "floor"))}
    disk = {"type": "disk", "to_world": T.rotate([1, 0, 0], -90)}
    assert found(fog=fog, disk=disk) == {frozenset(("fog", "disk"))}
    turned = T.rotate([0, 1, 0], 30)
    leaning = {
        "one": {**box([0, 0, 0], interior=interior), "to_world": turned @ T.scale(0.5)},
        "two": {**box([0, 0, 0]), "to_world": turned @ T.translate([1, 0, 0]).scale(0.5)},
    }
    assert found(**leaning) == {frozenset(("one", "two"))}
    tube = {"type": "cylinder", "bsdf": NULL}
    assert found(a={**tube, "interior": interior}, b=tube) == {frozenset("ab")}


def test_pairs_that_do_not() -> None:
    interior = medium()
    fog = box([0, 0, 0], interior=interior)
    assert not found(fog=fog, other=box([1.001, 0, 0]))
    assert not found(fog=fog, other=box([1, 1, 0]))  # an edge
    assert not found(fog=fog, inner=box([0, 0, 0], 0.5), ball={"type": "sphere", "radius": 0.5})
    assert not found(a=FLOOR, b=FLOOR)  # no boundary
    assert not found(
        fog=fog, floor={**FLOOR, "to_world": T.translate([0, -0.5, 5]).rotate([1, 0, 0], -90)}
    )


@pytest.mark.parametrize("scale", (1e-3, 1e3))
def test_any_size(scale: float) -> None:
    parts = {
        name: {**part, "to_world": T.scale(scale) @ part["to_world"]}
        for name, part in BOXES.items()
    }
    assert found(**parts) == {frozenset(("one", "two"))}


def test_info_names_them() -> None:
    rows = {row.question: row for row in report.findings(scene(**BOXES))}
    assert rows["boundaries that coincide with other surfaces"].answer == "one and two"
    rows = {row.question: row for row in report.findings(scene(one=BOXES["one"]))}
    assert rows["boundaries that coincide with other surfaces"].answer == "none"


def test_what_is_known_holds_no_shapes() -> None:
    built = scene(**BOXES)
    first = coincident(built.shapes(), 1e-5)
    assert len(first.groups) == 2 and first.pairs
    assert coincident(built.shapes()[:1], 1e-5).groups == ()
