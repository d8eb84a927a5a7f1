"""The command ``nonexp``: each of its commands is a module of its name."""

from __future__ import annotations

import importlib
import re
import sys
from collections.abc import Callable, Sequence
from inspect import BoundArguments
from typing import Any

from cyclopts import App, CycloptsError, Parameter

from ..system.version import __version__
from .arguments import UserError

__all__ = ["COMMANDS", "app", "main", "parse"]

COMMANDS = (
    "render",
    "merge",
    "compare",
    "info",
    "models",
    "plot",
    "fit",
    "cloud",
    "check",
    "validate",
    "bench",
    "doctor",
)

EXAMPLES = """\
examples:
  nonexp render scenes/dragon.xml
  nonexp render scenes/dragon.xml -D medium=gamma --spp 256 -o gamma.exr
  nonexp render scenes/dragon.xml --error 1% --time 2h
  nonexp render scenes/dragon.xml --error 1% --time 8h --resume
  nonexp merge a.exr b.exr -o both.exr
  nonexp compare a.exr b.exr -o difference.png
  nonexp info scenes/dragon.xml
  nonexp models
  nonexp plot gamma alpha=0.5 -o gamma.svg
  nonexp fit data.csv --model gamma --model linear -o fit.png
  nonexp fit scene.xml --image photo.exr -p sigma_t --model gamma --model exponential
  nonexp cloud scenes/cloud.npz
  nonexp check my_laws.py
  nonexp validate --quick
  nonexp doctor
"""


def app() -> App:
    """All commands with their arguments."""
    found = App(
        "nonexp",
        help="Render participating media with non-exponential transmittance in Mitsuba 3.",
        help_epilogue=EXAMPLES,
        help_format="plaintext",
        version=f"nonexp {__version__}",
        default_parameter=Parameter(negative=(), show_default=False, allow_repeating=True),
    )
    for place, name in enumerate(COMMANDS):
        command = getattr(importlib.import_module(f"{__package__}.{name}"), name)
        found.command(command, name=name, help_epilogue="", help_format="markdown", sort_key=place)
    return found


def parse(arguments: Sequence[str]) -> tuple[Callable[..., Any], BoundArguments]:
    """The function that does what a command line asks for, and its arguments.

    Raises :class:`UserError`.
    """
    if not arguments:
        raise UserError(f"the command is missing: it must be one of {', '.join(COMMANDS)}")
    try:
        command, bound, _ = app().parse_args(arguments, exit_on_error=False, print_error=False)
    except CycloptsError as error:
        chain = " ".join(("nonexp", *(error.command_chain or ())))
        said = re.sub(r"(?<!\.)\.$", "", " ".join(str(error).split()))
        raise UserError(f"{said} (see {chain} --help)") from None
    return command, bound


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code.

    0, 1 where ``compare`` finds a difference, ``check`` a fault or ``validate`` a deviation, 2 for
    an error, 130 for Ctrl-C, 143 for SIGTERM.
    """
    try:
        command, bound = parse(sys.argv[1:] if arguments is None else arguments)
        return command(*bound.args, **bound.kwargs) or 0
    except UserError as error:
        print(f"nonexp: error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("nonexp: interrupted, nothing written", file=sys.stderr)
        return 130
