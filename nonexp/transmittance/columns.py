"""Measured transmittances: reading tables of them, and checking them."""

from __future__ import annotations

import csv
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["check", "read_table"]

Array = npt.NDArray[np.float64]


def read_table(path: str | Path) -> tuple[Array, Array, Array | None]:
    """Distances (or optical depths), transmittances and, if given, their standard deviations.

    A text file has one point per line, in columns separated by commas, semicolons or blanks;
    lines that start with ``#`` and one line of titles are skipped. An NPZ file has the arrays
    ``tau`` (or ``distance``), ``ff`` and perhaps ``sigma``. The third column may be missing.

    Raises ``OSError`` or ``ValueError`` naming the file and, if it is about one, the line.
    """
    path = Path(path)
    if path.is_dir():
        raise OSError(f"{str(path)!r} is a folder: it must be a table of transmittances")
    if not path.exists():
        raise OSError(f"{str(path)!r} does not exist")
    if path.suffix.lower() == ".npz":
        return _read_npz(path)
    rows: list[list[float]] = []
    lines: list[int] = []
    for number, cells in _cells(path):
        try:
            row = [float(cell) for cell in cells]
        except ValueError:
            if not rows and not lines:
                lines.append(number)  # the titles
                continue
            wrong = next(cell for cell in cells if not _is_number(cell))
            raise ValueError(f"{path}, line {number}: {wrong!r} is not a number") from None
        wanted = (len(rows[0]),) if rows else (2, 3)
        if len(row) not in wanted:
            raise ValueError(
                f"{path}, line {number}: has {len(row)} columns, it must have "
                f"{' or '.join(map(str, wanted))} (distance, transmittance, standard deviation)"
            )
        rows.append(row)
        lines.append(number)
    if not rows:
        raise ValueError(f"{path} holds no numbers")
    lines = lines[-len(rows) :]
    tau, ff, *sigma = np.array(rows).T
    return check(tau, ff, sigma[0] if sigma else None, where=lambda i: f"{path}, line {lines[i]}: ")


def _cells(path: Path) -> Iterator[tuple[int, list[str]]]:
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise ValueError(f"{path} is not a text file (nor does its name end in .npz)") from None
    for number, line in enumerate(text.splitlines(), 1):
        line = line.strip()
        if line and not line.startswith("#"):
            separator = next((mark for mark in ";,\t" if mark in line), None)
            cells = next(csv.reader([line], delimiter=separator)) if separator else line.split()
            yield number, [cell.strip() for cell in cells]


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _read_npz(path: Path) -> tuple[Array, Array, Array | None]:
    try:
        with np.load(path) as file:
            arrays = {name: file[name] for name in file.files}
    except (ValueError, zipfile.BadZipFile, EOFError):
        raise ValueError(f"{path} is not an NPZ file of numbers") from None
    tau = next((arrays[name] for name in ("tau", "distance") if name in arrays), None)
    if tau is None or "ff" not in arrays:
        found = ", ".join(arrays) or "none"
        raise ValueError(f"{path} has the arrays {found}: it must have tau (or distance) and ff")
    try:
        return check(tau, arrays["ff"], arrays.get("sigma"), where=lambda i: f"{path}, point {i}: ")
    except ValueError as error:
        raise ValueError(str(error) if str(path) in str(error) else f"{path}: {error}") from None


def check(
    tau: Any, ff: Any, sigma: Any = None, where: Callable[[int], str] = lambda i: f"point {i}: "
) -> tuple[Array, Array, Array | None]:
    """The data as arrays of one length; ``ValueError`` where they are no transmittance.

    ``where`` begins the message about the point of that index.
    """
    columns = {"tau": tau, "ff": ff} | ({} if sigma is None else {"sigma": sigma})
    arrays: dict[str, Array] = {}
    for name, values in columns.items():
        try:
            arrays[name] = np.asarray(values, dtype=np.float64)
        except (TypeError, ValueError):
            raise ValueError(f"{name} is {values!r}: it must be a sequence of numbers") from None
    if sigma is not None and arrays["sigma"].ndim == 0:
        arrays["sigma"] = np.full(arrays["tau"].shape, arrays["sigma"])
    for name, values in arrays.items():
        if values.ndim != 1 or len(values) != len(arrays["tau"]):
            shape, wanted = values.shape, arrays["tau"].shape[:1]
            raise ValueError(f"{name} has shape {shape}: it must be {wanted or '(points,)'}")
    x, y, s = arrays["tau"], arrays["ff"], arrays.get("sigma")
    noise = 0.1 if s is None else 6 * s  # how far outside [0, 1] a measurement may lie
    for name, values, allowed, words in (
        ("tau", x, x >= 0, "a finite number >= 0"),
        ("ff", y, (y >= -noise) & (y <= 1 + noise), "a transmittance in [0, 1], but for noise"),
        ("sigma", s, s is None or s > 0, "a finite standard deviation > 0"),
    ):
        if values is not None and not np.all(good := allowed & np.isfinite(values)):
            i = int(np.argmin(good))
            raise ValueError(f"{where(i)}{name} is {values[i]:g}, it must be {words}")
    if not np.any(x > 0):
        raise ValueError("tau has no value > 0: there is nothing to fit")
    return x, y, s
