"""Choosing one of several alternatives of a given weight, as mixtures do."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import drjit as dr

from ..numerics import filled, select
from . import Draw, Transmittance
from .parameters import check, number

__all__ = ["pick", "replayed", "require_extinction", "weights"]

_STEP = 2.0**-23  # of random numbers in single precision


def weights(model: Transmittance, given: tuple[Any, ...], items: str) -> tuple[Any, ...]:
    """Weights ``given`` for what a model holds in the field ``items``; all 1 if none are given.

    Raises ``ValueError`` when there are no items, or not as many weights, or only zeros.
    """
    name, count = type(model).__name__, len(getattr(model, items))
    if count == 0:
        raise ValueError(f"{name}.{items} is empty: it must hold at least one number")
    if not given:
        return (1.0,) * count
    if len(given) != count:
        raise ValueError(
            f"{name}.weight holds {len(given)} numbers: it must hold as many as {items} ({count})"
        )
    if not any(number(w) for w in given):
        raise ValueError(f"{name}.weight holds only zeros: at least one must be > 0")
    return given


def require_extinction(model: Transmittance) -> None:
    """Raise ``ValueError`` unless the mean extinction of a mixture is positive and finite."""
    check(f"mean extinction of {type(model).__name__}", model.sigma_bar, above=0)


def pick(draw: Draw, shares: Sequence[Any], values: Sequence[Any]) -> Any:
    """One of ``values``, each with a probability proportional to its share (>= 0, sum > 0).

    A share of zero is never picked. In single precision a second random number refines the first,
    so that shares far below its step are picked with the right probability. A choice from a single
    value draws no number.
    """
    if len(values) == 1:
        return values[0]
    u = draw()
    rest = 1 - u
    if dr.is_array_v(u) and dr.type_v(u) == dr.VarType.Float32:
        fine = _STEP * draw()
        u, rest = u + fine, rest - fine  # precise near 0 and near 1, respectively

    below = _sums(shares[:-1])
    above = _sums(shares[:0:-1])[::-1]
    picked = filled(u, values[-1])
    for value, low, high in reversed(list(zip(values[:-1], below, above, strict=True))):
        fraction = dr.minimum(low, high) / (low + high)
        first = select(low <= high, u < fraction, rest > fraction)
        picked = select(first, value, picked)
    return picked


def replayed(draw: Draw) -> Callable[[], Draw]:
    """Replays the same random numbers for alternatives of which only one is used.

    Each call of the result starts from the first number again: ``numbers = replayed(draw)``, then
    ``a.sample_f(numbers())`` and ``b.sample_f(numbers())``.
    """
    drawn: list[Any] = []

    def again() -> Draw:
        position = -1

        def following() -> Any:
            nonlocal position
            position += 1
            if position == len(drawn):
                drawn.append(draw())
            return drawn[position]

        return following

    return again


def _sums(shares: Sequence[Any]) -> list[Any]:
    """Running sums, without derivatives."""
    sums = [dr.detach(shares[0])]
    for share in shares[1:]:
        sums.append(sums[-1] + dr.detach(share))
    return sums
