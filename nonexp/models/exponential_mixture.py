"""The exponential mixture: extinction is one of a few values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import drjit as dr

from ..numerics import log1p, select
from ..transmittance import Draw, Transmittance
from ..transmittance.choice import pick, require_extinction, weights
from ..transmittance.parameters import check, number, vector

# Below this float32 has no normal numbers. Its reciprocal stands for infinity, because
# zero times infinity would be NaN.
_VANISHING = 1e-37


@dataclass(frozen=True, eq=False)
class ExponentialMixture(Transmittance):
    """T = sum w_i exp(-sigma_i tau), sum w_i = 1: extinction is one of a few values.

    The mean transmittance of classical media of extinction ``sigma_i``, each taken with probability
    ``w_i``: ``weight[i]`` over the sum of all weights, which are equal where none are given. The
    tail is that of the smallest ``sigma_i``; a ``sigma_i`` of 0 is a share of vacuum, where nothing
    collides. Exponential where all ``sigma_i`` are the same. No atoms.

    :meth:`double` makes the double exponential, :meth:`levermore` the law of a random medium of
    two materials.
    """

    sigma: Any = vector(
        (0.2, 1.8), least=0, scales=-1, doc="extinctions, relative to that of the medium"
    )
    weight: Any = vector(
        (), least=0, relative=True, doc="relative weight of each extinction; equal if not given"
    )
    examples: ClassVar[tuple[dict[str, Any], ...]] = (
        {},
        {"sigma": (0.05, 1.0, 8.0), "weight": (1.0, 2.0, 1.0)},
        {"sigma": (2.0, 0.0), "weight": (3.0, 1.0)},
        {"sigma": (1.5,)},
    )

    @classmethod
    def double(cls, sigma0: Any, sigma1: Any) -> ExponentialMixture:
        """Double exponential: two extinctions of equal weight."""
        return cls((sigma0, sigma1))

    @classmethod
    def levermore(cls, sigma0: Any, sigma1: Any, chord0: Any, chord1: Any) -> ExponentialMixture:
        """Mean transmittance of a binary Markov mixture (Levermore & Pomraning).

        Two materials of extinction ``sigma0`` and ``sigma1`` alternate along a ray in chords whose
        lengths are independent and exponentially distributed with means ``chord0`` and ``chord1``
        (in the unit of which the extinctions are reciprocals). A ray starts in material i with
        the probability of its share of the volume, ``chord_i / (chord0 + chord1)``.

        Raises ``ValueError`` for a negative extinction, a chord that is not positive, and if both
        extinctions are 0.
        """
        for i, (sigma, chord) in enumerate(((sigma0, chord0), (sigma1, chord1))):
            check(f"ExponentialMixture.levermore: sigma{i}", sigma, least=0)
            check(f"ExponentialMixture.levermore: chord{i}", chord, above=0)

        # Flux I_i in material i: I_i' = -sigma_i I_i - I_i/chord_i + I_j/chord_j. The exponents
        # are the eigenvalues; the weights follow from T(0) = 1 and -T'(0) = mean. Written such
        # that no difference cancels.
        share0, share1 = chord0 / (chord0 + chord1), chord1 / (chord0 + chord1)
        mean = share0 * sigma0 + share1 * sigma1
        partner = share1 * sigma0 + share0 * sigma1 + 1 / chord0 + 1 / chord1
        coupling = share0 * share1 * dr.square(sigma0 - sigma1)
        gap = partner - mean
        root = dr.sqrt(dr.square(gap) + 4 * coupling)
        fast = (mean + partner + root) / 2
        slow = (sigma0 * sigma1 + sigma0 / chord1 + sigma1 / chord0) / fast
        large = (dr.abs(gap) + root) / 2
        small = coupling / large
        return cls((slow, fast), (select(gap > 0, large, small), select(gap > 0, small, large)))

    def prepare(self) -> None:
        object.__setattr__(self, "weight", weights(self, self.weight, "sigma"))
        require_extinction(self)

    @property
    def sigma_bar(self) -> Any:
        return sum(self._rates) / sum(self.weight)

    @property
    def extinctions(self) -> tuple[Any, Any]:
        weight = [number(w) for w in self.weight]
        return [number(s) for s in self.sigma], [w / sum(weight) for w in weight]

    @property
    def jumps(self) -> tuple[tuple[Any, Any], ...] | None:
        return ()

    def ff(self, tau: Any) -> Any:
        return self._mean(self.weight, tau) / sum(self.weight)

    def pf(self, tau: Any) -> Any:
        return self._mean(self._rates, tau) / sum(self._rates)

    def pp(self, tau: Any) -> Any:
        squares = [rate * s for rate, s in zip(self._rates, self.sigma, strict=True)]
        return self._mean(squares, tau) / sum(self._rates)

    def sample_f(self, draw: Draw) -> Any:
        return _flight(draw, pick(draw, self.weight, self.sigma))

    def sample_p(self, draw: Draw) -> Any:
        return _flight(draw, pick(draw, self._rates, self.sigma))

    @property
    def _rates(self) -> list[Any]:
        return [w * s for w, s in zip(self.weight, self.sigma, strict=True)]

    def _mean(self, factors: Any, tau: Any) -> Any:
        tau = select(tau > 1 / _VANISHING, 1 / _VANISHING, tau)
        return sum(f * dr.exp(-s * tau) for f, s in zip(factors, self.sigma, strict=True))


def _flight(draw: Draw, sigma: Any) -> Any:
    collides = sigma > _VANISHING
    return select(collides, -log1p(-draw()) / dr.maximum(sigma, _VANISHING), dr.inf)
