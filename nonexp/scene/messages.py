"""What is wrong with a scene, in one sentence."""

from __future__ import annotations

from collections.abc import Mapping

from .. import models
from ..system import insides

__all__ = ["SceneError", "explain"]


class SceneError(ValueError):
    """A scene cannot be loaded; the message is one sentence for the user."""


def explain(error: BaseException, parameters: Mapping[str, str] | None = None) -> str:
    """One sentence out of an exception that Mitsuba raised while loading or rendering.

    Drops source positions in Mitsuba, and Python tracebacks down to the last cause; keeps the
    place in the scene file.
    """
    text = insides.SOURCE_POSITION.sub("", str(error)).strip() or type(error).__name__
    places = insides.SCENE_POSITION.findall(text)
    place = f"{places[-1][0]}, line {places[-1][1]}: " if places else ""
    causes = list(insides.PYTHON_CAUSE.finditer(text))
    if causes and "Traceback (most recent call last)" in text:
        text = text[causes[-1].end() :]
    elif match := insides.UNUSED_PROPERTY.search(text):
        plugin, name, value = match.groups()
        text = f"{plugin} has no parameter {name!r}, given as {value}: remove it or correct it"
        model = models.registry.get(plugin.removeprefix("transmittance_"))
        fields = ", ".join(getattr(model, "__dataclass_fields__", ()))
        text += f" (its parameters are {fields})" if fields else ""
    elif match := insides.UNKNOWN_PLUGIN.search(text):
        text = f"{match[1]} {match[2]!r} is unknown"
        if match[2].startswith("transmittance_"):
            text += f": it must be one of {', '.join(f'transmittance_{n}' for n in models.names())}"
        else:
            text += ": it must be the name of a Mitsuba or nonexp plugin"
    elif match := insides.UNUSED_PARAMETER.search(text):
        given = f"parameter {match[1]!r}, given as {match[2]!r}"
        text = f"{given}, is not used: nothing in the scene or its includes refers to it"
    text = " ".join(insides.SCENE_POSITION.sub("", text).split())
    for name, value in (parameters or {}).items():
        if f'"{value}"' in text:
            text += f" (from -D {name}={value})"
    return place + text
