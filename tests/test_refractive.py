"""The search for connections through smooth glass: what it finds, and with which density.

Geometry is checked in float64 with ray tracing of the test's own, densities also by Monte Carlo.
"""

from __future__ import annotations

import itertools
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from build import scene
from tiers import THOROUGH, quick, thorough

from nonexp.integrators.needs import SceneNeeds
from nonexp.integrators.rays import Subscenes

refractive = import_module("nonexp.integrators.glass")

ETA = 1.4


LAMP = {
    "type": "rectangle",
    "to_world": mi.ScalarTransform4f().translate([0.3, 2.1, 0.2]).rotate([1, 0, 0], 90),
    "emitter": {"type": "area", "radiance": 1.0},
}


def glass(eta: float = ETA, **kw: Any) -> dict[str, Any]:
    return {"type": "dielectric", "int_ior": eta, "ext_ior": 1.0, **kw}


@cache
def sphere_mesh(texture_coordinates: bool = False, rows: int = 24) -> str:
    """A file of a unit sphere: rows x 2 rows of quadrangles, with the sphere's own normals."""
    columns = 2 * rows
    theta = np.linspace(0, np.pi, rows + 1)[:, None]
    phi = np.linspace(0, 2 * np.pi, columns, endpoint=False)[None]
    ring = np.sin(theta) * (np.arange(rows + 1) % rows != 0)[:, None]
    z = np.broadcast_to(np.cos(theta), ring.shape[:1] + phi.shape[1:])
    p = np.stack([ring * np.cos(phi), ring * np.sin(phi), z], axis=2)
    p = np.concatenate([p, p[:, :1]], axis=1)  # the seam twice
    at = np.arange((rows + 1) * (columns + 1)).reshape(rows + 1, columns + 1)
    a, b, c, d = at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]
    faces = np.concatenate(
        [np.stack([a, b, c], 2)[:-1].reshape(-1, 3), np.stack([a, c, d], 2)[1:].reshape(-1, 3)]
    )
    mesh = mi.Mesh(
        "sphere",
        p.size // 3,
        len(faces),
        has_vertex_normals=True,
        has_vertex_texcoords=texture_coordinates,
    )
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = np.ravel(p).astype(np.float32)
    parameters["vertex_normals"] = np.ravel(p).astype(np.float32)
    parameters["faces"] = np.ravel(faces).astype(np.uint32)
    if texture_coordinates:
        uv = np.stack(np.meshgrid(np.linspace(0, 1, columns + 1), theta[:, 0]), axis=2)
        parameters["vertex_texcoords"] = np.ravel(uv).astype(np.float32)
    parameters.update()
    path = Path(tempfile.mkdtemp()) / "sphere.ply"
    mesh.write_ply(str(path))
    return str(path)


def mesh_ball(bsdf: Any, texture_coordinates: bool = False, **kw: Any) -> dict[str, Any]:
    filename = sphere_mesh(texture_coordinates)
    return {"type": "ply", "filename": filename, "bsdf": bsdf, **kw}


def round_ball(bsdf: Any, radius: float = 1.0, **kw: Any) -> dict[str, Any]:
    return {"type": "sphere", "radius": radius, "bsdf": bsdf, **kw}


def search(**parts: Any) -> Any:
    """The search in a scene of lobes (and lights)."""
    built = scene(**{"lamp": LAMP, **parts})
    return refractive.refraction(SceneNeeds.of(built, None, "on").lobes, Subscenes())


# ------------------------------------------------------------------------------- the shapes


def flat(p: Any, n: Any) -> Callable[[Any, Any], tuple[Any, Any]]:
    """Where rays meet a plane, and its normal there."""

    def meet(x: Any, w: Any) -> tuple[Any, Any]:
        t = np.sum((p - x) * n, -1, keepdims=True) / np.sum(w * n, -1, keepdims=True)
        return x + t * w, np.broadcast_to(n, x.shape)

    return meet


def curved(centre: Any, radius: float, axes: Any) -> Callable[[Any, Any], tuple[Any, Any]]:
    """Where rays leave a sphere, or a cylinder if one of the ``axes`` does not count."""

    def meet(x: Any, w: Any) -> tuple[Any, Any]:
        o, d = (x - centre) * axes, w * axes
        a, b = np.sum(d * d, -1, keepdims=True), np.sum(o * d, -1, keepdims=True)
        c = np.sum(o * o, -1, keepdims=True) - radius**2
        p = x + (np.sqrt(b * b - a * c) - b) / a * w
        return p, (p - centre) * axes / radius

    return meet


def triangles(corners: Any, normals: Any) -> Callable[[Any, Any], tuple[Any, Any]]:
    """Where rays meet a triangle each, and the interpolated normal; both arrays (3, n, 3)."""
    edges = corners[1:] - corners[0]
    face = np.cross(edges[0], edges[1])

    def meet(x: Any, w: Any) -> tuple[Any, Any]:
        p, _ = flat(corners[0], face)(x, w)
        area = np.maximum(np.sum(face * face, -1, keepdims=True), 1e-30)
        u = np.sum(np.cross(p - corners[0], edges[1]) * face, -1, keepdims=True) / area
        v = np.sum(np.cross(edges[0], p - corners[0]) * face, -1, keepdims=True) / area
        n = (1 - u - v) * normals[0] + u * normals[1] + v * normals[2]
        return p, n / np.maximum(np.linalg.norm(n, axis=-1, keepdims=True), 1e-30)

    return meet


def triangles_of(si: Any) -> Callable[[Any, Any], tuple[Any, Any]]:
    """The triangles that interactions with meshes are on."""
    mesh = mi.MeshPtr(si.shape)
    at = mesh.face_indices(si.prim_index)
    corners = [numpy(mesh.vertex_position(corner)) for corner in at]
    normals = [numpy(mesh.vertex_normal(corner)) for corner in at]
    return triangles(np.array(corners), np.array(normals))


def numpy(v: Any) -> Any:
    return np.array(v, dtype=np.float64).T


@dataclass
class Case:
    """Lobes, points inside them, and where rays from there leave."""

    parts: Callable[[], dict[str, Any]]
    inside: Callable[[Any], Any]
    """points from random numbers, shape (n, 3)"""
    meet: Callable[[Any], Callable[[Any, Any], tuple[Any, Any]]]
    """from the surface interactions found, and points: the surface"""
    least: float = 0.7
    """fraction of targets to which a crossing is found; for some there is none"""


def in_unit_ball(u: Any) -> Any:
    z, phi = 2 * u[:, 0] - 1, 2 * np.pi * u[:, 1]
    r = np.sqrt(1 - z * z)
    d = np.stack([r * np.cos(phi), r * np.sin(phi), z], axis=1)
    return d * np.cbrt(u[:, 2:])


SHIFT = np.array([1.2, 0, 0])


def in_two_balls(u: Any) -> Any:
    return 0.5 * in_unit_ball(u) + np.where(np.arange(len(u))[:, None] % 2, SHIFT, -SHIFT)


def two_balls_met(si: Any) -> Callable[[Any, Any], tuple[Any, Any]]:
    return curved(np.where(numpy(si.p)[:, :1] > 0, SHIFT, -SHIFT), 0.5, np.ones(3))


PLACE = mi.ScalarTransform4f()


def water(surface: str) -> Case:
    """Seen from below a level surface."""
    level = PLACE.rotate([1, 0, 0], -90).scale(20)
    return Case(
        lambda: {"a": {"type": surface, "to_world": level, "bsdf": glass()}},
        lambda u: in_unit_ball(u) - [0, 1.01, 0],
        lambda si: flat(np.zeros(3), np.array([0, 1.0, 0])),
        0.99,
    )


CASES = {
    "sphere": Case(
        lambda: {"a": round_ball(glass(), 0.8)},
        lambda u: 0.8 * in_unit_ball(u),
        lambda si: curved(0, 0.8, np.ones(3)),
    ),
    "two spheres": Case(
        lambda: {
            "a": round_ball(glass(), 0.5, center=list(-SHIFT)),
            "b": round_ball(glass(), 0.5, center=list(SHIFT)),
        },
        in_two_balls,
        two_balls_met,
    ),
    "mesh": Case(lambda: {"a": mesh_ball(glass())}, lambda u: 0.9 * in_unit_ball(u), triangles_of),
    "mesh with UVs": Case(
        lambda: {"a": mesh_ball(glass(), True)}, lambda u: 0.9 * in_unit_ball(u), triangles_of
    ),
    "ellipsoid and ball of triangles": Case(
        lambda: {
            "a": mesh_ball(glass(), True, to_world=PLACE.translate(-SHIFT).scale([0.7, 0.5, 0.6])),
            "b": mesh_ball(glass(), to_world=PLACE.translate(SHIFT).scale(0.5)),
        },
        lambda u: 0.9 * in_two_balls(u) + 0.1 * np.sign(in_two_balls(u)[:, :1]) * SHIFT,
        triangles_of,
    ),
    "cylinder": Case(
        lambda: {"a": {"type": "cylinder", "p0": [-4, 0, 0], "p1": [4, 0, 0], "bsdf": glass()}},
        lambda u: 0.9 * in_unit_ball(u),
        lambda si: curved(0, 1, np.array([0, 1, 1])),
    ),
    "water": water("rectangle"),
    "disk of water": water("disk"),
}


def target(u: Any, x: Any, infinite: bool) -> Any:
    """Lines from ``x`` to points high above, or in directions upwards."""
    above = np.stack([4 * u[:, 0] - 2, 3 + u[:, 1], 4 * u[:, 2] - 2], axis=1)
    away = above if infinite else above - x
    distance = np.linalg.norm(away, axis=1)
    d = away / distance[:, None]
    end = x + 50 * d if infinite else above
    distance = np.full_like(distance, np.inf) if infinite else distance
    return refractive.Line(mi.Point3f(end.T), mi.Vector3f(d.T), mi.Float(distance))


def interaction(x: Any) -> Any:
    it = dr.zeros(mi.Interaction3f, dr.width(x))
    it.p = x
    return it


def find(g: Any, x: Any, line: Any) -> tuple[Any, Any]:
    """Searches from points, shape (n, 3)."""
    x = mi.Point3f(np.asarray(x).T)
    separated, crossing = g.find(x, line, interaction(x), mi.Bool(True) & (x.x == x.x))
    dr.eval(separated, crossing)  # by one kernel
    return np.array(separated), crossing


def refracted(meet: Any, x: Any, w: Any) -> tuple[Any, Any]:
    """Where rays leave the glass, and in which direction, in float64."""
    p, n = meet(x, w)
    cosine = np.sum(w * n, -1, keepdims=True)
    tangential = ETA * (w - cosine * n)
    square = np.sum(tangential**2, -1, keepdims=True)
    return p, tangential + np.sqrt(np.maximum(1 - square, 0)) * n


@pytest.mark.thorough
@pytest.mark.parametrize("infinite", [False, *thorough(True)], ids=["near", "at infinity"])
@pytest.mark.parametrize("name", quick(CASES, {"sphere", "mesh with UVs"}.__contains__))
def test_crossings(name: str, infinite: bool) -> None:
    """On the surface, as Snell says, leading to the target; ``spread`` is a ratio of angles."""
    case = CASES[name]
    u = np.random.default_rng(1).random((2, 4000, 3))
    x = case.inside(u[0]).astype(np.float32).astype(np.float64)
    line = target(u[1], x, infinite)
    parts = case.parts()
    glass = search(**parts)  # to be kept until its answers are evaluated
    separated, c = find(glass, x, line)
    found = np.array(c.found)
    assert np.all(separated)
    assert np.mean(found) >= case.least

    meet = case.meet(c.si)
    p, w, o = numpy(c.line.p), numpy(c.line.d), numpy(c.onward.d)
    with np.errstate(all="ignore"):
        right_p, right_o = refracted(meet, x, w)
    if infinite:
        assert np.all(np.isinf(np.array(c.onward.distance)))
        right_end = numpy(line.d)
    else:
        right_end = o
        end = p + o * np.array(c.onward.distance)[:, None]
        np.testing.assert_allclose(end[found], numpy(line.p)[found], atol=1e-5)
    distance = np.linalg.norm(p - x, axis=1)
    np.testing.assert_allclose(
        np.array(c.line.distance)[found], distance[found], rtol=2e-5, atol=3e-7
    )
    np.testing.assert_allclose(p[found], right_p[found], atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(w[found], axis=1), 1, atol=1e-6)
    np.testing.assert_allclose(o[found], right_end[found], atol=1e-6)
    # Directions that leave at a grazing angle turn by more than the half vector does.
    with np.errstate(all="ignore"):
        _, n = meet(x, w)
    sine = o - n * np.sum(o * n, axis=1, keepdims=True)
    right_sine = right_o - n * np.sum(right_o * n, axis=1, keepdims=True)
    np.testing.assert_allclose(sine[found], right_sine[found], atol=6e-5)
    assert np.all(np.sum(w * n, axis=1)[found] > 0) and np.all(np.sum(o * n, axis=1)[found] > 0)
    assert np.all(np.sum(numpy(c.si.n) * o, axis=1)[found] > 0)

    # Solid angle within per solid angle without: central differences.
    h = 1e-5
    s = np.cross(w, np.where(abs(w[:, :1]) < 0.7, [1, 0, 0], [0, 1, 0]))
    s /= np.linalg.norm(s, axis=1, keepdims=True)
    t = np.cross(w, s)

    def arrival(w: Any) -> Any:
        p, direction = refracted(meet, x, w)
        if infinite:
            return direction
        end, _ = flat(numpy(line.p), o)(p, direction)
        return end / np.array(c.onward.distance)[:, None]

    with np.errstate(all="ignore"):
        du, dv = ((arrival(w + h * k) - arrival(w - h * k)) / (2 * h) for k in (s, t))
        spread = 1 / np.abs(np.sum(np.cross(du, dv) * o, axis=1))
        error = np.abs(np.array(c.spread) / spread - 1)[found]
    error = np.sort(error[np.isfinite(error)])
    assert len(error) > 0.99 * np.sum(found)
    assert np.median(error) < 2e-5
    assert error[int(0.99 * len(error))] < 5e-3


def test_index_matched_glass_bends_nothing() -> None:
    """Crossings are where the straight line is; density, transmission are those of no surface."""
    u = np.random.default_rng(2).random((2, 4000, 3))
    for shape, size in ((round_ball, 1.0), (mesh_ball, 0.9)):
        x = size * in_unit_ball(u[0])
        line = target(u[1], x, False)
        built = scene(lamp=LAMP, a=shape(glass(1.0)))
        g = refractive.refraction(SceneNeeds.of(built, None, "on").lobes, Subscenes())
        _, c = find(g, x, line)
        assert np.mean(np.array(c.found)) > 0.995  # a mesh's normals turn rays away at its rim
        found = np.array(c.found)
        ds = dr.zeros(mi.DirectionSample3f, len(x))
        ds.d, ds.dist, ds.n = line.d, line.distance, mi.Normal3f(0, -1, 0)
        np.testing.assert_allclose(numpy(c.line.d)[found], numpy(line.d)[found], atol=2e-5)
        for value in (c.density(ds), c.passing, c.transmitted[0], c.transmitted[2]):
            error = np.sort(np.abs(np.array(value) - 1)[found])
            assert error[int(0.99 * len(error))] < 2e-4


# ------------------------------------------------------------------------------- Monte Carlo


@dataclass
class Rays:
    """What rays from points inside found behind the surface of the glass."""

    p: Any
    """where they left it"""
    line: Any
    """straight from where they began to the emitter that they met"""
    lit: Any
    """they met one"""
    light: Any
    """radiance, over the density of directions"""


def cast(built: Any, x: Any, sampler: Any) -> Rays:
    """Rays in all directions, that pass through one surface or are lost."""
    w = mi.warp.square_to_uniform_sphere(sampler.next_2d())
    si = built.ray_intersect(mi.Ray3f(x, w))
    bs, weight = si.bsdf().sample(mi.BSDFContext(), si, sampler.next_1d(), sampler.next_2d())
    out = mi.has_flag(bs.sampled_type, mi.BSDFFlags.DeltaTransmission)
    end = built.ray_intersect(si.spawn_ray(si.to_world(bs.wo)), out)
    emitter = end.emitter(built)
    lit = out & (emitter != None)  # noqa: E711
    light = dr.select(lit, weight[0] * emitter.eval(end, lit)[0] * 4 * dr.pi, 0)
    ds = mi.DirectionSample3f(built, end, interaction(x))
    infinite = ~end.is_valid()
    distance = dr.select(infinite, dr.inf, ds.dist)
    away = dr.select(infinite, x + 100 * ds.d, ds.p)
    return Rays(si.p, refractive.Line(away, ds.d, distance), lit, light)


def sampler(seed: int, count: int) -> Any:
    made = mi.load_dict({"type": "independent"})
    made.seed(seed, count)
    return made


def sky() -> dict[str, Any]:
    """Bright in one direction, black in half of all."""
    theta = np.linspace(0, np.pi, 16)[:, None]
    phi = np.linspace(0, 2 * np.pi, 32)[None]
    values = np.maximum(np.cos(theta) + 0.5 * np.sin(theta) * np.cos(phi), 0) ** 4
    return {"type": "envmap", "bitmap": mi.Bitmap(np.repeat(values[..., None], 3, 2))}


POINTS = [[0, 0, 0], [0.2, 0.3, 0.1], [0.7, 0.1, 0.1], [-0.4, 0.6, 0.2]]


@pytest.mark.thorough
@pytest.mark.parametrize("light", ["panel", *thorough("bulb", "sky")])
@pytest.mark.parametrize("kind", ["sphere", *thorough("mesh with UVs")])
def test_connections_estimate_what_rays_find(kind: str, light: str, effort: int) -> None:
    """Integrals over the emitter and over directions agree, of light that a search would find.

    A bias of 13 % is found with a probability above 0.9 (5 + 1.3 standard errors of 2 %), of 3 %
    with --full.
    """
    lobe = round_ball(glass(), 0.8)
    if kind != "sphere":
        lobe = mesh_ball(glass(), True, to_world=PLACE.scale(0.8))
    panel = {**LAMP, "to_world": LAMP["to_world"].scale(3)}
    bulb = {"type": "sphere", "center": [0.4, 2.2, 0.3], "radius": 1.2, "emitter": LAMP["emitter"]}
    built = scene(lobe=lobe, lamp={"panel": panel, "bulb": bulb, "sky": sky()}[light])
    g = refractive.refraction(SceneNeeds.of(built, None, "on").lobes, Subscenes())
    count = 2**18 * effort
    scores = []
    for seed, where in enumerate(POINTS):
        s = sampler(seed, count)
        x = dr.zeros(mi.Point3f, count) + dr.opaque(mi.Point3f, where)  # one kernel for all
        it = interaction(x)
        rays = cast(built, x, s)
        _, c = g.find(x, rays.line, it, rays.lit)
        same = c.found & (dr.norm(c.line.p - rays.p) < 1e-3 * c.line.distance)
        chance = dr.select(same, rays.light, 0)
        ds, value = built.sample_emitter_direction(it, s.next_2d(), False)
        distance = mi.Float(dr.inf) if light == "sky" else ds.dist
        separated, c = g.find(x, refractive.Line(ds.p, ds.d, distance), it, ds.pdf > 0)
        value = value[0] * c.transmitted[0] / c.density(ds)
        value = dr.select(separated & c.found, value, 0)
        dr.eval(chance, value, rays.light)  # by one kernel
        by_chance, connected = (np.array(v, dtype=np.float64) for v in (chance, value))
        assert np.all(np.isfinite(connected))
        error = np.hypot(np.std(by_chance), np.std(connected)) / np.sqrt(count)
        assert error < 0.02 * np.mean(by_chance) / effort**0.5
        scores.append((np.mean(connected) - np.mean(by_chance)) / error)
        assert np.mean(by_chance) > 0.9 * np.mean(np.array(rays.light))
    assert np.max(np.abs(scores)) < 5, scores


@THOROUGH
def test_searches_find_what_ordinary_paths_do() -> None:
    """From x in the ball, light met through p, in the dragon's room: 99 % of the searches from x
    to there find a way, 95 % the same one. (There may be several, the more the farther from the
    middle: the others are left to chance.)"""
    place = PLACE.translate([0, 2.95, 0.5]).rotate([1, 0, 0], 90).scale([2, 2.25, 1])
    centre = mi.Point3f(0, 0.81, 0)
    built = scene(
        light={**LAMP, "to_world": place},
        lobe=round_ball(glass(), 0.8, center=[0, 0.81, 0]),
    )
    g = refractive.refraction(SceneNeeds.of(built, None, "on").lobes, Subscenes())
    count = 2**18
    u = np.random.default_rng(3).random((count, 3))
    x = centre + mi.Vector3f(0.8 * in_unit_ball(u).T)
    rays = cast(built, x, sampler(1, count))
    _, c = g.find(x, rays.line, interaction(x), rays.lit)
    same = c.found & (dr.norm(c.line.p - rays.p) < 1e-3 * c.line.distance)
    lit = np.array(rays.lit)
    assert np.sum(lit) > 20_000
    assert np.mean(np.array(c.found)[lit]) >= 0.99
    assert np.mean(np.array(same)[lit]) >= 0.95
    middle = lit & (np.array(dr.norm(x - centre)) < 0.5 * 0.8)
    assert np.mean(np.array(same)[middle]) >= 0.9999


# ------------------------------------------------------------------------------- rough ground


@pytest.mark.parametrize("radius", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("eta", [*thorough(1.0001), 1.4, *thorough(2.4), 1 / 1.4])
def test_whatever_is_asked_ends_in_numbers(eta: float, radius: float) -> None:
    """Points on the surface, in the middle, outside; targets on, in, near the ball, at infinity."""
    u = np.random.default_rng(4).random((400, 3))
    d = in_unit_ball(u)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    starts = [0 * d, d * (1 - 1e-7), d, d * (1 + 1e-6), d * 0.999, in_unit_ball(u[::-1]), 3 * d]
    other = np.roll(d, 1, axis=0)
    ends = [other, other * (1 + 1e-6), other * 0.5, 1.001 * other, 5 * other, -d, 0 * d]
    x, y = (np.concatenate(v) for v in zip(*itertools.product(starts, ends), strict=True))
    x, y = (radius * x).astype(np.float32), (radius * y).astype(np.float32)
    g = search(a=round_ball(glass(eta), radius))
    for infinite in (False, True):
        away = (y - x).astype(np.float64)
        distance = np.linalg.norm(away, axis=1)
        away = np.where(distance[:, None] > 0, away, [radius, 0, 0])
        away /= np.linalg.norm(away, axis=1, keepdims=True)
        end = x + 10 * radius * away if infinite else y
        length = np.full_like(distance, np.inf) if infinite else distance
        line = refractive.Line(mi.Point3f(end.T), mi.Vector3f(away.T), mi.Float(length))
        separated, c = find(g, x, line)
        found = np.array(c.found) & separated
        assert not np.any(np.array(c.found) & ~separated)
        assert np.mean(found) > 0.04
        for value in (c.spread, c.passing, c.transmitted[0], c.line.distance, *c.line.p):
            assert np.all(np.isfinite(np.array(value)[found]))
        assert np.all(np.array(c.spread)[found] > 0)
        p, w, o = numpy(c.line.p)[found], numpy(c.line.d)[found], numpy(c.onward.d)[found]
        n = p / radius
        np.testing.assert_allclose(np.linalg.norm(n, axis=1), 1, atol=1e-5)
        half = np.cross(n, eta * w - o)
        assert np.max(np.abs(half)) < 1e-4
        assert np.all(np.sum(w * n, 1) > 0) and np.all(np.sum(o * n, 1) > 0)


@THOROUGH
def test_the_search_takes_no_more_steps_than_it_may() -> None:
    """Kernels launched where each step is one: a mesh far from round keeps searches busy."""
    g = search(a=mesh_ball(glass(2.4), to_world=PLACE.scale([3, 0.2, 1])))
    u = np.random.default_rng(5).random((2, 2000, 3))
    x = in_unit_ball(u[0]) * [2.7, 0.18, 0.9]
    line = target(u[1], x, False)
    with (
        dr.scoped_set_flag(dr.JitFlag.SymbolicLoops, False),
        dr.scoped_set_flag(dr.JitFlag.KernelHistory),
    ):
        dr.kernel_history_clear()
        _, c = find(g, x, line)
        dr.eval(c)
        kernels = len(dr.kernel_history([dr.KernelType.JIT]))
    assert refractive.STEPS / 2 < kernels < 2 * refractive.STEPS + 20
    assert np.all(np.isfinite(np.array(c.spread)[np.array(c.found)]))
