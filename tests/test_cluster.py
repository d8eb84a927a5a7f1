"""Rendering on several workers: the image of one machine, whatever happens to them."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

import nonexp
from nonexp import cli, rendering
from nonexp.rendering import Plan, cluster
from nonexp.rendering.job import RenderJob
from nonexp.rendering.render import run
from nonexp.scene.cloud import cloud
from nonexp.scene.load import load

pytestmark = [pytest.mark.thorough, pytest.mark.usefixtures("several_threads")]

pytest.importorskip("distributed")

ROOT = Path(__file__).resolve().parent.parent

SCENE = """
<scene version="3.0.0">
    <default name="b" value="1"/>
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
    <include filename="medium.xml"/>
    <shape type="sphere"><bsdf type="null"/><ref name="interior" id="medium"/></shape>
</scene>
"""
MEDIUM = """
<scene version="3.0.0">
    <medium type="nonexp_homogeneous" id="medium">
        <texture type="transmittance_linear" name="t"><float name="b" value="$b"/></texture>
    </medium>
</scene>
"""
GRID = """
<scene version="3.0.0">
    <medium type="nonexp_heterogeneous" id="medium">
        <string name="filename" value="grids/$b.npy"/>
        <transform name="to_world"><translate value="-0.5"/><scale value="2"/></transform>
        <texture type="transmittance_linear" name="t"/>
    </medium>
</scene>
"""


@pytest.fixture(scope="module")
def workers() -> Iterator[cluster.Cluster]:
    """Two workers on this machine."""
    before = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, (str(ROOT), before)))
    try:
        with cluster.connect("local:2") as connected:
            yield connected
    finally:
        if before is None:
            del os.environ["PYTHONPATH"]
        else:
            os.environ["PYTHONPATH"] = before


@pytest.fixture
def path(tmp_path: Path) -> Path:
    (tmp_path / "scene.xml").write_text(SCENE)
    (tmp_path / "medium.xml").write_text(MEDIUM)
    return tmp_path / "scene.xml"


def job(path: Path, passes: int, **parameters: str) -> RenderJob:
    loaded = load(path, parameters)
    return RenderJob.of_file(loaded, path, parameters, spp=4 * passes, pass_spp=4, seed=5)


def test_the_passes_are_those_of_one_machine_in_order(workers: cluster.Cluster, path: Path) -> None:
    assert workers.workers() == 2
    assert re.match(r"http://.*:\d+/status", workers.dashboard)
    here = list(rendering.render_passes(load(path, {}).scene, Plan(9, 4), 5))
    there = list(workers.passes(job(path, 9)))
    np.testing.assert_array_equal(there, here)
    np.testing.assert_array_equal(list(workers.passes(job(path, 9), start=6)), here[6:])
    other = next(workers.passes(job(path, 1, b="2")))
    assert not np.array_equal(other, here[0])


def test_a_worker_renders_the_sensor_asked_for(workers: cluster.Cluster, path: Path) -> None:
    second = SCENE[SCENE.index("    <sensor") : SCENE.index("    <emitter")]
    second = second.replace("<sensor", '<sensor id="side"').replace("0, 0, 4", "0, 3, 2")
    path.write_text(SCENE.replace("    <emitter", second + "    <emitter"))
    loaded = load(path, {})
    asked = RenderJob.of_file(loaded, path, {}, spp=4, pass_spp=4, sensor="side")
    here = list(rendering.render_passes(loaded.scene, Plan(1, 4), sensor="side"))
    np.testing.assert_array_equal(list(workers.passes(asked)), here)
    other = list(rendering.render_passes(loaded.scene, Plan(1, 4)))
    assert not np.array_equal(here, other)


def test_a_worker_finds_the_grid_of_a_medium(workers: cluster.Cluster, path: Path) -> None:
    (path.parent / "medium.xml").write_text(GRID)
    (path.parent / "grids").mkdir()
    for name, seed in (("a", 1), ("1", 2)):
        np.save(path.parent / f"grids/{name}.npy", cloud(16, seed))
    found = []
    for parameters in ({"b": "a"}, {}):
        here = list(rendering.render_passes(load(path, parameters).scene, Plan(1, 4), 5))
        np.testing.assert_array_equal(list(workers.passes(job(path, 1, **parameters))), here)
        found.append(here)
    assert not np.array_equal(*found)


def test_a_scene_in_memory_has_nothing_to_send(workers: cluster.Cluster) -> None:
    scene = mi.load_dict(mi.cornell_box())
    with pytest.raises(ValueError, match="a scene in memory has no files to send to a cluster"):
        nonexp.render(scene, spp=4, source=workers.passes)


def test_an_open_end_is_cut_when_enough_is_there(workers: cluster.Cluster, path: Path) -> None:
    loaded = load(path, {})
    asked: dict[str, Any] = {"error": 0.05, "seed": 3, "pass_spp": 2}
    image = run(RenderJob.of_file(loaded, path, {}, **asked), loaded.scene, source=workers.passes)
    alone = nonexp.render(loaded.scene, **asked)
    assert image.stopped == alone.stopped == "error"
    assert image.passes == alone.passes
    np.testing.assert_array_equal(image.mean, alone.mean)
    np.testing.assert_array_equal(image.stderr, alone.stderr)


def test_a_worker_that_is_killed_costs_time_but_nothing_else(
    workers: cluster.Cluster, path: Path
) -> None:
    here = list(rendering.render_passes(load(path, {}).scene, Plan(40, 4), 5))
    there = []
    for number, image in enumerate(workers.passes(job(path, 40))):
        there.append(image)
        if number == 5:
            processes = workers._client.run(os.getpid)
            os.kill(next(iter(processes.values())), signal.SIGKILL)
    np.testing.assert_array_equal(there, here)


def test_another_version_on_a_worker_is_refused(workers: cluster.Cluster, path: Path) -> None:
    asked = job(path, 2)
    versions = {**asked.identity["versions"], "drjit": "9.9"}
    asked = replace(asked, identity={**asked.identity, "versions": versions})
    with pytest.raises(ValueError, match=r"a worker on .* has drjit [\d.]+ instead of drjit 9\.9"):
        next(workers.passes(asked))


def test_the_command_renders_the_same_file(
    path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
    workers: cluster.Cluster,
) -> None:  # fmt: skip
    monkeypatch.chdir(path.parent)
    words = ["render", "scene.xml", "--variant", "llvm_ad_rgb", "--spp", "40", "-D", "b=1.5"]
    assert cli.main([*words, "-o", "one.exr"]) == 0
    address = workers._client.scheduler.address
    assert cli.main([*words, "-o", "two.exr", "--cluster", address]) == 0
    assert re.search(r"nonexp: \d workers?, dashboard at http://", capsys.readouterr().err)
    assert Path("one.png").read_bytes() == Path("two.png").read_bytes()
    from test_checkpoint import content

    assert content(Path("one.exr")) == content(Path("two.exr"))


def test_a_scheduler_that_is_killed_is_told_in_a_sentence(
    path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    dask = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--no-dashboard", "--port"]
    quiet: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    with subprocess.Popen([*dask, address.rpartition(":")[2]], **quiet) as scheduler:
        try:
            with cluster.connect(address) as where:
                under_way = where.passes(job(path, 1000))
                threading.Timer(1.0, scheduler.kill).start()  # nobody has joined to work
                with pytest.raises(RuntimeError, match="the scheduler cannot be reached any more"):
                    list(under_way)
        finally:
            scheduler.kill()
    assert "Traceback" not in capfd.readouterr().err


def test_an_address_without_scheduler_is_told(
    path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(path.parent)
    monkeypatch.setattr(cluster, "_TIMEOUT", 0.2)
    words = ["render", "scene.xml", "--variant", "llvm_ad_rgb", "--spp", "8", "--cluster"]
    assert cli.main([*words, "tcp://127.0.0.1:9"]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "--cluster is 'tcp://127.0.0.1:9': no scheduler answers there (it must be" in said


def test_without_dask_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ImportError, match=r"pip install 'nonexp\[cluster\]'"):
        cluster.require()
