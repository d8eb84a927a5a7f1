"""Rows of numbers that a kernel looks up by index.

A :class:`Table` is made once, in double precision, and serves Python floats and Dr.Jit arrays of
every backend and precision. Its contents are data, not part of the kernel's program: another table
of the same width needs no new compilation.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import Any

import drjit as dr
import numpy as np

__all__ = ["Table", "padded_length", "tables_in"]


class Table:
    """Immutable rows of a few numbers each.

    ``rows``: array of shape (n, k), n and k at least 1. ``table.row(like, index)`` looks one up,
    ``table.find(x, column)`` finds the last row whose sorted column does not exceed ``x``.
    """

    def __init__(self, rows: Any) -> None:
        self.rows = np.array(rows, dtype=np.float64)
        if self.rows.ndim != 2 or 0 in self.rows.shape:
            raise ValueError(f"a table of shape {self.rows.shape} cannot be looked up in")
        self.rows.setflags(write=False)
        self._stride = padded_length(self.rows.shape[1])  # such packets are fetched in one go
        self._arrays: dict[Any, Any] = {}

    def __len__(self) -> int:
        return len(self.rows)

    def __reduce__(self) -> Any:
        return Table, (self.rows,)  # without the arrays, which belong to this machine

    def row(self, like: Any, index: Any) -> tuple[Any, ...]:
        """The numbers of row ``index``, as scalars of the type of ``like``.

        ``index`` is a whole number, or an integer array where ``like`` is a Dr.Jit array; it is
        the caller's duty to keep it below ``len(table)``. No derivatives. Rows of whole numbers are
        fetched outside of kernels, which take them as parameters.
        """
        if not dr.is_array_v(like):
            return tuple(float(v) for v in self.rows[int(index)])
        if isinstance(index, int):
            return self._scalars(type(like), index)
        width = self.rows.shape[1]
        source = self._array(type(like))
        if self._stride == 1:
            return (dr.gather(type(like), source, index),)
        size = min(self._stride, 4)
        packet, parts = _packet(type(like), size), self._stride // size
        needed = range((width + size - 1) // size)
        fetched = [dr.gather(packet, source, index * parts + part) for part in needed]
        return tuple(fetched[i // size][i % size] for i in range(width))

    def find(self, x: Any, column: int = 0) -> Any:
        """Index of the last row whose entry in ``column`` is <= x; 0 if there is none.

        The column must ascend. It is compared in the precision of ``x``: rounding entries keeps
        their order. NaN finds row 0.
        """
        if not dr.is_array_v(x):
            position = int(np.searchsorted(self.rows[:, column], x, side="right")) - 1
            return max(position, 0) if x == x else 0
        x = dr.detach(x)
        source = self._array(type(x))
        index = dr.uint32_array_t(x)
        step = padded_length(len(self.rows)) // 2
        if not step:
            return index(0)
        middle = self._scalars(type(x), step)[column]
        found = dr.select(middle <= x, index(step), 0)
        step //= 2
        while step:
            entry = dr.gather(type(x), source, (found + step) * self._stride + column)
            found = dr.select(entry <= x, found + step, found)
            step //= 2
        return found

    def arrays(self, kind: Any) -> list[Any]:
        """All arrays of a Dr.Jit type that were made of this table so far."""
        made = []
        for key, value in self._arrays.items():
            if key is kind:
                made.append(value)
            elif isinstance(key, tuple) and key[0] is kind:
                made.extend(value)
        return made

    def _scalars(self, kind: Any, index: int) -> tuple[Any, ...]:
        """One row as evaluated arrays of width 1."""
        if (kind, index) not in self._arrays:
            row = tuple(dr.opaque(kind, float(v)) for v in self.rows[index])
            self._arrays[kind, index] = row
        return self._arrays[kind, index]

    def _array(self, kind: Any) -> Any:
        """All rows as one evaluated array, padded to powers of two in both directions.

        The padding is NaN, which no number reaches: a search never ends there.
        """
        if kind not in self._arrays:
            padded = np.full((padded_length(len(self.rows)), self._stride), np.nan)
            padded[: len(self.rows), : self.rows.shape[1]] = self.rows
            # A list is copied to aligned memory. A NumPy array would be used where it lies, and
            # kernels fetch packets in one go, or not, by where that is.
            array = kind(padded.ravel().tolist())
            dr.make_opaque(array)
            self._arrays[kind] = array
        return self._arrays[kind]


def tables_in(value: Any) -> Iterator[Table]:
    """All tables that an object is made of, at any depth."""
    if isinstance(value, Table):
        yield value
    elif isinstance(value, (tuple, list)):
        for item in value:
            yield from tables_in(item)
    elif isinstance(value, dict):
        yield from tables_in(list(value.values()))
    elif type(value).__module__.startswith("nonexp.") and hasattr(value, "__dict__"):
        yield from tables_in(list(vars(value).values()))


def padded_length(n: int) -> int:
    """The least power of two that is not below ``n``."""
    return 1 << (n - 1).bit_length()


def _packet(kind: Any, size: int) -> Any:
    """Static array type of ``size`` components of a Dr.Jit floating-point type."""
    suffix = "f" if dr.type_v(kind) == dr.VarType.Float32 else "f64"
    return getattr(sys.modules[kind.__module__], f"Array{size}{suffix}")
