"""What the README, docs/ and examples/ show works as it stands."""

from __future__ import annotations

import ast
import doctest
import importlib
import os
import re
import shlex
import subprocess
import sys
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest import mock

import mitsuba as mi
import numpy as np
import pytest
import yaml
from measure import radiance
from tiers import THOROUGH

from nonexp import __version__, cli, models
from nonexp.scene import cloud as clouds
from nonexp.scene.load import load

ROOT = Path(__file__).resolve().parent.parent
README = ROOT / "README.md"
PAGES = [README, ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").glob("*.md"))]
TEXTS = {page: page.read_text(encoding="utf-8") for page in PAGES}


def blocks(language: str) -> list[Any]:
    """Fenced blocks of that language of all pages, as test cases."""
    pattern = rf"^```{language}\n(.*?)^```$"
    return [
        pytest.param(block, id=f"{page.stem}-{i}")
        for page, text in TEXTS.items()
        for i, block in enumerate(re.findall(pattern, text, re.MULTILINE | re.DOTALL))
    ]


SMALL_CLOUD = clouds.cloud(8)

INTRODUCED = {"plan": "nonexp.rendering", "Competitor": "nonexp.bench.competitors"}
"""Names that the text around a snippet introduces, and where they live."""


@pytest.fixture
def desk(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[dict[str, Any]]:
    """Names of a module in which a snippet runs, in a folder that looks like the repository's root
    but may be written to, and holds the clouds of ``nonexp cloud``; models that it registers are
    forgotten."""
    module = types.ModuleType("snippet")
    monkeypatch.setitem(sys.modules, "snippet", module)
    for folder in ("scenes", "examples"):
        (tmp_path / folder).symlink_to(ROOT / folder)
    monkeypatch.chdir(tmp_path)
    for grid in ("cloud.npz", "cloud.vol"):
        clouds.write(Path(grid), SMALL_CLOUD)
    for name, where in INTRODUCED.items():
        vars(module)[name] = getattr(importlib.import_module(where), name)
    with mock.patch.dict(models.registry):
        yield vars(module)


def in_a_scene(part: Any) -> dict[str, Any]:
    """A scene dictionary around an integrator, medium, texture or sampler given as dictionary."""
    kind = part["type"]
    if kind == "nonexp_sobol":
        camera = {"type": "perspective", "sampler": part}
        return {"type": "scene", "integrator": {"type": "path"}, "camera": camera}
    if kind.startswith("transmittance_"):
        part = {"type": "nonexp_homogeneous", "transmittance": part}
    if part["type"] in ("nonexp_homogeneous", "nonexp_heterogeneous", "nonexp_binary_mixture"):
        ball = {"type": "sphere", "bsdf": {"type": "null"}, "interior": part}
        return {"type": "scene", "integrator": {"type": "nonexp_volpath"}, "ball": ball}
    return {"type": "scene", "integrator": part}


# ------------------------------------------------------------------------------ snippets


@pytest.mark.parametrize("code", blocks("python"))
def test_python_runs(code: str, desk: dict[str, Any]) -> None:
    if code.startswith("{"):
        assert mi.load_dict(in_a_scene(ast.literal_eval(code))).integrator()
    else:
        exec(compile(code, "snippet", "exec"), desk)


@pytest.mark.parametrize("session", blocks("pycon"))
def test_python_sessions_give_what_they_show(session: str, desk: dict[str, Any]) -> None:
    test = doctest.DocTestParser().get_doctest(session, desk, "session", None, None)
    said: list[str] = []
    doctest.DocTestRunner(verbose=False).run(test, out=said.append)
    assert not said, "".join(said)


@pytest.mark.parametrize("xml", blocks("xml"))
def test_xml_loads(xml: str, desk: dict[str, Any]) -> None:
    element = re.search(r"<(\w+)", xml)
    assert element is not None
    if element[1] == "scene":
        assert np.all(np.isfinite(radiance(mi.load_string(xml), 64, 1, grid=4)))
        return
    if element[1] == "texture":
        xml = f'<medium type="nonexp_homogeneous">{xml}</medium>'
        element = re.search(r"<(\w+)", xml)
    if element is not None and element[1] == "medium":
        xml = re.sub(r"<medium ([^>]*)>", r"<medium \1>", xml)
        xml = f'<shape type="sphere"> <bsdf type="null"/> {_interior(xml)} </shape>'
    assert mi.load_string(f'<scene version="3.9.0"> {xml} </scene>') is not None


def _interior(medium: str) -> str:
    head, _, rest = medium.partition(">")
    head = head if "name=" in head else f'{head} name="interior"'
    return f"{head}>{rest}"


def commands() -> list[Any]:
    """Lines of sh blocks, without comments; each once."""
    seen: dict[str, Any] = {}
    for case in blocks("sh"):
        for line in case.values[0].splitlines():
            words = shlex.split(line, comments=True)
            if words:
                name = f"{case.id.rpartition('-')[0]}-{len(seen)}"
                seen.setdefault(" ".join(words), pytest.param(words, id=name))
    return list(seen.values())


KNOWN = {".", "cd", "dask", "export", "git", "jupyter", "make", "nonexp", "pip", "python"}


LOADED: set[tuple[str, ...]] = set()
"""Scenes that have been loaded, with the names of their parameters."""


@pytest.mark.parametrize("words", commands())
def test_command_is_understood(
    words: list[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(ROOT)
    while re.fullmatch(r"[A-Z_]+=\S*", words[0]):
        words = words[1:]
    program, arguments = words[0].removeprefix(".venv/bin/"), words[1:]
    assert program in KNOWN, f"{program}: a program that this test does not know"
    if program == "nonexp":
        _, bound = cli.parse(arguments)
        for word in arguments:
            name = Path(word)
            if name.suffix in (".xml", ".csv") and len(name.parts) > 1:
                assert name.is_file()
        scene = bound.arguments.get("scene")
        if scene is not None and scene.parent.name == "scenes":
            parameters = dict(bound.arguments.get("parameters", ()))
            if scene.name == "cloud.xml":  # whose grid is made by a command before
                clouds.write(tmp_path / "cloud.npz", SMALL_CLOUD)
                parameters["grid"] = str(tmp_path / "cloud.npz")
            medium = parameters.get("medium")
            if medium is not None:
                assert (scene.parent / "media" / f"{medium}.xml").is_file(), medium
            # What else a law's file may hold: tests/test_scenes.py renders every one of them.
            if (scene.name, *sorted(parameters)) not in LOADED:
                LOADED.add((scene.name, *sorted(parameters)))
                load(scene, parameters, (8, 6))
    elif program == "make":
        makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
        for target in arguments:
            assert "=" in target or re.search(rf"^{target}:", makefile, re.MULTILINE), target
    elif program == "pip":
        for extra in re.findall(r"\[(\w+)\]", " ".join(arguments)):
            project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
            assert re.search(rf"^{extra} = \[", project, re.MULTILINE), extra
    elif program == "python" and arguments[0] != "-m":
        assert (ROOT / arguments[0]).is_file()


def test_readme_renders_as_it_says(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    lines = re.findall(r"^\.venv/bin/nonexp (render .*)$", TEXTS[README], re.MULTILINE)
    assert lines
    monkeypatch.chdir(ROOT)
    clouds.write(tmp_path / "cloud.npz", SMALL_CLOUD)
    for line in lines:
        smaller = ["--spp", "1", "--size", "8x6", "-o", str(tmp_path / "out.exr")]
        if "scenes/cloud.xml" in line:
            smaller += ["-D", f"grid={tmp_path / 'cloud.npz'}"]
        assert cli.main([*shlex.split(line, comments=True), *smaller]) == 0


# ------------------------------------------------------------------------------ links, tables


def anchors(text: str) -> set[str]:
    """Names of the headings of a page, as forges make them."""
    headings = re.findall(r"^#+ (.*)$", re.sub(r"^```.*?^```$", "", text, flags=re.M | re.S), re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_links_lead_somewhere(page: Path) -> None:
    text = re.sub(r"^```.*?^```$", "", TEXTS[page], flags=re.MULTILINE | re.DOTALL)
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        if re.match(r"[a-z]+:", link):
            continue
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        assert target.exists(), link
        if anchor and target.suffix == ".md":
            assert anchor in anchors(target.read_text(encoding="utf-8")), link


def test_every_model_is_in_the_tables() -> None:
    gallery = TEXTS[ROOT / "docs" / "gallery.md"]
    for name in models.names():
        assert f"\n| `{name}` | " in TEXTS[README]
        assert f"scenes/dragon.xml -D medium={name} " in gallery, "run make gallery"


def test_gallery_is_small_enough_for_a_repository() -> None:
    pictures = list((ROOT / "docs" / "images" / "gallery").glob("*.png"))
    assert len(pictures) == TEXTS[ROOT / "docs" / "gallery.md"].count("](images/gallery/")
    assert sum(picture.stat().st_size for picture in pictures) < 4e6


@pytest.mark.parametrize("page", ("models.md", "plugins.md", "python.md", "cli.md"))
def test_reference_is_what_the_code_says(page: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    reference = importlib.import_module("reference")
    assert set(reference.PAGES) == {"models.md", "plugins.md", "python.md", "cli.md"}
    assert TEXTS[ROOT / "docs" / page] == reference.PAGES[page](), "run python tools/reference.py"


def test_citation() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["version"] == __version__
    assert {"cff-version", "message", "title", "authors"} <= set(citation)


# ------------------------------------------------------------------------------ examples, Sphinx


@pytest.mark.parametrize("path", sorted((ROOT / "examples").glob("*.py")), ids=lambda p: p.stem)
def test_example_runs(
    path: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = path.read_text(encoding="utf-8")
    assert len(code.splitlines()) <= 30
    monkeypatch.setenv("NONEXP_QUALITY", "0.02")
    monkeypatch.setattr(sys, "argv", [str(path)])
    monkeypatch.chdir(tmp_path)
    exec(compile(code, str(path), "exec"), {"__name__": "__main__", "__file__": str(path)})
    assert capsys.readouterr().out


@THOROUGH
def test_documentation_builds_without_a_warning(tmp_path: Path) -> None:
    """All pages and notebooks, the latter not executed: tests/test_notebooks.py does that."""
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-c", "docs"]
    command += ["-D", "nb_execution_mode=off", ".", str(tmp_path / "html")]
    environment = {**os.environ, "PYTHONWARNINGS": ""}
    built = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
    assert built.returncode == 0, built.stderr
    assert (tmp_path / "html" / "docs" / "index.html").is_file()
