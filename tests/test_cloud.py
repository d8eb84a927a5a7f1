"""The procedural cloud, the command that writes it, and its scene."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tiers import THOROUGH

import nonexp
from nonexp import cli
from nonexp.scene import cloud as clouds
from nonexp.scene.cloud import cloud
from nonexp.scene.load import load
from nonexp.scene.messages import SceneError

SCENE = Path(__file__).resolve().parent.parent / "scenes" / "cloud.xml"


@pytest.mark.parametrize("seed", range(4))
def test_a_cloud_is_in_its_cube_and_mostly_empty(seed: int) -> None:
    found = cloud(48, seed)
    assert found.shape == (48, 48, 48) and found.dtype == np.float32
    assert found.min() == 0 and 0.99 < found.max() <= 1
    assert 0.8 < np.mean(found == 0) < 0.95 and 0.05 < found.mean() < 0.15
    for axis in range(3):
        assert not np.take(found, [0, -1], axis).any()
    bricks = found.reshape(6, 8, 6, 8, 6, 8).max((1, 3, 5))
    assert np.mean(bricks == 0) > 0.5
    rows = found.sum((0, 2))  # y is up: the base is broad, the top is not
    filled = np.flatnonzero(rows)
    assert rows[filled[len(filled) // 5]] > 1.5 * rows[filled[-len(filled) // 5]]


def test_seeds_are_other_clouds_and_give_the_same_again() -> None:
    first, again, other = cloud(24, 1), cloud(24, 1), cloud(24, 2)
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 0.5
    assert cloud(24, 10**12).any()


def test_the_shape_is_the_same_at_every_resolution(monkeypatch: pytest.MonkeyPatch) -> None:
    """With the same octaves, voxels of odd multiples share their centres exactly."""
    monkeypatch.setattr(clouds, "_OCTAVES", clouds._OCTAVES[:2])
    coarse, fine = cloud(30), cloud(90)
    np.testing.assert_allclose(coarse, fine[1::3, 1::3, 1::3], atol=2e-4)
    monkeypatch.undo()
    whole = cloud(48)
    monkeypatch.setattr(clouds, "_SLAB", 7)
    np.testing.assert_allclose(cloud(48), whole, atol=1e-4)
    means = cloud(96).reshape(48, 2, 48, 2, 48, 2).mean((1, 3, 5))
    assert np.abs(means - whole).mean() < 0.01


def test_octaves_finer_than_two_voxels_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    coarse, fine = cloud(24), cloud(64)
    monkeypatch.setattr(clouds, "_OCTAVES", clouds._OCTAVES[:1])
    np.testing.assert_array_equal(cloud(24), coarse)
    assert np.abs(cloud(64) - fine).max() > 0.2


@pytest.mark.parametrize("given", [(3, 1), (1025, 1), (16, -1)])
def test_bad_arguments(given: tuple[int, int]) -> None:
    with pytest.raises(ValueError, match=r"(resolution|seed) is -?\d+: it must be a whole number"):
        cloud(*given)


# --------------------------------------------------------------------- the command


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("name", ["a.npz", "a.npy", "a.vol"])
def test_the_command_writes_what_a_medium_reads(
    folder: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    (folder / name).write_text("old")
    assert cli.main(["cloud", name, "--resolution", "16", "--seed", "3"]) == 0
    out, err = capsys.readouterr()
    assert re.fullmatch(rf"{name}: 16 x 16 x 16 voxels, \d\d% of them empty\n", out) and not err
    assert [path.name for path in folder.iterdir()] == [name]
    np.testing.assert_array_equal(nonexp.read_grid(name)[0], cloud(16, 3))
    first = hashlib.sha256((folder / name).read_bytes()).digest()
    assert cli.main(["cloud", name, "--resolution", "16", "--seed", "3"]) == 0
    assert hashlib.sha256((folder / name).read_bytes()).digest() == first  # a file of no date


@pytest.mark.parametrize(
    "arguments, message",
    [
        ([], 'Command "cloud" parameter FILE requires an argument'),
        (["a.vdb"], "FILE is 'a.vdb': it must end in .npz, .npy, .vol"),
        (["no/a.npz"], "FILE is 'no/a.npz': its folder 'no' does not exist"),
        (["dir.npy"], "FILE is 'dir.npy': it is a folder"),
        (["a.npz", "--resolution", "2"], "--resolution is '2': it must be a whole number from 4"),
        (["a.npz", "--resolution", "1e2"], "--resolution is '1e2': it must be a whole number"),
        (["a.npz", "--seed", "-1"], "--seed is '-1': it must be a whole number from 0"),
    ],
)
def test_errors_are_one_sentence(
    folder: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], message: str
) -> None:
    (folder / "dir.npy").mkdir()
    assert cli.main(["cloud", *arguments]) == 2
    out, err = capsys.readouterr()
    assert not out and err.startswith(f"nonexp: error: {message}") and err.count("\n") == 1
    assert [path.name for path in folder.iterdir()] == ["dir.npy"]


@pytest.mark.parametrize("name", ["a.npz", "a.npy", "a.vol"])
def test_a_failure_leaves_the_old_file(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    (folder / name).write_text("old")

    def broken(path: Any, *_: Any, **__: Any) -> None:
        raise OSError("no space left on device")

    monkeypatch.setattr(clouds.np, "save", broken)
    monkeypatch.setattr(clouds.np, "savez_compressed", broken)
    monkeypatch.setattr(clouds.mi.VolumeGrid, "write", broken)
    assert cli.main(["cloud", name, "--resolution", "8"]) == 2
    assert capsys.readouterr().err == "nonexp: error: no space left on device\n"
    assert (folder / name).read_text() == "old"
    assert [path.name for path in folder.iterdir()] == [name]


# --------------------------------------------------------------------- the scene


def test_the_scene_says_what_is_missing() -> None:
    with pytest.raises(SceneError, match=r"'gone.npz': it does not exist \(the command nonexp clo"):
        load(SCENE, {"grid": "gone.npz"})


@THOROUGH
def test_the_scene_shows_a_cloud_in_the_sky_that_differs_between_laws(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", cloud(32))
    images = {}
    for law in ("exponential", "gamma", "linear"):
        parameters = {"grid": str(tmp_path / "a.npy"), "medium": law}
        scene = load(SCENE, parameters, (16, 12)).scene
        images[law] = nonexp.render(scene, spp=256, seed=1).mean
        (sky, white) = images[law][0, 0], images[law][5, 6]
        assert sky[2] > 1.5 * sky[0]  # blue
        assert white[0] > 0.75 * white[2]
    assert np.abs(images["gamma"] - images["exponential"]).max() > 0.02
    assert np.abs(images["linear"] - images["exponential"]).max() > 0.02
    np.testing.assert_array_equal(images["gamma"][0, 0], images["linear"][0, 0])
