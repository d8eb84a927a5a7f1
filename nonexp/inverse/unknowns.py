"""What is fitted: single numbers of a scene, where they may lie, and how the search sees them.

The search works on *coordinates*: a number, or the logarithm of one that is positive.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from .. import models
from ..transmittance.kinds import kind_of, parameters_of
from .derivatives import changed, numbers

__all__ = [
    "Bounds",
    "Unknown",
    "allowed",
    "find",
    "listed",
    "starts_of",
    "unknowns",
    "values_of",
    "write",
]

Bounds = tuple[float, float]

_MOST = 64
"""Numbers that a parameter may consist of: each costs a render per step."""

_REACH = math.log(1e6)
"""How far from its start the logarithm of a number may go."""

_POSITIVE, _SHARE = (0.0, math.inf), (0.0, 1.0)
_RANGES: dict[str, Bounds] = {
    "sigma_t": _POSITIVE,
    "scale": _POSITIVE,
    "extinction": _POSITIVE,
    "emission": _POSITIVE,
    "radiance": _POSITIVE,
    "irradiance": _POSITIVE,
    "intensity": _POSITIVE,
    "albedo": _SHARE,
    "reflectance": _SHARE,
    "g": (-0.99, 0.99),
}
"""A word of a parameter's name -> where its numbers may lie. Laws declare their own."""


@dataclass(frozen=True)
class Unknown:
    """One number to be fitted, called ``key`` or ``key[item]`` in the scene."""

    key: str
    item: int
    label: str
    """what reports call it"""
    start: float
    low: float
    high: float

    @property
    def logarithmic(self) -> bool:
        """The search sees the logarithm."""
        return self.start > 0 and self.low >= 0 and (self.low > 0 or self.high == math.inf)

    @property
    def unit(self) -> float:
        """How far is far, for a number that is not seen as a logarithm."""
        width = self.high - self.low
        return width if width < math.inf else abs(self.start) or 1.0

    @property
    def limits(self) -> Bounds:
        """Where the coordinate may lie."""
        if not self.logarithmic:
            return self.low / self.unit, self.high / self.unit
        start = math.log(self.start)
        low = math.log(self.low) if self.low > 0 else -math.inf
        return max(low, start - _REACH), min(math.log(self.high), start + _REACH)

    def coordinate(self, value: float) -> float:
        return math.log(value) if self.logarithmic else value / self.unit

    def value(self, coordinate: float) -> float:
        return math.exp(coordinate) if self.logarithmic else coordinate * self.unit

    def slope(self, coordinate: float) -> float:
        """Derivative of the value by the coordinate."""
        return math.exp(coordinate) if self.logarithmic else self.unit

    def within(self, value: float) -> bool:
        return self.low <= value <= self.high


def find(parameters: Any, name: str) -> tuple[str, int | None]:
    """The parameter of a scene with a name, which may be a part of its full name, such as
    ``sigma_t``, and may end in the number of an item, such as ``sigma_t[2]``.

    ``KeyError`` where the scene has none or several.
    """
    short, item = name, None
    if name not in parameters and name.endswith("]") and name[:-1].rpartition("[")[2].isdigit():
        short, _, number = name[:-1].rpartition("[")
        item = int(number)
    found = [short] if short in parameters else []
    found = found or [key for key in parameters.keys() if f".{short}." in f".{key}."]
    if not found:
        raise KeyError(f"the scene has no parameter {name!r}: mi.traverse(scene) lists them")
    if len(found) > 1:
        shown = ", ".join(found[:8]) + (", ..." if len(found) > 8 else "")
        raise KeyError(
            f"{name!r} is a part of several parameters' names: it must be one of {shown}"
        )
    if item is not None and item >= len(numbers(parameters[found[0]])):
        raise KeyError(f"{name!r} is not there: {found[0]} has fewer numbers")
    return found[0], item


def unknowns(
    parameters: Any,
    name: str,
    start: Any = None,
    bounds: Bounds | None = None,
    label: str | None = None,
) -> list[Unknown]:
    """The numbers of a parameter, from ``start`` or from what the scene holds.

    ``KeyError`` for a parameter that the scene does not have, ``ValueError`` for one that cannot
    be fitted, and for a start outside of its bounds.
    """
    key, item = find(parameters, name)
    label = label or name
    value = parameters[key]
    if not dr.is_array_v(value) or not dr.is_float_v(value):
        raise ValueError(f"{label} is {value}: only real numbers can be fitted")
    present = numbers(value)
    if len(present) > _MOST and item is None:
        raise ValueError(
            f"{label} has {len(present)} numbers: fit takes up to {_MOST}; for more, such as the "
            "voxels of a grid, use nonexp.inverse.descend"
        )
    if start is None:
        starts = present if item is None else present[[item]]
    else:
        starts = np.atleast_1d(np.asarray(start, dtype=np.float64)).ravel()
        if item is None and len(starts) == 1:
            starts = np.repeat(starts, len(present))
    items = range(len(present)) if item is None else [item]
    if len(starts) != len(items):
        raise ValueError(f"{label} starts at {start}: it must be one number, or {len(items)}")
    low, high = bounds or allowed(parameters, key)
    if not low < high:
        raise ValueError(f"the bounds of {label} are {low:g} and {high:g}: the first must be less")
    found = []
    for number, begin in zip(items, starts, strict=True):
        own = label if item is not None or len(present) == 1 else f"{label}[{number}]"
        one = Unknown(key, number, own, float(begin), float(low), float(high))
        if not one.within(one.start):
            raise ValueError(f"{own} starts at {one.start:g}: it must be in [{low:g}, {high:g}]")
        found.append(one)
    return found


def allowed(parameters: Any, key: str) -> Bounds:
    """Where the numbers of a parameter may lie: as its law declares, or by its name."""
    node = parameters.properties[key][2]
    words = key.split(".")
    if (law := models.registry.get(getattr(node, "key", ""))) is not None:
        kind: Any = kind_of(parameters_of(law)[words[-1]])
        allowed = getattr(kind, "range", None)
        if allowed is not None:
            return _closed(allowed.above, allowed.least), allowed.most
    for word in reversed(words):
        for name, bounds in _RANGES.items():
            if word == name or word.endswith(f"_{name}"):
                return bounds
    return -math.inf, math.inf


def _closed(above: float, least: float) -> float:
    """The lower end of a range, where it may be reached: numbers > 0 are seen as logarithms, and
    the end of any other open range is not quite reached."""
    if above > -math.inf and above != 0:
        return above + 1e-4 * max(1.0, abs(above))
    return max(above, least)


def values_of(found: Sequence[Unknown], at: Iterable[float]) -> list[float]:
    """The numbers at some coordinates."""
    return [one.value(float(u)) for one, u in zip(found, at, strict=True)]


def write(parameters: Any, found: Sequence[Unknown], values: Sequence[float]) -> None:
    """Give a scene these numbers."""
    new: dict[str, Any] = {}
    for one, value in zip(found, values, strict=True):
        if one.key not in new:
            new[one.key] = numbers(parameters[one.key])
        new[one.key][one.item] = value
    for key, array in new.items():
        parameters[key] = changed(parameters[key], list(array))
    parameters.update()


def listed(names: str | Sequence[str]) -> Sequence[str]:
    return [names] if isinstance(names, str) else names


def starts_of(
    parameters: Any,
    wanted: Mapping[str, Any],
    bounds: Mapping[str, Bounds],
) -> list[Unknown]:
    """The numbers of several parameters, each once."""
    found: list[Unknown] = []
    for name, start in wanted.items():
        for one in unknowns(parameters, name, start, bounds.get(name)):
            if any((one.key, one.item) == (other.key, other.item) for other in found):
                raise ValueError(f"{one.label} is given twice")
            found.append(one)
    return found
