"""What several commands share: kinds of arguments, scenes, and errors of one sentence."""

from __future__ import annotations

import contextlib
import importlib
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any

import mitsuba as mi
from cyclopts import Parameter

from ..scene.load import LoadedScene
from ..scene.load import load as load_scene
from ..scene.messages import explain
from ..system.machine import check_variant
from ..system.terminal import note

__all__ = [
    "Definitions",
    "Pairs",
    "Scene",
    "UserError",
    "Variant",
    "argument",
    "definition",
    "load",
    "one_of",
    "one_sentence",
    "only_one",
    "size",
    "whole",
]

_HAS_METAVAR = "metavar" in Parameter.__init__.__annotations__  # not before cyclopts 5


class UserError(Exception):
    """What the user has to change; the message is one sentence."""


@contextlib.contextmanager
def one_sentence() -> Iterator[None]:
    """Turn an error within the block into one sentence for the user."""
    try:
        yield
    except (ValueError, TypeError, OSError, RuntimeError, ImportError, MemoryError) as error:
        raise UserError(explain(error)) from error


def argument(
    metavar: str,
    parse: Callable[[str], Any] | None = None,
    *names: str,
    many: bool = False,
    **more: Any,
) -> Parameter:
    """An argument of a command: what help calls its value, and what understands the text.

    ``parse`` raises ``ValueError`` for text that is not allowed; ``many`` takes all of them.
    """

    def understood(text: str, name: str) -> Any:
        assert parse is not None
        try:
            return parse(text)
        except ValueError as error:
            raise UserError(f"{name} {re.sub(r'^[a-z]+ (?=is )', '', str(error))}") from None

    def convert(_type: Any, tokens: Any) -> Any:
        values = [understood(token.value, token.keyword or metavar) for token in tokens]
        return tuple(values) if many else values[-1]

    if parse is not None:
        more |= {"converter": convert, "n_tokens": 1, "accepts_keys": False}
    if _HAS_METAVAR:
        more["metavar"] = metavar
    return Parameter(name=names or None, **more)


# --------------------------------------------------------------------- kinds of arguments


def only_one(group: Any) -> None:
    """Raise :class:`UserError` where several arguments of a group are given."""
    given = [argument.name for argument in group if argument.tokens]
    if len(given) > 1:
        raise UserError(f"{' and '.join(given)} exclude each other: give one of them")


def whole(low: int, high: int = 2**31 - 1) -> Callable[[str], int]:
    """A whole number from ``low`` to ``high``."""

    def parse(text: str) -> int:
        if not re.fullmatch(r"[+-]?[0-9]{1,18}", text) or not low <= int(text) <= high:
            raise ValueError(f"is {text!r}: it must be a whole number from {low} to {high}")
        return int(text)

    return parse


def size(text: str) -> tuple[int, int]:
    """WIDTHxHEIGHT in pixels."""
    match = re.fullmatch(r"([0-9]{1,5})x([0-9]{1,5})", text)
    if match is None or not all(1 <= int(extent) <= 16384 for extent in match.groups()):
        raise ValueError(
            f"is {text!r}: it must be WIDTHxHEIGHT in pixels, from 1 to 16384 each, as in 640x480"
        )
    return int(match[1]), int(match[2])


def one_of(*allowed: str) -> Callable[[str], str]:
    """One of a few words."""

    def parse(text: str) -> str:
        if text not in allowed:
            raise ValueError(f"is {text!r}: it must be {' or '.join(allowed)}")
        return text

    return parse


def definition(example: str) -> Callable[[str], tuple[str, str]]:
    """A pair key=value."""

    def parse(text: str) -> tuple[str, str]:
        name, equals, value = text.partition("=")
        if not equals or not re.fullmatch(r"\w+", name):
            raise ValueError(f"is {text!r}: it must be key=value, as in {example}")
        return name, value

    return parse


# --------------------------------------------------------------------- scenes

Pairs = tuple[tuple[str, str], ...]

Scene = Annotated[Path, argument("SCENE.xml", help="Mitsuba scene file")]
Variant = Annotated[
    str | None, argument("V", help="Mitsuba variant (default: cuda_ad_rgb or llvm_ad_rgb)")
]
Definitions = Annotated[
    Pairs,
    argument(
        "key=value",
        definition("medium=gamma"),
        "-D",
        many=True,
        help="parameter of the scene file, such as medium=gamma; may be repeated",
    ),
]


def load(
    scene: Path, variant: str | None, parameters: Pairs, size: tuple[int, int] | None = None
) -> LoadedScene:
    """The scene in the variant asked for; warns if its integrator ignores its media's laws."""
    with one_sentence():
        mi.set_variant(check_variant(variant))
        mi.set_log_level(mi.LogLevel.Error)
        loaded = load_scene(scene, dict(parameters), size)
    counterpart = loaded.exponential_counterpart()
    if counterpart:
        note(
            f"warning: integrator {counterpart} shows its exponential counterpart "
            "(the scene holds a nonexp medium): use nonexp_volpath to see its own transmittance"
        )
    needs = importlib.import_module("nonexp.integrators.needs")
    for sensor, medium in needs.forgotten_media(loaded.scene):
        note(
            f"warning: sensor {sensor.id()!r} stands in the medium {medium.id()!r} without "
            "referring to it: its rays start in vacuum"
        )
    return loaded
