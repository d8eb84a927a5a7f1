"""``nonexp info``: what a scene needs."""

from __future__ import annotations

import importlib
from typing import Any

from ..rendering.sampling import SOBOL, own_sampler, sampler_of
from ..system.terminal import show, table
from .arguments import Definitions, Scene, Variant, load, one_sentence

__all__ = ["info"]


def info(scene: Scene, /, *, variant: Variant = None, parameters: Definitions = ()) -> None:
    """Tell what a scene needs, and what its kernel leaves out.

    Shows what the integrator nonexp_volpath finds in a scene, and what it therefore skips.
    """
    loaded = load(scene, variant, parameters)
    report = importlib.import_module("nonexp.integrators.report")
    with one_sentence():
        findings = report.findings(loaded.scene)
    rows = table("in the scene", "found", "in the kernel", lines=True)
    for finding in findings:
        rows.add_row(finding.question, finding.answer, finding.consequence)
    rows.add_row(*_sampler(loaded.scene.sensors()[0]))
    show(rows)
    if not any(name.startswith("nonexp_") for name in loaded.integrators):
        print(f"The scene's own integrator is {', '.join(loaded.integrators) or 'none'}.")


def _sampler(camera: Any) -> tuple[str, str, str]:
    """What stands in the table about the sampler, which the integrator does not know."""
    own, used = own_sampler(camera), sampler_of(camera)
    if used == own:
        points = "Sobol points, continued over passes" if used == SOBOL else "used as it is"
        return "sampler", own, points
    return "sampler", own, f"replaced by {used} (--sampler independent keeps it)"
