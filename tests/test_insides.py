"""What reaches into Mitsuba: with the version that is here, and stand-ins for the next one."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from nonexp.system import insides


class NextMesh:
    """A mesh as of Mitsuba 3.10: tensors, positions apart from vertices, no buffers."""

    def __init__(self) -> None:
        self._positions = mi.TensorXf(np.arange(12.0), (4, 3))
        self._geometric = mi.TensorXu([0, 1, 2, 0, 2, 3], (2, 3))

    def positions(self) -> Any:
        return self._positions

    def faces(self) -> Any:
        raise AssertionError("counts vertices, not positions")

    def geometric_faces(self) -> Any:
        return self._geometric

    def has_normals(self) -> bool:
        return True

    def has_flipped_normals(self) -> bool:
        return False


@pytest.fixture(autouse=True)
def variant() -> None:
    mi.set_variant("llvm_ad_rgb")


def test_meshes_of_this_version() -> None:
    cube: Any = mi.load_dict({"type": "cube", "flip_normals": True})
    positions = np.array(insides.vertex_positions(cube)).reshape(-1, 3)
    faces = np.array(insides.faces(cube)).reshape(-1, 3)
    assert faces.shape == (cube.face_count(), 3) and positions.shape == (cube.vertex_count(), 3)
    a, b, c = np.moveaxis(positions[faces], 1, 0)
    assert np.sum(a * np.cross(b, c)) / 6 == pytest.approx(8.0)  # the volume
    assert insides.flips_normals(cube) and not insides.flips_normals(mi.load_dict({"type": "disk"}))
    assert insides.has_vertex_normals(cube)
    assert not insides.has_vertex_normals(mi.Mesh("plain", 3, 1))


def test_meshes_of_the_next_version() -> None:
    mesh = NextMesh()
    np.testing.assert_array_equal(insides.vertex_positions(mesh), np.arange(12.0))
    np.testing.assert_array_equal(insides.faces(mesh), [0, 1, 2, 0, 2, 3])
    assert insides.has_vertex_normals(mesh) is True
    assert insides.flips_normals(mesh) is False


def test_normal_derivatives(monkeypatch: pytest.MonkeyPatch) -> None:
    sphere = mi.load_dict({"type": "sphere"})
    ray = mi.Ray3f([0.2, 0.1, 3], [0, 0, -1])
    flags = mi.RayFlags.All | insides.normal_derivatives()
    assert dr.norm(sphere.ray_intersect(ray, flags).dn_du)[0] > 0.1
    monkeypatch.setattr(mi, "RayFlags", SimpleNamespace(NormalPartials=2), raising=False)
    assert insides.normal_derivatives() == 2


def test_numbers_of_objects() -> None:
    shapes = [mi.load_dict({"type": "sphere"}) for _ in range(3)]
    numbers = [int(insides.number_of(mi.ShapePtr(shape))[0]) for shape in shapes]
    assert len(set(numbers)) == 3 and min(numbers) >= 1
    assert insides.number_of(mi.ShapePtr(None))[0] == 0
    assert int(insides.number_of(mi.ShapePtr(shapes[1]))[0]) == numbers[1]


def test_variables_tell_arrays_apart() -> None:
    one, two = mi.Float([1.0, 2.0]), mi.TensorXf([3.0, 4.0])
    before = insides.variables(one, two)
    assert insides.variables(one, two) == before and len(set(before)) == 2
    one += 1
    after = insides.variables(one, two)
    assert after[0] != before[0] and after[1] == before[1]


def test_nested_objects() -> None:
    scene = mi.load_dict(
        {
            "type": "scene",
            "group": {"type": "shapegroup", "ball": {"type": "sphere"}},
            "instance": {"type": "instance", "group": {"type": "ref", "id": "group"}},
        }
    )
    assert {shape.class_name() for shape in insides.nested(scene, mi.Shape)} >= {"Sphere"}
    assert len(insides.nested(scene, mi.BSDF)) == 1


def test_addresses_are_replaced() -> None:
    texts = ["object_140001234 a=0x7f0012ab", "object_140009999, object_140001234", "object_12"]
    assert insides.anonymous(texts) == ["object 0 a=object 1", "object 2, object 0", "object_12"]
    printed = [str(mi.load_dict({"type": "diffuse"})) for _ in range(2)]
    assert len({insides.anonymous([text])[0] for text in printed}) == 1


def test_numbers_of_samples_are_not_described() -> None:
    def described(**sampler: Any) -> str:
        return insides.described(mi.load_dict({"type": "independent", **sampler}), "end")

    assert described(sample_count=4) == described(sample_count=16)
    assert described(seed=1) != described(seed=2)
    assert described().endswith("\nend")


@pytest.mark.parametrize("pixel_format", ["rgb", "xyz", "xyza", "luminance"])
def test_films_of_xyz(pixel_format: str) -> None:
    film = mi.load_dict({"type": "hdrfilm", "pixel_format": pixel_format})
    assert insides.is_xyz(film) == pixel_format.startswith("xyz")
