"""Choosing the LLVM library and the variant."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import drjit as dr
import mitsuba as mi
import pytest

from nonexp.system import machine


@pytest.mark.parametrize(
    ("path", "major"),
    [
        ("/usr/lib/x86_64-linux-gnu/libLLVM-14.0.6.so.1", 14),
        ("/usr/lib/x86_64-linux-gnu/libLLVM-15.so", 15),
        ("/usr/lib/x86_64-linux-gnu/libLLVM-18.so.18.1", 18),
        ("/usr/lib/aarch64-linux-gnu/libLLVM.so.19.1", 19),
        ("/usr/lib/llvm-18/lib/libLLVM.so", 18),
        ("/usr/lib64/llvm17/lib/libLLVM.so", 17),
        ("/opt/homebrew/Cellar/llvm/21.1.0/lib/libLLVM.dylib", 21),
        ("/opt/homebrew/opt/llvm@18/lib/libLLVM.dylib", 18),
        ("/home/x86_64/lib/libLLVM.so", 0),
    ],
)
def test_the_version_is_read_from_the_name(path: str, major: int) -> None:
    assert machine._major(path) == major


@pytest.fixture
def libraries(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder in which alone LLVM is looked for; the variable is not set."""
    monkeypatch.setattr(machine, "_GLOBS", {machine.platform.system(): (f"{tmp_path}/libLLVM*",)})
    monkeypatch.setattr(machine, "_ENVIRONMENT_GLOBS", ())
    monkeypatch.delenv(machine.LLVM_VARIABLE, raising=False)
    return tmp_path


def test_the_newest_usable_llvm_is_selected(libraries: Path) -> None:
    for name in ("libLLVM-15.so.1", "libLLVM-9.so.1", "libLLVM.so.19.1", "libLLVM.so.18.1"):
        (libraries / name).touch()
    (libraries / "libLLVM-19.so").symlink_to("libLLVM.so.19.1")
    (libraries / "libLLVM-99.so").symlink_to("nowhere")
    assert [major for major, _ in machine.find_llvm()] == [19, 18, 15, 9]
    chosen = machine.select_llvm()
    assert chosen is not None
    assert os.path.realpath(chosen) == str(libraries / "libLLVM.so.19.1")
    assert os.environ[machine.LLVM_VARIABLE] == chosen


def test_an_old_llvm_is_not_selected_but_named(libraries: Path) -> None:
    (libraries / "libLLVM-15.so.1").touch()
    assert machine.select_llvm() is None
    assert machine.LLVM_VARIABLE not in os.environ
    problem = machine._llvm_problem(None, None)
    assert problem is not None
    assert "only LLVM 15, which is too old" in problem


def test_the_choice_of_the_user_is_respected(
    libraries: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (libraries / "libLLVM.so.19.1").touch()
    monkeypatch.setenv(machine.LLVM_VARIABLE, "mine.so")
    assert machine.select_llvm() is None
    assert os.environ[machine.LLVM_VARIABLE] == "mine.so"


@pytest.mark.parametrize(
    ("path", "version", "words"),
    [
        (None, None, "no LLVM library"),
        ("/nowhere/libLLVM.so", None, "'/nowhere/libLLVM.so', which does not exist"),
        (__file__, None, "which Dr.Jit cannot load"),
        ("lib15.so", (15, 0, 6), "LLVM is version 15.0.6 (DRJIT_LIBLLVM_PATH is 'lib15.so')"),
    ],
)
def test_a_problem_says_what_is_wrong_and_what_to_do(
    libraries: Path, path: str | None, version: tuple[int, int, int] | None, words: str
) -> None:
    problem = machine._llvm_problem(path, version)
    assert problem is not None
    assert words in problem
    assert "LLVM 17 or newer" in problem
    assert "let DRJIT_LIBLLVM_PATH point to" in problem
    assert "\n" not in problem


def test_this_machine_renders() -> None:
    report = machine.inspect()
    assert report.problem is None
    assert "llvm_ad_rgb" in report.variants
    assert report.llvm_version is not None
    assert report.llvm_version[0] >= machine.OLDEST_LLVM
    assert report.gpu == any(v.startswith("cuda") for v in report.variants)
    assert machine.check_variant(None) == ("cuda_ad_rgb" if report.gpu else "llvm_ad_rgb")
    assert machine.check_variant("llvm_ad_mono") == "llvm_ad_mono"


@pytest.mark.parametrize(
    ("name", "what"),
    [
        ("scalar_rgb", "is not supported"),
        ("llvm_ad_mono_polarized", "is not supported"),
        ("llvm_rgb", "is unknown"),
        ("", "is unknown"),
    ],
)
def test_other_variants_are_refused_with_those_that_work(name: str, what: str) -> None:
    with pytest.raises(machine.MachineError) as error:
        machine.check_variant(name)
    usable = [v for v in mi.variants() if not v.startswith("scalar") and "polarized" not in v]
    assert str(error.value) == f"variant {name!r} {what}: it must be one of {', '.join(usable)}"


def test_a_variant_that_does_not_work_here_is_refused_with_the_reason(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    report = machine.Report((), False, None, None, "there is no LLVM")
    monkeypatch.setattr(machine, "inspect", lambda: report)
    with pytest.raises(machine.MachineError, match="there is no LLVM"):
        machine.check_variant(None)
    with pytest.raises(machine.MachineError, match="'cuda_ad_rgb' needs an NVIDIA GPU"):
        machine.check_variant("cuda_ad_rgb")


METAL = ["scalar_rgb", "llvm_ad_rgb", "metal_ad_rgb", "metal_ad_rgb_polarized", "metal_spectral"]


@pytest.mark.parametrize(
    ("llvm", "metal", "variants", "default"),
    [
        (True, True, ("llvm_ad_rgb", "metal_ad_rgb", "metal_spectral"), "llvm_ad_rgb"),
        (False, True, ("metal_ad_rgb", "metal_spectral"), "metal_ad_rgb"),
        (True, False, ("llvm_ad_rgb",), "llvm_ad_rgb"),
        (False, False, (), "llvm_ad_rgb"),
    ],
)
def test_variants_of_metal(
    monkeypatch: pytest.MonkeyPatch,
    llvm: bool,
    metal: bool,
    variants: tuple[str, ...],
    default: str,
) -> None:
    """With stand-ins: a Mac has not been tried."""
    present = {dr.JitBackend.Metal: metal, dr.JitBackend.CUDA: False}
    monkeypatch.setattr(dr, "has_backend", present.get)
    monkeypatch.setattr(machine, "_llvm", lambda: (None, (19, 0, 0) if llvm else None))
    monkeypatch.setattr(mi, "variants", lambda: METAL)
    report = machine.inspect()
    assert report.variants == variants
    assert not report.gpu  # of NVIDIA
    assert machine.choose_variant(report.gpu, report.variants) == default
    if variants:
        assert machine.check_variant(None) == default
    else:
        with pytest.raises(machine.MachineError, match=r"this machine has .*LLVM"):
            machine.check_variant(None)
    if metal:
        assert machine.check_variant("metal_spectral") == "metal_spectral"
    else:
        words = "'metal_ad_rgb' needs macOS and a GPU with Metal, which are not found: .* here are"
        with pytest.raises(machine.MachineError, match=words):
            machine.check_variant("metal_ad_rgb")
    with pytest.raises(machine.MachineError, match="polarized' is not supported: it must be one"):
        machine.check_variant("metal_ad_rgb_polarized")


def test_a_missing_library_of_drjit_is_named(tmp_path: Path) -> None:
    """Dr.Jit as its wheel behaves without libatomic: its error handler fails in turn."""
    (tmp_path / "drjit.py").write_text(
        "try:\n"
        "    raise ImportError('libatomic.so.1: cannot open shared object file')\n"
        "except ImportError:\n"
        "    _drjit_ext\n"
    )
    script = (
        "import sys, importlib.util as u\n"
        f"spec = u.spec_from_file_location('machine', {machine.__file__!r})\n"
        "sys.modules['machine'] = m = u.module_from_spec(spec); spec.loader.exec_module(m)\n"
        "try: m.load_drjit()\n"
        "except ImportError as error: print(error)\n"
    )
    result = subprocess.run(
        [sys.executable, "-c", script],
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert "libatomic.so.1: cannot open" in result.stdout
    assert "apt-get install libatomic1" in result.stdout
