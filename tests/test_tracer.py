"""Spheres that the kernel intersects itself, among other shapes: as Mitsuba finds them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from build import ball, medium, scene
from tiers import thorough

from nonexp.integrators import rays as transport_rays
from nonexp.integrators import report
from nonexp.integrators.rays import Offset, Subscenes, Tracer

T = mi.ScalarTransform4f()
BALLS: dict[str, Any] = {
    "outer": {"type": "sphere", "radius": 2.0, "bsdf": {"type": "dielectric"}},
    "inner": {"type": "sphere", "center": [0.3, 0, 0], "flip_normals": True},
    "moved": {
        "type": "sphere",
        "to_world": T.translate([2, 0.5, 0]).rotate([0, 0, 1], 40).scale(0.6),
    },
    "lamp": {
        "type": "sphere",
        "center": [0, 3, 0],
        "radius": 0.1,
        "emitter": {"type": "area", "radiance": 1.0},
    },
}
OTHERS: dict[str, Any] = {
    "cube": {"type": "cube", "to_world": T.translate([-1.5, 0, 0]).scale(0.7)},
    "tube": {"type": "cylinder", "p0": [0, -1, 1], "p1": [0, 1, 1], "radius": 0.5},
    "floor": {"type": "rectangle", "to_world": T.translate([0, -3, 0]).scale(5)},
}


def traced(**parts: Any) -> tuple[mi.Scene, Tracer]:
    built = scene(**parts)
    return built, Tracer.of(built, Subscenes())


def rays(n: int, size: float = 1.0, shift: float = 0.0) -> mi.Ray3f:
    """From everywhere around, half of them short."""
    rng = np.random.default_rng(3)
    o = size * rng.uniform(-3, 3, (3, n)) + np.array([[shift], [0], [0]])
    d = mi.Vector3f(rng.normal(size=(3, n)).astype(np.float32))
    ray = mi.Ray3f(mi.Point3f(o.astype(np.float32)), dr.normalize(d))
    short = size * rng.uniform(0, 6, n)
    ray.maxt = mi.Float(np.where(rng.random(n) < 0.5, short, np.inf).astype(np.float32))
    return ray


@pytest.mark.parametrize(
    ("size", "others"),
    [(1.0, OTHERS), *thorough((1.0, {}), (1e-3, {}), (1e3, {}), several=True)],
    ids=["other shapes", "spheres", "millimetres", "kilometres"],
)
def test_meets_what_mitsuba_meets(size: float, others: dict[str, Any]) -> None:
    scale = T.scale(size)
    larger = {k: {**p, "to_world": scale @ p.get("to_world", T)} for k, p in BALLS.items()}
    built, own = traced(**larger, **others)
    assert len(own.spheres) == 4
    ray = rays(200_000, size)
    active = mi.Bool(np.arange(200_000) % 7 > 0)
    a, b = built.ray_intersect(ray, active), own.intersect(ray, False, active)
    # A ray that only grazes a sphere may miss it here or there.
    same = np.array(a.shape == b.shape)
    assert np.mean(same) > 1 - 5e-5
    hit = same & np.array(a.is_valid())
    assert 0.2 < np.mean(hit) < 0.8
    assert np.array_equal(np.array(a.is_valid())[same], np.array(b.is_valid())[same])
    for name, unit in {"t": size, "p": size, "n": 1, "wi": 1, "uv": 1}.items():
        x, y = (np.array(getattr(si, name)).reshape(-1, 200_000)[:, hit] for si in (a, b))
        error = np.max(abs(x - y), axis=0) / unit
        assert np.quantile(error, 0.999) < 2e-5 and np.quantile(error, 0.5) < 1e-6, name
    blocked = own.occluded(ray, active)
    assert np.mean(np.array(blocked) != np.array(built.ray_test(ray, active))) < 5e-5


def test_a_sphere_can_be_passed() -> None:
    parts = {**BALLS, **OTHERS}
    built, own = traced(**parts)
    outer = next(shape for shape in built.shapes() if shape.id() == "outer")
    rest, _ = traced(**{name: part for name, part in parts.items() if name != "outer"})
    ray = rays(100_000)
    found = np.array(own.occluded(ray, mi.Bool(True), passing=outer))
    assert np.mean(found != np.array(rest.ray_test(ray))) < 5e-5
    assert np.mean(found != np.array(built.ray_test(ray))) > 0.05


@pytest.mark.parametrize("shift", [0.0, 30.0])
def test_rays_that_leave_a_sphere_do_not_meet_it_again(shift: float) -> None:
    """From either side, in all directions: out they meet nothing, in they cross the ball."""
    n = 200_000
    built, own = traced(
        ball={"type": "sphere", "center": [shift, 0, 0]},
        far={"type": "sphere", "center": [-100, 0, 0], "radius": 0.01},
    )
    offset = Offset(built)
    si = own.intersect(rays(n, 0.5, shift), False, mi.Bool(True))
    rng = np.random.default_rng(5)
    d = dr.normalize(mi.Vector3f(rng.normal(size=(3, n)).astype(np.float32)))
    ball = next(shape for shape in built.shapes() if shape.bbox().max.x > 0)
    start = si.is_valid() & (si.shape == mi.ShapePtr(ball))
    ray = mi.Ray3f(offset.onward(si, d), d)
    again = own.intersect(ray, False, start)
    cosine = np.array(dr.dot(d, si.n))
    hits = np.array(again.shape == mi.ShapePtr(ball))[np.array(start)]
    cosine = cosine[np.array(start)]
    assert len(hits) > 20_000
    assert not np.any(hits[cosine > 0])
    assert np.all(hits[cosine < 0])
    t = np.array(again.t)[np.array(start)][cosine < 0]
    # The chord, but for the way to where the ray starts.
    error = np.abs(t + 2 * cosine[cosine < 0])
    assert np.max(error) < 0.05 and np.median(error) < 2e-3


def test_only_where_it_pays(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def spheres(**parts: Any) -> int:
        return len(traced(**parts)[1].spheres)

    assert spheres(**BALLS, **OTHERS) == 4
    assert spheres(**OTHERS) == 0
    with monkeypatch.context() as patch:
        patch.setattr(transport_rays, "MOST_SPHERES", 3)
        assert spheres(**BALLS, **OTHERS) == 0
    bent = {"type": "sphere", "to_world": T.scale([1, 2, 1])}
    assert spheres(bent=bent, lamp=BALLS["lamp"]) == 1
    group = {"type": "shapegroup", "ball": {"type": "sphere"}}
    copy = {"type": "instance", "group": {"type": "ref", "id": "group"}}
    assert spheres(group=group, copy=copy, lamp=BALLS["lamp"]) == 0
    distances = np.linspace(-1, 1, 8, dtype=np.float32).reshape(2, 2, 2, 1)
    grid = {"type": "sdfgrid", "grid": mi.TensorXf(distances)}
    assert spheres(**BALLS, grid=grid) == 0
    path = tmp_path / "curve.txt"
    path.write_text("0 0 0 0.1\n0 1 0 0.1\n0 2 0 0.1\n1 3 0 0.1\n", encoding="utf-8")
    for curve in ("linearcurve", "bsplinecurve"):
        assert spheres(**BALLS, curve={"type": curve, "filename": str(path)}) == 0
    monkeypatch.setattr(
        transport_rays, "MOST_FACES", 13
    )  # cube, rectangle, and a cylinder counted as one
    assert spheres(**BALLS, **OTHERS) == 0


def test_follows_a_sphere_that_moves() -> None:
    built, _ = traced(ball={"type": "sphere"})
    params = mi.traverse(built)
    params["ball.to_world"] = mi.Transform4f().translate([0, 0, 5]).scale(2)
    params.update()
    (sphere,) = Tracer.of(built, Subscenes()).spheres
    np.testing.assert_allclose(np.array(sphere.centre).ravel(), [0, 0, 5])
    np.testing.assert_allclose(np.array(sphere.radius), 2)


def test_people_are_told() -> None:
    def told(**parts: Any) -> dict[str, str]:
        return {found.question: found.answer for found in report.findings(scene(**parts))}

    assert told(**BALLS, **OTHERS)["spheres"] == "4 of 7 shapes"
    assert told(**OTHERS)["spheres"] == "none"
    through = "surfaces that let rays straight through"
    alone = told(fog=ball(medium()), lamp=BALLS["lamp"])
    assert alone[through] == "one sphere"
    walked = told(fog=ball(medium()), mask={"type": "rectangle", "bsdf": {"type": "null"}})
    assert walked[through] == "some"
