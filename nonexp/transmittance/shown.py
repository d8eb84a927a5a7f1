"""How laws and fits show themselves to a reader."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

from .kinds import number, single

__all__ = ["brief", "html_table", "signed", "with_error"]


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


def with_error(value: Any, error: float | None) -> tuple[str, str]:
    """A value and its standard error, to two digits of the error."""
    if not isinstance(value, float):
        return str(value), ""
    if error is None:
        return f"{value:.6g}", ""
    if math.isnan(error):
        return f"{value:.6g}", "at its limit"
    if math.isinf(error):
        return f"{value:.3g}", "not determined"
    if error < 1e-12 * abs(value):
        return f"{value:.6g}", "0"
    digits = 1 - math.floor(math.log10(error))
    if -3 < digits < 10 and abs(value) < 1e7:
        return f"{value:.{max(digits, 0)}f}", f"{error:.{max(digits, 0)}f}"
    return f"{value:.6g}", f"{error:.2g}"


def signed(error: str) -> str:
    """A standard error behind its value; words about it in parentheses."""
    return f"± {error}" if error[:1].isdigit() else f"({error})" if error else ""
