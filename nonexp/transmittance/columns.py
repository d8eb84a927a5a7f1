"""Tables of transmittances: reading them, and checking measurements.

:func:`read` is the one reader, of text and of NPZ files. What a table must obey beyond that is
up to its user: a law must be convex (``tabulated``), a measurement may be noisy
(:func:`check_measured`).
"""

from __future__ import annotations

import csv
import dataclasses
import re
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["Columns", "check_measured", "read", "read_table"]

Array = npt.NDArray[np.float64]

_MEANINGS = {
    "tau": {"tau", "depth", "distance", "length", "thickness"},
    "ff": {"ff", "transmittance", "transmission", "transmissivity"},
    "sigma": {"deviation", "err", "error", "sd", "sem", "sigma", "std", "stdev", "stderr"}
    | {"uncertainty"},
}
"""Words in titles that tell what a column is."""

_EXTINCTIONS = [["sigma", of] for of in ("t", "s", "a", "bar")]
"""Words of titles that begin like a standard deviation, and are none."""


@dataclasses.dataclass(frozen=True, eq=False)
class Columns:
    """A table in ascending order of ``tau``, as read."""

    tau: Array
    ff: Array
    sigma: Array | None
    rows: tuple[str, ...]
    """where each point stands: ``line 4`` of a text file, ``row 3`` of an array"""
    taken: str
    """which columns these are, for messages: ``tau is 'x', ff is 'y'``"""

    @staticmethod
    def of(values: Mapping[str, Any], rows: Sequence[str] = (), taken: str = "") -> Columns:
        """Sorted; ``values`` are ``tau``, ``ff`` and perhaps ``sigma``, one number or one per row.

        Raises ``ValueError`` where they are not vectors of numbers, of one length.
        """
        arrays: dict[str, Array] = {}
        for name, column in values.items():
            try:
                arrays[name] = np.asarray(column, dtype=np.float64)
            except (TypeError, ValueError):
                words = "it must be a sequence of numbers"
                raise ValueError(f"{name} is {column!r}: {words}") from None
        wanted = arrays["tau"].shape[:1]
        for name, array in arrays.items():
            if name == "sigma" and array.ndim == 0:
                array = arrays[name] = np.full(wanted, array)
            if array.ndim != 1 or array.shape != wanted:
                shape = wanted or "(points,)"
                raise ValueError(f"{name} has shape {array.shape}: it must be {shape}")
        order = np.argsort(arrays["tau"], kind="stable")
        tau, ff, sigma = (arrays[n][order] if n in arrays else None for n in ("tau", "ff", "sigma"))
        assert tau is not None and ff is not None
        names = rows or [f"row {i + 1}" for i in range(len(tau))]
        return Columns(tau, ff, sigma, tuple(names[i] for i in order), taken)


def read_table(path: str | Path) -> tuple[Array, Array, Array | None]:
    """Distances (or optical depths), transmittances and, if given, their standard deviations.

    A text file has one point per line, in columns separated by commas, semicolons, tabs or blanks,
    with decimal points, or decimal commas where no comma separates columns. Columns are found by
    words in their titles: ``tau``, ``distance``, ``depth``, ``thickness``, ``length``; ``ff``,
    ``transmittance``, ``transmission``; ``sigma``, ``stderr``, ``std``, ``error``,
    ``uncertainty``, ``deviation``; all others are then left out. Without such titles the two or
    three columns of numbers are distance, transmittance and standard deviation, in this order; an
    index, as ``DataFrame.to_csv`` writes it, and columns of text do not count. Lines that start
    with ``#`` and a row of units below the titles are skipped.

    An NPZ file has arrays of such names. Rows are returned in ascending order of distance.

    Raises ``OSError`` or ``ValueError`` naming the file and, if it is about one, the line; and
    which column was taken for what.
    """
    try:
        table = read(path)
        try:
            return check_measured(table.tau, table.ff, table.sigma, table.rows)
        except ValueError as error:
            raise ValueError(f"{error} (columns: {table.taken})") from None
    except OSError as error:
        raise OSError(f"{path}: {error}") from None
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def read(path: str | Path) -> Columns:
    """The columns of a text or NPZ file, found as in :func:`read_table`, with any numbers.

    Raises ``OSError`` where there is no such file, ``ValueError`` where it is no table, naming the
    line if they are about one, but not the file.
    """
    path = Path(path)
    if path.is_dir():
        raise OSError("it is a folder, not a table of transmittances")
    if not path.exists():
        raise OSError("there is no such file")
    return _of_archive(path) if path.suffix.lower() == ".npz" else _of_text(path)


def check_measured(
    tau: Any, ff: Any, sigma: Any = None, rows: Sequence[str] = ()
) -> tuple[Array, Array, Array | None]:
    """The data as arrays of one length, sorted; ``ValueError`` where they are no transmittance.

    ``rows`` are the names of the points in messages. Noise may take ``ff`` out of [0, 1], by 0.1
    or six standard deviations.
    """
    names = rows or [f"point {i}" for i in range(np.size(tau))]
    values = {"tau": tau, "ff": ff} | ({} if sigma is None else {"sigma": sigma})
    data = Columns.of(values, names)
    x, y, s = data.tau, data.ff, data.sigma
    noise = 0.1 if s is None else 6 * s
    for name, column, allowed, words in (
        ("tau", x, x >= 0, "a finite number >= 0"),
        ("ff", y, (y >= -noise) & (y <= 1 + noise), "a transmittance in [0, 1], but for noise"),
        ("sigma", s, s is None or s > 0, "a finite standard deviation > 0"),
    ):
        if column is not None and not np.all(good := allowed & np.isfinite(column)):
            i = int(np.argmin(good))
            raise ValueError(f"{data.rows[i]}: {name} is {column[i]:g}, it must be {words}")
    if not np.any(x > 0):
        raise ValueError("tau has no value > 0: there is nothing to fit")
    return x, y, s


# ------------------------------------------------------------------------------- files


def _of_archive(path: Path) -> Columns:
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
    except (ValueError, zipfile.BadZipFile, EOFError):
        raise ValueError("it is not an NPZ file of numbers") from None
    titles = list(arrays)
    chosen = _by_title(titles)
    if not {"tau", "ff"} <= chosen.keys():
        found = ", ".join(arrays) or "none"
        raise ValueError(f"it has the arrays {found}: it must have tau (or distance) and ff")
    values = {meaning: arrays[titles[i]] for meaning, i in chosen.items()}
    return Columns.of(values, taken=_told({m: titles[i] for m, i in chosen.items()}))


def _of_text(path: Path) -> Columns:
    content = _content(path)
    lines = list(_cells(content))
    while lines and all(len(cells) > 1 and not cells[-1] for _, cells in lines):
        lines = [(number, cells[:-1]) for number, cells in lines]  # each ends with a separator
    titles: list[str] = []
    if lines and not any(map(_is_number, lines[0][1])):
        titles = lines.pop(0)[1]
    if not lines:
        raise ValueError("it holds no numbers")
    first, width = lines[0][0], len(lines[0][1])
    if not titles:
        titles = _commented(content.splitlines()[: first - 1], width)
    units = bool(titles) and len(lines) > 1 and _is_units(lines[0][1], lines[1][1])
    lines = lines[units:]
    for number, cells in lines:
        if len(cells) != width:
            raise ValueError(f"line {number} has {len(cells)} columns, line {first} has {width}")
    columns = [[cells[i] for _, cells in lines] for i in range(width)]
    named = _counts(columns[0]) or not any(map(_is_number, columns[0]))
    if titles and len(titles) == width - 1 and named:
        titles = ["", *titles]  # R writes no title above the names of rows
    if titles and len(titles) != width:
        raise ValueError(f"line {first} has {width} columns, but there are {len(titles)} titles")

    chosen = _chosen(titles, columns, first)
    text = {meaning: columns[i] for meaning, i in chosen.items()}
    numbers: dict[str, list[float]] = {}
    for meaning, column in text.items():
        for (line, _), cell in zip(lines, column, strict=True):
            if not _is_number(cell):
                raise ValueError(f"line {line} has {cell!r} for {meaning}: it must be a number")
        numbers[meaning] = list(map(_number, column))
    every = [cell for column in text.values() for cell in column]
    if any("," in cell for cell in every) and any("." in cell for cell in every):
        raise ValueError("it has decimal points and decimal commas: it must have one of them")
    names = {m: titles[i] if titles else f"column {i + 1}" for m, i in chosen.items()}
    return Columns.of(numbers, [f"line {number}" for number, _ in lines], _told(names))


def _content(path: Path) -> str:
    data = path.read_bytes()
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:  # spreadsheets write units such as µm in one byte
        text = data.decode("latin-1")
    if re.search(r"[\x00-\x08\x0e-\x1f\x7f-\x9f]", text):
        raise ValueError("it is not a text file (nor does its name end in .npz)")
    return text


def _cells(content: str) -> Iterator[tuple[int, list[str]]]:
    """Numbers of the lines that are not empty, and their cells."""
    for number, line in enumerate(content.splitlines(), 1):
        line = line.partition("#")[0].strip(" ")
        separator = next((mark for mark in ";\t," if mark in line), None)
        cells = line.split()
        decimal = separator == "," and len(cells) > 1 and all(map(_is_number, cells))
        if separator and not decimal:
            cells = next(csv.reader([line], delimiter=separator, skipinitialspace=True))
        cells = [cell.strip().strip('"') for cell in cells]
        if any(cells):
            yield number, cells


def _commented(above: Sequence[str], width: int) -> list[str]:
    """Titles in the last comment above the numbers, as ``numpy.savetxt`` writes them."""
    comment = next((line for line in reversed(above) if line.startswith("#")), "")
    words = re.findall(r"[^\s,;#]+", comment)
    return words if len(words) == width and {"tau", "ff"} <= _by_title(words).keys() else []


# ------------------------------------------------------------------------------- cells


def _number(text: str) -> float:
    """The number in a cell, also with a decimal comma."""
    return float(re.sub(r"^([+-]?\d+),(\d+([eE][+-]?\d+)?)$", r"\1.\2", text))


def _is_number(text: str) -> bool:
    try:
        _number(text)
    except ValueError:
        return False
    return True


def _is_units(cells: Sequence[str], below: Sequence[str]) -> bool:
    """Whether the row below the titles is one of units: words (or 1) where numbers follow."""
    words = [not _is_number(cell) for cell in cells]
    plain = all(word or cell == "1" for word, cell in zip(words, cells, strict=True))
    over = zip(words, cells, below, strict=False)
    return plain and any(word and cell and _is_number(number) for word, cell, number in over)


def _counts(column: Sequence[str]) -> bool:
    """Whether a column counts the rows, from 0 or 1."""
    numbers = [_number(cell) if _is_number(cell) else np.nan for cell in column]
    return any(np.array_equal(numbers, np.arange(len(numbers)) + k) for k in (0, 1))


# ------------------------------------------------------------------------------- columns


def _chosen(titles: Sequence[str], columns: list[list[str]], first: int) -> dict[str, int]:
    """Which column is tau, which ff, and which, if there is one, the standard deviation."""
    named = _by_title(titles)
    if {"tau", "ff"} <= named.keys():
        return named
    numbers = [i for i, column in enumerate(columns) if any(map(_is_number, column))]
    numbers = [i for i in numbers if not titles or _meaning(titles[i]) != "other"]
    if numbers and _is_index(titles, columns, numbers):
        numbers = numbers[1:]
    if len(numbers) not in (2, 3):
        raise ValueError(
            f"line {first} has {len(numbers)} columns of numbers (an index does not count): there "
            "must be 2 or 3 (distance, transmittance, standard deviation), or titles tau and ff"
        )
    chosen = dict(zip(("tau", "ff", "sigma"), numbers, strict=False))
    if len(numbers) == 2 and len(named) == 1 and "sigma" not in named:
        (meaning, i), *_ = named.items()
        chosen = {m: i if m == meaning else sum(numbers) - i for m in ("tau", "ff")}
    for meaning, i in named.items():
        if chosen.get(meaning) != i:
            missing = " and ".join(m for m in ("tau", "ff") if m not in named)
            raise ValueError(
                f"column {titles[i]!r} is {meaning}, but no title says which is {missing}"
            )
    return chosen


def _by_title(titles: Sequence[str]) -> dict[str, int]:
    """The columns whose titles tell what they are."""
    found: dict[str, int] = {}
    for i, title in enumerate(titles):
        meaning = _meaning(title)
        if meaning in found:
            both = f"{titles[found[meaning]]!r} and {title!r}"
            raise ValueError(f"columns {both} could both be {meaning}: rename one of them")
        if meaning in _MEANINGS:
            found[meaning] = i
    return found


def _meaning(title: str) -> str:
    """``tau``, ``ff`` or ``sigma``; ``other`` of what is known to be none of them; else empty."""
    words = re.findall(r"[a-z0-9]+", re.sub(r"[\[(].*", "", title.lower()))  # without the unit
    meant = [meaning for meaning, known in _MEANINGS.items() if known & {*words}]
    if words in _EXTINCTIONS or {"tau", "sigma"} <= {*meant}:  # the latter: errors of a distance
        return "other"
    return meant[-1] if meant else ""


def _is_index(titles: Sequence[str], columns: list[list[str]], numbers: list[int]) -> bool:
    """Whether the first column of numbers is an index, not a distance.

    By its title, as pandas and R write it; without titles if it counts the rows, and the column
    that follows rises as no transmittance does.
    """
    index = columns[numbers[0]]
    if titles:
        whole = all(_is_number(cell) and _number(cell).is_integer() for cell in index)
        return whole and titles[numbers[0]].lower() in ("", "index", "unnamed: 0")
    if len(numbers) < 3 or len(index) < 2 or not _counts(index):
        return False
    second = [_number(cell) if _is_number(cell) else np.nan for cell in columns[numbers[1]]]
    return bool(np.all(np.diff(second) > 0))


def _told(titles: Mapping[str, str]) -> str:
    return ", ".join(f"{meaning} is {title!r}" for meaning, title in titles.items())
