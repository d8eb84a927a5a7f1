"""Which tests are quick: all but those marked thorough, which ``pytest --quick`` leaves out.

Cases that ``repetitions.txt`` lists run only with ``pytest --full``.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import pytest

THOROUGH = pytest.mark.thorough


def repetitions() -> re.Pattern[str]:
    """What matches the ids of tests that run only with --full."""
    text = (Path(__file__).parent / "repetitions.txt").read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if line and not line.startswith("#")]
    return re.compile("|".join(re.escape(line).replace(r"\*", ".*") for line in lines))


def thorough(*values: Any, several: bool = False) -> list[Any]:
    """Values with which a test is not quick, each of one parameter or of ``several``."""
    return [pytest.param(*(value if several else [value]), marks=THOROUGH) for value in values]


def quick(values: Iterable[Any], chosen: Callable[[Any], bool], several: bool = False) -> list[Any]:
    """Values of which only the chosen ones make a quick test."""
    return [v if chosen(v) else thorough(v, several=several)[0] for v in values]
