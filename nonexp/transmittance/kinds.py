"""What all kinds of parameters have in common; the kinds are in :mod:`.parameters`."""

from __future__ import annotations

import dataclasses
from typing import Any

import drjit as dr

__all__ = ["Kind", "kind_of", "number", "parameters_of", "single"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Kind:
    """What a parameter may be. ``label`` in messages is ``Model.parameter``."""

    doc: str = ""
    """what it means, for the manual"""
    limits: str = ""
    """allowed range, for the manual"""
    same_as: str | None = None
    """name of the parameter whose value is the default"""
    differentiable: bool = False
    """its values are variables of the kernel, with derivatives; else they are part of the program
    or of tables made from them"""
    scene_name: str | None = None
    """the parameter's name in scenes and for ``models.create``, where the field has another"""
    scales: int = 0
    """how it depends on the unit of optical depth: 1 as a length, -1 as an extinction, 0 not at
    all; ``ff(s tau; p) = ff(tau; p s^-scales)`` if all parameters of the law follow suit"""
    relative: bool = False
    """only the ratios of its values count, as of weights"""

    def accept(self, label: str, value: Any) -> Any:
        """The value in the form that models compute with; ``ValueError`` if it is not allowed."""
        raise NotImplementedError


def kind_of(field: dataclasses.Field[Any]) -> Kind | None:
    """The kind of a model's field; None for a field that :mod:`nonexp.parameters` did not make."""
    return field.metadata.get("kind")


def parameters_of(model: Any) -> dict[str, dataclasses.Field[Any]]:
    """The fields of a model, or of its class, by the names that scenes use."""
    named = {}
    for field in dataclasses.fields(model):
        kind = kind_of(field)
        named[(kind and kind.scene_name) or field.name] = field
    return named


def single(value: Any) -> Any:
    """The number in a Dr.Jit or NumPy array of width 1; anything else as it is."""
    if dr.is_array_v(value) and len(value) == 1:
        return dr.detach(value)[0]
    if not dr.is_array_v(value) and getattr(value, "shape", None) in ((), (1,)):
        return value.item()
    return value


def number(value: Any) -> float:
    """A number, or the one in an array of width 1, as a float without derivatives."""
    return float(single(value))
