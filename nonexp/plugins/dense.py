"""What files of grids have in common: names of grids, and sparse grids made dense."""

from __future__ import annotations

import contextlib
import math
import os
import re
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

__all__ = ["Box", "GridError", "check_size", "choose", "reading"]


class GridError(ValueError):
    """A file holds no such grid; the message is one sentence for the user."""


@contextlib.contextmanager
def reading(path: str) -> Iterator[None]:
    """Turn whatever a reader raises for a damaged file into one sentence."""
    try:
        yield
    except (GridError, ImportError):
        raise
    except Exception as error:
        said = re.split(r"\n|\.\s", str(error).strip() or type(error).__name__)[0].rstrip(".")
        raise GridError(f"filename is {path!r}: it cannot be read ({said})") from error


def choose(path: str, field: str, names: Sequence[str]) -> int:
    """The index of the grid called ``field``, or of the only one. Raises ``ValueError``."""
    if not names:
        raise GridError(f"filename is {path!r}: it holds no grid")
    allowed = f"it must be one of {', '.join(map(repr, names))}, the grids of {path!r}"
    if not field:
        if len(names) > 1:
            raise GridError(f"field is missing: {allowed}")
        return 0
    if names.count(field) != 1:
        many = "the file holds several of that name; " if field in names else ""
        raise GridError(f"field is {field!r}: {many}{allowed}")
    return names.index(field)


def check_size(path: str, shape: Sequence[int]) -> None:
    """Raise ``ValueError`` for a grid that cannot be held: indices have 31 bits."""
    count = math.prod(shape[:3])
    memory = 4 * math.prod(shape)
    held = math.inf
    if hasattr(os, "sysconf"):
        held = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    if count >= 2**31 or memory > held:
        size = " x ".join(map(str, reversed(shape[:3])))
        limit = "less than 2^31 voxels" if count >= 2**31 else f"at most {held / 2**30:.3g} GiB"
        raise GridError(
            f"filename is {path!r}: its grid spans {size} voxels, {memory / 2**30:.3g} GiB if "
            f"every one is stored, as it is here: it must be {limit}"
        )


class Box:
    """The dense grid over a box of voxels, from ``low`` to ``high``, both included (x, y, z)."""

    def __init__(self, path: str, low: Any, high: Any, background: float) -> None:
        self.low = np.asarray(low, np.int64)
        self.shape = tuple(int(n) for n in (np.asarray(high, np.int64) - self.low + 1)[::-1])
        check_size(path, self.shape)
        self.values = np.full(self.shape, background, np.float32)

    def put(self, voxels: Any, values: Any) -> None:
        """Set voxels (rows of x, y, z)."""
        x, y, z = (voxels - self.low).T
        self.values[z, y, x] = values

    def fill(self, origin: Any, size: int, value: float) -> None:
        """Set all voxels of a cube, which lies in the box."""
        x, y, z = (slice(n, n + size) for n in np.asarray(origin, np.int64) - self.low)
        self.values[z, y, x] = value

    def placed(self, to_world: Any) -> Any:
        """Matrix from the unit cube, by that from voxel indices, which are whole at centres."""
        to_index = np.eye(4)
        to_index[:3, :3] = np.diag(self.shape[::-1])
        to_index[:3, 3] = self.low - 0.5
        return np.asarray(to_world, float) @ to_index
