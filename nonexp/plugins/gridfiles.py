"""Files of grids: Mitsuba's ``.vol``, NumPy's ``.npy`` and ``.npz``, OpenVDB and NanoVDB."""

from __future__ import annotations

import os
from typing import Any

import mitsuba as mi
import numpy as np

from nonexp.plugins import nanovdb, openvdb
from nonexp.plugins.dense import GridError, check_size, choose, reading

__all__ = ["read", "read_grid"]


def read_grid(filename: str | os.PathLike[str], field: str = "") -> tuple[Any, Any]:
    """Read a grid from a file, as the medium ``nonexp_heterogeneous`` does: values and placement.

    ``filename`` ends in ``.vol`` (Mitsuba), ``.npy`` or ``.npz`` (NumPy, any real type), ``.vdb``
    (OpenVDB, needs ``pip install "nonexp[vdb]"``) or ``.nvdb`` (NanoVDB). ``field`` is the name of
    an array or grid, needed where the file holds several. A variant of Mitsuba must be set.

    The values are float32 with the axes z, y, x, and a last one if there are three channels. The
    placement is a 4 x 4 matrix from the unit cube to the space of the file, or None: NumPy's files
    know none, and that of a ``.vol`` is ignored, as Mitsuba's ``gridvolume`` does. An OpenVDB or
    NanoVDB grid becomes dense over the bounding box of its active voxels, whose centres lie at
    integer indices; its background fills the rest of the box.

    Raises ``ValueError`` if the file is missing or damaged, or holds no such grid, and
    ``ImportError`` without the package that reads OpenVDB.
    """
    return read(os.fspath(filename), field)


def read(path: str, field: str = "") -> tuple[Any, Any]:
    """Values and placement of a grid: :func:`read_grid`."""
    ending = os.path.splitext(path)[1].lower()
    if ending not in _READERS:
        raise GridError(f"filename is {path!r}: it must end in {', '.join(_READERS)}")
    if not os.path.isfile(path):
        missing = "does not exist (the command nonexp cloud FILE makes a grid)"
        what = "is a folder" if os.path.isdir(path) else missing
        raise GridError(f"filename is {path!r}: it {what}")
    if field and ending in (".vol", ".npy"):
        raise GridError(f"field is {field!r}: a {ending} file holds one grid, without a name")
    with reading(path):
        array, placed = _READERS[ending](path, field)
        return _checked(path, array), placed


def _vol(path: str, _: str) -> tuple[Any, None]:
    return np.array(mi.VolumeGrid(path)), None


def _npy(path: str, _: str) -> tuple[Any, None]:
    with open(path, "rb") as file:
        array = np.load(file, allow_pickle=False)
    if not isinstance(array, np.ndarray):
        raise ValueError("its contents are those of a .npz file")
    return array, None


def _npz(path: str, field: str) -> tuple[Any, None]:
    with open(path, "rb") as file:  # which np.load leaves open where it fails
        archive = np.load(file, allow_pickle=False)
        if isinstance(archive, np.ndarray):
            raise ValueError("its contents are those of a .npy file")
        array = archive[archive.files[choose(path, field, archive.files)]]
    if not isinstance(array, np.ndarray):
        raise ValueError("what it holds is no array")
    return array, None


_READERS = {
    ".vol": _vol,
    ".npy": _npy,
    ".npz": _npz,
    ".vdb": openvdb.read,
    ".nvdb": nanovdb.read,
}


def _checked(path: str, array: Any) -> Any:
    said = f"filename is {path!r}: its grid"
    if array.dtype.kind not in "biuf":
        raise GridError(f"{said} holds {array.dtype}: it must hold real numbers")
    if array.ndim == 4 and array.shape[3] == 1:
        array = array[..., 0]
    if array.ndim != 3 and not (array.ndim == 4 and array.shape[3] == 3):
        raise GridError(
            f"{said} has the shape {array.shape}: it must be (z, y, x), or (z, y, x, 3)"
        )
    if 0 in array.shape:
        raise GridError(f"{said} has the shape {array.shape}: it must not be empty")
    check_size(path, array.shape)
    with np.errstate(over="ignore"):
        return np.ascontiguousarray(array, np.float32)
