"""The identity of a render: two renders with equal identities are the same image, bit for bit."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from importlib import metadata
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..system import insides
from ..system.version import __version__

__all__ = ["differences", "digest", "of_scene", "versions"]


def of_scene(scene: mi.Scene, integrator: Any = None) -> dict[str, Any]:
    """Identity of a scene in memory: checksums of its parameters and of its description.

    The parameters are all that ``mi.traverse`` finds, meshes and textures included. The
    description is what ``print`` shows of the scene and the integrator, without addresses and
    without the sampler's number of samples. What appears in neither is not covered, such as the
    code of a Python function.
    """
    integrator = scene.integrator() if integrator is None else integrator
    with dr.suspend_grad():
        parameters = mi.traverse(scene)
        names = insides.anonymous([str(name) for name in parameters.keys()])
        values = {
            name: _hash(_bytes(parameters[key]))
            for name, key in zip(names, parameters.keys(), strict=True)
        }
        options = {
            name: value
            for name, value in sorted(getattr(integrator, "__dict__", {}).items())
            if isinstance(value, (bool, int, float, str)) and not name.startswith("_")
        }
        description = insides.described(scene, integrator)
    return {
        "integrator": type(integrator).__name__,
        "options": options,
        "description": _hash(description.encode()),
        "values": values,
    }


def versions() -> dict[str, str]:
    """Versions of the packages, and of LLVM where it is used: other ones may round differently."""
    found = {"nonexp": __version__, **{n: metadata.version(n) for n in ("mitsuba", "drjit")}}
    if (mi.variant() or "").startswith("llvm"):
        found["llvm"] = ".".join(map(str, dr.detail.llvm_version()))
    return found


def digest(identity: Mapping[str, Any]) -> str:
    """Checksum of an identity: equal identities have equal checksums."""
    return _hash(json.dumps(identity, sort_keys=True).encode())


def differences(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """How two identities differ, one phrase for each difference.

    >>> differences({"seed": 1, "files": {"a.ply": "4f"}}, {"seed": 2, "files": {"a.ply": "e0"}})
    ['seed was 1, is 2', 'file a.ply has changed']
    """
    phrases = []
    for name in dict.fromkeys((*before, *now)):
        old, new = before.get(name), now.get(name)
        if all(isinstance(value, Mapping | None) for value in (old, new)):
            old, new, label = old or {}, new or {}, name.removesuffix("s")
            for key in dict.fromkeys((*old, *new)):
                phrases += _difference(f"{label} {key}", old.get(key), new.get(key))
        else:
            phrases += _difference(name, old, new)
    return phrases


def _difference(label: str, old: Any, new: Any) -> list[str]:
    """A phrase if two values differ; checksums are not shown."""
    if old == new:
        return []
    if label.startswith(("file ", "value ", "description")):
        what = "is new" if old is None else "is gone" if new is None else "has changed"
        return [f"{label} {what}"]
    return [f"{label} was {_shown(old)}, is {_shown(new)}"]


def _shown(value: Any) -> str:
    if value is None:
        return "not given"
    return "x".join(map(str, value)) if isinstance(value, list) else str(value)


def _hash(data: bytes) -> str:
    return hashlib.blake2b(data, digest_size=16).hexdigest()


def _bytes(value: Any) -> bytes:
    """The contents of a parameter of a scene, with its type and shape."""
    try:
        array = np.array(getattr(value, "matrix", value))
    except (TypeError, ValueError, RuntimeError):
        array = np.array(None)
    if array.dtype == object:
        return insides.anonymous([repr(value)])[0].encode()
    return f"{array.dtype} {array.shape} ".encode() + array.tobytes()
