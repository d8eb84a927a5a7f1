"""``nonexp bench``: run time against error, side by side with Mitsuba's integrators."""

from __future__ import annotations

import os
import shlex
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import mitsuba as mi
from cyclopts import Group, Parameter

from ..rendering.targets import seconds
from ..system.files import check_writable
from ..system.machine import check_variant
from ..system.terminal import note, show, table
from .arguments import UserError, Variant, argument, one_sentence, only_one, whole

if TYPE_CHECKING:
    from ..bench.results import Results
    from ..bench.scenes import Case

__all__ = ["bench"]

WHAT = Group("Other work, one at a time", validator=only_one)


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())


def bench(
    *,
    quick: bool = False,
    scenes: Annotated[tuple[str, ...], argument("A,B", _names)] = (),
    out: Annotated[Path, argument("DIR")] = Path("out/benchmarks"),
    seed: Annotated[int, argument("S", whole(0))] = 0,
    variant: Variant = None,
    references: Annotated[Path | None, argument("DIR")] = None,
    list_: Annotated[bool, Parameter("--list", group=WHAT)] = False,
    compare: Annotated[tuple[Path, ...], argument("JSON", group=WHAT, consume_multiple=True)] = (),
    scaling: Annotated[bool, Parameter(group=WHAT)] = False,
    gradients: Annotated[bool, Parameter(group=WHAT)] = False,
    rebuild_references: Annotated[bool, Parameter(group=WHAT)] = False,
    time: Annotated[float, argument("T", seconds)] = 300.0,
) -> int:
    """Measure run time against error, beside Mitsuba's integrators.

    Measures run time against error of nonexp_volpath and of Mitsuba's integrators on a set of
    scenes, and writes results.json, results.md and plots. A full run takes 16 minutes on 2 idle
    cores. Exit code 1 says that --compare found something worse.

    Args:
        quick: 3 minutes: fewer competitors, passes
        scenes: only these scenes (fog_sphere), scenes with their law (fog_sphere-gamma), a family
            (cloud, cloud-128), or all; default: all but most of the clouds
        out: folder for the results (default: out/benchmarks)
        seed: default: 0
        references: folder of the references (default: benchmarks/references of the source tree)
        list_: list scenes and competitors, and end
        compare: print what changed beyond the noise: from OLD.json to a run made now, or from
            OLD.json to NEW.json
        scaling: measure how time and memory grow with samples, pixels, media, depth, thickness
        gradients: measure derivatives of images, beside prbvolpath (10 minutes; --quick: 1)
        rebuild_references: render the references anew, and end
        time: time per reference, as in 10m (default: 5m; the dragon gets three times as much)
    """
    from ..bench.references import default_folder
    from ..bench.results import Results
    from ..bench.scenes import cases

    if len(compare) > 2:
        raise UserError(f"--compare got {len(compare)} files: it takes one or two")
    with one_sentence():
        chosen = cases(scenes or (("all",) if list_ else ()))
        old = [Results.read(path) for path in compare]
        if len(old) == 2:
            return _show_changes(old[0], old[1])
        mi.set_variant(check_variant(variant))
        mi.set_log_level(mi.LogLevel.Error)
        folder = references or default_folder()
        if list_:
            return _list(chosen)
        if rebuild_references:
            return _rebuild(chosen, folder, time)
        _warn_if_busy()
        _check_out(out)
        if scaling:
            return _scaling(out, seed, quick)
        if gradients:
            return _gradients(out, seed, quick)
        done = _measure(chosen, folder, out, seed, quick)
        return _show_changes(old[0], done) if old else 0


def _measure(chosen: list[Case], folder: Path, out: Path, seed: int, quick: bool) -> Results:
    from ..bench import report, run

    started = time.perf_counter()
    with _progress() as show:
        done = run.run(
            chosen,
            folder,
            quick=quick,
            variant=mi.variant() or "",
            seed=seed,
            on_pass=show,
        )
    for text in done.skipped:
        note(f"skipped: {text}")
    print("\n".join(report.summary(done)))
    print()
    for path in run.write(done, out):
        print(path)
    note(f"{time.perf_counter() - started:.0f} s")
    return done


def _scaling(out: Path, seed: int, quick: bool) -> int:
    from ..bench import results, scaling

    variant = mi.variant() or ""
    with _progress() as show:
        samples = scaling.run(variant=variant, quick=quick, on_sample=show)
    print("\n".join(scaling.sentences(samples)))
    print()
    about = results.environment(variant, seed, quick)
    for path in scaling.write(samples, about, out):
        print(path)
    return 0


def _gradients(out: Path, seed: int, quick: bool) -> int:
    from ..bench import gradients, results

    variant = mi.variant() or ""
    with _progress() as show:
        rows = gradients.run(variant=variant, seed=seed, quick=quick, on_pass=show)
    print("\n".join(gradients.table(rows)))
    print()
    for path in gradients.write(rows, results.environment(variant, seed, quick), out):
        print(path)
    return 0


def _list(chosen: list[Case]) -> int:
    from ..bench.competitors import competing

    rows = table("case", "scene", "competitors")
    for case in chosen:
        names = ", ".join(competitor.name for competitor in competing(case))
        text = case.scene.text if case.usual else f"{case.scene.text}; only if named"
        rows.add_row(case.name, text, names)
    show(rows)
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
                case, folder, share, command=command, on_pass=partial(_show_share, show, case.name)
            )
        size = references.path(case, folder).stat().st_size
        print(
            f"{references.path(case, folder)}: standard error of the mean "
            f"{100 * references.relative_stderr(made):.3f} %, {size / 1024:.0f} KiB"
        )
    return 0


def _show_share(show: Callable[[str], None], name: str, done: float) -> None:
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
    rows = table("case", "competitor", "what", "old", "new", "new / old", "")
    for change in found:
        ratio = change.ratio
        shown = f"{ratio.value:.3f} ({ratio.low:.3f} to {ratio.high:.3f})" if ratio else ""
        verdict = "better" if change.better else "worse"
        rows.add_row(
            change.case, change.competitor, change.what, change.old, change.new, shown, verdict
        )
    show(rows)
    return 1 if any(not change.better for change in found) else 0


# --------------------------------------------------------------------- small things


def _check_out(folder: Path) -> None:
    """Make the folder, and raise ``OSError`` if it cannot be written to."""
    if folder.exists() and not folder.is_dir():
        raise OSError(f"--out is {str(folder)!r}: it must be a folder")
    folder.mkdir(parents=True, exist_ok=True)
    check_writable(folder / "results.json")


def _warn_if_busy() -> None:
    if hasattr(os, "getloadavg") and os.getloadavg()[0] > 0.5:
        note(f"warning: this machine is busy (load {os.getloadavg()[0]:.1f}): times will be off")


@contextmanager
def _progress() -> Iterator[Callable[[str], None]]:
    """Show the work in progress, on a terminal."""
    from rich.console import Console

    console = Console(stderr=True)
    if not sys.stderr.isatty():
        yield lambda text: None
        return
    with console.status("starting ...") as status:
        yield lambda text: status.update(text)
