"""Files of grids."""

from __future__ import annotations

from typing import Any


def read(path: str, field: str = "") -> tuple[Any, Any]:
    raise NotImplementedError
