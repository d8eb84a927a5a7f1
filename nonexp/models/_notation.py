"""A model written as the nested element of a scene: a Mitsuba dictionary, or XML."""

from __future__ import annotations

from typing import Any
from xml.sax.saxutils import quoteattr

import drjit as dr

from ..transmittance import Transmittance, parameters
from ..transmittance.kinds import kind_of, number, parameters_of
from ._registry import registry

__all__ = ["to_dict", "to_xml"]


def to_dict(model: Transmittance) -> dict[str, Any]:
    """The dictionary from which ``mi.load_dict`` makes the texture of this model.

    >>> import nonexp
    >>> nonexp.models.to_dict(nonexp.models.create("gamma", alpha=0.5))
    {'type': 'transmittance_gamma', 'alpha': 0.5}

    Raises ``ValueError`` for a model whose class is not registered, or that holds a function
    without a name that scenes could use.
    """
    scene: dict[str, Any] = {"type": f"transmittance_{_key(model)}"}
    for name, field in parameters_of(model).items():
        kind, value = kind_of(field), getattr(model, field.name)
        if isinstance(kind, parameters.Components):
            scene |= {f"model_{i}": to_dict(component) for i, component in enumerate(value)}
        elif isinstance(kind, parameters.Vector):
            if len(value):
                scene[name] = ", ".join(repr(_plain(item)) for item in value)
        elif isinstance(kind, parameters.Function):
            scene[name] = _name_of(f"{type(model).__name__}.{name}", value)
        elif isinstance(kind, parameters.Text):
            if value:
                scene[name] = value
        else:
            scene[name] = _plain(value)
    return scene


def to_xml(model: Transmittance, indent: str = "") -> str:
    """The XML element that gives a medium this model as its transmittance.

    >>> import nonexp
    >>> print(nonexp.models.to_xml(nonexp.models.create("gamma", alpha=0.5)))
    <texture type="transmittance_gamma" name="transmittance">
        <float name="alpha" value="0.5"/>
    </texture>
    """
    return "\n".join(indent + line for line in _lines(to_dict(model), "transmittance"))


def _lines(scene: dict[str, Any], name: str) -> list[str]:
    head = f"<texture type={quoteattr(scene['type'])} name={quoteattr(name)}"
    if len(scene) == 1:
        return [f"{head}/>"]
    lines = [f"{head}>"]
    for key, value in scene.items():
        if isinstance(value, dict):
            lines += ["    " + line for line in _lines(value, key)]
        elif key != "type":
            tag = {int: "integer", float: "float"}.get(type(value), "string")
            lines.append(f"    <{tag} name={quoteattr(key)} value={quoteattr(str(value))}/>")
    return [*lines, "</texture>"]


def _key(model: Transmittance) -> str:
    for key, cls in registry.items():
        if type(model) is cls:
            return key
    raise ValueError(f"{type(model).__name__} is no registered model: register it first")


def _plain(value: Any) -> int | float:
    """A Python number, as short as the precision of an array allows."""
    if type(value) is int:
        return value
    single = dr.is_array_v(value) and dr.type_v(value) == dr.VarType.Float32
    return float(f"{number(value):.9g}") if single else number(value)


def _name_of(label: str, function: Any) -> str:
    module, name = getattr(function, "__module__", ""), getattr(function, "__qualname__", "<")
    if not module or module == "__main__" or "<" in name:
        raise ValueError(f"{label} is {function!r}: only a function of a module can go in a scene")
    return f"{module}:{name}"
