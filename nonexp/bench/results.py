"""The file of results (JSON with all figures), and changes between two of them."""

from __future__ import annotations

import datetime
import json
import math
import os
import platform
import statistics
import subprocess
from dataclasses import asdict, dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any

from ..system.version import __version__
from .statistics import Bias, Estimate, Figures, Point

__all__ = [
    "SCHEMA",
    "CaseResult",
    "Change",
    "Results",
    "Row",
    "changes",
    "environment",
    "machine_factor",
]

SCHEMA = 1
"""Version of the file's layout."""


@dataclass
class Row:
    """A competitor in a case.

    ``operations`` is the number of operations of its largest kernel. ``compile_seconds`` is the
    time of the first image of one sample per pixel minus that of the second; with
    ``compile_cached`` the largest kernel came from the cache, because an earlier competitor had the
    same. ``memory`` is the peak number of bytes that Dr.Jit allocated in addition to the scene.
    ``error`` says why there are no figures.
    """

    name: str
    plugin: str
    properties: dict[str, Any]
    medium: dict[str, Any] | None
    spp: int
    passes: int = 0
    figures: Figures | None = None
    operations: int = 0
    compile_seconds: float = 0.0
    compile_cached: bool = False
    memory: int = 0
    error: str | None = None


@dataclass
class CaseResult:
    """All competitors in a case, and the origin of its reference."""

    name: str
    text: str
    size: tuple[int, int]
    reference: str
    reference_stderr: float
    baseline: str | None
    rows: list[Row]

    def row(self, name: str) -> Row | None:
        """The row of a competitor."""
        return next((row for row in self.rows if row.name == name), None)

    def relative(self, row: Row) -> Estimate | None:
        """Efficiency relative to that of the baseline; the interval includes the noise of both."""
        base = self.row(self.baseline or "")
        if base is None or base.figures is None or row.figures is None:
            return None
        if row is base:
            return Estimate(1.0, 1.0, 1.0)
        return _ratio(row.figures.efficiency, base.figures.efficiency)


@dataclass
class Results:
    """A run of the benchmark."""

    cases: list[CaseResult]
    environment: dict[str, Any]
    skipped: list[str] = field(default_factory=list)
    schema: int = SCHEMA

    def to_json(self) -> str:
        """The text of the file."""
        return json.dumps(asdict(self), indent=1)

    @staticmethod
    def from_json(text: str, where: str = "the file") -> Results:
        """Results from the text of a file. Raises ``ValueError`` for any other text or schema."""
        try:
            data = json.loads(text)
            schema = data["schema"]
            if schema == SCHEMA:
                return Results(
                    [_case(case) for case in data["cases"]], data["environment"], data["skipped"]
                )
        except (ValueError, TypeError, KeyError) as error:
            raise ValueError(f"{where} does not hold results of nonexp bench ({error})") from error
        raise ValueError(f"{where} has schema {schema}: this version reads schema {SCHEMA}")

    @staticmethod
    def read(path: Path) -> Results:
        """Results from a file. Raises ``OSError`` or ``ValueError``."""
        return Results.from_json(path.read_text(encoding="utf-8"), str(path))


def _case(data: dict[str, Any]) -> CaseResult:
    rows = [Row(**{**row, "figures": _figures(row["figures"])}) for row in data["rows"]]
    return CaseResult(**{**data, "rows": rows, "size": tuple(data["size"])})


def _figures(data: dict[str, Any] | None) -> Figures | None:
    if data is None:
        return None
    first, median, third = data["seconds"]
    return Figures(
        seconds=(first, median, third),
        variance=data["variance"],
        curve=[Point(**point) for point in data["curve"]],
        bias=Bias(**data["bias"]),
        slope=Estimate(**data["slope"]),
        efficiency=Estimate(**data["efficiency"]),
    )


# --------------------------------------------------------------------- where it ran


def environment(variant: str, seed: int, quick: bool) -> dict[str, Any]:
    """Machine, versions and commit."""
    import drjit as dr

    packages = ("mitsuba", "drjit", "numpy", "scipy")
    llvm = dr.detail.llvm_version() if variant.startswith("llvm") else ()
    return {
        "date": datetime.datetime.now(datetime.timezone.utc).isoformat(timespec="seconds"),
        "processor": _processor(),
        "cores": os.cpu_count(),
        "threads": dr.thread_count(),
        "load": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        "system": platform.platform(),
        "python": platform.python_version(),
        "nonexp": __version__,
        "commit": _commit(),
        **{name: metadata.version(name) for name in packages},
        "llvm": ".".join(map(str, llvm)),
        "variant": variant,
        "seed": seed,
        "quick": quick,
    }


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def _commit() -> str:
    """Commit of the source tree that this file belongs to; empty without one."""
    here = Path(__file__).resolve().parents[2]
    if not (here / ".git").exists():
        return ""
    try:
        told = [
            subprocess.run(["git", *words], cwd=here, capture_output=True, text=True, timeout=20)
            for words in (("rev-parse", "--short=12", "HEAD"), ("status", "--porcelain", "-uno"))
        ]
    except (OSError, subprocess.SubprocessError):
        return ""
    if any(done.returncode for done in told):
        return ""
    return told[0].stdout.strip() + ("+changes" if told[1].stdout.strip() else "")


# --------------------------------------------------------------------- comparison


@dataclass(frozen=True)
class Change:
    """A figure that differs between two results, beyond the noise: new/old with its interval."""

    case: str
    competitor: str
    what: str
    old: str
    new: str
    ratio: Estimate | None
    better: bool | None


TOLERANCE = 0.05
"""Times and efficiencies of two runs of the same program may differ by this fraction."""

SIGMAS = 4.0
"""A ratio of two estimates within so many standard errors is noise: with 150 figures, 1 % false
alarms."""


def changes(old: Results, new: Results) -> list[Change]:
    """What changed from ``old`` to ``new`` for every competitor that both have.

    Times and efficiencies differ if their ratio deviates from 1 by more than four standard errors
    and by more than 5 %, relative to that of Mitsuba's integrator in the same case (or, if none
    competes, to that of all cases, with its spread): a faster machine changes nothing. Kernel sizes
    and memory differ if they change by more than 2 %, biases if one appears or disappears.
    """
    found = []
    speed = machine_factor(old, new)
    for after in new.cases:
        before = next((case for case in old.cases if case.name == after.name), None)
        if before is None:
            continue
        for row in after.rows:
            was = before.row(row.name)
            if was is not None:
                found += _row_changes(before, after, was, row, speed)
    return found


def machine_factor(old: Results, new: Results) -> Estimate:
    """How much longer Mitsuba's own integrators take in ``new``: the median over cases.

    The interval is that of a single case, from the spread over cases. The factor is 1 if Mitsuba's
    integrators compete in no case.
    """
    logs = []
    for after in new.cases:
        before = next((case for case in old.cases if case.name == after.name), None)
        pair = _stock_baselines(before, after) if before else None
        if pair is not None:
            was, now = (_estimate(row, "seconds").value for row in pair)
            logs.append(math.log(now / was))
    middle = statistics.median(logs) if logs else 0.0
    spread = 1.96 * statistics.stdev(logs) if len(logs) > 1 else 0.0
    return Estimate(math.exp(middle), math.exp(middle - spread), math.exp(middle + spread))


def _stock_baselines(before: CaseResult, after: CaseResult) -> tuple[Row, Row] | None:
    """The baseline's rows in both results, if it is one of Mitsuba's integrators."""
    was, row = before.row(after.baseline or ""), after.row(after.baseline or "")
    if was is None or row is None or row.medium is None:
        return None
    return (was, row) if was.figures is not None and row.figures is not None else None


def _row_changes(
    before: CaseResult, after: CaseResult, was: Row, row: Row, speed: Estimate
) -> list[Change]:
    found: list[Change] = []

    def change(
        what: str, a: str, b: str, better: bool | None, ratio: Estimate | None = None
    ) -> None:
        found.append(Change(after.name, row.name, what, a, b, ratio, better))

    if (was.error is None) != (row.error is None):
        change("fails", was.error or "no", row.error or "no", row.error is None)
    if was.figures is None or row.figures is None:
        return found
    if was.figures.bias.found != row.figures.bias.found:
        a, b = (f"{100 * f.bias.mean:+.2f} %" for f in (was.figures, row.figures))
        change("bias", a, b, was.figures.bias.found)
    stock = _stock_baselines(before, after)
    for what, power in (("seconds", -1), ("efficiency", 1)):
        if stock is not None and row.name == after.baseline:
            continue  # all others are relative to it
        ratio = _ratio(_estimate(row, what), _estimate(was, what))
        if stock is not None:
            ratio = _ratio(ratio, _ratio(_estimate(stock[1], what), _estimate(stock[0], what)))
        else:
            inverse = Estimate(1 / speed.value, 1 / speed.high, 1 / speed.low)
            ratio = _ratio(ratio, speed if what == "seconds" else inverse)
        if _beyond_noise(ratio):
            a, b = (f"{_estimate(r, what).value:.4g}" for r in (was, row))
            label = "s per pass" if what == "seconds" else "efficiency"
            change(label, a, b, ratio.value**power > 1, ratio)
    for what in ("operations", "memory"):
        a, b = getattr(was, what), getattr(row, what)
        if abs(b - a) > 0.02 * max(a, b):
            change(what, f"{a}", f"{b}", b < a, Estimate(b / a, b / a, b / a) if a else None)
    return found


def _estimate(row: Row, what: str) -> Estimate:
    """A figure with its interval; for times, that of the median, from their quartiles."""
    assert row.figures is not None
    if what == "efficiency":
        return row.figures.efficiency
    first, median, third = row.figures.seconds
    margin = 1.96 * 1.2533 * (third - first) / 1.349 / math.sqrt(max(row.passes, 1))
    return Estimate(median, max(median - margin, 1e-3 * median), median + margin)


def _ratio(a: Estimate, b: Estimate) -> Estimate:
    """Ratio of independent estimates, whose logarithms are assumed normal."""
    if not all(0 < x < math.inf for e in (a, b) for x in (e.value, e.low, e.high)):
        return Estimate(math.nan, math.nan, math.nan)
    value = a.value / b.value
    margin = math.exp(math.hypot(math.log(a.high / a.low) / 2, math.log(b.high / b.low) / 2))
    return Estimate(value, value / margin, value * margin)


def _beyond_noise(ratio: Estimate) -> bool:
    if not ratio.value > 0:
        return False
    off = abs(math.log(ratio.value))
    error = math.log(ratio.high / ratio.low) / 2 / 1.96
    return off > SIGMAS * error and off > math.log1p(TOLERANCE)
