"""What the README and the notebooks show works as it stands."""

from __future__ import annotations

import importlib
import json
import re
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from measure import radiance

from nonexp import cli, models

ROOT = Path(__file__).resolve().parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", README, re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("code", blocks("python"))
def test_python_examples_run(code: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    exec(code, {})


@pytest.mark.parametrize("xml", blocks("xml"))
def test_scene_examples_render(xml: str) -> None:
    built = mi.load_string(xml)
    assert np.all(np.isfinite(radiance(built, 64, 1, grid=4)))


def test_command_lines_are_understood(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = re.findall(r"^\.venv/bin/nonexp (render .*)$", README, re.MULTILINE)
    assert len(lines) == 2
    monkeypatch.chdir(ROOT)
    for line in lines:
        words = line.split()
        smaller = ["--spp", "1", "--size", "8x6", "-o", str(tmp_path / "out.exr")]
        assert cli.main([*words, *smaller]) == 0


def test_every_model_is_in_the_table() -> None:
    for name in models.names():
        assert f"\n| `{name}` | " in README


def test_the_manual_of_the_models_is_what_their_classes_say(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    text = importlib.import_module("model_reference").text()
    written = (ROOT / "docs" / "models.md").read_text(encoding="utf-8")
    assert written == text, "run python tools/model_reference.py"


def test_pictures_exist() -> None:
    for picture in re.findall(r"!\[.*?\]\((.*?)\)", README):
        assert (ROOT / picture).is_file()


@pytest.mark.parametrize("path", sorted((ROOT / "notebooks").glob("*.ipynb")), ids=lambda p: p.name)
def test_notebooks_run(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plt = pytest.importorskip("matplotlib.pyplot")
    plt.switch_backend("Agg")
    monkeypatch.chdir(path.parent)
    names: dict[str, object] = {}
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        assert not cell.get("outputs"), "strip the outputs"
        if cell["cell_type"] == "code":
            exec("".join(cell["source"]), names)
    plt.close("all")
