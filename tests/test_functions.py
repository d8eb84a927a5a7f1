"""Functions that scenes name: which module is imported, and what is left of the import."""

from __future__ import annotations

import importlib
import pickle
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mitsuba as mi
import pytest

import nonexp
from nonexp.transmittance import functions
from nonexp.transmittance.functions import load_function


@pytest.fixture(autouse=True)
def modules_and_path() -> Iterator[None]:
    """Modules of these tests go again."""
    before, path = set(sys.modules), list(sys.path)
    yield
    assert sys.path == path
    for name in set(sys.modules) - before:
        del sys.modules[name]
    functions._imported.clear()


def write(folder: Path, value: str, name: str = "a_law") -> str:
    """A module whose function ``f`` returns a value; the folder's name."""
    folder.mkdir(exist_ok=True)
    (folder / f"{name}.py").write_text(f"def f():\n    return {value}\n", encoding="utf-8")
    return str(folder)


def test_two_folders_can_have_modules_of_the_same_name(tmp_path: Path) -> None:
    one, two = write(tmp_path / "one", "1"), write(tmp_path / "two", "2")
    first, second = load_function("x", "a_law:f", [one]), load_function("x", "a_law:f", [two])
    assert (first(), second()) == (1, 2)
    assert load_function("x", "a_law:f", [one]) is first  # not run again
    assert load_function("x", "a_law:f", [two]) is second
    assert load_function("x", "a_law:f", [str(tmp_path), two, one]) is second


def test_a_module_is_imported_anew_when_it_has_changed(tmp_path: Path) -> None:
    for value in range(1, 9):  # of the same size, within a second
        folder = write(tmp_path, str(value))
        assert load_function("x", "a_law:f", [folder])() == value
    assert not (tmp_path / "__pycache__").exists()


def test_modules_that_it_imports_lie_beside_it_too(tmp_path: Path) -> None:
    for name in ("one", "two"):
        write(tmp_path / name, repr(name), "a_helper")
        (tmp_path / name / "a_law.py").write_text("from a_helper import f\n", encoding="utf-8")
    for name in ("one", "two", "one"):
        assert load_function("x", "a_law:f", [str(tmp_path / name)])() == name
    write(tmp_path / "one", "'new'", "a_helper")
    assert load_function("x", "a_law:f", [str(tmp_path / "one")])() == "new"


def test_modules_of_others_stay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    elsewhere, beside = write(tmp_path / "elsewhere", "1"), write(tmp_path / "beside", "2")
    with monkeypatch.context() as patch:
        patch.syspath_prepend(elsewhere)
        theirs: Any = importlib.import_module("a_law")
    assert load_function("x", "a_law:f", [beside])() == 2
    assert sys.modules["a_law"] is theirs
    # What they imported from there is not run a second time, and not behind their back.
    write(tmp_path / "elsewhere", "10")
    assert load_function("x", "a_law:f", [elsewhere]) is theirs.f


def test_modules_of_others_are_not_mistaken_for_those_beside(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    elsewhere = write(tmp_path / "elsewhere", "1", "a_helper")
    beside = write(tmp_path / "beside", "2", "a_helper")
    for name in ("secrets", "drjit"):  # of Python, and a package in use
        write(tmp_path / "beside", "3", name)
    (tmp_path / "beside/a_law.py").write_text(
        "import secrets\nfrom a_helper import f\nfrom drjit import exp\n"
    )
    with monkeypatch.context() as patch:
        patch.syspath_prepend(elsewhere)
        theirs: Any = importlib.import_module("a_helper")
    pythons: Any = importlib.import_module("secrets")
    assert load_function("x", "a_law:f", [beside])() == 2
    assert sys.modules["a_helper"] is theirs and theirs.f() == 1
    assert sys.modules["secrets"] is pythons


def test_modules_keep_their_names(tmp_path: Path) -> None:
    """By them functions are pickled, and classes find the module that they stand in."""
    (tmp_path / "a_law.py").write_text(
        """from __future__ import annotations
from dataclasses import dataclass


@dataclass
class Law:
    rate: float = 2

    def __call__(self):
        return self.rate


def f():
    return Law()()
""",
        encoding="utf-8",
    )
    f = load_function("x", "a_law:f", [str(tmp_path)])
    assert f() == 2 and f.__module__ == "a_law"
    assert pickle.loads(pickle.dumps(f)) is f
    other = "import pickle, sys; print(pickle.loads(bytes.fromhex(sys.argv[1]))())"
    command = [sys.executable, "-c", other, pickle.dumps(f).hex()]
    found = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert found.stdout == "2\n"


def test_a_folder_does_not_hide_a_package(tmp_path: Path) -> None:
    package = tmp_path / "nonexp"
    package.mkdir()
    (package / "__init__.py").write_text("", encoding="utf-8")
    assert load_function("x", "nonexp.models.custom:wigner", [str(tmp_path)])
    assert sys.modules["nonexp"] is nonexp


def test_packages_are_told_apart_too(tmp_path: Path) -> None:
    for name in ("one", "two"):
        write(tmp_path / name, "0", "a_law")
        write(tmp_path / name / "a_package", repr(name), "part")
        (tmp_path / name / "a_package" / "__init__.py").write_text("from .part import f\n")
        (tmp_path / name / "a_law.py").write_text("from a_package.part import f\n")
    for name in ("one", "two", "one"):
        for law in ("a_package:f", "a_package.part:f", "a_law:f"):
            assert load_function("x", law, [str(tmp_path / name)])() == name
    write(tmp_path / "one" / "a_package", "'new'", "part")
    for law in ("a_law:f", "a_package.part:f", "a_package:f"):
        assert load_function("x", law, [str(tmp_path / "one")])() == "new"


def test_a_module_of_another_scene_is_not_there(tmp_path: Path) -> None:
    write(tmp_path / "one", "1", "a_helper")
    for name in ("one", "two"):
        write(tmp_path / name, "1")
        (tmp_path / name / "a_law.py").write_text("from a_helper import f\n", encoding="utf-8")
    assert load_function("x", "a_law:f", [str(tmp_path / "one")])() == 1
    with pytest.raises(ValueError, match="No module named 'a_helper'"):
        load_function("x", "a_law:f", [str(tmp_path / "two")])


def test_the_folder_comes_first_and_links_count_as_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    early, home = write(tmp_path / "early", "1"), write(tmp_path / "home", "2")
    with monkeypatch.context() as patch:
        patch.syspath_prepend(home)
        patch.syspath_prepend(early)
        assert load_function("x", "a_law:f", [home])() == 2
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        write(tmp_path / name / "real", repr(name), "a_helper")
        (tmp_path / name / "a_helper.py").symlink_to(tmp_path / name / "real" / "a_helper.py")
        (tmp_path / name / "a_law.py").write_text("from a_helper import f\n", encoding="utf-8")
        assert load_function("x", "a_law:f", [str(tmp_path / name)])() == name
    write(tmp_path / "one" / "real", "'new'", "a_helper")
    assert load_function("x", "a_law:f", [str(tmp_path / "one")])() == "new"


def test_a_module_may_make_models_while_it_is_imported(tmp_path: Path) -> None:
    (tmp_path / "a_law.py").write_text(
        """from nonexp import models

law = models.create("custom", ff="nonexp.models.custom:wigner")


def f(tau):
    return law.ff(tau)
""",
        encoding="utf-8",
    )
    assert callable(load_function("x", "a_law:f", [str(tmp_path)]))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("def f(:", "module a_law fails with SyntaxError: .*a_law.py, line 1"),
        ("1 / 0", "module a_law fails with ZeroDivisionError: division by zero"),
        ("import no_such_module", "No module named 'no_such_module'"),
        ("g = 1", "module a_law has no function f"),
    ],
)
def test_what_is_wrong_with_a_module_is_one_sentence(
    tmp_path: Path, text: str, message: str
) -> None:
    (tmp_path / "a_law.py").write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=f"Custom.ff is 'a_law:f': {message}"):
        load_function("Custom.ff", "a_law:f", [str(tmp_path)])
    write(tmp_path, "5")
    assert load_function("Custom.ff", "a_law:f", [str(tmp_path)])() == 5


def test_two_scenes_have_each_their_law(tmp_path: Path) -> None:
    mi.set_variant("llvm_ad_rgb")
    laws = []
    for rate in (1, 2):
        folder = tmp_path / str(rate)
        folder.mkdir()
        (folder / "a_law.py").write_text(
            f"import drjit as dr\n\ndef law(tau):\n    return dr.exp(-{rate} * tau)\n",
            encoding="utf-8",
        )
        (folder / "scene.xml").write_text(
            """<scene version="3.0.0">
                <medium type="nonexp_homogeneous" id="fog">
                    <texture type="transmittance_custom" name="transmittance">
                        <string name="ff" value="a_law:law"/>
                    </texture>
                </medium>
                <shape type="sphere"><ref id="fog" name="interior"/></shape>
            </scene>""",
            encoding="utf-8",
        )
        scene = mi.load_file(str(folder / "scene.xml"))
        laws.append(scene.shapes()[0].interior_medium().model)
    for rate, law in zip((1, 2), laws, strict=True):
        assert float(law.ff(mi.Float(0.5))[0]) == pytest.approx(2.718281828 ** (-0.5 * rate))
