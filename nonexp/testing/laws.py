"""Everything that is asked of a transmittance law, as one call or check by check."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from ..models import registry
from ..transmittance import Transmittance
from ..transmittance.functions import load_function, load_module
from ..transmittance.kinds import parameters_of
from . import precision, relations, renders, samplers
from .faults import Fault

__all__ = [
    "CHECKS",
    "RENDERED",
    "Check",
    "LawChecks",
    "Outcome",
    "check_law",
    "find_laws",
    "law_checks",
]

Law = Transmittance | type[Transmittance]


@dataclass(frozen=True)
class Check:
    """One thing that is asked of a law."""

    name: str
    """the kind of fault"""
    finds: str
    """what it finds"""
    run: Callable[[Transmittance], Any]
    """raises :class:`.Fault` where the law does not pass"""
    stage: int = 1
    """checks presuppose those of the stages before"""


RENDERED = 3
"""Stage of the checks that render."""

_SAMPLER = "probabilities off by 0.35 %, means by 0.6 % of the spread (2^20 flights)"

CHECKS = (
    Check(
        "floats and arrays",
        "what fails on an array, or loses its precision there",
        relations.computes_with_arrays,
        0,
    ),
    Check(
        "ff falls and is convex",
        "any value outside [0, 1], any rise or bend of 400 points",
        relations.falls_and_is_convex,
    ),
    Check(
        "pf is -ff'/sigma_bar",
        "pf for ff, wrong sigma_bar or normalisation: relative 1e-9",
        relations.fp_is_minus_the_slope_of_ff,
    ),
    Check(
        "reciprocity", "fp other than sigma_bar pf (1e-12), pf(0), sigma_bar", relations.reciprocity
    ),
    Check("pp is -pf'", "relative 1e-9 at 140 depths", relations.pp_is_minus_the_slope_of_pf),
    Check("declared jumps", "jumps of pp other than declared: 1e-6", relations.declared_jumps),
    Check(
        "densities integrate to 1",
        "missing atoms and kinks, wrong normalisation: 1e-8",
        relations.integrals,
    ),
    Check("renewal", "sigma_bar int pf other than 1 - ff: 1e-9", relations.renewal),
    Check(
        "floats and arrays agree",
        "relative 1e-12 in float64, 3e-5 in float32",
        relations.floats_and_arrays,
    ),
    Check(
        "finite up to infinity",
        "NaN, infinite and negative values in float32",
        relations.nothing_but_numbers,
    ),
    Check(
        "derivatives by parameters",
        "relative 1e-6 against differences",
        relations.derivatives_by_parameters,
    ),
    Check(
        "single precision",
        "relative 1e-5 (1 + |ln value|) from depth 1e-8 to 1e8",
        precision.values,
    ),
    Check(
        "derivatives in single precision",
        "relative 1e-3 from depth 1e-8 to 1e8, of laws without jumps",
        precision.slopes,
    ),
    Check("derivatives far away", "NaN at depth 1e20, of laws without jumps", precision.far_slopes),
    Check("sampler of ff", _SAMPLER, partial(samplers.sampler, origin="f"), 2),
    Check("sampler of pf", _SAMPLER, partial(samplers.sampler, origin="p"), 2),
    Check(
        "rendered transmittance",
        "0.6 % of all rays (2^18 rays)",
        renders.share_that_crosses,
        3,
    ),
    Check("rendered single scattering", "2 % of the radiance", renders.scattered_once, 3),
    Check(
        "white furnace",
        "any path other than 1",
        renders.white_furnace_without_connections,
        3,
    ),
    Check("white furnace with connections", "5 % of the radiance", renders.white_furnace, 3),
    Check("reciprocity of lamp and detector", "15 % of the flux", renders.reciprocal, 3),
)
"""All of them, in the order in which they run."""


@dataclass(frozen=True)
class Outcome:
    """What a check said of a law."""

    law: str
    """the law with its parameters"""
    check: Check
    fault: str | None = None
    """what is wrong; None: nothing"""
    skipped: str | None = None
    """why it did not run; None: it did"""

    @property
    def passed(self) -> bool:
        """It ran, and found nothing."""
        return self.fault is None and self.skipped is None


class LawChecks:
    """The checks of one law; each runs once, when its outcome is asked for."""

    def __init__(self, law: Transmittance) -> None:
        self.law = law
        self.name = _shown(self.law)
        self._known: dict[str, Outcome] = {}

    def outcome(self, check: Check) -> Outcome:
        """What a check says; it is skipped where one of an earlier stage has found a fault."""
        if check.name not in self._known:
            self._known[check.name] = self._run(check)
        return self._known[check.name]

    def _run(self, check: Check) -> Outcome:
        for earlier in CHECKS:
            if earlier.stage < check.stage and (fault := self.outcome(earlier).fault):
                return Outcome(self.name, check, skipped=f"{earlier.name}: {fault}")
        try:
            check.run(self.law)
        except Fault as fault:
            return Outcome(self.name, check, str(fault).removeprefix(f"{check.name}: "))
        except Exception as error:  # of the law's own code
            said = " ".join(str(error).split())
            return Outcome(self.name, check, f"it fails with {type(error).__name__}: {said}")
        return Outcome(self.name, check)

    def outcomes(self, checks: Iterable[Check] = CHECKS) -> Iterator[Outcome]:
        """All outcomes, one after the other."""
        return map(self.outcome, checks)


def law_checks(law: Law) -> list[LawChecks]:
    """The checks of a law; of a class, those of each of its ``examples``."""
    if not isinstance(law, type):
        return [LawChecks(law)]
    if not issubclass(law, Transmittance) or inspect.isabstract(law):
        raise ValueError(f"law is {law!r}: it must be a subclass of nonexp.Transmittance")
    return [LawChecks(law(**_fields(law, given))) for given in law.examples]


def check_law(law: Law, *, rendered: bool = True) -> list[Outcome]:
    """Check a law: the relations between its functions, its samplers, precision and renders.

    ``law`` is an instance, or a class: then each of its ``examples`` is checked. The class need not
    be registered. Checks are those of ``nonexp check``: derivatives, normalisation, renewal,
    Python floats against arrays, single precision over 16 decades, 2^20 flights of each sampler,
    and, unless ``rendered`` is false, transmittance, single scattering, white furnace and
    reciprocity through ``nonexp_volpath``, in the variant that is set. Returns what each said, and
    with it which error it would have found.

    Raises ``AssertionError`` that names the kind of each fault, ``ValueError`` for what is no law.

    >>> import nonexp
    >>> from nonexp.testing import check_law
    >>> len(check_law(nonexp.models.create("gamma", alpha=0.5), rendered=False))
    16
    """
    chosen = [check for check in CHECKS if rendered or check.stage < RENDERED]
    found = [outcome for checks in law_checks(law) for outcome in checks.outcomes(chosen)]
    faults = [f"{one.law}: {one.check.name}: {one.fault}" for one in found if one.fault]
    if faults:
        raise Fault("\n".join(faults))
    return found


def find_laws(name: str, folders: Sequence[str | Path] = (".",)) -> list[type[Transmittance]]:
    """The laws that a text names: a model's key, ``module:Class``, ``module``, or a file of them.

    Of a module or file all laws that are defined there. Modules are looked for in ``folders``
    first. Raises ``ValueError``.
    """
    if name in registry:
        return [registry[name]]
    places, module = [str(folder) for folder in folders], name
    if name.partition(":")[0].endswith(".py"):
        file, colon, cls = name.partition(":")
        if not Path(file).is_file():
            raise ValueError(f"law is {name!r}: there is no file {file}")
        places.insert(0, str(Path(file).resolve().parent))
        module = f"{Path(file).stem}{colon}{cls}"
    if ":" in module:
        laws: list[Any] = [load_function("law", module, places)]
    else:
        held = load_module("law", module, places)
        values = list(vars(held).values())
        laws = [value for value in values if _is_law(value) and value.__module__ == held.__name__]
        if not laws:
            raise ValueError(f"law is {name!r}: there is no class of nonexp.Transmittance in it")
    for law in laws:
        if not _is_law(law):
            raise ValueError(f"law is {name!r}: it must be a class of nonexp.Transmittance")
        try:
            law(**_fields(law, law.examples[0] if law.examples else {}))
        except (TypeError, ValueError, KeyError) as error:
            raise ValueError(
                f"law {law.__name__} cannot be made of its examples, by default without "
                f"parameters: {error}"
            ) from error
    return laws


def _is_law(value: Any) -> bool:
    return (
        isinstance(value, type)
        and issubclass(value, Transmittance)
        and not inspect.isabstract(value)
    )


def _fields(law: type[Transmittance], given: dict[str, Any]) -> dict[str, Any]:
    """Parameters, which have the names of scenes, by the names of fields."""
    fields = parameters_of(law)
    return {fields[name].name: value for name, value in given.items()}


def _shown(law: Transmittance) -> str:
    text = repr(law)
    return text if len(text) <= 60 else f"{text[:57]}..."
