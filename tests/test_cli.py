"""The command line: what it writes, what it says, and that failures leave files alone."""

from __future__ import annotations

import dataclasses
import json
import math
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import OpenEXR
import pytest
from tiers import thorough

import nonexp
from nonexp import __version__, cli, fitting, models, rendering
from nonexp.images import denoise as denoising
from nonexp.images import exr, moments
from nonexp.images.png import tone_map
from nonexp.parameters import describe
from nonexp.rendering import progress, targets
from nonexp.scene.load import load

pytestmark = pytest.mark.thorough

SCENE = """
<scene version="3.0.0">
    <default name="medium" value="gamma"/>
    <default name="integrator" value="nonexp_volpath"/>
    <default name="radiance" value="1"/>
    <default name="spp" value="8"/>
    <default name="filter" value="box"/>
    <integrator type="$integrator"><integer name="max_depth" value="6"/></integrator>
    <sensor type="perspective">
        <transform name="to_world">
            <lookat origin="0, 0, 4" target="0, 0, 0" up="0, 1, 0"/>
        </transform>
        <sampler type="independent"><integer name="sample_count" value="$spp"/></sampler>
        <film type="hdrfilm">
            <integer name="width" value="12"/>
            <integer name="height" value="10"/>
            <rfilter type="$filter"/>
        </film>
    </sensor>
    <emitter type="constant"><rgb name="radiance" value="$radiance"/></emitter>
    <include filename="media/$medium.xml"/>
    <shape type="sphere"><bsdf type="null"/><ref name="interior" id="medium"/></shape>
</scene>
"""
MEDIUM = """
<scene version="3.0.0">
    <default name="sigma_t" value="1"/>
    <default name="albedo" value="0.8"/>
    <medium type="nonexp_homogeneous" id="medium">
        <float name="sigma_t" value="$sigma_t"/>
        <float name="albedo" value="$albedo"/>
        {law}
    </medium>
</scene>
"""
LAWS = {
    "gamma": '<default name="alpha" value="2"/><texture type="transmittance_gamma" name="t">'
    '<float name="alpha" value="$alpha"/></texture>',
    "linear": '<default name="b" value="1"/><texture type="transmittance_linear" name="t">'
    '<float name="b" value="$b"/></texture>',
    "typo": '<texture type="transmittance_gama" name="t"/>',
    "misspelt": '<texture type="transmittance_gamma" name="t"><float name="alpa" value="1"/>'
    "</texture>",
}
STOCK = """
<scene version="3.0.0">
    <medium type="homogeneous" id="medium"><float name="albedo" value="0.8"/></medium>
</scene>
"""

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a scene and its media, in which the command runs."""
    (tmp_path / "scene.xml").write_text(SCENE)
    (tmp_path / "media").mkdir()
    for name, law in LAWS.items():
        before, _, after = law.partition("<texture")
        text = MEDIUM.format(law="<texture" + after).replace("<medium", before + "<medium")
        (tmp_path / "media" / f"{name}.xml").write_text(text)
    (tmp_path / "media" / "stock.xml").write_text(STOCK)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def run(folder: Path, capsys: pytest.CaptureFixture[str]) -> Run:
    """Run a command line in this process: exit code, stdout, stderr."""

    def command(*arguments: str) -> tuple[int, str, str]:
        code = cli.main(["render", "--variant", "llvm_ad_rgb", *arguments])
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return command


def read(path: Path) -> tuple[dict[str, object], dict[str, np.ndarray]]:
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return dict(file.header()), {k: c.pixels.copy() for k, c in file.channels().items()}


def subcommand(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run the real command in a process of its own."""
    root = str(Path(__file__).parents[1])
    return subprocess.run(
        [sys.executable, "-m", "nonexp", *arguments],
        env={**os.environ, "PYTHONPATH": root, **environment},
        capture_output=True,
        text=True,
    )


# --------------------------------------------------------------------- what is written


def test_the_exr_holds_mean_stderr_and_how_it_was_made(folder: Path) -> None:
    arguments = ("scene.xml", "-D", "alpha=0.5", "-D", "spp=3", "--spp", "16", "--seed", "7")
    result = subcommand("render", *arguments, "--variant", "llvm_ad_rgb")
    assert (result.returncode, result.stderr) == (0, "")
    said = r"scene\.exr: 16 samples per pixel in 8 passes, \d+\.\d s, error \d+\.\d\d%\n"
    assert re.fullmatch(said, result.stdout)
    assert sorted(p.name for p in folder.iterdir()) == [
        "media", "scene.exr", "scene.png", "scene.xml"
    ]  # fmt: skip

    header, channels = read(folder / "scene.exr")
    assert set(channels) == {"R", "G", "B", "stderr.R", "stderr.G", "stderr.B"}
    assert {(c.shape, c.dtype.name) for c in channels.values()} == {((10, 12), "float32")}
    assert header["nonexp:scene"] == "scene.xml"
    assert json.loads(str(header["nonexp:parameters"])) == {"alpha": "0.5", "spp": "3"}
    assert header["nonexp:integrator"] == "nonexp_volpath"
    counts = [header[f"nonexp:{k}"] for k in ("spp", "pass_spp", "passes", "seed")]
    assert counts == [16, 2, 8, 7]
    assert (header["nonexp:filter"], header["nonexp:stopped"]) == ("BoxFilter", "spp")
    identity = json.loads(str(header["nonexp:identity"]))
    assert sorted(identity["files"]) == ["media/gamma.xml", "scene.xml"]
    assert len(str(header["nonexp:scene_hash"])) == 32
    assert header["nonexp:variant"] == "llvm_ad_rgb"
    assert header["nonexp:version"] == __version__
    assert header["nonexp:mitsuba"] and header["nonexp:drjit"] and header["nonexp:llvm"]
    assert float(str(header["nonexp:seconds"])) > 0
    assert 0 < float(str(header["nonexp:error"])) < 1

    loaded = load(Path("scene.xml"), {"alpha": "0.5"})
    image = nonexp.render(loaded.scene, spp=16, seed=7)
    for i, name in enumerate("RGB"):
        np.testing.assert_array_equal(channels[name], image.mean[:, :, i].astype(np.float32))
        expected = image.stderr[:, :, i].astype(np.float32)
        np.testing.assert_array_equal(channels[f"stderr.{name}"], expected)


def test_the_same_seed_gives_the_same_files(run: Run, folder: Path) -> None:
    for name, seed in (("a", "1"), ("b", "1"), ("c", "2")):
        assert run("scene.xml", "-o", f"{name}.exr", "--spp", "40", "--seed", seed)[0] == 0
    a, b, c = (read(folder / f"{name}.exr")[1] for name in "abc")
    for channel in a:
        np.testing.assert_array_equal(a[channel], b[channel])
    assert not np.array_equal(a["R"], c["R"])
    assert (folder / "a.png").read_bytes() == (folder / "b.png").read_bytes()


def test_the_picture_is_tone_mapped(run: Run, folder: Path) -> None:
    import mitsuba as mi

    assert run("scene.xml", "-D", "radiance=0.5, 0, 40")[0] == 0
    picture = np.array(mi.Bitmap(str(folder / "scene.png")))
    assert picture.shape == (10, 12, 3)
    assert picture.dtype == np.uint8
    assert picture[0, 0].tolist() == [188, 0, 255]  # sRGB of 0.5, 0 and more than 1


def test_tone_mapping_rises_smoothly_to_white() -> None:
    x = np.linspace(0, 20, 20001)
    y = tone_map(x)
    assert (np.diff(y[x < 5]) > 0).all()
    assert np.abs(np.diff(y[x > 0.5], 2)).max() < 1e-5  # no kink
    assert 0.999 < y[-1] <= 1
    assert tone_map(np.array([-1.0, np.nan, np.inf])) == pytest.approx([0, 0, 1])


@pytest.mark.parametrize(("spp", "told"), [("8", ""), ("100", "--spp 100 becomes 104: 13 passes")])
def test_rounding_of_spp_is_told(run: Run, spp: str, told: str) -> None:
    code, out, err = run("scene.xml", "--spp", spp)
    assert code == 0
    assert err.startswith(f"nonexp: {told}" if told else "")
    assert bool(err) == bool(told)
    assert f"{104 if told else 8} samples per pixel" in out


@pytest.mark.parametrize("name", ["a.png", "a.exr"])
def test_an_output_is_named_by_its_picture_or_its_exr(run: Run, folder: Path, name: str) -> None:
    code, out, err = run("scene.xml", "-o", name)
    assert (code, err) == (0, "") and out.startswith("a.exr: 8 samples per pixel")
    assert {p.name for p in folder.iterdir()} == {"a.exr", "a.png", "media", "scene.xml"}
    with pytest.raises(ValueError, match=r"output is 'a\.jpg': it must be a file name in \.exr or"):
        exr.exr_path(Path("a.jpg"))


def test_a_sensor_is_chosen_by_number_or_id(run: Run, folder: Path) -> None:
    second = re.findall(r"    <sensor.*</sensor>\n", SCENE, re.DOTALL)[0]
    for old, new in (
        ('type="perspective"', 'type="thinlens" id="side"'),
        ('origin="0, 0, 4"', 'origin="3, 0, 0"'),
        ("<sampler", '<float name="aperture_radius" value="0.1"/><sampler'),
        ('name="width" value="12"', 'name="width" value="7"'),
        ("$filter", "gaussian"),
    ):
        assert old in second
        second = second.replace(old, new)
    (folder / "scene.xml").write_text(SCENE.replace("    <emitter", second + "    <emitter", 1))
    for name, sensor in (("a", "1"), ("b", "side"), ("c", "0")):
        assert run("scene.xml", "-o", f"{name}.exr", "--sensor", sensor)[::2] == (0, "")
    (a, seen), (b, same), (c, other) = (read(folder / f"{name}.exr") for name in "abc")
    assert seen["R"].shape == (10, 7) and other["R"].shape == (10, 12)
    np.testing.assert_allclose(same["R"], seen["R"], atol=1e-5)
    assert (a["nonexp:filter"], c["nonexp:filter"]) == ("GaussianFilter", "BoxFilter")
    identities = [json.loads(str(header["nonexp:identity"])) for header in (a, b, c)]
    assert [(i["sensor"], i["size"]) for i in identities] == [(1, [7, 10])] * 2 + [(0, [12, 10])]


# --------------------------------------------------------------------- black images

BLACK = (
    "the image is black everywhere: no light reaches the camera "
    "(fog without bounds is black, by theory, under a directional light or an environment)"
)


def test_a_black_image_is_told_and_has_no_error(run: Run, folder: Path) -> None:
    job = ("scene.xml", "-D", "radiance=0", "--error", "1%", "--pass-spp", "1")
    code, out, err = run(*job, "--spp", "12")
    assert (code, err) == (0, f"nonexp: warning: {BLACK}\n")
    assert "error" not in out and "12 samples per pixel in 12 passes" in out
    header, channels = read(folder / "scene.exr")
    assert header["nonexp:stopped"] == "spp" and math.isnan(float(str(header["nonexp:error"])))
    assert not channels["R"].any()
    code, out, err = run(*job)
    assert (code, out) == (2, "")
    why = f"after 64 passes {BLACK}; add spp or time as a second target to go on"
    said = f"error is 0.01, which cannot be reached: {why}"
    assert err == f"nonexp: error: {said}\n"


# --------------------------------------------------------------------- size


@pytest.mark.parametrize("film", ["<film type='hdrfilm'/>", ""])
def test_size_works_without_help_from_the_scene(run: Run, folder: Path, film: str) -> None:
    text = re.sub(r"<film.*</film>", film, SCENE, flags=re.DOTALL)
    (folder / "scene.xml").write_text(text.replace('name="filter"', 'name="unused"'))
    assert run("scene.xml", "--size", "9x7")[0] == 0
    assert read(folder / "scene.exr")[1]["R"].shape == (7, 9)


def test_size_changes_the_camera_and_the_crop_window_too(folder: Path) -> None:
    crop = "".join(
        f'<integer name="crop_{name}" value="{value}"/>'
        for name, value in {"width": 4, "height": 5, "offset_x": 8, "offset_y": 5}.items()
    )
    path = folder / "scene.xml"
    path.write_text(SCENE.replace("<rfilter", crop + "<rfilter"))
    camera = load(path, {}, (24, 40)).scene.sensors()[0]
    assert list(camera.film().size()) == [24, 40]
    assert list(camera.film().crop_size()) == [8, 20]
    assert list(camera.film().crop_offset()) == [16, 20]

    import mitsuba as mi

    path.write_text(SCENE)
    resized = load(path, {}, (24, 40)).scene.sensors()[0]
    path.write_text(SCENE.replace('value="12"', 'value="24"').replace('value="10"', 'value="40"'))
    written = load(path, {}).scene.sensors()[0]
    rays = [s.sample_ray(0, 0, mi.Point2f(0.9, 0.1), 0)[0].d for s in (resized, written)]
    np.testing.assert_array_equal(np.array(rays[0]), np.array(rays[1]))


# --------------------------------------------------------------------- media and integrators


def test_a_stock_integrator_is_warned_about(run: Run) -> None:
    code, _, err = run("scene.xml", "-D", "integrator=volpath")
    assert code == 0
    assert err.startswith("nonexp: warning: integrator volpath shows its exponential counterpart")
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    "parameters", [(), ("medium=stock", "integrator=volpath"), ("medium=stock",)]
)
def test_other_combinations_are_not(run: Run, parameters: tuple[str, ...]) -> None:
    arguments = [word for parameter in parameters for word in ("-D", parameter)]
    assert run("scene.xml", *arguments)[::2] == (0, "")


# --------------------------------------------------------------------- errors

ERRORS: dict[str, tuple[list[str], str]] = {
    "no scene": (["nope.xml"], "'nope.xml' does not exist"),
    "folder": (["media"], "'media' is a folder"),
    "not xml": (["text.xml"], 'Parsing of XML file "text.xml" failed: .*line 1'),
    "not a scene": (["medium.xml"], "holds a homogeneous, not a scene: .* must be <scene>"),
    "no sensor": (["media/stock.xml"], "has no sensor"),
    "medium": (
        ["scene.xml", "-D", "medium=foo"],
        "medium is 'foo': it must be one of gamma, linear, misspelt, stock, typo .files of media",
    ),
    "include": (["include.xml"], r"includes 'gone\.xml', and gone\.xml does not exist"),
    "parameter": (
        ["scene.xml", "-D", "sigmat=3"],
        r"'sigmat', given as '3' \(did you mean 'sigma_t'\?\): .* albedo, alpha, .*, sigma_t, spp",
    ),
    "parameter of another model": (
        ["scene.xml", "-D", "medium=linear", "-D", "alpha=1"],
        "has no parameter 'alpha', given as '1': .*albedo, b, filter",
    ),
    "model": (
        ["scene.xml", "-D", "medium=typo"],
        r"typo\.xml, line \d+: texture 'transmittance_gama' is unknown: .*, transmittance_gamma",
    ),
    "parameter of a model": (
        ["scene.xml", "-D", "medium=misspelt"],
        "no parameter 'alpa'.* its parameters are alpha",
    ),
    "integrator": (
        ["scene.xml", "-D", "integrator=foo"],
        r"scene\.xml, line \d+: integrator 'foo' is unknown",
    ),
    "property": (["property.xml"], "hdrfilm has no parameter 'widht', given as 12"),
    "number": (
        ["scene.xml", "-D", "spp=many"],
        r'could not parse integer value "many" \(from -D spp=many\)',
    ),
    "sigma_t": (["scene.xml", "-D", "sigma_t=-1"], "sigma_t is -1: it must be"),
    "sigma_t nan": (["scene.xml", "-D", "sigma_t=nan"], "sigma_t is nan: it must be"),
    "albedo": (["scene.xml", "-D", "albedo=1.5"], "albedo is 1.5: it must be"),
    "albedo below": (["scene.xml", "-D", "albedo=-0.5"], "albedo is -0.5: it must be"),
    "alpha": (["scene.xml", "-D", "alpha=0"], "alpha is 0: it must be .*> 0"),
    "b": (["scene.xml", "-D", "medium=linear", "-D", "b=-2"], "b is -2: it must be .*> 0"),
    "variant": (["scene.xml", "--variant", "foo"], "variant 'foo' is unknown: .*llvm_ad_rgb, "),
    "scalar": (["scene.xml", "--variant", "scalar_rgb"], "'scalar_rgb' is not supported: .*llvm_"),
    "output folder": (["scene.xml", "-o", "no/a.exr"], "output is 'no/a.exr': its folder 'no' "),
    "output name": (["scene.xml", "-o", "a.jpg"], r"output is 'a.jpg': .*\.exr or \.png"),
    "output is a folder": (["scene.xml", "-o", "dir.exr"], "output is 'dir.exr': .* is a folder"),
    "picture is a folder": (["scene.xml", "-o", "pic.exr"], "'pic.png' is a folder"),
    "unwritable": (["scene.xml", "-o", "/proc/a.exr"], "its folder '/proc' must be writable"),
    "spp": (["scene.xml", "--spp", "0"], "--spp is '0': it must be a whole number from 1 to"),
    "spp text": (["scene.xml", "--spp", "1e3"], "--spp is '1e3': it must be a whole number"),
    "seed": (["scene.xml", "--seed", "-1"], "--seed is '-1': it must be a whole number from 0 to"),
    "long seed": (["scene.xml", "--seed", "9" * 5000], "--seed is '99*': it must be"),
    "size": (["scene.xml", "--size", "12"], "--size is '12': it must be WIDTHxHEIGHT"),
    "size of nothing": (["scene.xml", "--size", "0x5"], "--size is '0x5': it must be"),
    "definition": (["scene.xml", "-D", "medium"], "-D is 'medium': it must be key=value"),
    "time": (["scene.xml", "--time", "soon"], "--time is 'soon': it must be a time > 0, as in"),
    "no time": (["scene.xml", "--time", "0m"], "--time is '0m': it must be a time > 0"),
    "error": (
        ["scene.xml", "--error", "200%"],
        "--error is '200%': it must lie between 0 and 1",
    ),
    "error text": (["scene.xml", "--error", "low"], "--error is 'low': it must lie between"),
    "pass size": (["scene.xml", "--pass-spp", "0"], "--pass-spp is '0': it must be a whole number"),
    "interval": (["scene.xml", "--checkpoint", "-5"], "--checkpoint .*"),
    "nothing to resume": (["scene.xml", "--resume", "--checkpoint", "off"], "--resume needs check"),
    "resume or not": (
        ["scene.xml", "--resume", "--restart"],
        "--resume and --restart exclude each other",
    ),
    "option": (
        ["scene.xml", "--sp"],
        r"Unknown option: --sp\. Did you mean --spp\? \(see nonex",
    ),
    "no flag": (["scene.xml", "--no-resume"], "Unknown option: --no-resume"),
    "too much": (["scene.xml", "other.xml"], "Unused Tokens: .'other.xml'"),
    "sensor": (["scene.xml", "--sensor", "2"], "sensor is '2': it must be one of .*: 0$"),
    "sensor id": (["scene.xml", "--sensor", "top"], "sensor is 'top': it must be one of .*: 0$"),
}


@pytest.mark.parametrize("case", ERRORS)
def test_errors_are_one_sentence_and_leave_files_alone(run: Run, folder: Path, case: str) -> None:
    (folder / "text.xml").write_text("hello")
    (folder / "medium.xml").write_text('<medium version="3.0.0" type="homogeneous"/>')
    (folder / "include.xml").write_text(
        '<scene version="3.0.0"><include filename="gone.xml"/></scene>'
    )
    (folder / "property.xml").write_text(SCENE.replace('name="width"', 'name="widht"'))
    for name in ("dir.exr", "pic.png"):
        (folder / name).mkdir()
    for name in ("scene.exr", "scene.png"):
        (folder / name).write_text("old")
    before = sorted(folder.rglob("*"))

    arguments, message = ERRORS[case]
    code, out, err = run(*arguments)
    assert (code, out) == (2, "")
    assert re.match(f"nonexp: error: .*{message}", err)
    assert err.count("\n") == 1
    assert "Traceback" not in err and ".cpp" not in err
    assert sorted(folder.rglob("*")) == before
    assert (folder / "scene.exr").read_text() == (folder / "scene.png").read_text() == "old"


@pytest.mark.parametrize("stage", ["write_exr", "write_png"])
def test_a_failure_while_writing_leaves_the_old_files(
    run: Run, folder: Path, monkeypatch: pytest.MonkeyPatch, stage: str
) -> None:
    def fail(path: Path, *_: object) -> None:
        path.write_text("half")
        raise OSError("No space left on device")

    for name in ("scene.exr", "scene.png"):
        (folder / name).write_text("old")
    before = sorted(folder.iterdir())
    monkeypatch.setattr(exr, stage, fail)
    code, out, err = run("scene.xml")
    assert (code, out) == (2, "")
    assert err == (
        "nonexp: error: 'scene.exr' cannot be written: No space left on device "
        "(what is done is in 'scene.exr.checkpoint', from which --resume goes on)\n"
    )
    assert sorted(folder.iterdir()) == sorted([*before, folder / "scene.exr.checkpoint"])
    assert (folder / "scene.exr").read_text() == (folder / "scene.png").read_text() == "old"


def test_a_failure_while_rendering_is_one_sentence(
    run: Run, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise RuntimeError("[integrator.cpp:12] out of\n  memory")

    monkeypatch.setattr("nonexp.cli.render.run", fail)
    assert run("scene.xml") == (2, "", "nonexp: error: out of memory\n")
    assert not (folder / "scene.exr").exists()


def test_the_output_is_checked_before_the_scene_is_loaded(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    loaded = lambda *_: pytest.fail("the scene was loaded")  # noqa: E731
    monkeypatch.setattr("nonexp.cli.arguments.load_scene", loaded)
    assert run("scene.xml", "-o", "no/a.exr")[0] == 2


@pytest.mark.parametrize(
    ("number", "said", "code"), [("SIGINT", "interrupted", 130), ("SIGTERM", "terminated", 143)]
)
@pytest.mark.parametrize("checkpoint", ["60", "off"])
def test_a_signal_ends_the_run_after_the_pass(
    run: Run, folder: Path, monkeypatch: pytest.MonkeyPatch,
    number: str, said: str, code: int, checkpoint: str,
) -> None:  # fmt: skip
    def interrupted(*arguments: Any, **keywords: Any) -> Iterator[Any]:
        for i, image in enumerate(passes(*arguments, **keywords)):
            if i == 1:
                os.kill(os.getpid(), getattr(signal, number))
            yield image

    passes = rendering.render_passes
    monkeypatch.setattr("nonexp.rendering.render.render_passes", interrupted)
    (folder / "scene.exr").write_text("old")
    # A process that a shell has put into the background ignores SIGINT.
    handler = signal.signal(getattr(signal, number), signal.default_int_handler)
    try:
        found, out, err = run("scene.xml", "--checkpoint", checkpoint)
    finally:
        signal.signal(getattr(signal, number), handler)
    assert (found, out) == (code, "")
    assert (folder / "scene.exr").read_text() == "old"
    assert err.splitlines()[0] == "nonexp: ending after this pass (once more: at once)"
    names = {path.name for path in folder.iterdir()} - {"media", "scene.exr", "scene.xml"}
    if checkpoint == "off":
        assert err.splitlines()[1] == f"nonexp: {said}, nothing written"
        assert names == set()
        return
    assert err.splitlines()[1].startswith(f"nonexp: {said}; what is done is in 'scene.exr.check")
    assert names == {"scene.exr.checkpoint"}
    monkeypatch.undo()
    monkeypatch.chdir(folder)
    assert run("scene.xml", "--resume")[::2] == (0, "")
    whole = nonexp.render(load(Path("scene.xml"), {}).scene)
    np.testing.assert_array_equal(
        read(folder / "scene.exr")[1]["R"], whole.mean[:, :, 0].astype(np.float32)
    )


def test_ctrl_c_while_the_image_is_written_tells_of_the_checkpoint(
    run: Run, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("nonexp.cli.render.write", interrupted)
    (folder / "scene.exr.checkpoint").write_text("")  # damaged; its time lies ahead
    os.utime(folder / "scene.exr.checkpoint", (4e9, 4e9))
    code, out, err = run("scene.xml", "--checkpoint", "off")
    assert (code, out) == (130, "") and "nothing written" in err
    code, out, err = run("scene.xml")
    assert (code, out) == (130, "")
    assert "interrupted; what is done is in 'scene.exr.checkpoint'" in err
    monkeypatch.undo()
    monkeypatch.chdir(folder)
    assert run("scene.xml", "--resume")[0] == 0


def test_ctrl_c_before_the_first_pass_writes_nothing(
    run: Run, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("nonexp.cli.arguments.load_scene", interrupted)
    before = sorted(folder.iterdir())
    assert run("scene.xml") == (130, "", "nonexp: interrupted, nothing written\n")
    assert sorted(folder.iterdir()) == before


@pytest.mark.parametrize("command", ["render", "doctor"])
def test_a_missing_llvm_is_told_with_what_to_install(folder: Path, command: str) -> None:
    arguments = ["scene.xml", "--variant", "llvm_ad_rgb"] if command == "render" else []
    result = subcommand(command, *arguments, DRJIT_LIBLLVM_PATH="/nowhere/libLLVM.so")
    said = result.stderr if command == "render" else result.stdout
    (line,) = (line for line in said.splitlines() if "DRJIT_LIBLLVM_PATH is" in line)
    assert "'/nowhere/libLLVM.so', which does not exist: install LLVM 17 or newer" in line
    assert "Traceback" not in result.stderr
    assert result.returncode == 2 or "cuda" in result.stdout


# --------------------------------------------------------------------- nonexp plot, nonexp fit

Command = Callable[..., tuple[int, str, str]]


@pytest.fixture
def command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Command:
    """Run a command line in this process, in a folder with data."""
    x = np.linspace(0, 4, 40)
    ff = (1 + 2 * x / 0.5) ** -0.5 + 0.004 * np.random.default_rng(5).normal(size=40)
    columns = np.stack([x, ff, np.full(40, 0.004)], axis=1)
    np.savetxt(tmp_path / "data.csv", columns[:, :2], delimiter=",", header="distance,ff")
    np.savetxt(tmp_path / "weighted.txt", columns)
    np.savez(tmp_path / "data.npz", tau=x, ff=ff)
    (tmp_path / "bad.csv").write_text("1,0.5\n2,half\n")
    (tmp_path / "two.csv").write_text("1,0.5\n")
    (tmp_path / "old.png").write_text("old")
    (tmp_path / "dir.png").mkdir()
    monkeypatch.chdir(tmp_path)

    def call(*arguments: str) -> tuple[int, str, str]:
        code = cli.main(arguments)
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return call


@pytest.mark.parametrize("data", ["data.csv", "weighted.txt", "data.npz"])
def test_fit_prints_parameters_with_errors_and_the_xml(command: Command, data: str) -> None:
    code, out, err = command("fit", data, "--model", "gamma")
    assert (code, err) == (0, "")
    assert "\x1b" not in out
    assert re.search(r"^gamma +value +standard error$", out, re.MULTILINE)
    alpha = re.search(r"^alpha +(0\.\d+) +(0\.00\d+)$", out, re.MULTILINE)
    sigma_t = re.search(r"^sigma_t +(\d\.\d+) +(0\.0\d+)$", out, re.MULTILINE)
    assert alpha and abs(float(alpha[1]) - 0.5) < 4 * float(alpha[2])
    assert sigma_t and abs(float(sigma_t[1]) - 2) < 4 * float(sigma_t[2])
    assert re.search(r"^rms residual 0\.00\d+ over 40 points", out, re.MULTILINE)
    assert ("chi2" in out) == (data == "weighted.txt")
    pasted = out[out.index("<float") :]
    assert re.fullmatch(
        r'<float name="sigma_t" value="[\d.]+"/>\n'
        r'<texture type="transmittance_gamma" name="transmittance">\n'
        r'    <float name="alpha" value="[\d.]+"/>\n</texture>\n',
        pasted,
    )


@pytest.mark.parametrize("chosen", [("linear", "gamma", "exponential"), *thorough(("all",), ())])
def test_fit_compares_models_best_first(command: Command, chosen: tuple[str, ...]) -> None:
    options = [word for name in chosen for word in ("--model", name)]
    code, out, err = command("fit", "data.csv", *options, "--fix", "b=3")
    assert (code, err) == (0, "")
    lines = out.partition("\n\n")[0].splitlines()
    assert all(len(line) <= 100 or line.startswith("not fitted:") for line in lines)
    table = [line for line in lines if not line.startswith(" ")]  # without what is wrapped
    assert table[0].split() == "model parameters sigma_t rms residual AIC - best".split()
    order = [row.split()[0] for row in table[1:]]
    compared = [name for name in order if name in ("gamma", "exponential", "linear")]
    assert compared == ["gamma", "exponential", "linear"]
    differences = [float(row.split()[-1]) for row in table[1:] if not row.startswith("not")]
    assert differences == sorted(differences) and differences[0] == 0
    assert (len(differences) > 8) == (not chosen or chosen == ("all",))
    assert ("not fitted: constant" in out) == (len(differences) > 8)
    assert f'"transmittance_{order[0]}"' in out


def test_fit_holds_what_it_is_told(command: Command) -> None:
    _, out, _ = command("fit", "data.csv", "--model", "gamma", "--fix", "alpha=0.7")
    assert re.search(r"^alpha +0\.7 *$", out, re.MULTILINE)
    assert '<float name="alpha" value="0.7"/>' in out
    _, out, _ = command("fit", "data.csv", "--model", "gamma", "--sigma-t", "1.5")
    assert '<float name="sigma_t" value="1.5"/>' in out
    _, out, _ = command("fit", "data.csv", "--model", "linear", "--sigma-t", "fit")
    assert '<float name="b" value="1.0"/>' in out
    start = "sigma=0.1,1,9"
    _, out, _ = command("fit", "data.csv", "--model", "exponential_mixture", "--start", start)
    assert re.search(r"^weight\[2\] ", out, re.MULTILINE)


def test_fit_draws_the_result(command: Command, tmp_path: Path) -> None:
    code, out, _ = command("fit", "data.csv", "--model", "gamma", "-o", "old.png")
    assert code == 0 and out.endswith("\nold.png\n")
    assert (tmp_path / "old.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("arguments", "written"),
    [
        (["gamma"], "gamma.png"),
        *thorough(
            (["gamma", "alpha=0.5", "-o", "old.png"], "old.png"),
            (["exponential_mixture", "sigma=0.2,1.8", "-o", "figure.svg"], "figure.svg"),
            (["erlang", "k=3", "-o", "figure.pdf"], "figure.pdf"),
            several=True,
        ),
        (["custom", "ff=nonexp.models.custom:wigner"], "custom.png"),
    ],
)
def test_plot_draws_a_model(
    command: Command, tmp_path: Path, arguments: list[str], written: str
) -> None:
    before = {path.name for path in tmp_path.iterdir()}
    assert command("plot", *arguments) == (0, f"{written}\n", "")
    assert {path.name for path in tmp_path.iterdir()} == before | {written}
    assert (tmp_path / written).stat().st_size > 5000


MODEL_ERRORS: dict[str, tuple[list[str], str]] = {
    "plot": (["plot"], 'Command "plot" parameter MODEL requires an argument'),
    "plot model": (["plot", "gama"], "model is 'gama': it must be one of "),
    "plot key": (["plot", "gamma", "b=1"], "gamma has no parameter 'b': its parameters are alpha"),
    "plot value": (["plot", "gamma", "alpha=0"], "Gamma.alpha is 0: it must be "),
    "plot word": (["plot", "gamma", "alpha=x"], "Gamma.alpha is 'x': it must be "),
    "plot pair": (["plot", "gamma", "alpha"], "is 'alpha': it must be key=value, as in alpha=0.5"),
    "plot suffix": (["plot", "gamma", "-o", "a.exr"], "output is 'a.exr': it must end in .png, "),
    "plot folder": (["plot", "gamma", "-o", "no/a.png"], "its folder 'no' does not exist"),
    "plot on a folder": (["plot", "gamma", "-o", "dir.png"], "output is 'dir.png': it is a folder"),
    "no data": (["fit", "gone.csv", "--model", "gamma"], "gone.csv: there is no such file"),
    "data": (
        ["fit", "bad.csv", "--model", "gamma"],
        "bad.csv: line 2 has 'half' for ff: it must be a number",
    ),
    "few data": (["fit", "two.csv", "--model", "gamma"], r"than there are points \(1\)"),
    "fit model": (["fit", "data.csv", "--model", "gama"], "model is 'gama': it must be one of"),
    "fit models": (
        ["fit", "data.csv", "--model", "gamma", "--model", "gama"],
        "model is 'gama': it must be one of",
    ),
    "refusal": (["fit", "data.csv", "--model", "constant"], "constant does not depend on tau"),
    "one refuses": (
        ["fit", "data.csv", "--model", "gamma", "--model", "custom"],
        "custom: Custom.ff is missing",
    ),
    "fixed": (
        ["fit", "data.csv", "--model", "gamma", "--fix", "b=1"],
        "gamma has no parameter 'b'",
    ),
    "fixed for none": (
        ["fit", "data.csv", "--model", "gamma", "--model", "exponential", "--fix", "b=1"],
        "none of the models to fit has a parameter 'b'",
    ),
    "pair": (["fit", "data.csv", "--fix", "b"], "--fix is 'b': it must be key=value"),
    "sigma_t": (["fit", "data.csv", "--sigma-t", "-1"], "--sigma-t is '-1': it must be a number"),
    "sigma_t word": (["fit", "data.csv", "--sigma-t", "no"], "--sigma-t is 'no': .* fit, or auto"),
    "fit suffix": (["fit", "data.csv", "-o", "a.exr"], "output is 'a.exr': it must end in .png"),
}


@pytest.mark.parametrize("case", MODEL_ERRORS)
def test_errors_of_plot_and_fit_are_one_sentence(
    command: Command, tmp_path: Path, case: str
) -> None:
    before = sorted(tmp_path.rglob("*"))
    arguments, message = MODEL_ERRORS[case]
    code, out, err = command(*arguments)
    assert (code, out) == (2, "")
    assert re.match(f"nonexp: error: .*{message}", err)
    assert err.count("\n") == 1
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("arguments", [("plot", "gamma"), ("fit", "data.csv", "-o", "a.png")])
def test_without_matplotlib_nothing_is_computed(
    command: Command, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...]
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setattr(fitting, "compare", lambda *_, **__: pytest.fail("it was fitted"))
    code, out, err = command(*arguments)
    assert (code, out) == (2, "")
    why = "plots need matplotlib, which is not installed: pip install 'nonexp[plot]'"
    assert err == f"nonexp: error: {why}\n"


# --------------------------------------------------------------------- other commands


def test_models_lists_every_model_in_100_columns(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["models"]) == 0
    out = capsys.readouterr().out
    assert "\x1b" not in out
    lines = out.splitlines()
    assert max(map(len, lines)) <= 100
    starts = [lines[0].index(name) for name in ("model", "transm", "parameters", "sigma_bar")]
    rows: dict[str, list[str]] = {}
    for line in lines[1:-1]:
        cells = [line[a:b].strip() for a, b in zip(starts, [*starts[1:], None], strict=True)]
        name = cells[0] or list(rows)[-1]
        held = rows.setdefault(name, ["", "", ""])
        rows[name] = [f"{old} {new}".strip() for old, new in zip(held, cells[1:], strict=True)]
    assert list(rows) == models.names()
    for name, (law, parameters, sigma_bar) in rows.items():
        cls = models.registry[name]
        assert law == (cls.__doc__ or "").splitlines()[0].strip()
        assert sigma_bar == f"{models.create(name, **cls.examples[0]).sigma_bar:.6g}"
        fields = [describe(field) for field in dataclasses.fields(cls)]  # type: ignore[arg-type]
        assert parameters.split() == " ".join(fields or ["none"]).split()
    assert "alpha = 2 (> 0)" in rows["gamma"][1]
    assert lines[-1].startswith("tau is optical depth, sigma_bar = ")


def test_doctor_says_that_this_machine_can_render(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["doctor"]) == 0
    out = capsys.readouterr().out
    assert "llvm_ad_rgb" in out
    assert re.search(r"^LLVM +\d\d\.\d+\.\d+ \(/.*libLLVM.*\)$", out, re.MULTILINE)
    assert "This machine can render" in out


def test_help_and_version() -> None:
    shown = subcommand("--version")
    assert (shown.returncode, shown.stdout) == (0, f"nonexp {__version__}\n")
    shown = subcommand("--help")
    assert shown.returncode == 0
    for command in cli.COMMANDS:
        assert re.search(rf"^\W*{command} +\w", shown.stdout, re.MULTILINE)


@pytest.mark.parametrize("arguments", [[], ["rendre"], ["render"]])
def test_bad_usage_is_one_line(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(arguments) == 2
    err = capsys.readouterr().err
    assert err.startswith("nonexp: error: ")
    assert err.count("\n") == 1


# --------------------------------------------------------------------- long renders


def test_targets_of_the_command_are_those_of_the_library(run: Run, folder: Path) -> None:
    job = ("scene.xml", "--seed", "3", "--pass-spp", "2")
    code, out, err = run(*job, "--error", "6%", "--time", "1h")
    assert (code, err) == (0, "")
    header, channels = read(folder / "scene.exr")
    loaded = load(Path("scene.xml"), {})
    image = nonexp.render(loaded.scene, error=0.06, seed=3, pass_spp=2)
    assert (header["nonexp:passes"], header["nonexp:stopped"]) == (image.passes, "error")
    assert header["nonexp:error"] == pytest.approx(image.error)
    np.testing.assert_array_equal(channels["R"], image.mean[:, :, 0].astype(np.float32))
    assert f"{image.spp} samples per pixel in {image.passes} passes" in out
    code, out, err = run(*job, "--time", "0.2s", "-o", "timed.exr")
    assert (code, err) == (0, "")
    assert read(folder / "timed.exr")[0]["nonexp:stopped"] == "time"


@pytest.mark.parametrize(
    ("text", "seconds"), [("90", 90), ("90s", 90), ("10m", 600), ("2h30m", 9000), ("1.5d", 129600)]
)
def test_times_are_understood(text: str, seconds: float) -> None:
    assert targets.seconds(text) == seconds
    assert targets.fraction("1.5%") == targets.fraction("0.015") == pytest.approx(0.015)


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0.04, "0.0 s"),
        (59.94, "59.9 s"),
        (185, "3 min 05 s"),
        (7620, "2 h 07 min"),
        (97200, "1 d 03 h"),
    ],
)
def test_times_are_written_as_people_do(seconds: float, text: str) -> None:
    assert progress.time(seconds) == text


def test_progress_is_one_line() -> None:
    shown = targets.Progress(12, None, 30.0, 16, 2.5, moments.Noise(0.034, 0.035), 1234.0)
    said = progress.describe(shown, 480 * 360, 0.01)
    assert said == "192 spp, 1.1 M/s, error 3.40% (to be 1%), 20 min 34 s left"


def test_resuming_without_a_checkpoint_starts_over(run: Run, folder: Path) -> None:
    code, _, err = run("scene.xml", "--resume")
    assert code == 0
    why = "there is no checkpoint 'scene.exr.checkpoint': starting from the beginning"
    assert err == f"nonexp: {why}\n"
    assert not (folder / "scene.exr.checkpoint").exists()  # quicker made again than kept


def test_another_scene_is_not_resumed(run: Run, folder: Path) -> None:
    assert run("scene.xml", "--checkpoint", "0")[0] == 0
    old = (folder / "scene.exr.checkpoint").read_bytes()
    code, out, err = run("scene.xml", "--resume", "--checkpoint", "0", "-D", "alpha=0.7")
    assert (code, out) == (2, "")
    assert "is of another render: parameter alpha was not given, is 0.7" in err
    text = (folder / "media/gamma.xml").read_text()
    (folder / "media/gamma.xml").write_text(text.replace('value="0.8"', 'value="0.7"'))
    assert "file media/gamma.xml has changed" in run("scene.xml", "--resume")[2]
    assert (folder / "scene.exr.checkpoint").read_bytes() == old


def test_a_denoised_image_is_added_and_named(
    run: Run, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fake(image: np.ndarray, **options: object) -> np.ndarray:
        assert options == {"hdr": True} and image.dtype == np.float32
        return np.full_like(image, 0.5)

    monkeypatch.setitem(sys.modules, "pyoidn", SimpleNamespace(denoise=fake))
    monkeypatch.setattr(denoising.metadata, "version", lambda name: f"of {name}")
    assert run("scene.xml", "--seed", "4", "--denoise")[0] == 0
    header, channels = read(folder / "scene.exr")
    assert header["nonexp:denoiser"] == "Open Image Denoise of pyoidn"
    assert (channels["denoised.G"] == 0.5).all()
    assert (folder / "scene.denoised.png").is_file()
    assert run("scene.xml", "--seed", "4", "-o", "raw.exr")[0] == 0
    plain, raw = read(folder / "raw.exr")
    assert "nonexp:denoiser" not in plain
    for name, values in raw.items():
        np.testing.assert_array_equal(values, channels[name])


def test_open_image_denoise_removes_noise() -> None:
    pytest.importorskip("pyoidn")
    noisy = np.random.default_rng(1).gamma(4, 0.25, (64, 64, 3))
    clean, name = denoising.denoise(noisy)
    assert name.startswith("Open Image Denoise 2.")
    assert clean.std() < noisy.std() / 4
    assert clean.mean() == pytest.approx(noisy.mean(), rel=0.05)


def test_without_a_denoiser_the_extra_is_named(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyoidn", None)
    code, _, err = run("scene.xml", "--denoise")
    assert code == 2
    assert "denoising needs a CUDA variant, or Open Image Denoise, which is not installed" in err
    assert "pip install 'nonexp[denoise]'" in err
