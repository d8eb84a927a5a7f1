"""The progress bar of a render, and times as people write them."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator

from .targets import Progress

__all__ = ["bar", "describe", "row", "time"]


def time(seconds: float) -> str:
    """Seconds as 4.2 s, 3 min 05 s, 2 h 07 min or 1 d 03 h."""
    if not math.isfinite(seconds):
        return "?"
    if seconds < 60:
        return f"{seconds:.1f} s"
    for size, unit, part, name in ((86400, "d", 3600, "h"), (3600, "h", 60, "min")):
        if seconds >= size:
            return f"{seconds // size:.0f} {unit} {seconds % size // part:02.0f} {name}"
    return f"{seconds // 60:.0f} min {int(seconds % 60):02d} s"


def describe(progress: Progress, pixels: int, error: float | None) -> str:
    """Samples per pixel, samples per second, error (and its target), and time left."""
    parts = [f"{progress.spp} spp"]
    if progress.pass_seconds > 0:
        speed = pixels * progress.pass_spp / progress.pass_seconds
        parts.append(f"{speed / 1e6:.1f} M/s" if speed >= 1e6 else f"{speed / 1e3:.0f} k/s")
    if math.isfinite(progress.noise.error):
        target = f" (to be {100 * error:.3g}%)" if error is not None else ""
        parts.append(f"error {progress.noise.error:.2%}{target}")
    if math.isfinite(progress.left):
        parts.append(f"{time(progress.left)} left")
    return ", ".join(parts)


@contextlib.contextmanager
def bar(name: str, pixels: int, error: float | None) -> Iterator[Callable[[Progress], None]]:
    """Show the progress of a render: call what is given after each pass."""
    with row(name) as update:

        def show(progress: Progress) -> None:
            whole = progress.seconds + progress.left
            share = progress.seconds / whole if 0 < whole < math.inf else 0.0
            update(share, describe(progress, pixels, error))

        yield show


@contextlib.contextmanager
def row(name: str) -> Iterator[Callable[[float, str], None]]:
    """A progress bar on a terminal (stderr) or in Jupyter: call what is given with the share that
    is done, and the state in words."""
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar

    console = Console(stderr=True)
    columns = (
        TextColumn(name, markup=False),
        BarColumn(bar_width=12),
        TimeElapsedColumn(),
        TextColumn("{task.fields[state]}", markup=False),
    )
    shown = console.is_terminal or console.is_jupyter
    with Bar(*columns, console=console, disable=not shown) as rows:
        task = rows.add_task("", total=1.0, state="compiling")
        yield lambda share, state: rows.update(task, completed=share, state=state)
        rows.refresh()  # Jupyter would keep the last but one
