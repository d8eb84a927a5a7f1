"""The registry of models: known by key, made with checked parameters."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any, TypeVar

from ..transmittance import Transmittance
from ..transmittance.kinds import parameters_of

__all__ = ["create", "names", "on_register", "register", "registry"]

Model = TypeVar("Model", bound=type[Transmittance])

registry: dict[str, type[Transmittance]] = {}
"""Model classes by key."""

on_register: list[Callable[[str], None]] = []
"""Called with the key of each model registered from now on."""


def register(cls: Model, key: str | None = None) -> Model:
    """Make a model known under ``key`` (default: the name of the file that defines it).

    Afterwards :func:`create` makes it, and scenes name it ``transmittance_<key>``. Returns the
    class, so it also works as a decorator. Registering a key again replaces the model.

    Raises ``TypeError`` when ``cls`` is no concrete, frozen dataclass derived from
    :class:`~nonexp.transmittance.Transmittance`, ``ValueError`` when the key is no identifier.
    """
    key = cls.__module__.rpartition(".")[2] if key is None else key
    if not (isinstance(cls, type) and issubclass(cls, Transmittance)):
        raise TypeError(f"model {key!r} is {cls!r}: it must be a subclass of nonexp.Transmittance")
    if inspect.isabstract(cls):
        missing = ", ".join(sorted(cls.__abstractmethods__))
        raise TypeError(f"model {key!r} ({cls.__name__}) does not define {missing}")
    options = getattr(cls, "__dataclass_params__", None)
    if options is None or not options.frozen or options.eq:
        raise TypeError(
            f"model {key!r} ({cls.__name__}) must be a dataclass(frozen=True, eq=False)"
        )
    if not key.isidentifier():
        raise ValueError(f"model key is {key!r}: it must be a Python identifier")
    registry[key] = cls
    for listener in on_register:
        listener(key)
    return cls


def names() -> list[str]:
    """Keys of all models, sorted."""
    return sorted(registry)


def create(name: str, **parameters: Any) -> Transmittance:
    """The model called ``name`` with the given parameters (defaults for the others).

    Parameters have the names that scenes use: the fields' own, but for ``ff`` of ``custom`` and
    ``tabulated``, whose fields are ``function`` and ``values``.

    Raises ``ValueError`` for an unknown model, an unknown or missing parameter, or a value out of
    range.
    """
    try:
        cls = registry[name]
    except KeyError:
        raise ValueError(f"model is {name!r}: it must be one of {', '.join(names())}") from None
    fields = parameters_of(cls)
    for parameter in parameters:
        if parameter not in fields:
            known = ", ".join(fields) or "none"
            raise ValueError(f"{name} has no parameter {parameter!r}: its parameters are {known}")
    return cls(**{fields[parameter].name: value for parameter, value in parameters.items()})
