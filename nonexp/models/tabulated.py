"""The tabulated law: measured or computed transmittance."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar
from zipfile import BadZipFile

import numpy as np

from ..transmittance.parameters import text, vector
from ..transmittance.piecewise import Curve, Piecewise, hermite

# Tables in single precision are convex, or straight, only up to this.
_ROUNDING = 2e-7


@dataclass(frozen=True, eq=False)
class Tabulated(Piecewise):
    """T = a convex curve through given points (tau, ff), from a file or from two vectors.

    A file is text with two columns, tau and ff, separated by commas or blanks (``#`` starts a
    comment, one line of headings may stand first), or an NPZ archive with arrays ``tau`` and
    ``ff``. Rows ascend in tau; (0, 1) is added in front if it is missing.

    The curve goes through all points (to single precision), falls, is convex, and has a continuous
    slope: pf is continuous and piecewise linear, pp piecewise constant; samples follow the curve
    exactly. Straight rows stay straight; else slopes at the points are geometric means of those of
    the chords, weighted by distance. With spacing h of a smooth law the errors of ff and pf fall
    about as h^3 and h^2. Where another knot is needed between two points to stay convex, it is
    added (Schumaker 1983). After the last row T goes on as an exponential; with T = 0 there the law
    ends, with an atom if it ends with a slope (straight tables: the linear law); and T = T(inf)
    from where the table has become flat.

    Tables that rise or are not convex, by more than 2e-7 in ff, are refused (``ValueError`` with
    the row): smooth noisy measurements first. The extinction ``sigma_bar`` is the slope of the
    curve at 0: it is known as well as rows near 0 tell it.
    """

    filename: Any = text(is_file=True, doc="file with the columns tau and ff")
    tau: Any = vector((), least=0, differentiable=False, doc="optical depths, instead of a file")
    ff: Any = vector((), differentiable=False, doc="transmittance at these depths")
    examples: ClassVar[tuple[dict[str, Any], ...]] = (
        {"tau": (0.125, 0.25, 0.5, 1.0, 2.0, 4.0), "ff": (0.875, 0.75, 0.52, 0.25, 0.06, 0.004)},
        {"tau": (0.0, 0.5, 1.0, 2.0), "ff": (1.0, 0.75, 0.5, 0.0)},
        {"tau": (0.1, 0.35, 0.5, 1.0, 3.0), "ff": (0.7, 0.4, 0.3, 0.1, 0.0)},
    )

    def fit(self) -> Curve:
        if bool(self.filename) == bool(self.tau or self.ff):
            raise ValueError("Tabulated needs either a filename or both tau and ff")
        if self.filename:
            label = f"Tabulated.filename is {self.filename!r}"
            rows, tau, ff = _read(label, self.filename)
        else:
            label = "Tabulated.ff"
            rows, tau, ff = _entries(label, self.tau, self.ff)
        return _curve(*_checked(label, rows, tau, ff))

    def prepare(self) -> None:
        super().prepare()
        object.__setattr__(self, "ff", _Column(self.ff, super().ff))


class _Column(tuple):  # type: ignore[type-arg]
    """The parameter ff, which is called like the law: both are ``model.ff``."""

    law: Any

    def __new__(cls, values: tuple[float, ...], law: Any) -> _Column:
        column = super().__new__(cls, values)
        column.law = law
        return column

    def __call__(self, tau: Any) -> Any:
        return self.law(tau)


# ------------------------------------------------------------------------------- reading


def _read(label: str, filename: str) -> tuple[list[str], Any, Any]:
    """Names of the rows, tau, ff."""
    path = Path(filename)
    if not path.exists():
        raise ValueError(f"{label}: there is no such file")
    try:
        if path.suffix.lower() == ".npz":
            with np.load(path, allow_pickle=False) as archive:
                columns = {name: np.array(archive[name], dtype=float) for name in archive}
        else:
            content = path.read_text(encoding="utf-8-sig")
    except (OSError, BadZipFile, EOFError, TypeError, ValueError) as error:
        words = "a text file of two columns, or an archive named .npz of number arrays"
        raise ValueError(f"{label}: it must be {words} ({error})") from None
    if path.suffix.lower() != ".npz":
        return _lines(label, content)
    if not {"tau", "ff"} <= set(columns):
        found = ", ".join(columns) or "none"
        raise ValueError(f"{label}: its arrays are {found}: it must hold tau and ff")
    return _entries(label, columns["tau"], columns["ff"])


def _entries(label: str, tau: Any, ff: Any) -> tuple[list[str], Any, Any]:
    tau, ff = np.asarray(tau, dtype=float), np.asarray(ff, dtype=float)
    if tau.ndim != 1 or tau.shape != ff.shape:
        shapes = [" x ".join(map(str, column.shape)) for column in (tau, ff)]
        raise ValueError(f"{label}: tau has {shapes[0]} entries and ff {shapes[1]}: one row each")
    return [f"row {i + 1}" for i in range(len(tau))], tau, ff


def _lines(label: str, content: str) -> tuple[list[str], Any, Any]:
    rows: list[str] = []
    values: list[tuple[float, float]] = []
    headings = False
    for number, line in enumerate(content.splitlines(), 1):
        words = [word for word in re.split(r"[\s,;]+", line.partition("#")[0]) if word]
        if not words:
            continue
        try:
            tau, ff = map(float, words)
        except ValueError:
            if rows or headings or any(map(_is_number, words)):
                raise ValueError(
                    f"{label}: line {number} is {line.strip()!r}: it must hold two numbers"
                ) from None
            headings = True
            continue
        rows.append(f"line {number}")
        values.append((tau, ff))
    columns = np.array(values, dtype=float).reshape(-1, 2).T
    return rows, columns[0], columns[1]


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


# ------------------------------------------------------------------------------- checking


def _checked(label: str, rows: list[str], tau: Any, ff: Any) -> tuple[Any, Any]:
    """The table from (0, 1) on, convex to the last bit, without what follows its end."""

    def refuse(i: Any, words: str) -> None:
        raise ValueError(f"{label}: {rows[i]} has ff = {ff[i]:.9g} at tau = {tau[i]:.9g}: {words}")

    for i in np.flatnonzero(~(np.isfinite(tau) & np.isfinite(ff))):
        refuse(i, "both must be finite")
    for i in np.flatnonzero((ff < 0) | (ff > 1)):
        refuse(i, "ff must be in [0, 1]")
    for i in np.flatnonzero((tau < 0) | ((tau > 0) & (tau < 1e-18)) | (tau > 1e18)):
        refuse(i, "tau must be 0, or in [1e-18, 1e18]")
    for i in np.flatnonzero(np.diff(tau) <= 0) + 1:
        refuse(i, f"tau must be greater than in {rows[i - 1]}, where it is {tau[i - 1]:.9g}")
    if len(tau) and tau[0] == 0 and ff[0] < 1 - _ROUNDING:
        refuse(0, "at tau = 0 it must be 1")
    for i in np.flatnonzero(np.diff(ff) > _ROUNDING) + 1:
        refuse(i, f"it must not be above {rows[i - 1]}, where it is {ff[i - 1]:.9g}")

    start = 1 if len(tau) and tau[0] == 0 else 0
    x = np.append(0, tau[start:])
    y = np.minimum.accumulate(np.append(1, ff[start:]))
    if len(tau) < 2:
        raise ValueError(f"{label}: there are {len(tau)} rows: there must be at least 2")
    hull = _hull(x, y)
    excess = y - np.interp(x, x[hull], y[hull])
    worst = int(np.argmax(excess))
    if excess[worst] > _ROUNDING:
        straight = y[worst] - excess[worst]
        refuse(
            worst - 1 + start,
            f"the table must be convex, which here allows at most {straight:.9g} "
            "(the straight line between rows around it)",
        )
    if y[-1] == 1:
        raise ValueError(f"{label}: ff is 1 in all rows: use the model constant")
    return x, y - excess


def _hull(x: Any, y: Any) -> list[int]:
    """Corners of the lower convex hull, from the first point to the last."""
    corners: list[int] = []
    for i in range(len(x)):
        while len(corners) > 1:
            a, b = corners[-2:]
            if (y[b] - y[a]) * (x[i] - x[b]) <= (y[i] - y[b]) * (x[b] - x[a]):
                break
            corners.pop()
        corners.append(i)
    return corners


# ------------------------------------------------------------------------------- the curve


def _curve(tau: Any, ff: Any) -> Curve:
    """The curve through a convex table that starts with (0, 1)."""
    nothing = np.flatnonzero(ff <= 0)
    count = nothing[0] + 1 if len(nothing) else len(ff)
    tau, ff = tau[:count], ff[:count]
    width = np.diff(tau)
    chord = np.minimum.accumulate(-np.diff(ff) / width)
    same = np.diff(chord) >= -1e-9 * chord[:-1]
    straight = np.append(same, False) | np.append(False, same)

    slope = np.empty(count)
    share = width[1:] / (width[:-1] + width[1:])
    slope[1:-1] = chord[:-1] ** share * chord[1:] ** (1 - share)
    only_left, only_right = straight[:-1] & ~straight[1:], straight[1:] & ~straight[:-1]
    slope[1:-1] = np.where(only_left, chord[:-1], np.where(only_right, chord[1:], slope[1:-1]))
    # Ends: the same law of growth goes on; a table that reaches 0 ends with a parabola.
    if count > 2:
        growth = chord[0] / max(chord[1], 1e-3 * chord[0])
        slope[0] = chord[0] * min(growth ** (1 - share[0]), 2)
    else:
        slope[0] = chord[0] if ff[-1] == 0 else -np.log(ff[-1]) / width[0]
    if straight[-1] or (count == 2 and ff[-1] == 0):
        slope[-1] = chord[-1]
    elif ff[-1] > 0:
        slope[-1] = min(chord[-1], ff[-1] * np.log(ff[-2] / ff[-1]) / width[-1])
    else:
        slope[-1] = max(chord[-1] - (chord[-2] - chord[-1]) * share[-1], 0)
    slope = np.minimum.accumulate(slope)

    flat = np.flatnonzero(slope <= 0)
    count = flat[0] + 1 if len(flat) else count
    return hermite(tau[:count], ff[:count], slope[:count])
