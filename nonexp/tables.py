"""Rows of numbers that a kernel looks up by index.

A :class:`Table` is made once, in double precision, and serves Python floats and Dr.Jit arrays of
every backend and precision. Its contents are data, not part of the kernel's program: another table
of the same width needs no new compilation.
"""

from __future__ import annotations

import sys
from typing import Any

import drjit as dr
import numpy as np

__all__ = ["Table"]


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
        self._stride = _power_of_two(self.rows.shape[1])  # such packets are fetched in one go
        self._arrays: dict[Any, Any] = {}

    def __len__(self) -> int:
        return len(self.rows)

    def row(self, like: Any, index: Any) -> tuple[Any, ...]:
        """The numbers of row ``index``, as scalars of the type of ``like``.

        ``index`` is a whole number, or an integer array where ``like`` is a Dr.Jit array; it is
        the caller's duty to keep it below ``len(table)``. No derivatives.
        """
        if not dr.is_array_v(like):
            return tuple(float(v) for v in self.rows[int(index)])
        width = self.rows.shape[1]
        source = self._array(type(like))
        if self._stride == 1:
            return (dr.gather(type(like), source, index),)
        packet = dr.gather(_packet(type(like), self._stride), source, index)
        return tuple(packet[i] for i in range(width))

    def find(self, x: Any, column: int = 0) -> Any:
        """Index of the last row whose entry in ``column`` is <= x; 0 if there is none.

        The column must ascend. It is compared in the precision of ``x``: rounding entries keeps
        their order. NaN finds row 0.
        """
        last = len(self.rows) - 1
        if not dr.is_array_v(x):
            position = int(np.searchsorted(self.rows[:, column], x, side="right")) - 1
            return min(max(position, 0), last)
        x = dr.detach(x)
        source = self._array(type(x))
        index = dr.uint32_array_t(x)
        found = index(0)
        step = _power_of_two(len(self.rows)) // 2
        while step:
            entry = dr.gather(type(x), source, (found + step) * self._stride + column)
            found = dr.select(entry <= x, found + step, found)
            step //= 2
        return dr.minimum(found, last)

    def _array(self, kind: Any) -> Any:
        """All rows as one evaluated array, padded to powers of two in both directions."""
        if kind not in self._arrays:
            padded = np.full((_power_of_two(len(self.rows)), self._stride), np.inf)
            padded[: len(self.rows), : self.rows.shape[1]] = self.rows
            array = kind(padded.ravel())
            dr.make_opaque(array)
            self._arrays[kind] = array
        return self._arrays[kind]


def _power_of_two(n: int) -> int:
    """The least one that is not below n."""
    return 1 << (n - 1).bit_length()


def _packet(kind: Any, size: int) -> Any:
    """Static array type of ``size`` components of a Dr.Jit floating-point type."""
    suffix = "f" if dr.type_v(kind) == dr.VarType.Float32 else "f64"
    module = sys.modules[kind.__module__]
    cls = getattr(module, f"Array{size}{suffix}", None)
    return cls if cls is not None else getattr(module, f"ArrayX{suffix}")
