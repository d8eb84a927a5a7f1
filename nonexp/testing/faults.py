"""What a check raises, and words for numbers in it."""

from __future__ import annotations

__all__ = ["Fault", "percent"]


class Fault(AssertionError):
    """A law or an integrator is wrong; the text names the kind of fault."""


def percent(ratio: float) -> str:
    """How much a ratio differs from 1: ``too large by 1.0 %``, in two digits."""
    word = "too large" if ratio > 1 else "too small"
    return f"{word} by {float(f'{100 * abs(ratio - 1):.2g}'):g} %"
