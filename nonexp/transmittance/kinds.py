"""What every kind of parameter has in common; :mod:`.parameters` has the kinds."""

from __future__ import annotations

import dataclasses
from typing import Any

__all__ = ["Kind", "kind_of"]


@dataclasses.dataclass(frozen=True)
class Kind:
    """What a parameter may be. ``label`` in messages is ``Model.field``."""

    doc: str = ""
    """what it means, for the manual"""
    limits: str = ""
    """allowed range, for the manual"""
    same_as: str | None = None
    """name of the parameter whose value is the default"""
    differentiable: bool = False
    """its values are variables of the kernel, with derivatives; else they are part of the program
    or of tables made from them"""

    def accept(self, label: str, value: Any) -> Any:
        """The value in the form that models compute with; ``ValueError`` if it is not allowed."""
        raise NotImplementedError


def kind_of(field: dataclasses.Field[Any]) -> Kind | None:
    """The kind of a model's field; None for a field that :mod:`nonexp.parameters` did not make."""
    return field.metadata.get("kind")
