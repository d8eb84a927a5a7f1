"""Collisions along a ray through two materials that alternate in exponential chords.

A Markov process: in material i collisions happen at rate ``sigma[i]``, and the material ends at
rate ``1/chord[i]``. With

    Q = [[-(sigma0 + 1/chord0), 1/chord0], [1/chord1, -(sigma1 + 1/chord1)]]

``exp(Q t)[i, j]`` is the probability to be in j at distance t, not having collided, from i at 0.
Both eigenvalues of Q are real, and every entry is a sum of positive terms: nothing cancels.

A *start* is 0 for a point that knows nothing of the material, which is i with the probability
``chord[i] / (chord0 + chord1)``, or 1 + i for a point in material i.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from . import expm1, log1p, select

__all__ = ["Alternation"]


@dataclass
class Alternation:
    """The process for two extinctions and mean chords, of Python floats or Dr.Jit arrays.

    Chords must be within [1e-30, 1e30]; distances may be infinite.
    """

    sigma: tuple[Any, Any]
    rate: tuple[Any, Any]
    """at which each material ends"""
    share: tuple[Any, Any]
    """of the volume, of each material"""
    slow: Any
    """lesser eigenvalue of -Q"""
    fast: Any
    """greater eigenvalue of -Q"""
    gap: Any
    """their difference"""
    lasting: tuple[Any, Any]
    """weight of the slow exponential in ``exp(Q t)[i, i]``, of the fast one in the other entry"""

    @classmethod
    def of(cls, sigma: tuple[Any, Any], chord: tuple[Any, Any]) -> Alternation:
        """The process for mean chords in the unit of which extinctions are reciprocals."""
        total = chord[0] + chord[1]
        share = chord[0] / total, chord[1] / total
        rate = 1 / chord[0], 1 / chord[1]
        geometric = dr.sqrt(rate[0]) * dr.sqrt(rate[1])
        excess = (sigma[0] - sigma[1]) + (rate[0] - rate[1])
        # Not the square root of a sum of squares, which overflow.
        larger = dr.maximum(dr.abs(excess), 2 * geometric)
        ratio = dr.minimum(dr.abs(excess), 2 * geometric) / larger
        gap = larger * dr.sqrt(1 + ratio * ratio)
        fast = ((sigma[0] + sigma[1]) + (rate[0] + rate[1]) + gap) / 2
        slow = sigma[0] * ((sigma[1] + rate[1]) / fast) + sigma[1] * (rate[0] / fast)
        # (sigma_i + rate_i - slow) / gap: their sum is 1, their product (geometric / gap)^2.
        most = (1 + dr.abs(excess) / gap) / 2
        least = (geometric / gap) * ((geometric / gap) / most)
        lasting = select(excess > 0, least, most), select(excess > 0, most, least)
        return cls(sigma, rate, share, slow, fast, gap, lasting)

    def mean_extinction(self, start: Any) -> Any:
        """Density of a collision right at a start."""
        weight = self._weights(start)
        return weight[0] * self.sigma[0] + weight[1] * self.sigma[1]

    def survival(self, start: Any, t: Any) -> Any:
        """Probability that no collision happens up to a distance."""
        first, second = self._row(start, t)
        return (first + second) * dr.exp(-self._decay(t))

    def density(self, start: Any, end: Any, t: Any) -> Any:
        """Density of the first collision at a distance, in material ``end`` (0 or 1)."""
        first, second = self._row(start, t)
        probability = select(end == 1, second, first) * dr.exp(-self._decay(t))
        return select(end == 1, self.sigma[1], self.sigma[0]) * probability

    def flight(self, start: Any, u: Any, u_fast: Any, u_slow: Any) -> Any:
        """Distance of the first collision, from random numbers in [0, 1).

        Any phase-type law of two states is that of an exponential step of the fast eigenvalue, and
        after it, with some probability, another one of the slow eigenvalue. The density at 0 tells
        the probability.
        """
        done = u * self.fast < self.mean_extinction(start)
        ends = self.slow > 0
        step = select(ends, -log1p(-u_slow) / select(ends, self.slow, 1.0), dr.inf)
        return -log1p(-u_fast) / self.fast + select(done, 0.0, step)

    def material(self, start: Any, t: Any, u: Any) -> Any:
        """Whether a first collision at a distance is one in the second material."""
        first, second = self._row(start, t)
        first, second = first * (self.sigma[0] / self.fast), second * (self.sigma[1] / self.fast)
        return u * (first + second) >= first

    def _weights(self, start: Any) -> tuple[Any, Any]:
        return (
            select(start == 0, self.share[0], select(start == 1, 1.0, 0.0)),
            select(start == 0, self.share[1], select(start == 2, 1.0, 0.0)),
        )

    def _decay(self, t: Any) -> Any:
        return select(self.slow > 0, self.slow * t, 0.0)  # zero times infinity is not a number

    def _row(self, start: Any, t: Any) -> tuple[Any, Any]:
        """Probabilities to be in each material, not having collided, over the slow exponential."""
        weight, gone, rest = self._weights(start), -expm1(-self.gap * t), dr.exp(-self.gap * t)
        kept = (
            self.lasting[0] + self.lasting[1] * rest,
            self.lasting[1] + self.lasting[0] * rest,
        )
        changed = self.rate[0] / self.gap * gone, self.rate[1] / self.gap * gone
        return (
            weight[0] * kept[0] + weight[1] * changed[1],
            weight[0] * changed[0] + weight[1] * kept[1],
        )
