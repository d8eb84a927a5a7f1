"""Laws whose transmittance is piecewise quadratic, with an exponential tail.

Between knots ``t_0 = 0 < ... < t_n`` the transmittance is C1, quadratic and convex; so pf is
continuous and piecewise linear, pp piecewise constant. After the last knot it falls as
``T_n exp(-(tau - t_n) s_n/T_n)``, ``s = -T'``, again C1. Where the slope has died out
(``s_n = 0 < T_n``) that is a plateau, ``T(inf) = T_n``; where ``T`` ends with a slope
(``T_n = 0 < s_n``) there is an atom of probability ``s_n/s_0`` at ``t_n``.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import drjit as dr
import numpy as np

from ..numerics import select
from ..numerics.lookup import Table
from . import Draw, Transmittance

__all__ = ["Curve", "Piecewise", "hermite"]

_FARTHEST = 3e38  # finite in either precision
_LEAST = 1e-37  # not subnormal in either
_MOST_JUMPS = 1e4  # of pp, in all, times their depths; 1 to 2 where pp falls


@dataclass(frozen=True, eq=False)
class Curve:
    """A piecewise quadratic, convex, falling function on [0, t_n] that starts at 1.

    ``knots``, ascending from 0, ``slope`` = -T' there, non-increasing, and ``rest`` = T(t_n) are
    given up to a common factor of the last two; knots are rounded to single precision, so that
    every precision computes with the same.
    """

    knots: Any
    slope: Any
    rest: float

    def __post_init__(self) -> None:
        rounded = np.asarray(self.knots, dtype=np.float32).astype(np.float64)
        knots, which = np.unique(rounded, return_inverse=True)
        slope: Any = np.bincount(which, self.slope) / np.bincount(which)
        slope[0], slope[-1] = self.slope[0], self.slope[-1]
        total = _accumulated(knots, slope, self.rest)[0]
        object.__setattr__(self, "knots", knots)
        object.__setattr__(self, "slope", slope / total)
        object.__setattr__(self, "rest", self.rest / total)

    @property
    def values(self) -> Any:
        """T at the knots."""
        return _accumulated(self.knots, self.slope, self.rest)

    def at(self, tau: Any) -> tuple[Any, Any]:
        """T and -T' at depths within the knots, as NumPy arrays."""
        i = np.clip(np.searchsorted(self.knots, tau, side="right") - 1, 0, len(self.knots) - 2)
        width = self.knots[i + 1] - self.knots[i]
        depth = self.knots[i + 1] - tau
        slope = self.slope[i + 1] + (self.slope[i] - self.slope[i + 1]) * (depth / width)
        return self.values[i + 1] + depth * (slope + self.slope[i + 1]) / 2, slope


def hermite(tau: Any, ff: Any, slope: Any) -> Curve:
    """The curve with given values and slopes at given depths.

    Where one quadratic does not meet both ends of an interval, a knot is added inside (Schumaker
    1983), placed in the middle of the range in which the curve stays convex. ``slope`` must not
    rise, and each chord must lie between the slopes at its ends (a chord beyond them by rounding is
    taken as equal to one).
    """
    width = np.diff(tau)
    chord = -np.diff(ff) / width
    left, right = slope[:-1], slope[1:]
    span = left - right
    share = np.clip((chord - right) / np.where(span > 0, span, 1), 0, 1)
    ends = np.asarray(tau, dtype=np.float32)
    low, high = np.nextafter(ends[:-1], np.inf), np.nextafter(ends[1:], -np.inf)
    inner = np.clip((tau[:-1] + share * width).astype(np.float32), low, high).astype(np.float64)
    bent = np.abs(share - 0.5) * span > 1e-13 * chord
    i = np.flatnonzero(bent & (inner > tau[:-1]) & (inner < tau[1:]))
    portion = ((inner - tau[:-1]) / width)[i]
    middle = 2 * chord[i] - portion * left[i] - (1 - portion) * right[i]
    middle = np.clip(middle, right[i], left[i])
    return Curve(np.insert(tau, i + 1, inner[i]), np.insert(slope, i + 1, middle), float(ff[-1]))


class _Tables(NamedTuple):
    """A curve and its tail as kernels look them up, and the depths where pp jumps."""

    knots: Table
    pieces: Table
    by_ff: Table
    by_pf: Table
    whole: Table
    kinks: tuple[float, ...]
    jumps: tuple[tuple[float, float], ...]


class Piecewise(Transmittance):
    """Base of models that are a :class:`Curve` and its exponential tail.

    The numbers of the curve are data of the kernel, not part of it: curves whose numbers of knots
    round up to the same power of two share one.
    """

    @abstractmethod
    def make_curve(self) -> Curve:
        """The curve, from the model's parameters; ``ValueError`` if they allow none."""

    def prepare(self) -> None:
        _ = self._tables  # made now: errors belong to construction

    @cached_property
    def _curve(self) -> Curve:
        return self.make_curve()

    @cached_property
    def _tables(self) -> _Tables:
        # The first piece is halved: next to 0 it is expanded about 0, where T = 1 exactly. All
        # others are expanded about their right ends, so that only positive terms are added.
        curve = self._curve
        knots = np.insert(curve.knots, 1, curve.knots[1] / 2)
        slope = np.insert(curve.slope, 1, (curve.slope[0] + curve.slope[1]) / 2)
        ff, pf = _accumulated(knots, slope, curve.rest), slope / slope[0]
        width, fall = np.diff(knots), -np.diff(slope) / slope[0]
        end, rest, last = knots[-1], ff[-1], slope[-1]
        fading = rest > 0 and last > 0
        rate = last / rest if fading else 0.0

        # Centre, width towards the other end, pf and its rise towards there, ff, pp.
        pieces = np.zeros((len(knots), 6))
        pieces[:-1] = np.stack([knots[1:], width, pf[1:], fall, ff[1:], fall / width], axis=1)
        pieces[0, :5] = 0, -width[0], 1, -fall[0], 1
        pieces[-1] = end, 1, pf[-1] if fading else 0, 0, rest, rate * pf[-1]
        whole = [slope[0], end, rest, pf[-1], rate, 1 / rate if fading else 0.0]
        jumps = np.flatnonzero(np.diff(pieces[:, 5]) != 0) + 1
        jumps = jumps[jumps > 1]
        heights = np.diff(pieces[:, 5])[jumps - 1]
        kinks = {*knots[jumps].tolist(), *(where for where, _ in _atoms(curve))}
        return _Tables(
            knots=Table(knots[:, None]),
            pieces=Table(pieces),
            by_ff=Table(-ff[:, None]),
            by_pf=Table(-pf[:, None]),
            whole=Table([whole]),
            kinks=tuple(sorted(kinks)),
            jumps=tuple(zip(knots[jumps].tolist(), heights.tolist(), strict=True)),
        )

    @property
    def sigma_bar(self) -> Any:
        return float(self._curve.slope[0])

    @property
    def atoms(self) -> tuple[tuple[Any, Any], ...]:
        return _atoms(self._curve)

    @property
    def kinks(self) -> tuple[Any, ...]:
        return self._tables.kinks

    @property
    def jumps(self) -> tuple[tuple[Any, Any], ...] | None:
        # Ramps between neighbouring numbers are as good as atoms.
        total = sum(where * abs(height) for where, height in self._tables.jumps)
        return None if self.atoms or total > _MOST_JUMPS else self._tables.jumps

    def ff(self, tau: Any) -> Any:
        depth, part, fade, (pf, rise, ff, _) = self._at(tau)
        return (ff + self._sigma_bar_for(tau) * depth * (pf + rise * (0.5 * part))) * fade

    def _sigma_bar_for(self, tau: Any) -> Any:
        return self._tables.whole.row(tau, 0)[0]

    def pf(self, tau: Any) -> Any:
        _, part, fade, (pf, rise, _, _) = self._at(tau)
        return (pf + rise * part) * fade

    def pp(self, tau: Any) -> Any:
        _, _, fade, (_, _, _, pp) = self._at(tau)
        return pp * fade

    def sample_f(self, draw: Draw) -> Any:
        u = draw()
        left = 1 - u
        sigma_bar, end, rest, _, _, mean = self._tables.whole.row(u, 0)
        centre, width, pf, rise, ff, _ = self._tables.pieces.row(u, self._tables.by_ff.find(-left))
        # rise/2 part^2 + pf part = area/(sigma_bar width), in units of pf at the far end
        far = dr.maximum(pf + rise, _LEAST)
        near, area = pf / far, (left - ff) / (sigma_bar * width) / far
        root = dr.sqrt(dr.maximum(near * near + 2 * (rise / far) * area, 0))
        inside = _within(centre, width, 2 * area, near + root)
        beyond = end + mean * dr.log(dr.maximum(rest, _LEAST) / left)
        beyond = select(mean > 0, beyond, math.inf)
        return select(u > 0, select(left > rest, inside, beyond), 0)

    def sample_p(self, draw: Draw) -> Any:
        u = draw()
        left = 1 - u
        _, end, _, last, _, mean = self._tables.whole.row(u, 0)
        centre, width, pf, rise, _, _ = self._tables.pieces.row(u, self._tables.by_pf.find(-left))
        inside = _within(centre, width, dr.abs(left - pf), dr.abs(rise))
        beyond = end + mean * dr.log(dr.maximum(last, _LEAST) / left)
        return select(left > last, inside, beyond)

    def _at(self, tau: Any) -> tuple[Any, Any, Any, tuple[Any, ...]]:
        """Distance before the centre of the piece, in its widths too, fading of the tail, the rest
        of the piece."""
        _, end, _, _, rate, _ = self._tables.whole.row(tau, 0)
        centre, width, *piece = self._tables.pieces.row(tau, self._tables.knots.find(tau))
        before = tau < end
        depth = select(before, centre - tau, 0)
        fade = dr.exp(-rate * select(before, 0, dr.minimum(tau - end, _FARTHEST)))
        return depth, depth / width, fade, tuple(piece)


def _within(centre: Any, width: Any, over: Any, under: Any) -> Any:
    """The point of a piece that lies over/under widths from its centre."""
    return centre - width * dr.minimum(over / dr.maximum(under, _LEAST), 1)


def _accumulated(knots: Any, slope: Any, rest: float) -> Any:
    """T at the knots: the rest, and the areas under the slope from the last knot backwards."""
    areas = np.diff(knots) * (slope[:-1] + slope[1:]) / 2
    return np.cumsum(np.append(rest, areas[::-1]))[::-1]


def _atoms(curve: Curve) -> tuple[tuple[float, float], ...]:
    if curve.rest > 0 or curve.slope[-1] <= 0:
        return ()
    return ((float(curve.knots[-1]), float(curve.slope[-1] / curve.slope[0])),)
