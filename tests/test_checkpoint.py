"""Checkpoints: what they hold, what damages them, and that a run goes on as if nothing had been."""

from __future__ import annotations

import os
import random
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import OpenEXR
import pytest
from tiers import THOROUGH

import nonexp
from nonexp.images.moments import Moments
from nonexp.rendering import checkpoint
from nonexp.rendering.checkpoint import Checkpoint
from nonexp.rendering.job import RenderJob
from nonexp.scene import identity as sceneid
from nonexp.system import files

pytestmark = [pytest.mark.thorough, pytest.mark.usefixtures("several_threads")]

ROOT = Path(__file__).resolve().parent.parent


def scene(radiance: float = 1.0, depth: int = 3, spp: int = 8) -> Any:
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "nonexp_volpath", "max_depth": depth},
            "sensor": {
                "type": "perspective",
                "to_world": mi.ScalarTransform4f().look_at([0, 0, 3], [0, 0, 0], [0, 1, 0]),
                "sampler": {"type": "independent", "sample_count": spp},
                "film": {"type": "hdrfilm", "width": 16, "height": 12, "rfilter": {"type": "box"}},
            },
            "light": {
                "type": "sphere",
                "center": [2, 2, 2],
                "emitter": {"type": "area", "radiance": {"type": "rgb", "value": radiance}},
            },
            "ball": {"type": "cube"},
        }
    )


def state(passes: int = 3, shape: tuple[int, ...] = (2, 3, 3)) -> Checkpoint:
    rng = np.random.default_rng(passes)
    moments = Moments()
    for _ in range(passes):
        moments = moments.plus(rng.normal(size=shape))
    return Checkpoint({"seed": 1, "files": {"a.xml": "12"}}, moments, 1.25 * passes)


def assert_equal(a: Moments, b: Moments) -> None:
    assert a.passes == b.passes
    assert a.mean.tobytes() == b.mean.tobytes()
    assert a.squares.tobytes() == b.squares.tobytes()


# --------------------------------------------------------------------- files


def test_a_checkpoint_holds_the_state_to_the_bit(tmp_path: Path) -> None:
    path = tmp_path / "a.checkpoint"
    written = state()
    checkpoint.write(path, written)
    found = checkpoint.read(path)
    assert_equal(found.moments, written.moments)
    assert (found.identity, found.seconds, found.finished) == (written.identity, 3.75, False)
    assert found.written
    assert [p.name for p in tmp_path.iterdir()] == ["a.checkpoint"]


def test_the_one_before_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "a.checkpoint"
    for passes in (1, 2, 3):
        checkpoint.write(path, state(passes))
    assert checkpoint.read(path).moments.passes == 3
    assert checkpoint.read(checkpoint.older(path)).moments.passes == 2
    checkpoint.write(path, state(9), keep=False)
    assert checkpoint.read(path).moments.passes == 9
    assert checkpoint.read(checkpoint.older(path)).moments.passes == 2


def test_every_flipped_bit_and_every_truncation_is_noticed(tmp_path: Path) -> None:
    path = tmp_path / "a.checkpoint"
    checkpoint.write(path, state(1))
    checkpoint.write(path, state(2))
    whole = path.read_bytes()
    rng = random.Random(1)
    for place in range(len(whole)):
        damaged = bytearray(whole)
        damaged[place] ^= 1 << rng.randrange(8)
        path.write_bytes(damaged)
        with pytest.raises(ValueError, match="is damaged: its checksum does not match"):
            checkpoint.read(path)
    for length in (*range(0, len(whole), 7), len(whole) - 1):
        path.write_bytes(whole[:length])
        loaded = checkpoint.newest(path)
        assert loaded is not None
        found, wrong = loaded
        assert_equal(found.moments, state(1).moments)
        assert "is damaged" in wrong


def test_without_a_whole_one_it_is_said(tmp_path: Path) -> None:
    path = tmp_path / "a.checkpoint"
    assert checkpoint.newest(path) is None
    path.write_bytes(b"nonsense")
    checkpoint.older(path).write_bytes(b"")
    with pytest.raises(ValueError, match=r"is damaged: .*, and there is no older one: delete it"):
        checkpoint.newest(path)


@pytest.mark.parametrize("call", ["write", "fsync", "replace"])
@pytest.mark.parametrize("number", [1, 2, 3])
def test_wherever_writing_breaks_off_one_checkpoint_is_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str, number: int
) -> None:
    """As if the power went at the n-th write, fsync or rename of the third checkpoint."""
    path = tmp_path / "a.checkpoint"
    for passes in (1, 2):
        checkpoint.write(path, state(passes))

    class PowerCut(BaseException):
        pass

    calls = 0

    def cut(original: Any) -> Any:
        def replacement(*arguments: Any, **keywords: Any) -> Any:
            nonlocal calls
            calls += 1
            if calls == number:
                raise PowerCut
            return original(*arguments, **keywords)

        return replacement

    if call == "write":
        monkeypatch.setattr(np, "ascontiguousarray", cut(np.ascontiguousarray))
    else:
        monkeypatch.setattr(files.os, call, cut(getattr(os, call)))
    try:
        checkpoint.write(path, state(3))
    except PowerCut:
        pass
    monkeypatch.undo()
    loaded = checkpoint.newest(path)
    assert loaded is not None
    assert_equal(loaded[0].moments, state(loaded[0].moments.passes).moments)
    assert loaded[0].moments.passes >= 2
    assert not [p for p in tmp_path.iterdir() if p.suffix == ".part"]


def test_an_identity_is_what_json_can_hold(tmp_path: Path) -> None:
    file = tmp_path / "checkpoint"
    with pytest.raises(ValueError, match=r"identity is .*: it must be what JSON can hold"):
        nonexp.render(mi.load_dict(mi.cornell_box()), checkpoint=file, identity={"a": tmp_path})
    assert not file.exists()
    assert sceneid.differences({"a": {"b": 1}}, {"a": "c"}) == ["a was {'b': 1}, is c"]


def test_leftovers_of_killed_runs_are_removed_after_a_day(tmp_path: Path) -> None:
    target = tmp_path / "[a].exr"
    killed = "import os, sys, pathlib; from nonexp.system.files import replacing\n"
    killed += "with replacing(pathlib.Path(sys.argv[1])) as (p,): p.write_text(''); os._exit(9)"
    assert subprocess.run([sys.executable, "-c", killed, target]).returncode == 9
    (left,) = tmp_path.iterdir()
    kept = [".[a].exr.0123.part", ".b.exr.0123.part", "[a].exr", ".a.exr.0123.part"]
    for name in kept:
        (tmp_path / name).write_text("")
    for path in (left, *(tmp_path / name for name in kept[1:])):
        os.utime(path, (1e9, 1e9))
    yesterday = time.time() - 80_000  # it may be that of a run on another machine
    os.utime(tmp_path / kept[0], (yesterday, yesterday))
    files.remove_leftovers(target)
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(kept)


def test_two_writers_of_one_file_do_not_share_a_temporary_one(tmp_path: Path) -> None:
    target = tmp_path / "a"
    with files.replacing(target) as (first,), files.replacing(target) as (second,):
        first.write_text("1")
        second.write_text("2")
    assert target.read_text() == "1" and [p.name for p in tmp_path.iterdir()] == ["a"]


def test_a_disk_that_is_full_is_told_once_and_old_files_stay(tmp_path: Path) -> None:
    path, told = tmp_path / "gone" / "a.checkpoint", []
    path.parent.mkdir()
    job = RenderJob.of_scene(scene(), checkpoint=path, interval=0)
    path.parent.rmdir()
    keeper = checkpoint.Keeper(job, keep_present=False, warn=told.append)
    for passes in (1, 2, 3):
        keeper.offer(state(passes).moments, 1.0)
        time.sleep(0.01)
    assert not keeper.close(state(4).moments, 1.0, True)
    assert told == [f"checkpoint {str(path)!r} cannot be written (No such file or directory)"]


def test_differences_are_named() -> None:
    before = {
        "parameters": {"alpha": "0.5"},
        "files": {"a.xml": "1", "b.ply": "2"},
        "size": [480, 360],
        "seed": 1,
        "versions": {"mitsuba": "3.9.0"},
    }
    now = {
        "parameters": {"alpha": "0.7", "b": "1"},
        "files": {"a.xml": "1", "b.ply": "3", "c.png": "4"},
        "size": [48, 36],
        "seed": 1,
        "versions": {"mitsuba": "3.9.1"},
    }
    assert sceneid.differences(before, now) == [
        "parameter alpha was 0.5, is 0.7",
        "parameter b was not given, is 1",
        "file b.ply has changed",
        "file c.png is new",
        "size was 480x360, is 48x36",
        "version mitsuba was 3.9.0, is 3.9.1",
    ]
    assert sceneid.differences(now, now) == []


# --------------------------------------------------------------------- resuming from Python


class Break(Exception):
    pass


def broken_off(target: Any, path: Path, after: int, **arguments: Any) -> None:
    def stop(progress: nonexp.Progress) -> None:
        if progress.done >= after:
            raise Break

    with pytest.raises(Break):
        nonexp.render(target, checkpoint=path, on_progress=stop, **arguments)


def assert_same_image(a: nonexp.Image, b: nonexp.Image) -> None:
    assert a.mean.tobytes() == b.mean.tobytes()
    assert a.stderr.tobytes() == b.stderr.tobytes()
    assert (a.spp, a.passes, a.seed) == (b.spp, b.passes, b.seed)


@pytest.mark.parametrize("interval", [0, 60])
def test_a_broken_run_goes_on_to_the_same_bits(tmp_path: Path, interval: float) -> None:
    path = tmp_path / "c"
    whole = nonexp.render(scene(), spp=40, seed=3)
    for after in (1, 4, 5):
        broken_off(scene(), path, after, spp=40, seed=3, interval=interval)
        saved = checkpoint.newest(path)
        assert saved is not None and saved[0].moments.passes == after
    seen: list[nonexp.Progress] = []
    image = nonexp.render(scene(), spp=40, seed=3, checkpoint=path, on_progress=seen.append)
    assert [p.done for p in seen] == list(range(6, whole.passes + 1))
    assert_same_image(image, whole)


def test_a_finished_run_can_be_extended(tmp_path: Path) -> None:
    path, target = tmp_path / "c", scene()
    first = nonexp.render(target, spp=32, checkpoint=path)
    assert (first.passes, first.pass_spp) == (8, 4)
    longer = nonexp.render(target, spp=80, checkpoint=path)
    assert_same_image(longer, nonexp.render(target, spp=80, pass_spp=4))
    again = nonexp.render(target, spp=64, checkpoint=path)  # it has more already
    assert_same_image(again, longer)
    assert longer.seconds > first.seconds
    afresh = nonexp.render(target, spp=64, checkpoint=path, resume=False)
    assert_same_image(afresh, nonexp.render(target, spp=64))


def test_a_run_to_an_error_goes_on_to_the_same_bits(tmp_path: Path) -> None:
    path = tmp_path / "c"
    whole = nonexp.render(scene(), error=0.1, seed=2, pass_spp=1)
    assert whole.stopped == "error" and whole.passes > 12
    broken_off(scene(), path, 11, error=0.1, seed=2, pass_spp=1)
    assert_same_image(nonexp.render(scene(), error=0.1, seed=2, checkpoint=path), whole)


def test_the_older_checkpoint_is_used_and_then_kept(tmp_path: Path) -> None:
    path = tmp_path / "c"
    whole = nonexp.render(scene(), spp=40)
    for after in (2, 5):
        broken_off(scene(), path, after, spp=40)
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.warns(UserWarning, match="is damaged: .*: the one before it is used"):
        broken_off(scene(), path, 4, spp=40)
    assert checkpoint.read(path).moments.passes == 4
    assert checkpoint.read(checkpoint.older(path)).moments.passes == 2  # not the damaged one
    assert_same_image(nonexp.render(scene(), spp=40, checkpoint=path), whole)


def test_another_render_is_refused_and_the_difference_named(tmp_path: Path) -> None:
    path = tmp_path / "c"
    broken_off(scene(), path, 2, spp=16)
    before = path.read_bytes()
    other: dict[str, tuple[Any, dict[str, Any]]] = {
        "value light.emitter.radiance.value has changed": (scene(radiance=2), {}),
        "option max_depth was 3, is 4": (scene(depth=4), {}),
        "seed was 0, is 1": (scene(), {"seed": 1}),
        "pass_spp was 2, is 4": (scene(), {"pass_spp": 4}),
    }
    for message, (target, arguments) in other.items():
        with pytest.raises(ValueError, match=f"is of another render: .*{message}"):
            nonexp.render(target, spp=16, checkpoint=path, **arguments)
    assert path.read_bytes() == before
    nonexp.render(scene(spp=99), spp=16, checkpoint=path)  # the sampler's number plays no part


def test_another_version_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "c"
    broken_off(scene(), path, 2, spp=16)
    versions = sceneid.versions()
    monkeypatch.setattr("nonexp.rendering.job.versions", lambda: {**versions, "drjit": "9.9"})
    with pytest.raises(ValueError, match=r"version drjit was [\d.]+, is 9\.9"):
        nonexp.render(scene(), spp=16, checkpoint=path)


def test_the_identity_of_a_scene_is_that_of_its_twin() -> None:
    target = scene()
    first = sceneid.of_scene(target)
    nonexp.render(target, spp=8)
    assert sceneid.of_scene(target) == first == sceneid.of_scene(scene())
    params = mi.traverse(target)
    params["ball.bsdf.reflectance.value"] = 0.25
    params.update()
    differ = sceneid.differences(first, sceneid.of_scene(target))
    assert "value ball.bsdf.reflectance.value has changed" in differ


# --------------------------------------------------------------------- the command, killed

SCENE = """
<scene version="3.0.0">
    <integrator type="nonexp_volpath"><integer name="max_depth" value="4"/></integrator>
    <sensor type="perspective">
        <transform name="to_world">
            <lookat origin="0, 0, 4" target="0, 0, 0" up="0, 1, 0"/>
        </transform>
        <film type="hdrfilm">
            <integer name="width" value="12"/> <integer name="height" value="10"/>
            <rfilter type="box"/>
        </film>
    </sensor>
    <emitter type="constant"/>
    <shape type="sphere">
        <bsdf type="null"/>
        <medium type="nonexp_homogeneous" name="interior">
            <texture type="transmittance_gamma" name="transmittance"/>
        </medium>
    </shape>
</scene>
"""


def command(folder: Path, *arguments: str, limit: int | None = None) -> subprocess.Popen[str]:
    def prepare() -> None:
        if limit is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    return subprocess.Popen(
        [
            sys.executable,
            "-m",
            "nonexp",
            "render",
            "scene.xml",
            "--variant",
            "llvm_ad_rgb",
            *arguments,
        ],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=prepare,
    )


def result(process: subprocess.Popen[str]) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of a command, at its end."""
    out, err = process.communicate()
    return process.returncode, out, err


def content(path: Path) -> dict[str, bytes]:
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {name: channel.pixels.tobytes() for name, channel in file.channels().items()}


@THOROUGH
def test_a_run_killed_again_and_again_gives_the_same_bits(tmp_path: Path, effort: int) -> None:
    """kill -9 at random moments, 5 times, 100 in full: at start, while rendering, while writing."""
    kills = 5 if effort == 1 else 100
    (tmp_path / "scene.xml").write_text(SCENE)
    job = ("--pass-spp", "1", "--spp", str(60 * kills), "--checkpoint", "0")
    assert result(command(tmp_path, *job, "-o", "whole.exr"))[0] == 0
    rng = random.Random(1)
    path = tmp_path / "broken.exr.checkpoint"

    def passes() -> int:
        found = checkpoint.newest(path)  # raises if neither file is whole
        return found[0].moments.passes if found else 0

    reached = [0]
    for _ in range(kills):
        run = command(tmp_path, *job, "-o", "broken.exr", "--resume")
        while run.poll() is None and passes() == reached[-1]:  # nothing to lose yet
            time.sleep(0.01)
        time.sleep(rng.uniform(0, 0.3))
        run.send_signal(signal.SIGKILL)
        run.communicate()
        reached.append(passes())
        assert reached[-1] >= reached[-2]
    assert len(set(reached)) > kills / 2, "killed when all was done"
    last = result(command(tmp_path, *job, "-o", "broken.exr", "--resume"))
    assert last[::2] == (0, "")
    assert content(tmp_path / "broken.exr") == content(tmp_path / "whole.exr")
    assert (tmp_path / "broken.png").read_bytes() == (tmp_path / "whole.png").read_bytes()


def test_a_full_disk_loses_nothing_that_was_there(tmp_path: Path) -> None:
    (tmp_path / "scene.xml").write_text(SCENE)
    assert result(command(tmp_path, "--spp", "16", "--checkpoint", "0"))[0] == 0
    before = {p: p.read_bytes() for p in tmp_path.iterdir()}
    job = command(tmp_path, "--spp", "32", "--checkpoint", "0", limit=1000)
    code, out, err = result(job)
    assert (code, out) == (2, "")
    warning, error = err.splitlines()
    assert "warning: checkpoint 'scene.exr.checkpoint' cannot be written (File too lar" in warning
    assert error.startswith("nonexp: error: 'scene.exr' cannot be written: ")
    assert error.endswith("; is the disk full?")  # and no word of the old checkpoint
    assert {p: p.read_bytes() for p in tmp_path.iterdir()} == before


def test_hours_are_not_overwritten_without_being_asked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from nonexp import cli

    monkeypatch.chdir(tmp_path)
    Path("scene.xml").write_text(SCENE)
    unfinished = Checkpoint({}, state().moments, 7000.0)
    checkpoint.write(Path("scene.exr.checkpoint"), unfinished)
    job = ["render", "scene.xml", "--variant", "llvm_ad_rgb", "--spp", "8"]
    assert cli.main(job) == 2
    said = "'scene.exr.checkpoint' holds 1 h 56 min of an unfinished render: give --resume"
    assert said in capsys.readouterr().err
    assert cli.main([*job, "--restart"]) == 0
    assert not list(tmp_path.glob("*.checkpoint*"))


def test_a_target_that_is_reached_already_ends_the_render(tmp_path: Path) -> None:
    file = tmp_path / "checkpoint"
    film = {"type": "hdrfilm", "width": 4, "height": 4, "rfilter": {"type": "box"}}
    sensor = {"type": "perspective", "film": film}
    parts = {"integrator": {"type": "direct"}, "light": {"type": "constant"}, "sensor": sensor}
    target = mi.load_dict({"type": "scene", **parts})

    def stop(progress: nonexp.Progress) -> None:
        if progress.done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        nonexp.render(target, spp=32, pass_spp=4, checkpoint=file, on_progress=stop)
    assert not checkpoint.read(file).finished
    assert nonexp.render(target, spp=8, pass_spp=4, checkpoint=file).passes == 3
    found = checkpoint.read(file)
    assert found.finished and found.moments.passes == 3


@THOROUGH
def test_memory_stays_flat(effort: int, tmp_path: Path) -> None:
    """1000 passes (10 000 in full) with a checkpoint every 50 ms: no growth after the first 200."""
    sizes: list[int] = []

    def look(progress: nonexp.Progress) -> None:
        if progress.done % 100 == 0:
            sizes.append(int(Path("/proc/self/statm").read_text().split()[1]))

    passes = 1000 if effort == 1 else 10_000
    film = {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}}
    target = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "direct"},
            "sensor": {"type": "perspective", "film": film},
            "light": {"type": "constant"},
        }
    )
    saved = {"checkpoint": tmp_path / "c", "interval": 0.05}
    image = nonexp.render(target, spp=passes, pass_spp=1, on_progress=look, **saved)
    assert image.passes == passes
    pages = resource.getpagesize()
    assert (max(sizes[2:]) - sizes[1]) * pages < 4e6
