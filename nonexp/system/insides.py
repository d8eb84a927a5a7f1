"""Where the package reaches into the insides of Mitsuba and Dr.Jit: all of it stands here.

Only :mod:`.machine`, which works before either is imported, asks Dr.Jit for its LLVM version
itself. Each entry says what it relies on, and why. Tested with Mitsuba 3.9.1 and Dr.Jit 1.5.0;
``pyproject.toml`` admits no later Mitsuba than 3.9. The names of Mitsuba 3.10 are those of its
development branch (read at commit b518514f1e), and are tested with stand-ins only.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from typing import Any

import drjit as dr
import mitsuba as mi

__all__ = [
    "anonymous",
    "base_seed",
    "described",
    "faces",
    "flips_normals",
    "has_vertex_normals",
    "is_xyz",
    "nested",
    "normal_derivatives",
    "number_of",
    "on_variant_change",
    "variables",
    "vertex_positions",
]


# --------------------------------------------------------------------- objects and arrays


def number_of(pointer: Any) -> Any:
    """Number by which Dr.Jit knows the object that a pointer such as ``mi.ShapePtr`` stands for.

    Numbers of one type count from 1 on; 0 is the null pointer. Why: a table with one entry per
    object is read faster than pointers are compared. Relies on pointer arrays holding such numbers,
    which Dr.Jit does not promise.
    """
    return dr.reinterpret_array(mi.UInt32, pointer)


def variables(*arrays: Any) -> tuple[int, ...]:
    """Numbers of the Dr.Jit variables behind arrays or tensors: equal numbers mean equal values.

    Why: keys of caches, without reading an array back. A number is given to another variable once
    its own is gone, so a cache must hold the arrays too.
    """
    return tuple(int(getattr(array, "array", array).index) for array in arrays)


def nested(root: Any, kind: type) -> list[Any]:
    """The objects of a class that ``root`` holds at any depth, itself included.

    Relies on ``hierarchy`` of ``mi.SceneParameters``, which is not documented.
    """
    return [node for node in mi.traverse(root).hierarchy if isinstance(node, kind)]


def on_variant_change(callback: Callable[[str | None, str], None]) -> None:
    """Call a function with the old and the new variant, at every change; added once.

    Relies on ``mi.detail``, which is not documented. Mitsuba 3.10 has an entry point for plugins
    instead (``nonexp.plugins.entry``).
    """
    mi.detail.add_variant_callback(callback)


# --------------------------------------------------------------------- printed scenes

_ADDRESS = re.compile(r"object_\d{6,}|0x[0-9a-f]{6,}")
"""What stands for an object without an id in the names of parameters, and in what is printed."""


def anonymous(texts: Iterable[str]) -> list[str]:
    """Texts with the addresses of objects replaced by numbers, in the order of their appearance."""
    seen: dict[str, str] = {}

    def number(match: re.Match[str]) -> str:
        return seen.setdefault(match[0], f"object {len(seen)}")

    return [_ADDRESS.sub(number, text) for text in texts]


_SAMPLES = re.compile(r"\b(sample_count|samples_per_wavefront|wavefront_size) = .*")


def described(*objects: Any) -> str:
    """What objects show when they are printed, without addresses and numbers of samples."""
    (text,) = anonymous(["\n".join(map(str, objects))])
    return _SAMPLES.sub("", text)


def base_seed(sampler: Any) -> int:
    """The parameter ``seed`` of a sampler: some say it only where they are printed."""
    found = re.search(r"\b(?:base_)?seed = (\d+)", str(sampler))
    return int(found[1]) if found else 0


def is_xyz(film: Any) -> bool:
    """Whether a film stores CIE XYZ: it says so only where it is printed."""
    return "pixel_format = xyz" in str(film)


# --------------------------------------------------------------------- Mitsuba's error messages

SOURCE_POSITION = re.compile(r"\[\w+\.(?:cpp|h|mm):\d+\] ")
"""Position in Mitsuba's source that begins a message."""

SCENE_POSITION = re.compile(
    r"(?:At|While loading|Error while loading) (\S+) \(line (\d+), col \d+\): "
    r"(?:while processing <include>:\s)?"
)
"""Position in a scene file: (file, line)."""

PYTHON_CAUSE = re.compile(r"^(?:\w+\.)*\w*(?:Error|Exception|Warning|Interrupt): ", re.MULTILINE)
"""Beginning of the last line of a Python traceback: a plugin's own exception."""

UNUSED_PROPERTY = re.compile(
    r'Found \d+ unreferenced propert\w+ in \w+ plugin of type "(\w+)":\s+- \w+ "(\w+)": (.*)'
)
"""A parameter that a plugin does not have: (plugin, parameter, value)."""

UNUSED_PARAMETER = re.compile(r"Found unused parameters:\s+- \$(\w+)=(.*)")
"""A parameter that a scene file has and does not use: (parameter, value)."""

UNKNOWN_PLUGIN = re.compile(
    r'failed to instantiate (\w+) plugin of type "(\w+)": (?:\[\w+\] )?Plugin "\2" not found!$'
)
"""A plugin that does not exist: (kind, plugin)."""


# --------------------------------------------------------------------- names that 3.10 changes


def vertex_positions(mesh: Any) -> Any:
    """Positions of a mesh's vertices, three numbers each; :func:`faces` counts these.

    3.9: ``vertex_positions_buffer()``; 3.10: ``positions()``, a tensor of distinct positions.
    """
    if hasattr(mesh, "positions"):
        return mesh.positions().array
    return mesh.vertex_positions_buffer()


def faces(mesh: Any) -> Any:
    """Numbers of the vertices of a mesh's triangles, three each.

    3.9: ``faces_buffer()``; 3.10: ``geometric_faces()``, a tensor. There ``faces()`` counts
    vertices that differ in normals or texture coordinates too.
    """
    if hasattr(mesh, "geometric_faces"):
        return mesh.geometric_faces().array
    return mesh.faces_buffer()


def has_vertex_normals(mesh: Any) -> bool:
    """Whether a mesh interpolates normals.

    3.9: ``has_vertex_normals()``; 3.10: ``has_normals()``.
    """
    return bool(mesh.has_normals() if hasattr(mesh, "has_normals") else mesh.has_vertex_normals())


def flips_normals(shape: Any) -> bool:
    """Whether a shape turns its normals against its geometry: ``has_flipped_normals()``.

    3.10 answers False for meshes, rightly: there ``flip_normals`` turns the geometry itself (the
    order of the vertices of each face) while the mesh is loaded.
    """
    return bool(shape.has_flipped_normals())


def normal_derivatives() -> int:
    """Flag that asks for ``dn_du`` and ``dn_dv`` of the shading normal.

    3.9: ``RayFlags.dNSdUV``; 3.10: ``RayFlags.NormalPartials``.
    """
    flags: Any = mi.RayFlags
    return flags.NormalPartials if hasattr(flags, "NormalPartials") else flags.dNSdUV
