"""Files of grids: every format against what it was written from, positions too; bad files."""

from __future__ import annotations

import io
import re
import sys
import zipfile
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
import vdbfiles
from tiers import THOROUGH

import nonexp
from nonexp.plugins import dense, nanovdb, openvdb
from nonexp.rendering.job import RenderJob
from nonexp.scene import files as scenefiles
from nonexp.scene.load import load

GRID = np.random.default_rng(1).random((4, 5, 6), np.float32)
COLOUR = np.random.default_rng(2).random((2, 3, 4, 3), np.float32)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of grid files, in which the test runs."""
    monkeypatch.chdir(tmp_path)
    vdbfiles.write(tmp_path)
    return tmp_path


def medium(**parameters: Any) -> Any:
    return mi.load_dict({"type": "nonexp_heterogeneous", **parameters})


# --------------------------------------------------------------------- values


@pytest.mark.parametrize("array", [GRID, COLOUR, GRID[:1, :1, :1]])
@pytest.mark.parametrize("ending", ["vol", "npy", "npz", "NPZ"])
def test_arrays_come_back(folder: Path, array: Any, ending: str) -> None:
    path = folder / f"grid.{ending}"
    if ending == "vol":
        mi.VolumeGrid(array).write(str(path))
    else:
        with open(path, "wb") as file:
            (np.save if ending == "npy" else np.savez_compressed)(file, array)
    for name in (path, str(path), path.name):
        found, placed = nonexp.read_grid(name)
        assert placed is None and found.dtype == np.float32
        np.testing.assert_array_equal(found, array)


@pytest.mark.parametrize("kind", ["f2", "f8", ">f4", "u1", "i8", "?", "g"])
def test_every_real_type_is_understood(folder: Path, kind: str) -> None:
    array = (8 * GRID).astype(kind)
    np.save("a.npy", array)
    np.testing.assert_array_equal(nonexp.read_grid("a.npy")[0], array.astype(np.float32))
    np.save("a.npy", np.asfortranarray(array)[..., None])
    found, _ = nonexp.read_grid("a.npy")
    assert found.flags.c_contiguous
    np.testing.assert_array_equal(found, array.astype(np.float32))


def test_a_field_names_the_array(folder: Path) -> None:
    np.savez("a.npz", density=GRID, heat=2 * GRID)
    np.testing.assert_array_equal(nonexp.read_grid("a.npz", "heat")[0], 2 * GRID)
    np.testing.assert_array_equal(nonexp.read_grid("a.npz", field="density")[0], GRID)


def several(background: float = 0.25) -> Any:
    """The grids ``density`` and ``heat`` of vdbfiles, over their active voxels."""
    low, high = np.array([-3, -5, -2]), np.array([20, 9, 7])
    array = np.full((high - low + 1)[::-1], background, np.float32)
    array[0 + 2 : 8 + 2, 0 + 5 : 8 + 5, 0 + 3 : 16 + 3] = 2
    for (x, y, z), value in vdbfiles.VOXELS.items():
        array[z + 2, y + 5, x + 3] = value
    return array, low, high


@pytest.mark.parametrize("name", ["several.vdb", "several.nvdb"])
@pytest.mark.parametrize("field", ["density", "heat"])
def test_vdb_is_read_with_its_tiles_and_its_place(folder: Path, name: str, field: str) -> None:
    if name.endswith(".vdb"):
        pytest.importorskip("tinyvdb")
    array, placed = nonexp.read_grid(name, field)
    expected, low, high = several()
    np.testing.assert_array_equal(array, expected)
    to_world = vdbfiles.TO_WORLD
    if field == "heat":
        to_world = np.array([[0.5, 0, 0, 1], [0, 0.5, 0, 2], [0, 0, 0.5, 3], [0, 0, 0, 1]])
    for unit, index in (([0, 0, 0], low - 0.5), ([1, 1, 1], high + 0.5), ([0, 1, 0], None)):
        if index is None:
            index = np.where([0, 1, 0], high + 0.5, low - 0.5)
        np.testing.assert_allclose(placed @ [*unit, 1], to_world @ [*index, 1], rtol=1e-14)


@pytest.mark.parametrize("bits, error", [("", 0), ("16", 4.5e-5), ("8", 0.0114), ("4", 0.193)])
def test_nanovdb_with_fewer_bits(folder: Path, bits: str, error: float) -> None:
    """At most half a step off, of which 2^bits - 1 lead from 0 to 5.75."""
    array, placed = nonexp.read_grid(f"ramp{bits}.nvdb")
    np.testing.assert_allclose(array, vdbfiles.RAMP, atol=error, rtol=0)
    assert len(np.unique(array)) >= (8 if bits == "4" else 20)
    np.testing.assert_allclose(placed @ [0, 0, 0, 1], [7.5, -0.5, -8.5, 1])


def test_leaves_are_made_dense_a_few_at_a_time(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(nanovdb, "_LEAVES", 1)
    np.testing.assert_array_equal(nonexp.read_grid("several.nvdb", "density")[0], several()[0])


# --------------------------------------------------------------------- in a medium


@pytest.mark.parametrize("name", ["several.vdb", "several.nvdb"])
def test_a_vdb_lies_where_it_says(folder: Path, name: str) -> None:
    if name.endswith(".vdb"):
        pytest.importorskip("tinyvdb")
    moved = mi.ScalarTransform4f().translate([5, -1, 2]).scale(3)
    found = medium(filename=name, field="density", to_world=moved, filter_type="nearest")
    expected, low, high = several()
    z, y, x = (axis.ravel() for axis in np.indices(expected.shape))
    index = np.stack([x, y, z, np.ones_like(x)]).astype(float)
    index[:3] += low[:, None]
    points = np.array(moved.matrix, dtype=float) @ vdbfiles.TO_WORLD @ index
    looked = found.density.lookup(mi.Point3f(*map(mi.Float, points[:3])))
    np.testing.assert_array_equal(looked, expected.ravel())
    beyond = (vdbfiles.TO_WORLD @ [*(high + 0.51), 1])[:3] * 3 + [5, -1, 2]
    assert found.density.lookup(mi.Point3f(beyond.tolist()))[0] == 0


def test_a_file_is_the_same_as_a_gridvolume(folder: Path) -> None:
    mi.VolumeGrid(GRID).write("a.vol")
    place = mi.ScalarTransform4f().rotate([0, 1, 0], 30).scale([1, 2, 3])
    rest = {"to_world": place, "filter_type": "trilinear", "wrap_mode": "mirror"}
    volume = {"type": "gridvolume", "filename": "a.vol", "raw": True, **rest}
    points = np.random.default_rng(3).uniform(-1, 3, (3, 500)).astype(np.float32)
    found = [
        np.array(one.density.lookup(mi.Point3f(points)))
        for one in (medium(filename="a.vol", **rest), medium(sigma_t=volume))
    ]
    assert np.count_nonzero(found[0]) > 20
    np.testing.assert_array_equal(*found)


# --------------------------------------------------------------------- bad files


def objects() -> Any:
    return np.array([[[{}]]], dtype=object)


def archived(**arrays: Any) -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


def saved(array: Any) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, array)
    return buffer.getvalue()


def foreign() -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("readme", "hello")
    return buffer.getvalue()


HUGE = saved(GRID).replace(b"(4, 5, 6)", b"(1290, 1290, 1291)")[:200]
BAD: dict[str, tuple[bytes | None, str, str]] = {
    "gone.npz": (None, "", r"'gone.npz': it does not exist \(the command nonexp cloud FILE makes"),
    "a.txt": (b"", "", r"'a.txt': it must end in .vol, .npy, .npz, .vdb, .nvdb"),
    "named.npy": (saved(GRID), "x", "field is 'x': a .npy file holds one grid, without a name"),
    "named.vol": (b"", "x", "field is 'x': a .vol file holds one grid, without a name"),
    "two.npz": (archived(a=GRID, b=GRID), "", "field is missing: it must be one of 'a', 'b', the"),
    "none.npz": (archived(a=GRID), "b", "field is 'b': it must be one of 'a', the grids of 'none"),
    "void.npz": (archived(), "", "it holds no grid"),
    "foreign.npz": (foreign(), "", "it cannot be read \\(what it holds is no array\\)"),
    "flat.npy": (saved(GRID[0]), "", r"has the shape \(5, 6\): it must be \(z, y, x\), or"),
    "two.npy": (saved(GRID[..., :2][..., None, :]), "", r"has the shape \(4, 5, 1, 2\): it must"),
    "five.npy": (saved(GRID[None, None]), "", r"has the shape \(1, 1, 4, 5, 6\): it must be"),
    "empty.npy": (saved(GRID[:0]), "", r"has the shape \(0, 5, 6\): it must not be empty"),
    "complex.npy": (saved(GRID * 1j), "", "holds complex64: it must hold real numbers"),
    "text.npy": (saved(np.full((1, 1, 1), "a")), "", "holds <U1: it must hold real numbers"),
    "time.npy": (saved(GRID.astype("m8[s]")), "", r"holds timedelta64\[s\]: it must hold real"),
    "objects.npy": (saved(objects()), "", "cannot be read .*Object arrays cannot be loaded"),
    "objects.npz": (archived(a=objects()), "", "cannot be read .*Object arrays cannot be loaded"),
    "cut.npy": (saved(GRID)[:200], "", "it cannot be read"),
    "cut.npz": (archived(a=GRID)[:200], "", "it cannot be read"),
    "huge.npy": (HUGE, "", "it cannot be read"),
    "zip.npy": (archived(a=GRID), "", "its contents are those of a .npz file"),
    "array.npz": (saved(GRID), "", "its contents are those of a .npy file"),
    "cut.vol": (b"VOL\3\1\0\0\0", "", "it cannot be read"),
    "other.vol": (b"nothing of the kind", "", "it cannot be read"),
    "other.vdb": (b"nothing of the kind", "", "it cannot be read"),
    "other.nvdb": (b"nothing of the kind", "", "it does not begin like a NanoVDB file"),
    "void.nvdb": (b"", "", "it holds no grid"),
    "nan.npy": (saved(GRID * np.nan), "", "'nan.npy': its grid holds nan: densities must be fin"),
    "minus.npy": (saved(GRID - 1), "", "its grid holds -0.9.*: densities must be finite numbers"),
    "large.npy": (
        saved(GRID.astype(float) * 1e300),
        "",
        "its grid holds inf: densities must be finite",
    ),
    "root.vdb": (None, "", r"its grid spans 4096 x 4096 x 4096 voxels, 256 GiB if every one"),
    "several.vdb": (None, "", "field is missing: it must be one of 'density', 'heat', 'mask', "),
    "several.nvdb": (None, "smoke", "field is 'smoke': it must be one of 'big', 'density', "),
    "blosc.nvdb": (None, "", "its grid 'density' is compressed by Blosc: it must be uncompressed"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_files_are_one_sentence(folder: Path, name: str) -> None:
    data, field, message = BAD[name]
    if name.endswith(".vdb"):
        pytest.importorskip("tinyvdb")
    if data is not None:
        (folder / name).write_bytes(data)
    with pytest.raises(Exception, match=message) as caught:
        medium(filename=name, **({"field": field} if field else {}))
    if "densities" not in message:
        with pytest.raises(ValueError) as direct:
            nonexp.read_grid(name, field)
        text = str(direct.value)
        assert re.search(message, text) and "\n" not in text
        assert re.match(r"(filename|field) is ", text) and (name in text or field)
        assert text in str(caught.value)


@pytest.mark.parametrize("name", ["several.vdb", "several.nvdb"])
@pytest.mark.parametrize(
    "field, message",
    [
        ("mask", "its grid 'mask' is .*[bB]ool.*: it must be "),
        ("v", "its grid 'v' is .*[vV]ec3.*: it must be "),
        ("empty", "its grid 'empty' is empty: it has no active voxels"),
        ("big", r"spans 200001 x 5001 x 901 voxels, 3.36e\+03 GiB if .* less than 2\^31 voxels"),
    ],
)
def test_grids_of_a_vdb_that_are_no_densities(
    folder: Path, name: str, field: str, message: str
) -> None:
    if name.endswith(".vdb"):
        pytest.importorskip("tinyvdb")
    with pytest.raises(ValueError, match=message):
        nonexp.read_grid(name, field)


@pytest.mark.parametrize("name", ["several.vdb", "several.nvdb", "ramp4.nvdb"])
def test_damaged_vdbs_are_one_sentence(folder: Path, name: str) -> None:
    if name.endswith(".vdb"):
        pytest.importorskip("tinyvdb")
    whole = (folder / name).read_bytes()
    for share in (0.02, 0.3, 0.7, 0.99):
        (folder / name).write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(ValueError, match=r"filename is .*: it cannot be read"):
            nonexp.read_grid(name, "density")


def test_a_grid_larger_than_memory_is_refused(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dense.os, "sysconf", lambda name: 16, raising=False)
    np.save("a.npy", GRID)
    with pytest.raises(ValueError, match=r"spans 6 x 5 x 4 voxels, .* must be at most .* GiB"):
        nonexp.read_grid("a.npy")


def test_without_tinyvdb_the_extra_is_named(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "tinyvdb", None)
    with pytest.raises(ImportError, match=r'tinyvdb, .* pip install "nonexp\[vdb\]"$'):
        nonexp.read_grid("several.vdb", "density")
    nonexp.read_grid("several.nvdb", "density")  # needs nothing


def test_other_transforms_are_refused() -> None:
    with pytest.raises(ValueError, match="transform of kind frustum: it must be linear"):
        openvdb._to_world("filename is 'a'", {"type": "frustum"})


# --------------------------------------------------------------------- files of scenes

SCENE = """
<scene version="3.0.0">
    <default name="grid" value="data/a.npy"/>
    <integrator type="nonexp_volpath"><integer name="max_depth" value="3"/></integrator>
    <sensor type="perspective">
        <transform name="to_world">
            <lookat origin="0.5, 0.5, 4" target="0.5, 0.5, 0" up="0, 1, 0"/>
        </transform>
        <film type="hdrfilm">
            <integer name="width" value="8"/> <integer name="height" value="8"/>
            <rfilter type="box"/>
        </film>
    </sensor>
    <emitter type="constant"/>
    <medium type="nonexp_heterogeneous" id="medium">
        <string name="filename" value="$grid"/>
        <float name="scale" value="3"/>
        <texture type="transmittance_gamma" name="t"/>
    </medium>
    <shape type="sphere">
        <point name="center" x="0.5" y="0.5" z="0.5"/>
        <bsdf type="null"/><ref name="interior" id="medium"/>
    </shape>
</scene>
"""


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    (tmp_path / "home/data").mkdir(parents=True)
    (tmp_path / "home/a.xml").write_text(SCENE)
    for name, factor in (("a", 1), ("b", 2)):
        np.save(tmp_path / f"home/data/{name}.npy", factor * GRID)
    return tmp_path / "home/a.xml"


def test_the_grid_is_a_file_of_the_scene(scene: Path) -> None:
    assert set(scenefiles.collect(scene, {}).digests()) == {"a.xml", "data/a.npy"}
    chosen = scenefiles.collect(scene, {"grid": "data/b.npy"})
    assert set(chosen.digests()) == {"a.xml", "data/b.npy"}
    chosen.check_movable()
    absolute = scenefiles.collect(scene, {"grid": str(scene.parent / "data/b.npy")})
    assert set(absolute.digests()) == {"a.xml", "data/b.npy"}


def test_another_grid_is_another_render(scene: Path) -> None:
    def identity(**parameters: str) -> Any:
        return RenderJob.of_file(load(scene, parameters), scene, parameters, spp=4).identity

    before = identity()
    np.save(scene.parent / "data/b.npy", GRID)
    assert identity() == before
    np.save(scene.parent / "data/a.npy", GRID + 1)
    assert identity() != before


@THOROUGH
@pytest.mark.parametrize("parameters", [{}, {"grid": "data/b.npy"}])
def test_a_packed_scene_finds_its_grid(
    scene: Path, tmp_path: Path, parameters: dict[str, str]
) -> None:
    packed = scenefiles.collect(scene, parameters).pack()
    with zipfile.ZipFile(io.BytesIO(packed)) as archive:
        archive.extractall(tmp_path / "moved")
    images = []
    for path in (scene, tmp_path / "moved/a.xml"):
        images.append(np.array(mi.render(load(path, parameters).scene, spp=4, seed=1)))
    assert images[0].std() > 0
    np.testing.assert_array_equal(*images)
