"""The files of a scene: found, told apart, packed, and found again elsewhere."""

from __future__ import annotations

import zipfile
from io import BytesIO
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from nonexp.scene import (
    files as scenefiles,
)
from nonexp.scene import (
    identity as sceneid,
)
from nonexp.scene import (
    load as scenefile,
)
from nonexp.scene import parse
from nonexp.scene import (
    walk as scenewalk,
)
from nonexp.scene.messages import SceneError

pytestmark = [pytest.mark.thorough, pytest.mark.usefixtures("several_threads")]

SCENES = Path(__file__).resolve().parent.parent / "scenes"

SCENE = """
<scene version="3.0.0">
    <default name="law" value="halved:half"/>
    <default name="table" value="unused.csv"/>
    <default name="medium" value="own"/>
    <integrator type="nonexp_volpath"><integer name="max_depth" value="3"/></integrator>
    <sensor type="perspective">
        <transform name="to_world">
            <lookat origin="0, 0, 4" target="0, 0, 0" up="0, 1, 0"/>
        </transform>
        <film type="hdrfilm">
            <integer name="width" value="8"/> <integer name="height" value="8"/>
            <rfilter type="box"/>
        </film>
    </sensor>
    <emitter type="constant"/>
    <include filename="parts/$medium.xml"/>
    <shape type="ply">
        <string name="filename" value="parts/cube.ply"/>
        <bsdf type="null"/><ref name="interior" id="medium"/>
    </shape>
</scene>
"""
OWN = """
<scene version="3.0.0">
    <medium type="nonexp_homogeneous" id="medium">
        <texture type="transmittance_custom" name="t"><string name="ff" value="$law"/></texture>
    </medium>
</scene>
"""
TABLE = """
<scene version="3.0.0">
    <medium type="nonexp_homogeneous" id="medium">
        <texture type="transmittance_tabulated" name="t">
            <string name="filename" value="$table"/>
        </texture>
    </medium>
</scene>
"""
LAW = "import drjit as dr\n\ndef half(tau):\n    return 0.5 * (dr.exp(-tau) + dr.exp(-2 * tau))\n"


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    folder = tmp_path / "scene"
    (folder / "parts").mkdir(parents=True)
    (folder / "a.xml").write_text(SCENE)
    (folder / "parts/own.xml").write_text(OWN)
    (folder / "parts/table.xml").write_text(TABLE)
    (folder / "halved.py").write_text(LAW)
    for name in ("used.csv", "unused.csv"):
        (folder / name).write_text("0,1\n1,0.4\n2,0.2\n4,0.05\n")
    mi.load_dict({"type": "cube"}).write_ply(str(folder / "parts/cube.ply"))
    return folder / "a.xml"


def test_includes_meshes_and_modules_are_found(scene: Path) -> None:
    found = scenefiles.collect(scene, {})
    assert sorted(found.digests()) == ["a.xml", "halved.py", "parts/cube.ply", "parts/own.xml"]


def test_parameters_choose_the_files(scene: Path) -> None:
    found = scenefiles.collect(scene, {"medium": "table", "table": "used.csv"})
    assert sorted(found.digests()) == ["a.xml", "parts/cube.ply", "parts/table.xml", "used.csv"]


def test_the_scenes_of_the_project_are_whole() -> None:
    dragon = scenefiles.collect(SCENES / "dragon.xml", {"medium": "tabulated"}).digests()
    assert {"dragon.xml", "room.xml", "media/tabulated.xml", "media/packing.csv"} <= set(dragon)
    assert {"meshes/dragon.ply", "textures/wood_floor.png"} <= set(dragon)
    assert "laws.py" in scenefiles.collect(SCENES / "fog.xml", {"medium": "custom"}).digests()


def test_every_change_changes_a_checksum(scene: Path) -> None:
    before = scenefiles.collect(scene, {}).digests()
    for name in before:
        path = scene.parent / name
        old = path.read_bytes()
        path.write_bytes(old + b"\n")
        after = scenefiles.collect(scene, {}).digests()
        assert [n for n in before if before[n] != after[n]] == [name]
        path.write_bytes(old)
    assert scenefiles.collect(scene, {}).digests() == before


def test_a_packed_scene_renders_the_same_elsewhere(scene: Path, tmp_path: Path) -> None:
    files = scenefiles.collect(scene, {})
    files.check_movable()
    packed = files.pack()
    assert files.pack() == packed
    moved = tmp_path / "moved"
    with zipfile.ZipFile(BytesIO(packed)) as archive:
        archive.extractall(moved)
    here, there = (
        np.array(mi.render(scenefile.load(path, {}).scene, spp=4, seed=1))
        for path in (scene, moved / "a.xml")
    )
    assert here.std() > 0
    np.testing.assert_array_equal(here, there)


def test_files_above_the_scene_are_packed_too(scene: Path) -> None:
    above = scene.parent.parent / "own.xml"
    (scene.parent / "parts/own.xml").rename(above)
    scene.write_text(SCENE.replace("parts/$medium.xml", "../$medium.xml"))
    files = scenefiles.collect(scene, {})
    assert files.folder == above.parent.resolve()
    with zipfile.ZipFile(BytesIO(files.pack())) as archive:
        assert sorted(archive.namelist()) == [
            "own.xml", "scene/a.xml", "scene/halved.py", "scene/parts/cube.ply"
        ]  # fmt: skip


def test_absolute_paths_cannot_be_moved(scene: Path) -> None:
    mesh = scene.parent.resolve() / "parts/cube.ply"
    scene.write_text(SCENE.replace("parts/cube.ply", str(mesh)))
    files = scenefiles.collect(scene, {})
    assert "parts/cube.ply" in files.digests()
    with pytest.raises(ValueError, match=r"a\.xml refers to '/.*cube\.ply' by an absolute path"):
        files.check_movable()


# --------------------------------------------------------------------- media of a scene


def test_media_are_found_wherever_they_hang() -> None:
    def medium(sigma_t: float) -> dict[str, object]:  # equal ones would be merged
        return {"type": "nonexp_homogeneous", "sigma_t": sigma_t}

    ball = {"type": "sphere", "bsdf": {"type": "null"}}
    built = mi.load_dict(
        {
            "type": "scene",
            "group": {"type": "shapegroup", "ball": {**ball, "interior": medium(1.0)}},
            "instance": {"type": "instance", "group": {"type": "ref", "id": "group"}},
            "camera": {"type": "perspective", "medium": medium(2.0)},
            "lamp": {"type": "point", "medium": medium(3.0)},
            "ball": {**ball, "exterior": medium(4.0)},
        }
    )
    assert len(scenewalk.media(built)) == 4
    assert scenefile.LoadedScene(built, ("volpath",)).exponential_counterpart() == "volpath"
    only_instances = mi.load_dict(
        {
            "type": "scene",
            "group": {"type": "shapegroup", "ball": {**ball, "interior": medium(5.0)}},
            "instance": {"type": "instance", "group": {"type": "ref", "id": "group"}},
        }
    )
    loaded = scenefile.LoadedScene(only_instances, ("volpath",))
    assert loaded.exponential_counterpart() == "volpath"
    assert scenefile.LoadedScene(built, ("nonexp_volpath",)).exponential_counterpart() is None


def test_a_scene_is_the_same_each_time_and_its_meshes_are_few(tmp_path: Path) -> None:
    """Shapes and lights in one order: it decides which random number finds which light."""
    mi.set_variant("llvm_ad_rgb")
    cube = '<shape type="cube" id="{id}"><transform name="to_world"><scale value="0.1"/>{move}'
    cube += "</transform>{rest}</shape>"
    shapes = []
    for i in range(40):
        light = f'<emitter type="area"><rgb name="radiance" value="{1 + i}"/></emitter>'
        rest = light if i % 8 == 0 else f'<ref id="b{i % 2}"/>'
        move = f'<translate x="{i % 7 - 3}" y="{i // 7 - 3}"/>'
        shapes.append(cube.format(id=f"cube{i}", move=move, rest=rest))
    path = tmp_path / "scene.xml"
    path.write_text(
        """<scene version="3.0.0">
            <integrator type="path"><integer name="max_depth" value="3"/></integrator>
            <sensor type="perspective">
                <transform name="to_world">
                    <lookat origin="0, 0, 9" target="0, 0, 0" up="0, 1, 0"/>
                </transform>
                <film type="hdrfilm"><rfilter type="box"/></film>
            </sensor>
            <bsdf type="diffuse" id="b0"/>
            <bsdf type="diffuse" id="b1"><rgb name="reflectance" value="0.2"/></bsdf>"""
        + "".join(shapes)
        + "</scene>",
        encoding="utf-8",
    )
    orders, identities, images = set(), set(), set()
    for _ in range(6):
        scene = scenefile.load(path, {}, (16, 12)).scene
        assert len(scene.shapes()) == 5 + 2
        orders.add(tuple(shape.id() for shape in scene.shapes()))
        identities.add(sceneid.digest(sceneid.of_scene(scene)))
        images.add(np.array(mi.render(scene, spp=16)).tobytes())
    assert len(orders) == len(identities) == len(images) == 1
    plain = mi.load_file(str(path), optimize=False)
    plain_faces = sum(shape.face_count() for shape in plain.shapes())
    assert sum(shape.face_count() for shape in scene.shapes()) == plain_faces


def test_what_the_module_of_a_law_imports_counts(scene: Path) -> None:
    folder = scene.parent
    (folder / "halved.py").write_text("import rates\nfrom inner.more import x\n" + LAW)
    (folder / "rates.py").write_text("import numpy\nimport further\n")
    (folder / "further.py").write_text("raise SystemExit('it is not run')\n")
    (folder / "inner").mkdir()
    (folder / "inner/__init__.py").write_text("")
    (folder / "inner/more.py").write_text("from . import most\nx = 1\n")
    (folder / "inner/most.py").write_text("")
    (folder / "another.py").write_text("")
    found = {name for name in scenefiles.collect(scene, {}).digests() if name.endswith(".py")}
    inner = {"inner/__init__.py", "inner/more.py", "inner/most.py"}
    assert found == {"halved.py", "rates.py", "further.py"} | inner


def test_files_are_those_that_mitsuba_takes(
    scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In the scene's folder rather than beside an included file, on a path, or where it runs."""
    working = tmp_path / "working"
    for place in ("scene", "scene/parts", "scene/shelf", "working"):
        (tmp_path / place).mkdir(exist_ok=True)
        (tmp_path / place / "both.ply").write_bytes((scene.parent / "parts/cube.ply").read_bytes())
    (tmp_path / "scene/shelf/inc.xml").write_text('<scene version="3.0.0"/>')
    (tmp_path / "working/here.ply").write_bytes((scene.parent / "parts/cube.ply").read_bytes())
    shape = '<shape type="ply"><string name="filename" value="{}"/></shape>'
    (scene.parent / "parts/own.xml").write_text(
        OWN.replace("</scene>", shape.format("both.ply") + "</scene>")
    )
    monkeypatch.chdir(working)
    extra = '<default name="dir" value="parts"/><default name="dir_mesh" value="$dir/cube"/>'
    extra += shape.format("here.ply") + shape.format("$dir_mesh.ply")
    scene.write_text(SCENE.replace("</scene>", extra + "</scene>"))
    core: Any = mi
    before = core.file_resolver()
    resolver: Any = mi.FileResolver(before)
    resolver.append(str(working))
    core.set_file_resolver(resolver)
    try:
        found = set(scenefiles.collect(scene, {}).digests())
        scenefile.load(scene, {})
        assert {"both.ply", "../working/here.ply", "parts/cube.ply"} <= found
        assert not {"parts/both.ply", "shelf/both.ply", "../working/both.ply"} & found

        shelf = '<path value="shelf"/><include filename="inc.xml"/>'
        text = scene.read_text()
        scene.write_text(text.replace('<default name="dir"', shelf + '<default name="dir"'))
        scenefile.load(scene, {})
        assert "shelf/inc.xml" in scenefiles.collect(scene, {}).digests()
    finally:
        core.set_file_resolver(before)


def test_parameters_are_put_in_as_mitsuba_does() -> None:
    values = {"a": "1", "ab": r"x\1$a"}
    assert parse.substituted(r"$ab.ply $a_b \$a", values) == r"x\11.ply 1_b \$a"


# --------------------------------------------------------------------- what the parser drops


def digests(scene: Path, **parameters: str) -> set[str]:
    return set(scenefiles.collect(scene, parameters).digests())


def test_includes_without_objects_count(scene: Path) -> None:
    """Mitsuba's parser forgets an included file that holds defaults alone."""
    (scene.parent / "settings.xml").write_text(
        '<scene version="3.0.0"><default name="medium" value="table"/>'
        '<default name="table" value="used.csv"/></scene>'
    )
    first = '<scene version="3.0.0"><default name="set" value="settings"/>'
    first += '<include filename="$set.xml"/>'
    scene.write_text(SCENE.replace('<scene version="3.0.0">', first))
    expected = {"a.xml", "settings.xml", "parts/table.xml", "parts/cube.ply", "used.csv"}
    assert digests(scene) == expected
    assert digests(scene, table="unused.csv") == expected - {"used.csv"} | {"unused.csv"}
    with pytest.raises(SceneError, match=r"parameter 'tabel'.*\(did you mean 'table'\?\)"):
        scenefile.load(scene, {"tabel": "used.csv"})


def test_files_of_spectra_count(scene: Path) -> None:
    """Mitsuba's parser reads them and forgets their names."""
    (scene.parent / "lamp.spd").write_text("400 1\n700 2\n")
    lamp = '<default name="lamp" value="lamp"/><emitter type="constant">'
    lamp += '<spectrum name="radiance" filename="$lamp.spd"/></emitter>'
    scene.write_text(SCENE.replace('<emitter type="constant"/>', lamp))
    assert "lamp.spd" in digests(scene)


def test_only_strings_name_files(scene: Path) -> None:
    for name in ("medium", "3", "own", "perspective", "3.0.0"):
        (scene.parent / name).write_text("")
    assert digests(scene) == {"a.xml", "halved.py", "parts/cube.ply", "parts/own.xml"}


def test_a_path_in_an_included_file_ends_with_it(scene: Path) -> None:
    for place in ("shelf", "parts/shelf"):
        (scene.parent / place).mkdir()
    cube = (scene.parent / "parts/cube.ply").read_bytes()
    (scene.parent / "parts/shelf/shelved.ply").write_bytes(cube)
    own = scene.parent / "parts/own.xml"
    own.write_text(
        OWN.replace('<scene version="3.0.0">', '<scene version="3.0.0"><path value="shelf"/>')
    )
    shape = '<shape type="ply"><string name="filename" value="shelved.ply"/></shape>'
    scene.write_text(SCENE.replace("</scene>", shape + "</scene>"))
    assert "parts/shelf/shelved.ply" not in digests(scene)
    with pytest.raises(
        SceneError, match=r'a.xml, line 22: .*PLY file "shelved.ply": file not found'
    ):
        scenefile.load(scene, {})  # nor does Mitsuba find it
    (scene.parent / "parts/shelf/shelved.xml").write_text(OWN)
    scene.write_text(SCENE.replace("</scene>", '<include filename="shelved.xml"/></scene>'))
    with pytest.raises(SceneError, match=r"a.xml includes 'shelved.xml', and .* does not exist"):
        scenefile.load(scene, {})


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"table": "used.csv"}, "parameter 'table', given as 'used.csv', is not used: nothing in"),
        ({"escaped": "a"}, "has no parameter 'escaped', given as 'a': its parameters are law, med"),
        ({"filename": "a"}, "parameter 'filename' cannot be given: Mitsuba reserves that name"),
        ({"medium": "circle"}, "Exceeded maximum include recursion depth"),
        ({"medium": "broken"}, 'Parsing of XML file ".*broken.xml" failed'),
        ({"medium": "undefined"}, r"undefined.xml, line 1: undefined parameter: \$nowhere"),
        ({"medium": "undefined", "now": "1"}, r"no parameter 'now', .* mean 'nowhere'\?\)"),
    ],
)
def test_what_is_wrong_is_one_sentence(
    scene: Path, parameters: dict[str, str], message: str
) -> None:
    scene.write_text(SCENE.replace("</scene>", r'<ref id="\$escaped"/></scene>'))
    parts = scene.parent / "parts"
    (parts / "circle.xml").write_text(
        '<scene version="3.0.0"><include filename="circle.xml"/></scene>'
    )
    (parts / "broken.xml").write_text("<scene")
    (parts / "undefined.xml").write_text('<scene version="3.0.0"><path value="$nowhere"/></scene>')
    core: Any = mi
    before = [str(folder) for folder in core.file_resolver()]
    for ask in (scenefile.load, scenefiles.collect):
        with pytest.raises(SceneError, match=message):
            ask(scene, parameters)
        assert [str(folder) for folder in core.file_resolver()] == before


# --------------------------------------------------------------------- merged meshes

MESHES = """<scene version="3.0.0">
    <integrator type="path"><integer name="max_depth" value="3"/></integrator>
    <sensor type="perspective">
        <transform name="to_world">
            <lookat origin="0, 1, 5" target="0, 0, 0" up="0, 1, 0"/>
        </transform>
        <film type="hdrfilm">
            <integer name="width" value="16"/> <integer name="height" value="12"/>
            <rfilter type="box"/>
        </film>
    </sensor>
    <emitter type="constant"/>
    <bsdf type="diffuse" id="b"><texture type="checkerboard" name="reflectance"/></bsdf>
    <bsdf type="diffuse" id="coloured">
        <texture type="mesh_attribute" name="reflectance">
            <string name="name" value="vertex_color"/>
        </texture>
    </bsdf>
    <medium type="homogeneous" id="fog"/>
    {}
</scene>"""


def mesh(kind: str, x: float, rest: str = "", bsdf: str = "b", id: str = "") -> str:
    plugin, _, file = kind.partition(":")
    file = f'<string name="filename" value="{file}"/>' if file else ""
    move = f'<transform name="to_world"><scale value="0.6"/><translate x="{x}"/></transform>'
    name = f'id="{id}"' if id else ""
    return f'<shape type="{plugin}" {name}>{file}{move}{rest}<ref id="{bsdf}"/></shape>'


FLIPPED = '<boolean name="flip_normals" value="true"/>'
FACETED = '<boolean name="face_normals" value="true"/>'
FOG = '<ref name="interior" id="fog"/>'
WEIGHED = '<float name="silhouette_sampling_weight" value="0.5"/>'
PLY = "ply:round.ply"


@pytest.fixture
def meshes(tmp_path: Path) -> Path:
    """A folder with meshes: without normals and texture coordinates, with both, and colours."""
    cube: Any = mi.load_dict({"type": "cube"})
    positions = np.array(cube.vertex_positions_buffer())
    for name in ("bare", "round", "coloured"):
        smooth = name != "bare"
        written: Any = mi.Mesh(name, 24, 12, has_vertex_normals=smooth, has_vertex_texcoords=smooth)
        parameters = mi.traverse(written)
        parameters["vertex_positions"], parameters["faces"] = positions, cube.faces_buffer()
        if smooth:  # like a ball
            parameters["vertex_normals"] = positions / 3**0.5
            parameters["vertex_texcoords"] = cube.vertex_texcoords_buffer()
        parameters.update()
        if name == "coloured":
            written.add_attribute("vertex_color", 3, np.linspace(0, 1, 72))
        written.write_ply(str(tmp_path / f"{name}.ply"))
    return tmp_path


@pytest.mark.parametrize(
    ("shapes", "count"),
    [
        ([mesh("cube", -1), mesh("cube", 1)], 1),
        ([mesh("cube", -1, FLIPPED), mesh("cube", 1)], 2),
        ([mesh("cube", -1, FLIPPED), mesh("cube", 1, FLIPPED), mesh("cube", 0)], 2),
        ([mesh("rectangle", -1, FLIPPED), mesh("rectangle", 1)], 2),
        ([mesh("rectangle", -1, FLIPPED), mesh("rectangle", 1, FLIPPED)], 1),
        ([mesh(PLY, -1), mesh(PLY, 1, FLIPPED)], 2),
        ([mesh(PLY, -1, FLIPPED), mesh(PLY, 1, FLIPPED)], 1),
        ([mesh(PLY, -1, FACETED), mesh(PLY, 1)], 2),
        ([mesh(PLY, -1, FACETED), mesh(PLY, 1, FACETED)], 1),
        ([mesh(PLY, -1, FOG), mesh(PLY, 1)], 2),
        ([mesh(PLY, -1, FOG), mesh(PLY, 1, FOG.replace("interior", "exterior"))], 2),
        ([mesh(PLY, -1, FOG), mesh(PLY, 1, FOG)], 1),
        ([mesh(PLY, -1), mesh("ply:bare.ply", 1), mesh(PLY, 0)], 2),
        ([mesh(PLY, -1, WEIGHED), mesh(PLY, 1, WEIGHED)], 2),
        ([mesh("ply:coloured.ply", x, bsdf="coloured") for x in (-1, 1)], 2),
        ([mesh("ply:coloured.ply", -1), mesh(PLY, 0), mesh("ply:bare.ply", 1)], 3),
    ],
)
def test_merging_meshes_leaves_the_image(meshes: Path, shapes: list[str], count: int) -> None:
    path = meshes / "scene.xml"
    path.write_text(MESHES.format("".join(shapes)))
    loaded = [scenefile.load(path, {}).scene for _ in range(2)]
    plain = mi.load_file(str(path), optimize=False)
    assert [len(scene.shapes()) for scene in (*loaded, plain)] == [count, count, len(shapes)]
    image, again, wanted = (np.array(mi.render(scene, spp=16)) for scene in (*loaded, plain))
    assert wanted.std() > 0.05
    np.testing.assert_array_equal(image, again)
    np.testing.assert_allclose(image, wanted, rtol=1e-4, atol=1e-4)
    assert len({sceneid.digest(sceneid.of_scene(scene)) for scene in loaded}) == 1


def test_what_is_not_merged_keeps_its_id(tmp_path: Path) -> None:
    group = "<shape type='shapegroup' id='g'>{}</shape>".format(
        mesh("cube", 0, id="a") + mesh("cube", 1, id="c")
    )
    instance = '<shape type="instance"><ref id="g"/></shape>'
    others = mesh("cube", -1, FLIPPED, id="d") + mesh("cube", 1, FACETED, id="e")
    path = tmp_path / "scene.xml"
    path.write_text(MESHES.format(group + instance + others))
    scene = scenefile.load(path, {}).scene
    names = {shape.id() for shape in scenewalk.shapes(scene)}
    assert {"a", "c", "d", "e"} <= names
    image, wanted = (
        np.array(mi.render(s, spp=16)) for s in (scene, mi.load_file(str(path), optimize=False))
    )
    np.testing.assert_array_equal(image, wanted)


def test_meshes_that_are_told_apart_when_read_have_an_order(meshes: Path) -> None:
    path = meshes / "scene.xml"
    for files in (("round", "bare"), ("bare", "round"), ("bare", "coloured", "round", "bare")):
        shapes = [mesh(f"ply:{file}.ply", x) for x, file in enumerate(files)]
        path.write_text(MESHES.format("".join(shapes)))
        found: list[Any] = scenefile.load(path, {}).scene.shapes()
        order = [(m.has_mesh_attributes(), m.has_vertex_texcoords()) for m in found]
        assert order == [(False, False), (False, True), (True, True)][: len(set(files))]
