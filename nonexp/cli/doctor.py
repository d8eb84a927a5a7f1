"""``nonexp doctor``: whether this machine can render."""

from __future__ import annotations

import platform
from importlib import metadata

from ..system import machine
from ..system.version import __version__

__all__ = ["doctor"]


def doctor() -> int:
    """Check whether this machine can render, and say what to do if it cannot."""
    report = machine.inspect()
    versions = ", ".join(f"{name} {metadata.version(name)}" for name in ("mitsuba", "drjit"))
    llvm = ".".join(map(str, report.llvm_version)) if report.llvm_version else "none"
    rows = {
        "python": f"{platform.python_version()} on {platform.system()} {platform.machine()}",
        "packages": f"nonexp {__version__}, {versions}",
        "LLVM": f"{llvm} ({report.llvm_path})" if report.llvm_path else llvm,
        "GPU": "usable" if report.gpu else "none (an NVIDIA GPU would be used)",
        "variants": ", ".join(report.variants) or "none",
    }
    for name, value in rows.items():
        print(f"{name:9} {value}")
    if report.problem:
        print(f"problem   {report.problem}")
    if not report.variants:
        print("This machine cannot render.")
        return 2
    variant = machine.choose_variant(report.gpu, report.variants)
    print(f"This machine can render, by default with {variant}.")
    return 0
