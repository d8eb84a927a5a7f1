"""OpenVDB files (``.vdb``), by the package tinyvdb."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Any

import numpy as np

from nonexp.plugins.dense import Box, GridError, choose

__all__ = ["read"]

_FLOAT = "Tree_float_5_4_3"
_MAPS = {
    "AffineMap": 128,
    "ScaleMap": 120,
    "ScaleTranslateMap": 144,
    "TranslationMap": 24,
    "UniformScaleMap": 120,
    "UniformScaleTranslateMap": 144,
    "UnitaryMap": 128,
}
"""Bytes of each kind of transform in a file."""


def read(path: str, field: str = "") -> tuple[Any, Any]:
    """Values and placement of a grid: :func:`nonexp.plugins.gridfiles.read_grid`."""
    try:
        import tinyvdb
    except ImportError:
        raise ImportError(
            f"filename is {path!r}: the package tinyvdb, which reads OpenVDB files, is not "
            'installed: pip install "nonexp[vdb]"'
        ) from None
    with tinyvdb.open(path) as file:
        file.read_grids()
        grids = [file.grid(number) for number in range(file.grid_count)]
        number = choose(path, field, [grid.name for grid in grids])
        grid = grids[number]
        said = f"filename is {path!r}: its grid {grid.name!r}"
        if not grid.type_name.startswith(_FLOAT):
            raise GridError(f"{said} is a {grid.type_name}: it must be a {_FLOAT}")
        to_world = _to_world(said, grid.transform)
        found = grid.to_sparse()
        voxels = np.frombuffer(found["coords"], np.int32).reshape(-1, 3)
        values = np.frombuffer(found["values"], np.float32)
        tiles = list(_tiles(file, number)) if _has_tiles(grid.tree) else []
        background = grid.float_background()
    if not len(voxels) and not tiles:
        raise GridError(f"{said} is empty: it has no active voxels")
    lows = [*([voxels.min(0)] if len(voxels) else []), *(origin for origin, *_ in tiles)]
    highs = [*([voxels.max(0)] if len(voxels) else []), *(o + (n - 1) for o, n, _ in tiles)]
    box = Box(path, np.min(lows, 0), np.max(highs, 0), background)
    for origin, size, value in tiles:
        box.fill(origin, size, value)
    box.put(voxels, values)
    return box.values, box.placed(to_world)


def _to_world(said: str, transform: Any) -> Any:
    """Matrix from voxel indices to the space of the file."""
    kind, matrix = transform["type"], np.eye(4)
    if kind in ("affine", "unitary"):
        return np.array(transform["matrix"]).T  # OpenVDB multiplies rows
    if not {*kind.split("_")} <= {"uniform", "scale", "translate", "translation"}:
        raise GridError(f"{said} has a transform of kind {kind}: it must be linear")
    if kind != "translation":
        matrix[:3, :3] = np.diag(transform["scale"])
    matrix[:3, 3] = transform["translation"]
    return matrix


# ------------------------------------------------------------------------------ tiles
#
# Nodes of one value have no children. tinyvdb keeps their values and writes them, but does not
# show them; so they are read from what it writes, uncompressed.


def _has_tiles(tree: Any) -> bool:
    """Of the root, ``active_voxel_count`` is the number of tiles and children."""
    nodes = [tree.node(number) for number in range(tree.num_nodes)]
    inner = [node for node in nodes if node.type == "internal"]
    children = sum(node.level == 1 for node in inner)
    return nodes[0].active_voxel_count > children or any(n.active_voxel_count for n in inner)


def _tiles(file: Any, number: int) -> Iterator[tuple[Any, int, float]]:
    """Origin, size and value of each active tile of a grid."""
    stream = _Stream(file.to_bytes(compression=0, level=0))
    stream.at = 8 + 12 + 1 + 36  # magic number, versions, flag, uuid
    stream.metadata()
    (count,) = stream.take("I")
    for place in range(count):
        _, kind, _ = stream.text(), stream.text(), stream.text()
        start, _, end = stream.take("3q")
        stream.at = start if place == number else end
        if place == number:
            break
    stream.take("I")  # compression
    stream.metadata()
    transform = stream.text()
    stream.at += _MAPS[transform]
    real = np.dtype("<f2" if kind.endswith("_HalfFloat") else "<f4")
    _, _, tiles, children = stream.take("IfII")
    for _ in range(tiles):
        *origin, value, active = stream.take("3if?")
        if active:
            yield np.array(origin), 4096, value
    leaves = 0
    for _ in range(children):
        upper = np.array(stream.take("3i"))
        below, found = stream.node(upper, 32, 128, real)
        yield from found
        for lower in below:
            more, found = stream.node(lower, 16, 8, real)
            yield from found
            stream.at += 64 * len(more)
            leaves += len(more)
    if stream.at + leaves * (64 + 1 + 512 * real.itemsize) != end:
        raise ValueError("its tiles are not where they should be")


class _Stream:
    """The bytes of a file, from front to back."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0

    def take(self, form: str) -> tuple[Any, ...]:
        found = struct.unpack_from("<" + form, self.data, self.at)
        self.at += struct.calcsize("<" + form)
        return found

    def text(self) -> str:
        (length,) = self.take("I")
        return self.take(f"{length}s")[0].decode(errors="replace")

    def metadata(self) -> None:
        for _ in range(3 * self.take("I")[0]):
            self.text()

    def array(self, kind: Any, count: int) -> Any:
        found = np.frombuffer(self.data, kind, count, self.at)
        self.at += found.nbytes
        return found

    def node(self, origin: Any, side: int, size: int, real: Any) -> tuple[Any, Any]:
        """Origins of the children of an inner node, in order; and its active tiles."""
        masks = self.array("u1", side**3 // 4).reshape(2, -1)
        children, active = np.unpackbits(masks, axis=1, bitorder="little").astype(bool)
        self.take("b")  # which values are stored: all
        values = self.array(real, side**3)
        places = np.stack(np.unravel_index(np.arange(side**3), (side, side, side)), 1)
        origins = origin + size * places
        tiles = [(origins[n], size, float(values[n])) for n in np.flatnonzero(active & ~children)]
        return origins[children], tiles
