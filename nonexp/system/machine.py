"""What this machine can render with: the LLVM library, the GPU, the Mitsuba variants.

:func:`select_llvm` needs neither Dr.Jit nor Mitsuba; it must run before Dr.Jit looks for LLVM.
"""

from __future__ import annotations

import glob
import os
import platform
import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

__all__ = [
    "LLVM_VARIABLE",
    "MachineError",
    "Report",
    "array_types",
    "check_variant",
    "choose_variant",
    "find_llvm",
    "inspect",
    "llvm_problem",
    "load_drjit",
    "select_llvm",
    "supported",
    "unsupported_reason",
]

LLVM_VARIABLE = "DRJIT_LIBLLVM_PATH"
"""Environment variable from which Dr.Jit takes the path of the LLVM library."""

OLDEST_LLVM = 17
"""Oldest usable major version: with 15 and 16 Dr.Jit aborts the process in its first kernel."""

# What a backend of Dr.Jit needs beside the LLVM library, on which there is more to say.
_NEEDS = {
    "llvm": None,
    "cuda": "an NVIDIA GPU and its driver",
    "metal": "macOS and a GPU with Metal",
}

_INSTALL = {
    "Linux": "apt-get install libllvm19",
    "Darwin": "brew install llvm",
    "Windows": "winget install LLVM.LLVM",
}
_GLOBS = {
    "Linux": (
        "/usr/lib/*-linux-gnu/libLLVM*.so*",
        "/usr/lib/llvm-*/lib/libLLVM*.so*",
        "/usr/lib64/libLLVM*.so*",
        "/usr/lib64/llvm*/lib*/libLLVM*.so*",
        "/usr/lib/libLLVM*.so*",
        "/usr/local/lib/libLLVM*.so*",
    ),
    "Darwin": (
        "/opt/homebrew/opt/llvm*/lib/libLLVM*.dylib",
        "/opt/homebrew/Cellar/llvm*/*/lib/libLLVM*.dylib",
        "/usr/local/opt/llvm*/lib/libLLVM*.dylib",
        "/usr/local/Cellar/llvm*/*/lib/libLLVM*.dylib",
    ),
}
_ENVIRONMENT_GLOBS = ("lib/libLLVM*.so*", "lib/libLLVM*.dylib")

# libLLVM-19.so.1, libLLVM.so.19.1, libLLVM-14.0.6.so.1, libLLVM.19.dylib, .../llvm-19/lib/...
_FILE_VERSION = re.compile(
    r"^libLLVM-(?P<dash>\d+)[^/]*\.(?:so|dylib)"
    r"|^libLLVM\.so\.(?P<so>\d+)"
    r"|^libLLVM\.(?P<dylib>\d+)[^/]*\.dylib"
)
_FOLDER_VERSION = re.compile(r"/llvm(?:-|@|/)?(\d+)")


class MachineError(RuntimeError):
    """This machine, or the variant asked for, cannot render; the message says what to do."""


@dataclass(frozen=True)
class Report:
    """What :func:`inspect` found.

    ``variants`` are the supported variants of this Mitsuba that work here; ``gpu`` says whether
    Dr.Jit can use an NVIDIA GPU; ``llvm_path`` and ``llvm_version`` what its LLVM backend uses,
    None where it has none; ``problem`` is the sentence that says why the LLVM backend does not
    work, or None.
    """

    variants: tuple[str, ...]
    gpu: bool
    llvm_path: str | None
    llvm_version: tuple[int, int, int] | None
    problem: str | None


# --------------------------------------------------------------------- finding LLVM


def find_llvm() -> list[tuple[int, str]]:
    """LLVM libraries of this machine as (major version, path), newest first; 0 for unknown."""
    patterns = list(_GLOBS.get(platform.system(), ()))
    for root in (sys.prefix, os.environ.get("CONDA_PREFIX")):
        if root and os.path.realpath(root) != "/usr":
            patterns += [os.path.join(glob.escape(root), tail) for tail in _ENVIRONMENT_GLOBS]
    found: dict[str, tuple[int, str]] = {}
    for pattern in patterns:
        for path in sorted(glob.glob(pattern)):
            if os.path.isfile(path):
                found.setdefault(os.path.realpath(path), (_major(path), path))
    return sorted(found.values(), key=lambda entry: -entry[0])


def _major(path: str) -> int:
    """Major version in the names of an LLVM library and its folder; 0 if there is none."""
    for name in (path, os.path.realpath(path)):
        match = _FILE_VERSION.search(os.path.basename(name)) or _FOLDER_VERSION.search(name)
        if match:
            return int(next(group for group in match.groups() if group))
    return 0


def select_llvm() -> str | None:
    """Let Dr.Jit use the newest usable LLVM: sets ``DRJIT_LIBLLVM_PATH`` unless it is set.

    Returns the path chosen, or None (with the environment unchanged) if the variable is set already
    or no usable library is found in the usual places.
    """
    if os.environ.get(LLVM_VARIABLE):
        return None
    for major, path in find_llvm():
        if major >= OLDEST_LLVM:
            os.environ[LLVM_VARIABLE] = path
            return path
    return None


def load_drjit() -> None:
    """Import Dr.Jit; raises an ``ImportError`` that says what to install where that fails.

    Its wheels for Linux need libatomic, which a minimal system lacks, and then fail with a
    ``NameError`` of their own.
    """
    try:
        import drjit  # noqa: F401
    except (ImportError, NameError) as error:
        cause = error.__context__ or error
        remedy = "install libatomic1 (apt-get install libatomic1)"
        if "libatomic" not in str(cause):
            remedy = "install nonexp again (pip install --force-reinstall drjit mitsuba)"
        raise ImportError(f"Dr.Jit cannot be loaded ({cause}): {remedy}") from None


# --------------------------------------------------------------------- what works


def inspect() -> Report:
    """Find out what works on this machine, without running a kernel."""
    import drjit as dr

    gpu = bool(dr.has_backend(dr.JitBackend.CUDA))
    path, version = _llvm()
    problem = _llvm_problem(path, version)
    metal = bool(dr.has_backend(dr.JitBackend.Metal))
    works = {"llvm": problem is None, "cuda": gpu, "metal": metal}
    variants = tuple(v for v in _supported() if works[_backend(v)])
    return Report(variants, gpu, path, version, problem)


def llvm_problem() -> str | None:
    """Why Dr.Jit's LLVM backend does not work on this machine, and what to do; None if it does."""
    return _llvm_problem(*_llvm())


def array_types() -> Any:
    """The module of differentiable Dr.Jit arrays (``Float64`` ...) of a backend that works here.

    LLVM where it works, else CUDA; needs no Mitsuba variant. Raises :class:`MachineError` where
    neither works.
    """
    import drjit as dr

    problem = llvm_problem()
    if problem is None:
        import drjit.llvm.ad as arrays
    elif dr.has_backend(dr.JitBackend.CUDA):
        import drjit.cuda.ad as arrays
    else:
        raise MachineError(problem)
    return arrays


def _llvm() -> tuple[str | None, tuple[int, int, int] | None]:
    """Path (where it has been chosen) and version of the LLVM library that Dr.Jit uses."""
    import drjit as dr

    path = os.environ.get(LLVM_VARIABLE) or None
    if not dr.has_backend(dr.JitBackend.LLVM):
        return path, None
    major, minor, patch = dr.detail.llvm_version()
    return path, (major, minor, patch)


def supported(variant: str) -> bool:
    """Whether nonexp's plugins work in this Mitsuba variant."""
    return unsupported_reason(variant) is None


def unsupported_reason(variant: str) -> str | None:
    """Why nonexp's plugins do not work in this variant; None if they do."""
    if variant.startswith("scalar"):
        return "there is no vectorised Python in scalar variants"
    if variant.endswith("polarized"):
        return "polarised light is not supported"
    return None


def _supported() -> list[str]:
    """The variants of this Mitsuba that nonexp supports."""
    import mitsuba as mi

    names: list[str] = mi.variants()
    return [v for v in names if _backend(v) in _NEEDS and supported(v)]


def _backend(variant: str) -> str:
    return variant.partition("_")[0]


def _llvm_problem(path: str | None, version: tuple[int, int, int] | None) -> str | None:
    remedy = (
        f"install LLVM {OLDEST_LLVM} or newer ({_INSTALL.get(platform.system(), 'LLVM')}), "
        f"or let {LLVM_VARIABLE} point to its libLLVM"
    )
    if version is None and path is not None:
        if not os.path.exists(path):
            return f"{LLVM_VARIABLE} is {path!r}, which does not exist: {remedy}"
        return f"{LLVM_VARIABLE} is {path!r}, which Dr.Jit cannot load: {remedy}"
    if version is None:
        old = ", ".join(sorted({str(major) for major, _ in find_llvm() if major}))
        found = f"only LLVM {old}, which is too old" if old else "no LLVM library"
        return f"this machine has {found}: {remedy}"
    if version[0] < OLDEST_LLVM:
        where = f" ({LLVM_VARIABLE} is {path!r})" if path else ""
        number = ".".join(map(str, version))
        return f"LLVM is version {number}{where}, with which Dr.Jit would abort: {remedy}"
    return None


def choose_variant(gpu: bool, variants: Sequence[str] = ()) -> str:
    """The variant to render with if none is asked for: CUDA if there is such a GPU, then LLVM.

    ``variants`` are those that work. Metal, which nonexp has never been tested with, is chosen
    only where LLVM does not work.
    """
    name = "cuda_ad_rgb" if gpu else "llvm_ad_rgb"
    return "metal_ad_rgb" if name not in variants and "metal_ad_rgb" in variants else name


def check_variant(name: str | None) -> str:
    """The variant to set: ``name`` if it works here, by default the fastest one in RGB.

    Raises :class:`MachineError` for an unknown or unsupported variant, and where the LLVM library
    or the GPU that it needs is missing.
    """
    import mitsuba as mi

    report = inspect()
    name = choose_variant(report.gpu, report.variants) if name is None else name
    if name in report.variants:
        return name
    if name not in _supported():
        known = "is not supported" if name in mi.variants() else "is unknown"
        raise MachineError(f"variant {name!r} {known}: it must be one of {', '.join(_supported())}")
    if needs := _NEEDS[_backend(name)]:
        usable = ", ".join(report.variants) or "none; run `nonexp doctor`"
        raise MachineError(
            f"variant {name!r} needs {needs}, which are not found: "
            f"variants that work here are {usable}"
        )
    raise MachineError(report.problem or f"variant {name!r} does not work on this machine")
