"""The command ``nonexp``: one module for each of its commands."""

from .main import COMMANDS, _parser, main

__all__ = ["COMMANDS", "_parser", "main"]
