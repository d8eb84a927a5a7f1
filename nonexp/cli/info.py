"""``nonexp info``: what a scene needs."""

from __future__ import annotations

import argparse
import importlib
from typing import Any

from ..system.terminal import stdout, table
from .arguments import add_scene, load, one_sentence

__all__ = ["add"]


def add(commands: Any) -> None:
    """Add the command to those of the parser."""
    info = commands.add_parser(
        "info",
        help="tell what a scene needs, and what its kernel leaves out",
        description="Show what the integrator nonexp_volpath finds in a scene, and what it "
        "therefore skips.",
    )
    add_scene(info)
    info.set_defaults(run=_info)


def _info(options: argparse.Namespace) -> int:
    from rich.text import Text

    loaded = load(options)
    report = importlib.import_module("nonexp.integrators.report")
    with one_sentence():
        findings = report.findings(loaded.scene)
    console = stdout()
    rows = table(console, "in the scene", "found", "in the kernel", lines=True)
    for finding in findings:
        row = (finding.question, finding.answer, finding.consequence)
        rows.add_row(*(Text(cell) for cell in row))
    console.print(rows)
    if not any(name.startswith("nonexp_") for name in loaded.integrators):
        print(f"The scene's own integrator is {', '.join(loaded.integrators) or 'none'}.")
    return 0
