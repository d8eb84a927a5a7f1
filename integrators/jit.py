"""What keeps a scene's numbers out of the kernel, and its objects numbered."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from nonexp.system import insides


def recording() -> bool:
    """Whether a function is being frozen: then nothing can be read, evaluated or built."""
    return bool(dr.flag(dr.JitFlag.FreezingScope))


def opaque(kind: Any, value: Any) -> Any:
    """A value that is no part of the kernel, so that another one needs no other kernel."""
    result = kind(value)
    if not recording():
        dr.make_opaque(result)
    return result


class Numbering:
    """Some of Mitsuba's objects, numbered from 1 on; all others are 0."""

    def __init__(self, pointers: Sequence[Any]) -> None:
        # Mitsuba numbers the objects of a type; this table leads from its number to ours.
        numbers = [int(insides.number_of(pointer)[0]) for pointer in pointers]
        table = np.zeros(max(numbers) + 1, dtype=np.uint32)
        table[numbers] = np.arange(1, len(numbers) + 1)
        self._table = mi.UInt32(table)

    def of(self, pointer: Any) -> Any:
        """Number of what a pointer stands for."""
        number = insides.number_of(pointer)
        return dr.gather(mi.UInt32, self._table, number, number < len(self._table))


class Remembered:
    """Results of slow looks at a scene, the latest few, by what they depend on."""

    def __init__(self, kept: int) -> None:
        self._kept = kept
        self._known: OrderedDict[Hashable, tuple[Any, Any]] = OrderedDict()

    def get(self, key: Hashable, held: Any, make: Callable[[], Any]) -> Any:
        """The result for a key. ``held`` are the objects and arrays whose numbers are in the key:
        holding them keeps these numbers from being given to others."""
        if key not in self._known:
            self._known[key] = make(), held
            if len(self._known) > self._kept:
                self._known.popitem(last=False)
        self._known.move_to_end(key)
        return self._known[key][0]
