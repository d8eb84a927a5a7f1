"""``nonexp check``: whether a transmittance law is right, or an integrator."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import mitsuba as mi

from ..system.machine import check_variant
from ..system.terminal import note, show, table
from ..transmittance.functions import load_module
from .arguments import UserError, Variant, argument, one_sentence

if TYPE_CHECKING:
    from ..testing.laws import Outcome

__all__ = ["check"]


def check(
    *laws: Annotated[str, argument("LAWS")],
    integrator: Annotated[str | None, argument("NAME")] = None,
    medium: Annotated[str, argument("NAME")] = "homogeneous",
    case: Annotated[tuple[str, ...], argument("NAME", str, many=True)] = (),
    skip_renders: bool = False,
    variant: Variant = None,
) -> int:
    """Check laws of your own, or an integrator.

    LAWS are files (my_laws.py), modules, single laws (my_laws.py:MyLaw, my_module:MyLaw) or models
    by name. Each law is checked on its examples: relations between its functions, derivatives,
    single precision over 16 decades, samplers, and renders of known answers. With --integrator
    LAWS are files that register the integrator, which is compared with Mitsuba's volpath in
    exponential media. The exit code is 0 if nothing is wrong, and 1 if something is.

    Args:
        laws: files, modules, laws or models
        integrator: check this integrator instead of laws
        medium: the medium that the integrator renders (default: homogeneous)
        case: of an integrator's checks only this one, such as null-constant; may be repeated
        skip_renders: without the renders, which take half of the time
    """
    with one_sentence():
        mi.set_variant(check_variant(variant))
        mi.set_log_level(mi.LogLevel.Error)
    if integrator is not None:
        return _integrator(integrator, medium, laws, case)
    if not laws:
        raise UserError("LAWS is missing: name a file of laws, a law, or a model")
    return _laws(laws, not skip_renders)


def _laws(names: tuple[str, ...], rendered: bool) -> int:
    from ..testing.laws import CHECKS, RENDERED, find_laws, law_checks

    with one_sentence():
        found = [checks for name in names for law in find_laws(name) for checks in law_checks(law)]
    chosen = [one for one in CHECKS if rendered or one.stage < RENDERED]
    faults = 0
    for checks in found:
        rows = table(checks.name, "verdict", "what it finds")
        outcomes = list(checks.outcomes(chosen))
        for outcome in outcomes:
            rows.add_row(outcome.check.name, _verdict(outcome), outcome.check.finds)
        show(rows)
        for outcome in outcomes:
            if outcome.fault:
                faults += 1
                print(f"{outcome.check.name}: {outcome.fault}")
        print()
    count = f"{len(found)} law{'s' * (len(found) != 1)}"
    print(
        f"{count}: {faults} fault{'s' * (faults > 1)}" if faults else f"{count}: nothing is wrong"
    )
    return 1 if faults else 0


def _verdict(outcome: Outcome) -> str:
    if outcome.skipped is not None:
        return "not run"
    return "passed" if outcome.passed else "WRONG"


def _integrator(name: str, medium: str, files: tuple[str, ...], cases: tuple[str, ...]) -> int:
    from ..testing.exponential import MATRIX, verdicts

    rows = table(f"{name} against volpath", "verdict", "finds a bias of", "difference")
    faults = []
    with one_sentence():
        for file in files:
            path = Path(file)
            module = path.stem if path.suffix == ".py" else file
            load_module("file", module, [str(path.resolve().parent)])
        chosen = cases or MATRIX
        for place, verdict in enumerate(verdicts(name, medium=medium, cases=chosen)):
            note(f"{place + 1} of {len(chosen)}: {verdict.case}")
            said = "" if verdict.agreement is None else f"{verdict.agreement.difference:+.2%}"
            verdict_text = "passed" if verdict.fault is None else "WRONG"
            rows.add_row(verdict.case, verdict_text, f"{verdict.within:.1%}", said)
            if verdict.fault is not None:
                faults.append(f"{verdict.case}: {verdict.fault}")
    show(rows)
    for fault in faults:
        print(fault)
    return 1 if faults else 0
