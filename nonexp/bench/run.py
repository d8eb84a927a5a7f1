"""A whole run: the cases one after the other, and the files of the results."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..system.files import write_text
from . import measure, references, report, results
from .competitors import BASELINES, competing
from .results import CaseResult, Results
from .scenes import Case, checkout

__all__ = ["run", "write"]


def run(
    cases: list[Case],
    folder: Path,
    *,
    quick: bool = False,
    variant: str = "llvm_ad_rgb",
    seed: int = 0,
    on_pass: Callable[[str], Any] = lambda text: None,
) -> Results:
    """Measure all cases that have their files and a reference; the others are listed as skipped.

    ``folder`` holds the references. Raises ``ValueError`` if nothing can be measured.
    """
    budget = measure.QUICK if quick else measure.FULL
    done = Results([], results.environment(variant, seed, quick))
    with measure.empty_kernel_cache():
        for case in cases:
            if case.scene.file and checkout() is None:
                done.skipped.append(f"{case.name} needs scenes/{case.scene.file} of a source tree")
                continue
            try:
                reference = references.load(case, folder)
            except FileNotFoundError as error:
                done.skipped.append(str(error))
                continue
            competitors = competing(case, quick)
            rows = measure.run_case(
                case, competitors, reference, budget, variant=variant, seed=seed, on_pass=on_pass
            )
            names = [row.name for row in rows if row.error is None]
            baseline = next((name for name in BASELINES if name in names), None)
            done.cases.append(
                CaseResult(
                    case.name,
                    case.scene.text,
                    case.scene.size,
                    reference.origin,
                    references.relative_stderr(reference),
                    baseline,
                    rows,
                )
            )
    if not done.cases:
        raise ValueError(f"nothing to measure: {'; '.join(done.skipped)}")
    return done


def write(done: Results, folder: Path) -> list[Path]:
    """Write ``results.json``, ``results.md`` and, with matplotlib, the plots.

    Every file is replaced only when its successor is complete. Returns the written paths.
    """
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for name, text in (("results.json", done.to_json()), ("results.md", report.markdown(done))):
        written.append(write_text(folder / name, text))
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        return written
    plots = {
        "main.png": report.main_plot,
        "error.png": report.error_plot,
        "efficiency.png": report.efficiency_plot,
    }
    for name, plot in plots.items():
        if plot(done, folder / name):
            written.append(folder / name)
    return written
