"""What identifies a render: two with the same identity are the same image, bit for bit."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from importlib import metadata
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..system.version import __version__

__all__ = ["differences", "digest", "of_scene", "versions"]


def of_scene(scene: mi.Scene, integrator: Any = None) -> dict[str, Any]:
    """Identity of a scene in memory: checksums of its parameters and of its description.

    The parameters are all that ``mi.traverse`` finds (meshes and textures among them), the
    description is what ``print(scene)`` and the integrator show, without addresses and without the
    sampler's number of samples. What neither shows, such as the code of a Python function, is
    not covered.
    """
    integrator = scene.integrator() if integrator is None else integrator
    with dr.suspend_grad():
        parameters = mi.traverse(scene)
        names = _anonymous([str(name) for name in parameters.keys()])
        values = {
            name: _hash(_bytes(parameters[key]))
            for name, key in zip(names, parameters.keys(), strict=True)
        }
        options = {
            name: value
            for name, value in sorted(getattr(integrator, "__dict__", {}).items())
            if isinstance(value, (bool, int, float, str))
        }
        (text,) = _anonymous([f"{scene}\n{integrator}"])
        text = re.sub(r"\b(sample_count|samples_per_wavefront|wavefront_size) = .*", "", text)
    return {
        "integrator": type(integrator).__name__,
        "options": options,
        "description": _hash(text.encode()),
        "values": values,
    }


def versions() -> dict[str, str]:
    """Versions of what computes an image."""
    found = {"nonexp": __version__, **{n: metadata.version(n) for n in ("mitsuba", "drjit")}}
    if (mi.variant() or "").startswith("llvm"):
        found["llvm"] = ".".join(map(str, dr.detail.llvm_version()))
    return found


def digest(identity: Mapping[str, Any]) -> str:
    """One checksum of an identity."""
    return _hash(json.dumps(identity, sort_keys=True).encode())


def differences(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """What differs between the identities of two renders, one phrase each."""
    phrases = []
    for name in dict.fromkeys((*before, *now)):
        old, new = before.get(name), now.get(name)
        if old == new:
            continue
        if all(isinstance(value, Mapping | None) for value in (old, new)):
            label = name.removesuffix("s")
            for key in dict.fromkeys((*(old or {}), *(new or {}))):
                phrases += _difference(f"{label} {key}", (old or {}).get(key), (new or {}).get(key))
        else:
            phrases += _difference(name, old, new)
    return phrases


def _difference(label: str, old: Any, new: Any) -> list[str]:
    if old == new:
        return []
    if label.startswith(("file ", "value ", "description")):  # checksums
        what = "is new" if old is None else "is gone" if new is None else "has changed"
        return [f"{label} {what}"]
    return [f"{label} was {_plain(old)}, is {_plain(new)}"]


def _plain(value: Any) -> str:
    if value is None:
        return "not given"
    return "x".join(map(str, value)) if isinstance(value, list) else str(value)


def _hash(data: bytes) -> str:
    return hashlib.blake2b(data, digest_size=16).hexdigest()


def _bytes(value: Any) -> bytes:
    try:
        array = np.array(getattr(value, "matrix", value))
    except (TypeError, ValueError, RuntimeError):
        array = np.array(None)
    if array.dtype == object:
        return _anonymous([repr(value)])[0].encode()
    return f"{array.dtype} {array.shape} ".encode() + array.tobytes()


def _anonymous(texts: list[str]) -> list[str]:
    """Texts with the addresses of objects replaced by numbers, in the order of their appearance."""
    seen: dict[str, str] = {}

    def number(match: re.Match[str]) -> str:
        return seen.setdefault(match[0], f"object {len(seen)}")

    return [re.sub(r"object_\d{6,}|0x[0-9a-f]{6,}", number, text) for text in texts]
