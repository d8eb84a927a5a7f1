"""What the commands print: results to stdout, notes to stderr."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

__all__ = ["note", "show", "stdout", "table"]

_PLAIN_WIDTH = 100
"""Columns of a table that is written into a file or pipe."""


def stdout() -> Console:
    """Where results go: a terminal, or plain text into a file or pipe."""
    from rich.console import Console

    if sys.stdout.isatty():
        return Console(highlight=False, markup=False)
    plain: dict[str, Any] = {"no_color": True, "force_terminal": False}
    return Console(width=_PLAIN_WIDTH, highlight=False, markup=False, **plain)


def table(*columns: str, numbers: bool = False, lines: bool = False) -> Table:
    """An empty table: framed in a terminal, without a frame and 100 columns wide elsewhere.

    Text wraps within the cells, except in the first column, which marks where a row begins.
    ``numbers`` aligns the other columns to the right and does not wrap them; ``lines`` rules rows.
    """
    from rich import box
    from rich.table import Table

    terminal = sys.stdout.isatty()
    empty = Table(
        box=box.ROUNDED if terminal else None, show_lines=lines and terminal, pad_edge=terminal
    )
    for i, column in enumerate(columns):
        justify: Any = "right" if numbers and i else "left"
        empty.add_column(column, no_wrap=numbers or not i, justify=justify)
    return empty


def show(result: Table | str, style: str | None = None) -> None:
    """Print a table, or text that is not wrapped."""
    stdout().print(result, style=style, soft_wrap=isinstance(result, str))


def note(text: str) -> None:
    """Print what is not a result."""
    print(f"nonexp: {text}", file=sys.stderr)
