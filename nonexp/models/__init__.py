"""The transmittance models: one file each, found by its name.

Every module of this package that defines a :class:`~nonexp.transmittance.Transmittance` is a model
whose key is the file's name. A class of your own joins them through :func:`register`.

>>> import nonexp
>>> cloud = nonexp.models.create("gamma", alpha=2.0)
>>> round(cloud.ff(1.0), 4)
0.4444
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable
from typing import Any

from ..transmittance import Transmittance
from ._notation import to_dict, to_xml
from ._registry import create, names, on_register, register, registry

__all__ = ["create", "fit", "names", "on_register", "register", "registry", "to_dict", "to_xml"]

fit: Callable[..., Any]
"""Least-squares fit of a model to a transmittance: :func:`nonexp.fit`, which stands above."""


def _register_package() -> None:
    for info in pkgutil.iter_modules(__path__):
        module = importlib.import_module(f"{__name__}.{info.name}")
        for value in vars(module).values():
            if (
                isinstance(value, type)
                and issubclass(value, Transmittance)
                and value.__module__ == module.__name__
            ):
                register(value)


_register_package()
