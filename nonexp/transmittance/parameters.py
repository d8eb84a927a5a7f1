"""Kinds of parameters that a transmittance model can have, as fields of its dataclass.

A kind says what is allowed, turns what a user gives (also the strings of scene files) into the one
form that the model computes with, and tells the Mitsuba texture how to carry it.
"""

from __future__ import annotations

import dataclasses
import math
import os
import re
from collections.abc import Iterable
from numbers import Real
from typing import Any

import drjit as dr

from .contract import Transmittance
from .functions import load_function
from .kinds import Kind, kind_of, number, parameters_of, single

__all__ = [
    "Components",
    "Function",
    "Kind",
    "Number",
    "Text",
    "Vector",
    "Whole",
    "check",
    "components",
    "describe",
    "function",
    "kind_of",
    "number",
    "parameter",
    "parameters_of",
    "text",
    "vector",
    "whole",
]

_REQUIRED = dataclasses.MISSING


@dataclasses.dataclass(frozen=True)
class _Range:
    """Finite numbers greater than ``above``, from ``least`` to ``most``."""

    above: float = -math.inf
    least: float = -math.inf
    most: float = math.inf

    def __contains__(self, value: float) -> bool:
        return self.above < value < math.inf and self.least <= value <= self.most

    def __str__(self) -> str:
        if self.most < math.inf:
            if self.above > -math.inf:
                return f"in ({self.above:g}, {self.most:g}]"
            return f"in [{self.least:g}, {self.most:g}]"
        if self.above > -math.inf:
            return f"> {self.above:g}"
        return f">= {self.least:g}" if self.least > -math.inf else ""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Number(Kind):
    """A finite real number, or a Dr.Jit array that holds one."""

    range: _Range = _Range()
    differentiable: bool = True

    def accept(self, label: str, value: Any) -> Any:
        _check(label, value, self.range)
        return _own(value)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Whole(Kind):
    """A whole number: part of the program, so that another one means another kernel."""

    range: _Range = _Range()

    def accept(self, label: str, value: Any) -> int:
        plain = single(value)
        if (
            isinstance(plain, bool)
            or not isinstance(plain, Real)
            or not (float(plain).is_integer() and float(plain) in self.range)
        ):
            shown = f"{float(plain):g}" if isinstance(plain, Real) else repr(plain)
            low, high = self.range.least, self.range.most
            raise ValueError(f"{label} is {shown}: it must be a whole number {low:g} to {high:g}")
        return int(float(plain))


@dataclasses.dataclass(frozen=True, kw_only=True)
class Vector(Kind):
    """Finite real numbers; from a sequence, a Dr.Jit or NumPy array, or a string "0.2, 1.8"."""

    range: _Range = _Range()
    differentiable: bool = True

    def accept(self, label: str, value: Any) -> tuple[Any, ...]:
        items = _items(label, value, self.range)
        for position, item in enumerate(items):
            _check(f"{label}[{position}]", item, self.range)
        if self.differentiable:
            return tuple(_own(item) for item in items)
        return tuple(map(number, items))


@dataclasses.dataclass(frozen=True, kw_only=True)
class Text(Kind):
    """A string, or what the model itself makes of it."""

    is_file: bool = False
    """it names a file: scenes look for it where they look for meshes"""

    def accept(self, label: str, value: Any) -> Any:
        if not isinstance(value, (str, os.PathLike)):
            raise ValueError(f"{label} is {value!r}: it must be a string")
        return os.fspath(value)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Function(Kind):
    """A Python function, or the string ``module:function`` that names it."""

    def accept(self, label: str, value: Any) -> Any:
        return value if callable(value) else load_function(label, value)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Components(Kind):
    """Other transmittance models, in order."""

    def accept(self, label: str, value: Any) -> tuple[Any, ...]:
        if isinstance(value, Transmittance):
            value = (value,)
        if not isinstance(value, Iterable) or isinstance(value, str):
            raise ValueError(f"{label} is {value!r}: it must be a sequence of models")
        models = tuple(value)
        for position, model in enumerate(models):
            if not isinstance(model, Transmittance):
                raise ValueError(f"{label}[{position}] is {model!r}: it must be a model")
        if not models:
            raise ValueError(f"{label} is empty: it must hold at least one model")
        return models


# --------------------------------------------------------------------------------------------------


def parameter(
    default: Any = _REQUIRED,
    *,
    above: float = -math.inf,
    least: float = -math.inf,
    most: float = math.inf,
    same_as: str | None = None,
    scales: int = 0,
    scene_name: str | None = None,
    doc: str = "",
) -> Any:
    """A finite real parameter greater than ``above``, within [``least``, ``most``].

    Making a model with a value outside raises ``ValueError`` with the name, the value and the
    allowed range. A Dr.Jit array passes if it holds one such number. ``same_as`` names the
    parameter whose value is taken where none is given.

    ``scales`` says how the parameter depends on the unit of optical depth: 1 as a length, -1 as an
    extinction or a rate, 0 (the default) not at all. Declare it for all parameters of a law or for
    none: with other units of depth the law must be the same one, of scaled parameters. Fits then
    know that ``sigma_t`` would only repeat that scale; without it no scale is assumed.

    ``scene_name`` is the name in scenes and for ``models.create``, if not the field's.
    """
    allowed = _Range(above, least, most)
    kind = Number(doc=doc, limits=str(allowed), scene_name=scene_name, range=allowed)
    return _field(default, dataclasses.replace(kind, same_as=same_as, scales=scales))


def whole(default: int, *, least: int, most: int, doc: str = "") -> Any:
    """A whole number from ``least`` to ``most``. Each value makes a kernel of its own."""
    allowed = _Range(least=least, most=most)
    return _field(default, Whole(doc=doc, limits=f"{least} to {most}", range=allowed))


def vector(
    default: Any = _REQUIRED,
    *,
    above: float = -math.inf,
    least: float = -math.inf,
    most: float = math.inf,
    differentiable: bool = True,
    scales: int = 0,
    relative: bool = False,
    scene_name: str | None = None,
    doc: str = "",
) -> Any:
    """Any number of finite reals, each in the range; a tuple of scalars in the model.

    In scene files it is a string, ``"0.2, 1.8"``. With ``differentiable=False`` they become plain
    floats, for models that make tables of them. An empty default means: not given. ``relative``
    says that only the ratios of the numbers count, as of weights; ``scales`` and ``scene_name``
    are those of :func:`parameter`.
    """
    allowed = _Range(above, least, most)
    kind = Vector(doc=doc, limits=str(allowed), scene_name=scene_name, range=allowed)
    kind = dataclasses.replace(kind, scales=scales, relative=relative)
    return _field(default, dataclasses.replace(kind, differentiable=differentiable))


def text(default: Any = "", *, is_file: bool = False, doc: str = "") -> Any:
    """A string, perhaps a file's name, which the model checks itself."""
    return _field(default, Text(doc=doc, is_file=is_file))


def function(default: Any = _REQUIRED, *, scene_name: str | None = None, doc: str = "") -> Any:
    """A Python function, or its name as ``module:function``."""
    return _field(default, Function(doc=doc, scene_name=scene_name))


def components(default: Any = _REQUIRED, *, doc: str = "") -> Any:
    """Other models, in order; in scenes nested ``transmittance_<model>`` textures."""
    return _field(default, Components(doc=doc))


def describe(field: dataclasses.Field[Any]) -> str:
    """A model's field for its manual: ``alpha = 2 (> 0): shape of the distribution``."""
    kind, default = kind_of(field), field.default
    if kind is None:
        return field.name
    name = kind.scene_name or field.name
    if kind.same_as is not None:
        shown = f" = {kind.same_as}"
    elif isinstance(kind, Components) and isinstance(default, tuple):
        shown = f" = {', '.join(type(model).__name__.lower() for model in default)}"
    elif isinstance(default, (tuple, list)):
        shown = f" = {', '.join(f'{value:g}' for value in default)}" if default else ""
    elif isinstance(default, Real):
        shown = f" = {float(default):g}"
    else:
        shown = f" = {default}" if default else ""
    limits = f" ({kind.limits})" if kind.limits else ""
    return f"{name}{shown}{limits}: {kind.doc}"


def check(
    label: str,
    value: Any,
    *,
    above: float = -math.inf,
    least: float = -math.inf,
    most: float = math.inf,
) -> None:
    """Raise ``ValueError`` unless ``value`` is one finite number in the range.

    For arguments that are no fields; ``label`` is what the message calls the argument.
    """
    _check(label, value, _Range(above, least, most))


# --------------------------------------------------------------------------------------------------


def _field(default: Any, kind: Kind) -> Any:
    if kind.same_as is not None:
        default = None
    metadata = {"kind": kind}
    if default is _REQUIRED:
        # Required parameters may follow optional ones: the model reports what is missing.
        return dataclasses.field(default=None, metadata={**metadata, "required": True})
    return dataclasses.field(default=default, metadata=metadata)


def _own(value: Any) -> Any:
    """A checked number as models compute with it: scalars of NumPy do not mix with Dr.Jit."""
    if dr.is_array_v(value) or type(value) in (int, float):
        return value
    return number(value)


def _check(label: str, value: Any, allowed: _Range) -> None:
    plain = single(value)
    words = f"a finite number {allowed}".rstrip()
    if isinstance(plain, bool) or not isinstance(plain, Real):
        raise ValueError(f"{label} is {value!r}: it must be {words}")
    if float(plain) not in allowed:
        raise ValueError(f"{label} is {float(plain):g}: it must be {words}")


def _items(label: str, value: Any, allowed: _Range) -> tuple[Any, ...]:
    words = f"numbers {allowed}".rstrip() + ', as in "0.2, 1.8"'
    if isinstance(value, str):
        try:
            return tuple(float(word) for word in re.split(r"[\s,;]+", value.strip()) if word)
        except ValueError:
            raise ValueError(f"{label} is {value!r}: it must be {words}") from None
    if dr.is_array_v(value) and dr.depth_v(value) == 1 and dr.is_dynamic_v(value):
        index = dr.uint32_array_t(type(value))
        return tuple(dr.gather(type(value), value, index(i)) for i in range(len(value)))
    if isinstance(value, Real) and not isinstance(value, bool):
        return (value,)
    if hasattr(value, "tolist"):
        value = value.tolist()
    if not isinstance(value, Iterable):
        raise ValueError(f"{label} is {value!r}: it must be {words}")
    return tuple(value)
