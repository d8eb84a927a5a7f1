"""``nonexp bench``: run time against error, side by side with Mitsuba's integrators."""

from __future__ import annotations

import argparse
import os
import shlex
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..system.terminal import note, stdout, table
from .arguments import UserError, duration, one_sentence, whole

if TYPE_CHECKING:
    from ..bench.results import Results
    from ..bench.scenes import Case

__all__ = ["add"]


def add(commands: Any) -> None:
    """Add the command to those of the parser."""
    bench = commands.add_parser(
        "bench",
        help="measure run time against error, beside Mitsuba's integrators",
        description="Measure run time against error of nonexp_volpath and of Mitsuba's integrators "
        "on a set of scenes, and write results.json, results.md and plots. A full run takes a "
        "quarter of an hour on 2 idle cores. Exit code 1 says that --compare found something "
        "worse.",
    )
    bench.add_argument("--quick", action="store_true", help="3 minutes: fewer competitors, passes")
    bench.add_argument(
        "--scenes",
        type=_names,
        default=(),
        metavar="A,B",
        help="only these scenes (fog_sphere), or scenes with their law (fog_sphere-gamma)",
    )
    bench.add_argument(
        "--out",
        type=Path,
        default=Path("out/benchmarks"),
        metavar="DIR",
        help="folder for the results (default: out/benchmarks)",
    )
    bench.add_argument("--seed", type=whole(0), default=0, metavar="S", help="default: 0")
    bench.add_argument("--variant", metavar="V", help="Mitsuba variant (default: the fastest)")
    bench.add_argument(
        "--references",
        type=Path,
        metavar="DIR",
        help="folder of the references (default: benchmarks/references of the source tree)",
    )
    what = bench.add_mutually_exclusive_group()
    what.add_argument("--list", action="store_true", help="list scenes and competitors, and end")
    what.add_argument(
        "--compare",
        nargs="+",
        type=Path,
        metavar="JSON",
        help="print what changed beyond the noise: from OLD.json to a run made now, or from "
        "OLD.json to NEW.json",
    )
    what.add_argument(
        "--scaling",
        action="store_true",
        help="measure how time and memory grow with samples, pixels, media, depth, thickness",
    )
    what.add_argument(
        "--rebuild-references", action="store_true", help="render the references anew, and end"
    )
    bench.add_argument(
        "--time",
        type=duration,
        default=300.0,
        metavar="T",
        help="time per reference, as in 10m (default: 5m; the dragon gets three times as much)",
    )
    bench.set_defaults(run=_bench)


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())


def _bench(options: argparse.Namespace) -> int:
    import mitsuba as mi

    from ..bench import references
    from ..bench.scenes import cases
    from ..system import machine

    if options.compare and len(options.compare) > 2:
        raise UserError(f"--compare got {len(options.compare)} files: it takes one or two")
    with one_sentence():
        chosen = cases(options.scenes)
        if options.compare:
            old = _read(options.compare[0])
            if len(options.compare) == 2:
                return _show_changes(old, _read(options.compare[1]))
        mi.set_variant(machine.check_variant(options.variant))
        mi.set_log_level(mi.LogLevel.Error)
        folder = options.references or references.default_folder()
        if options.list:
            return _list(chosen)
        if options.rebuild_references:
            return _rebuild(chosen, folder, options.time)
        _warn_if_busy()
        _check_out(options.out)
        if options.scaling:
            return _scaling(options)
        done = _measure(chosen, folder, options)
        if options.compare:
            return _show_changes(old, done)
    return 0


def _measure(chosen: list[Case], folder: Path, options: argparse.Namespace) -> Results:
    import mitsuba as mi

    from ..bench import report, run

    started = time.perf_counter()
    with _progress() as show:
        done = run.run(
            chosen,
            folder,
            quick=options.quick,
            variant=mi.variant() or "",
            seed=options.seed,
            on_pass=show,
        )
    for text in done.skipped:
        note(f"skipped: {text}")
    print("\n".join(report.summary(done)))
    print()
    for path in run.write(done, options.out):
        print(path)
    note(f"{time.perf_counter() - started:.0f} s")
    return done


def _scaling(options: argparse.Namespace) -> int:
    import mitsuba as mi

    from ..bench import results, scaling

    variant = mi.variant() or ""
    with _progress() as show:
        samples = scaling.run(variant=variant, quick=options.quick, on_sample=show)
    print("\n".join(scaling.sentences(samples)))
    print()
    about = results.environment(variant, options.seed, options.quick)
    for path in scaling.write(samples, about, options.out):
        print(path)
    return 0


def _list(chosen: list[Case]) -> int:
    from ..bench.competitors import competing

    console = stdout()
    rows = table(console, "case", "scene", "competitors")
    for case in chosen:
        names = ", ".join(competitor.name for competitor in competing(case))
        rows.add_row(case.name, case.scene.text, names)
    console.print(rows)
    return 0


def _rebuild(chosen: list[Case], folder: Path, seconds: float) -> int:
    from ..bench import references

    todo = [case for case in chosen if case.scene.exact is None]
    total = sum(case.scene.weight for case in todo) * seconds
    note(f"{len(todo)} references into {folder}, {total / 60:.0f} minutes")
    for case in todo:
        share = seconds * case.scene.weight
        words = ["nonexp", "bench", "--rebuild-references", "--scenes", case.name]
        command = shlex.join([*words, "--time", f"{seconds:g}s"])
        with _progress() as show:
            made = references.rebuild(
                case, folder, share, command=command, on_pass=partial(_tell, show, case.name)
            )
        size = references.path(case, folder).stat().st_size
        print(
            f"{references.path(case, folder)}: standard error of the mean "
            f"{100 * references.relative_stderr(made):.3f} %, {size / 1024:.0f} KiB"
        )
    return 0


def _tell(show: Callable[[str], None], name: str, done: float) -> None:
    show(f"{name}: {done:.0%}")


def _show_changes(old: Results, new: Results) -> int:
    from ..bench.results import changes, machine_factor

    found = changes(old, new)
    for about in (old.environment, new.environment):
        note(f"{about.get('date')}, commit {about.get('commit')}, {about.get('processor')}")
    factor = machine_factor(old, new)
    note(f"Mitsuba's own integrators took {factor.value:.3f} times as long; taken out below")
    if not found:
        print("nothing changed beyond the noise")
        return 0
    console = stdout()
    rows = table(console, "case", "competitor", "what", "old", "new", "new / old", "")
    for change in found:
        ratio = change.ratio
        shown = f"{ratio.value:.3f} ({ratio.low:.3f} to {ratio.high:.3f})" if ratio else ""
        verdict = "better" if change.better else "worse"
        rows.add_row(
            change.case, change.competitor, change.what, change.old, change.new, shown, verdict
        )
    console.print(rows)
    return 1 if any(not change.better for change in found) else 0


# --------------------------------------------------------------------- small things


def _read(path: Path) -> Results:
    from ..bench.results import Results

    return Results.read(path)


def _check_out(folder: Path) -> None:
    """Before an hour of work: the folder can be made and written to."""
    from ..system.files import check_writable

    if folder.exists() and not folder.is_dir():
        raise OSError(f"--out is {str(folder)!r}: it must be a folder")
    folder.mkdir(parents=True, exist_ok=True)
    check_writable(folder / "results.json")


def _warn_if_busy() -> None:
    if hasattr(os, "getloadavg") and os.getloadavg()[0] > 0.5:
        note(f"warning: this machine is busy (load {os.getloadavg()[0]:.1f}): times will be off")


@contextmanager
def _progress() -> Iterator[Callable[[str], None]]:
    """Shows what is being done, on a terminal."""
    from rich.console import Console

    console = Console(stderr=True)
    if not sys.stderr.isatty():
        yield lambda text: None
        return
    with console.status("starting ...") as status:
        yield lambda text: status.update(text)
