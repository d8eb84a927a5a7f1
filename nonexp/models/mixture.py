"""The mixture of other models."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ..transmittance import Draw, Transmittance
from ..transmittance.choice import pick, replayed, require_extinction, weights
from ..transmittance.parameters import components, number, vector
from .constant import Constant
from .exponential import Exponential
from .exponential_mixture import ExponentialMixture
from .gamma import Gamma
from .linear import Linear
from .quadratic import Quadratic


@dataclass(frozen=True, eq=False)
class Mixture(Transmittance):
    """T = sum w_i T_i, sum w_i = 1: some places follow one law, some another.

    ``w_i`` is ``weight[i]`` over the sum of all weights, which are equal where none are given.
    Models of any kind may be mixed, mixtures and vacuum (``constant``) included; together they need
    a positive mean extinction. ``sigma_bar = sum w_i sigma_bar_i``: a flight from a particle
    follows model i with probability ``w_i sigma_bar_i / sigma_bar``, since there are more
    collisions in the models of higher extinction. Atoms and kinks are those of all models.

    The blend of an exponential and a linear law of Vicini et al. 2021 is the mixture of
    ``exponential`` and ``linear`` with ``b=2``. To mix flights instead, ``pf = sum u_i pf_i``, give
    the models weights ``u_i / sigma_bar_i``.
    """

    models: Any = components((Exponential(), Linear()), doc="what is mixed")
    weight: Any = vector(
        (), least=0, relative=True, doc="relative weight of each model; equal if not given"
    )
    examples: ClassVar[tuple[dict[str, Any], ...]] = (
        {},
        {"models": (Exponential(), Linear(2.0)), "weight": (1.0, 3.0)},
        {"models": (Gamma(0.5), Quadratic(), Linear(2.0), Linear(0.5))},
        {"models": (ExponentialMixture(), Linear(3.0), Constant()), "weight": (2.0, 1.0, 1.0)},
    )

    def prepare(self) -> None:
        object.__setattr__(self, "weight", weights(self, self.weight, "models"))
        require_extinction(self)

    @property
    def sigma_bar(self) -> Any:
        return sum(self._rates) / sum(self.weight)

    @property
    def atoms(self) -> tuple[tuple[Any, Any], ...]:
        merged: dict[float, tuple[Any, Any]] = {}
        for rate, model in zip(self._rates, self.models, strict=True):
            for where, probability in model.atoms:
                _, before = merged.get(number(where), (where, 0.0))
                after = before + rate * probability / sum(self._rates)
                merged[number(where)] = where, after
        return tuple(merged[where] for where in sorted(merged))

    @property
    def kinks(self) -> tuple[Any, ...]:
        merged = {number(kink): kink for model in self.models for kink in model.kinks}
        return tuple(merged[where] for where in sorted(merged))

    @property
    def extinctions(self) -> tuple[Any, Any] | None:
        found = [model.extinctions for model in self.models]
        if None in found:
            return None
        shares = np.array([number(w) for w in self.weight])
        weights = [s * np.array(w) for s, (_, w) in zip(shares / shares.sum(), found, strict=True)]
        return np.concatenate([s for s, _ in found]), np.concatenate(weights)

    @property
    def jumps(self) -> tuple[tuple[Any, Any], ...] | None:
        merged: list[tuple[Any, Any]] = []
        for rate, model in zip(self._rates, self.models, strict=True):
            if number(rate) == 0:
                continue
            if model.jumps is None:
                return None
            merged += [(where, rate / sum(self._rates) * height) for where, height in model.jumps]
        return tuple(merged)

    def ff(self, tau: Any) -> Any:
        return _mean(self.weight, [model.ff(tau) for model in self.models])

    def pf(self, tau: Any) -> Any:
        return _mean(self._rates, [model.pf(tau) for model in self.models])

    def pp(self, tau: Any) -> Any:
        return _mean(self._rates, [model.pp(tau) for model in self.models])

    def sample_f(self, draw: Draw) -> Any:
        numbers = replayed(draw)
        return pick(draw, self.weight, [m.sample_f(numbers()) for m in self.models])

    def sample_p(self, draw: Draw) -> Any:
        numbers = replayed(draw)
        return pick(draw, self._rates, [m.sample_p(numbers()) for m in self.models])

    @property
    def _rates(self) -> list[Any]:
        return [w * m.sigma_bar for w, m in zip(self.weight, self.models, strict=True)]


def _mean(weight: Any, values: Any) -> Any:
    return sum(w * v for w, v in zip(weight, values, strict=True)) / sum(weight)
