"""``nonexp validate``: published numbers beside ours."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import mitsuba as mi
from cyclopts import Group, Parameter

from ..rendering.targets import fraction
from ..system.machine import check_variant
from ..system.terminal import note, show, table
from .arguments import UserError, Variant, argument, one_sentence, only_one

__all__ = ["validate"]

HOW = Group("How precisely, one of", validator=only_one)


def validate(
    *studies: Annotated[str, argument("STUDY")],
    quick: Annotated[bool, Parameter(group=HOW)] = False,
    error: Annotated[float | None, argument("E", fraction, group=HOW)] = None,
    list_: Annotated[bool, Parameter("--list")] = False,
    out: Annotated[Path | None, argument("DIR")] = None,
    variant: Variant = None,
) -> int:
    """Compare published numbers with ours.

    Computes what others have published, or independent programs compute, and prints both with
    their errors: slabs of exponential media and of binary Markov mixtures, collisions around a
    particle, power laws of transmission. A full run takes 10 minutes on 2 idle cores. The exit
    code is 0 if all agree, and 1 if a number deviates by more than one of so many does by chance
    in 1 of 1000 runs.

    Args:
        studies: only these studies (default: all)
        quick: a minute: fewer numbers, less precise
        error: standard error of each result, as in 0.1% (default: 0.2%; takes 4 times as long for
            half of it)
        list_: list the studies and their sources, and end
        out: folder for validation.md and images/validation.png
    """
    from ..validation import report, run
    from ..validation.study import FULL, QUICK, Effort

    for study in studies:
        if study not in run.STUDIES:
            raise UserError(f"STUDY is {study!r}: it must be one of {', '.join(run.STUDIES)}")
    chosen = studies or run.STUDIES
    if list_:
        rows = table("study", "what", "source", lines=True)
        for study in chosen:
            rows.add_row(study, *run.titles(study))
        show(rows)
        return 0
    with one_sentence():
        mi.set_variant(check_variant(variant))
        mi.set_log_level(mi.LogLevel.Error)
        if out is not None:
            out.mkdir(parents=True, exist_ok=True)
        effort = QUICK if quick else FULL if error is None else Effort.to(error)
        found = {}
        for study in chosen:
            note(run.titles(study)[0])
            found[study] = list(run.measure(study, effort))
    total = sum(map(len, found.values()))
    deviating = 0
    for study, measured in found.items():
        print("{}: {}".format(*run.titles(study)))
        rows = table("quantity", "published", "ours", "difference", "", numbers=True)
        for row in measured:
            rows.add_row(*report.cells(row, total))
            deviating += not run.agrees(row, total)
        show(rows)
        print(f"{report.sentence(measured)}\n")
    agree = "all agree" if not deviating else f"{deviating} deviate"
    counted = f"{total} number{'s' * (total != 1)}"
    print(f"{counted}: {agree} (limit {run.limit(total):.1f} standard errors)")
    if out is not None:
        with one_sentence():
            for path in report.write(found, out):
                print(path)
    return 1 if deviating else 0
