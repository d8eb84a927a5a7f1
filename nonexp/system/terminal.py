"""What the commands print: results to stdout, notes to stderr."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

__all__ = ["note", "stdout", "table"]


def stdout() -> Console:
    """Where results go: as wide as the terminal, or plain and unwrapped into a file or pipe."""
    from rich.console import Console

    if sys.stdout.isatty():
        return Console(highlight=False)
    return Console(width=10_000, highlight=False, no_color=True, force_terminal=False)


def table(console: Console, *columns: str, numbers: bool = False, lines: bool = False) -> Table:
    """An empty table: framed in a terminal, plain and unwrapped into a file or pipe.

    ``numbers`` aligns all columns but the first to the right; ``lines`` rules the rows.
    """
    from rich import box
    from rich.table import Table

    terminal = console.is_terminal
    empty = Table(
        box=box.ROUNDED if terminal else None, show_lines=lines and terminal, pad_edge=terminal
    )
    for i, column in enumerate(columns):
        empty.add_column(column, no_wrap=not terminal, justify="right" if numbers and i else "left")
    return empty


def note(text: str) -> None:
    """Tell something that is not a result."""
    print(f"nonexp: {text}", file=sys.stderr)
