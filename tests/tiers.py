"""Which tests are quick: all but those marked thorough, which ``pytest --quick`` leaves out.

Repetitions marked full run only with ``pytest --full``: cases beside others of their kind.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import pytest

THOROUGH = pytest.mark.thorough


FULL = (pytest.mark.full, THOROUGH)


def full(*values: Any, several: bool = False) -> list[Any]:
    """Values that are tested only with --full, each of one parameter or of ``several``."""
    return [pytest.param(*(value if several else [value]), marks=FULL) for value in values]


def thorough(*values: Any, several: bool = False) -> list[Any]:
    """Values with which a test is not quick, each of one parameter or of ``several``."""
    return [pytest.param(*(value if several else [value]), marks=THOROUGH) for value in values]


def quick(values: Iterable[Any], chosen: Callable[[Any], bool], several: bool = False) -> list[Any]:
    """Values of which only the chosen ones make a quick test."""
    return [v if chosen(v) else thorough(v, several=several)[0] for v in values]
