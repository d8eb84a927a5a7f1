"""The command ``nonexp``: each of its commands is a module of its name."""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Sequence

from ..system.version import __version__
from .arguments import Parser, UserError

__all__ = ["main"]

COMMANDS = ("render", "merge", "compare", "info", "models", "plot", "fit", "bench", "doctor")

EPILOG = """\
examples:
  nonexp render scenes/dragon.xml
  nonexp render scenes/dragon.xml -D medium=gamma -D alpha=0.5 --spp 256 -o gamma.exr
  nonexp render scenes/dragon.xml --error 1% --time 2h
  nonexp render scenes/dragon.xml --error 1% --time 8h --resume
  nonexp merge a.exr b.exr -o both.exr
  nonexp compare a.exr b.exr -o difference.png
  nonexp info scenes/dragon.xml
  nonexp models
  nonexp plot gamma alpha=0.5 -o gamma.svg
  nonexp fit data.csv --model gamma --model linear -o fit.png
  nonexp doctor
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code.

    0, 1 where ``compare`` finds a difference, 2 for an error, 130 for Ctrl-C, 143 for SIGTERM.
    """
    try:
        options = _parser().parse_args(arguments)
        code: int = options.run(options)
        return code
    except UserError as error:
        print(f"nonexp: error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("nonexp: interrupted, nothing written", file=sys.stderr)
        return 130


def _parser() -> Parser:
    parser = Parser(
        prog="nonexp",
        description="Render participating media with non-exponential transmittance in Mitsuba 3.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"nonexp {__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    for name in COMMANDS:
        importlib.import_module(f"{__package__}.{name}").add(commands)
    return parser
