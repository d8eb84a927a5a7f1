"""The command ``nonexp``: one module for each of its commands."""

from .app import COMMANDS, main, parse

__all__ = ["COMMANDS", "main", "parse"]
