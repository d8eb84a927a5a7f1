"""What several commands share: kinds of arguments, scenes, and errors of one sentence."""

from __future__ import annotations

import argparse
import contextlib
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from ..system.terminal import note

if TYPE_CHECKING:
    from ..scene.load import LoadedScene

__all__ = [
    "Parser",
    "UserError",
    "add_scene",
    "definition",
    "duration",
    "fraction",
    "load",
    "one_sentence",
    "size",
    "whole",
]


class UserError(Exception):
    """What the user has to change; the message is one sentence."""


class Parser(argparse.ArgumentParser):
    """Reports bad usage as one line, under the name of the command itself."""

    def error(self, message: str) -> NoReturn:
        message = re.sub(r"^argument (\S+): ", r"\1 ", message)
        raise UserError(f"{message} (see {self.prog} --help)")


@contextlib.contextmanager
def one_sentence() -> Iterator[None]:
    """Turn what goes wrong inside into one sentence for the user."""
    try:
        yield
    except (ValueError, TypeError, OSError, RuntimeError, ImportError, MemoryError) as error:
        from ..scene.messages import explain

        raise UserError(explain(error)) from error


# --------------------------------------------------------------------- scenes


def add_scene(command: argparse.ArgumentParser) -> None:
    """A scene file with its parameters, and the variant to load it in."""
    command.add_argument("scene", type=Path, metavar="SCENE.xml", help="Mitsuba scene file")
    command.add_argument(
        "--variant", metavar="V", help="Mitsuba variant (default: cuda_ad_rgb or llvm_ad_rgb)"
    )
    command.add_argument(
        "-D",
        dest="parameters",
        type=definition("medium=gamma"),
        action="append",
        default=[],
        metavar="key=value",
        help="parameter of the scene file, such as medium=gamma; may be repeated",
    )


def load(options: argparse.Namespace, size: tuple[int, int] | None = None) -> LoadedScene:
    """The scene in the variant asked for; warns if its integrator ignores its media's laws."""
    import mitsuba as mi

    from ..scene import load as scenefile
    from ..system import machine

    with one_sentence():
        mi.set_variant(machine.check_variant(options.variant))
        mi.set_log_level(mi.LogLevel.Error)
        loaded = scenefile.load(options.scene, dict(options.parameters), size)
    counterpart = loaded.exponential_counterpart()
    if counterpart:
        note(
            f"warning: integrator {counterpart} shows its exponential counterpart "
            "(the scene holds a nonexp medium): use nonexp_volpath to see its own transmittance"
        )
    return loaded


# --------------------------------------------------------------------- kinds of arguments


def whole(low: int, high: int = 2**31 - 1) -> Any:
    """A whole number from ``low`` to ``high``."""

    def parse(text: str) -> int:
        if not re.fullmatch(r"[+-]?[0-9]{1,18}", text) or not low <= int(text) <= high:
            raise argparse.ArgumentTypeError(
                f"is {text!r}: it must be a whole number from {low} to {high}"
            )
        return int(text)

    return parse


def size(text: str) -> tuple[int, int]:
    """WIDTHxHEIGHT in pixels."""
    match = re.fullmatch(r"([0-9]{1,5})x([0-9]{1,5})", text)
    if match is None or not all(1 <= int(extent) <= 16384 for extent in match.groups()):
        raise argparse.ArgumentTypeError(
            f"is {text!r}: it must be WIDTHxHEIGHT in pixels, from 1 to 16384 each, as in 640x480"
        )
    return int(match[1]), int(match[2])


def definition(example: str) -> Any:
    """A pair key=value."""

    def parse(text: str) -> tuple[str, str]:
        name, equals, value = text.partition("=")
        if not equals or not re.fullmatch(r"\w+", name):
            raise argparse.ArgumentTypeError(f"is {text!r}: it must be key=value, as in {example}")
        return name, value

    return parse


def duration(text: str) -> float:
    """A time in seconds, from text such as 90, 90s, 10m, 2h30m or 1.5d."""
    number = r"\d+(?:\.\d+)?"
    parts = re.findall(rf"({number})([dhms]|$)", text)
    value = sum(float(n) * {"d": 86400, "h": 3600, "m": 60}.get(unit, 1) for n, unit in parts)
    if not re.fullmatch(rf"(?:{number}[dhms])*(?:{number})?", text) or not 0 < value < math.inf:
        raise argparse.ArgumentTypeError(
            f"is {text!r}: it must be a time > 0, as in 90s, 10m, 2h30m or 1d"
        )
    return value


def fraction(text: str) -> float:
    """A number between 0 and 1, from text such as 1% or 0.01."""
    match = re.fullmatch(r"(\d*\.?\d+)\s*(%?)", text)
    value = float(match[1]) / (100 if match[2] else 1) if match else -1
    if not 0 < value < 1:
        raise argparse.ArgumentTypeError(
            f"is {text!r}: it must lie between 0 and 100 %, as in 1% or 0.01"
        )
    return value
