"""How laws and fits show themselves to a reader."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

from .kinds import number, single

__all__ = ["brief", "html_table"]


def brief(value: Any) -> str:
    """A parameter's value in a few words; of a long vector the first items and the last."""
    value = single(value)
    if isinstance(value, tuple):
        items = [brief(item) for item in value]
        return "(" + ", ".join(items if len(items) < 5 else [*items[:3], "...", items[-1]]) + ")"
    if isinstance(value, str):
        return value
    if hasattr(value, "sample_f"):
        return type(value).__name__.lower()
    if callable(value):
        return getattr(value, "__name__", "function")
    return f"{number(value):g}"


def html_table(
    title: str, head: Sequence[str], rows: Iterable[Sequence[str]], notes: Iterable[str] = ()
) -> str:
    """A table for Jupyter, its texts escaped."""
    cells = "".join(f"<th>{escape(text)}</th>" for text in head)
    lines = [f"<p><b>{escape(title)}</b></p>", f"<table><thead><tr>{cells}</tr></thead><tbody>"]
    for row in rows:
        cells = "".join(f"<td>{escape(text)}</td>" for text in row)
        lines.append(f"<tr>{cells}</tr>")
    return "\n".join([*lines, "</tbody></table>", *(f"<p>{escape(note)}</p>" for note in notes)])
