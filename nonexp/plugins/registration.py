"""Registration of the package's plugins with Mitsuba.

Plugins belong to a variant. :func:`register` makes all of them known to the variant that is set;
:func:`install` does that now and at every change of variant.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable
from functools import partial
from typing import Any

import mitsuba as mi

from .. import models
from ..system import insides, machine
from ..system.machine import supported, unsupported_reason

__all__ = ["install", "register"]

# Plugin name -> kind, module, class. The modules derive from classes of the variant.
_PLUGINS = {
    "nonexp_homogeneous": ("medium", "nonexp.plugins.medium", "NonexpHomogeneous"),
    "nonexp_heterogeneous": ("medium", "nonexp.plugins.medium", "NonexpHeterogeneous"),
    "nonexp_binary_mixture": ("medium", "nonexp.plugins.medium", "NonexpBinaryMixture"),
    "nonexp_volpath": ("integrator", "nonexp.integrators.volpath", "NonexpVolpath"),
    "nonexp_sobol": ("sampler", "nonexp.plugins.sampler", "NonexpSobol"),
}
_TEXTURE = ("nonexp.plugins.texture", "TransmittanceTexture")

# Variant -> what constructs the texture of a model from (key, Properties).
_textures: dict[str, Callable[[str, Any], Any]] = {}


def install() -> None:
    """Register the plugins with the variant that is set, and with each one set from now on."""
    insides.on_variant_change(_variant_changed)
    if _model_registered not in models.on_register:
        models.on_register.append(_model_registered)
    if mi.variant() is not None:
        register()


def register() -> None:
    """Register the plugins with the variant that is set: models at each call, the rest once."""
    variant = mi.variant()
    if variant not in _textures:
        _register_classes(variant)
    for key in models.names():
        _register_texture(variant, key)


def _register_classes(variant: str) -> None:
    refusal = _refusal(variant)
    if refusal is None:
        module, cls = _TEXTURE
        _textures[variant] = getattr(_load(module), cls)
        loaded = {module: _load(module) for _, module, _ in _PLUGINS.values()}
        for name, (kind, module, cls) in _PLUGINS.items():
            _register(kind, name, getattr(loaded[module], cls))
    else:
        _textures[variant] = lambda key, props: _refuse(f"transmittance_{key}", refusal)
        for name, (kind, _, _) in _PLUGINS.items():
            _register(kind, name, partial(_refuse, name, refusal))


def _refusal(variant: str) -> str | None:
    """Why a plugin cannot be made in this variant, here; None if it can."""
    reason = unsupported_reason(variant)
    if reason is not None:
        usable = ", ".join(v for v in mi.variants() if supported(v))
        return f"does not work in variant {variant} ({reason}): use {usable}"
    problem = machine.llvm_problem() if variant.startswith("llvm") else None
    return None if problem is None else f"cannot render in variant {variant}: {problem}"


def _variant_changed(_old: str | None, _new: str) -> None:
    register()


def _model_registered(key: str) -> None:
    if mi.variant() in _textures:
        _register_texture(mi.variant(), key)


def _register_texture(variant: str, key: str) -> None:
    make = _textures[variant]
    _register("texture", f"transmittance_{key}", lambda props: make(key, props))


def _register(kind: str, name: str, make: Callable[[Any], Any]) -> None:
    getattr(mi, f"register_{kind}")(name, make)


def _load(module: str) -> Any:
    """A module, reloaded for the variant that is set."""
    loaded = sys.modules.get(module)
    return importlib.reload(loaded) if loaded else importlib.import_module(module)


def _refuse(name: str, refusal: str, _props: Any = None) -> None:
    raise RuntimeError(f"{name} {refusal}")
