"""NanoVDB files (``.nvdb``) of version 32, as nanovdb/NanoVDB.h and io/IO.h lay them out.

The package tinyvdb reads only the first segment of a file, answers 0 for quantised values, knows
no transform and fetches voxels one by one.
"""

from __future__ import annotations

import struct
import zlib
from typing import Any

import numpy as np

from nonexp.plugins.dense import Box, GridError, choose

__all__ = ["read"]

_TYPES: tuple[str, ...] = (
    "?",
    "Float",
    "Double",
    "Int16",
    "Int32",
    "Int64",
    "Vec3f",
    "Vec3d",
    "Mask",
    "Half",
)
_TYPES += ("UInt32", "Bool", "RGBA8", "Fp4", "Fp8", "Fp16", "FpN")
_CODES: dict[str, Any] = {
    "Float": ("<f4", 512),
    "Fp4": ("u1", 256),
    "Fp8": ("u1", 512),
    "Fp16": ("<u2", 512),
}
_CODECS = ("none", "zip", "blosc")
_LEAVES = 1 << 12
"""Leaves that are made dense at a time: bounds memory."""


def read(path: str, field: str = "") -> tuple[Any, Any]:
    """Values and placement of a grid: :func:`nonexp.plugins.gridfiles.read_grid`."""
    with open(path, "rb") as file:
        grids = list(_segments(file.read()))
    name, kind, codec, data = grids[choose(path, field, [name for name, *_ in grids])]
    said = f"filename is {path!r}: its grid {name!r}"
    if kind not in _CODES:
        raise GridError(f"{said} is of type {kind}: it must be one of {', '.join(_CODES)}")
    if codec == "blosc":
        raise GridError(f"{said} is compressed by Blosc: it must be uncompressed, or by zip")
    if codec == "zip":
        data = memoryview(zlib.decompress(data[8:]))
    if struct.unpack_from("<I", data, 636)[0] != _TYPES.index(kind):
        raise ValueError("the grid is not what the head of the file says")
    leaves, lower, upper, root = (672 + at for at in struct.unpack_from("<4Q", data, 672))
    counts = struct.unpack_from("<3I", data, 704)
    low, high = np.frombuffer(data, "<i4", 6, root).reshape(2, 3)
    if any(low > high):
        raise GridError(f"{said} is empty: it has no active voxels")
    box = Box(path, low, high, *struct.unpack_from("<f", data, root + 28))
    _tiles(box, np.frombuffer(data, _inner(32), counts[2], upper), 128)
    _tiles(box, np.frombuffer(data, _inner(16), counts[1], lower), 8)
    for first in range(0, counts[0], _LEAVES):
        count, start = min(_LEAVES, counts[0] - first), leaves + first * _leaf(kind).itemsize
        _voxels(box, np.frombuffer(data, _leaf(kind), count, start), kind)
    to_world = np.eye(4)
    to_world[:3, :3] = np.frombuffer(data, "<f8", 9, 384).reshape(3, 3)
    to_world[:3, 3] = np.frombuffer(data, "<f8", 3, 528)
    return box.values, box.placed(to_world)


def _segments(data: bytes) -> Any:
    """Name, type, codec and data of each grid in a file."""
    at, view = 0, memoryview(data)
    while at < len(data):
        magic, version, count, codec = struct.unpack_from("<8sIHH", data, at)
        if magic not in (b"NanoVDB0", b"NanoVDB2"):
            raise ValueError("it does not begin like a NanoVDB file")
        if version >> 21 != 32 or codec >= len(_CODECS):
            raise ValueError(f"it is of version {version >> 21}, it must be 32")
        at += 16
        heads = []
        for _ in range(count):
            size, kind, length = struct.unpack_from("<8xQ16xI100xI", data, at)
            name = data[at + 176 : at + 176 + length].split(b"\0")[0].decode(errors="replace")
            heads.append((name, _TYPES[kind] if kind < len(_TYPES) else str(kind), size))
            at += 176 + length
        for name, named, size in heads:
            if at + size > len(data):
                raise ValueError("it ends too early")
            yield name, named, _CODECS[codec], view[at : at + size]
            at += size


def _inner(side: int) -> Any:
    """A node of ``side`` children along each axis; a child of none is a tile, of one value."""
    count = side**3
    names = ("low", "active", "children", "table")
    table = (32 + count // 4 + 16 + 31) // 32 * 32
    return np.dtype(
        {
            "names": names,
            "formats": [
                ("<i4", 3),
                ("u1", count // 8),
                ("u1", count // 8),
                ([("value", "<f4"), ("rest", "u4")], count),
            ],
            "offsets": [0, 32, 32 + count // 8, table],
            "itemsize": table + 8 * count,
        }
    )


def _tiles(box: Box, nodes: Any, size: int) -> None:
    """Fill the active tiles of nodes, each a cube of ``size`` voxels along an axis."""
    for node in nodes:
        side = round(len(node["table"]) ** (1 / 3))
        bits = np.unpackbits(node["active"] & ~node["children"], bitorder="little")
        for number in np.flatnonzero(bits):
            steps = np.array(np.unravel_index(number, (side, side, side)))
            origin = (node["low"] & -side * size) + size * steps
            box.fill(origin, size, node["table"]["value"][number])


def _leaf(kind: str) -> Any:
    """8 x 8 x 8 voxels: numbers, or codes of numbers."""
    codes, count = _CODES[kind]
    fields = [("low", "<i4", 3), ("rest", "u4"), ("active", "u1", 64)]
    fields += [("minimum", "<f4"), ("quantum", "<f4"), ("range", "u8"), ("codes", codes, count)]
    return np.dtype(fields)


def _voxels(box: Box, leaves: Any, kind: str) -> None:
    """Set the active voxels of leaves."""
    values = leaves["codes"]
    if kind == "Fp4":
        values = np.stack([values & 15, values >> 4], 2).reshape(-1, 512)
    if kind != "Float":
        values = values * leaves["quantum"][:, None] + leaves["minimum"][:, None]
    bits = np.unpackbits(leaves["active"], axis=1, bitorder="little")
    leaf, number = np.nonzero(bits)
    steps = np.stack(np.unravel_index(number, (8, 8, 8)), 1)
    box.put((leaves["low"][leaf] & -8) + steps, values[leaf, number])
