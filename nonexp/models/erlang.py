"""The Erlang law: a flight between particles is the sum of k exponential ones."""

from dataclasses import dataclass
from typing import Any, ClassVar

import drjit as dr

from ..numerics import log1p, with_derivative
from ..numerics.special import poisson_sum
from ..transmittance import Draw, Transmittance
from ..transmittance.parameters import parameter, whole


@dataclass(frozen=True, eq=False)
class Erlang(Transmittance):
    """T = Q(k+1, x) - x/k Q(k, x), x = rate tau: gamma-distributed flights between particles.

    ``Q`` is the regularised upper incomplete gamma function. Flights from a particle have mean
    ``k/rate`` and standard deviation ``sqrt(k)/rate``: the larger ``k``, the more regular the
    particles. ``k = 1`` is the exponential law of extinction ``rate``; as ``k`` grows the law
    tends to the linear law of ``b = k/rate``. ``k = 2`` makes transport exactly diffusive
    (d'Eon 2018).
    """

    k: Any = whole(2, least=1, most=64, doc="number of exponential steps in a flight")
    rate: Any = parameter(same_as="k", above=0, scales=-1, doc="steps per unit optical depth")
    examples: ClassVar[tuple[dict[str, Any], ...]] = (
        {},
        {"k": 1, "rate": 1.5},
        {"k": 3, "rate": 0.7},
        {"k": 20},
    )

    @property
    def sigma_bar(self) -> Any:
        return self.rate / self.k

    @property
    def jumps(self) -> tuple[tuple[Any, Any], ...] | None:
        return ()

    def ff(self, tau: Any) -> Any:
        weights = [(self.k - i) / self.k for i in range(self.k)]
        return with_derivative(
            poisson_sum(self._x(tau), weights),
            (tau, lambda t: -dr.detach(self.rate) / self.k * self._q(t)),
            (self.rate, lambda _: -dr.detach(tau) / self.k * self._q(tau)),
        )

    def pf(self, tau: Any) -> Any:
        return with_derivative(
            self._q(tau),
            (tau, lambda t: -dr.detach(self.rate) * self._step(self.k, t)),
            (self.rate, lambda _: -dr.detach(tau) * self._step(self.k, tau)),
        )

    def pp(self, tau: Any) -> Any:
        rate, x = dr.detach(self.rate), self._x(tau)

        def by_tau(t: Any) -> Any:
            if self.k == 1:
                return -(rate * rate) * self._step(1, t)
            return rate * rate * self._step(self.k - 1, t) * (1 - x / (self.k - 1))

        return with_derivative(
            rate * self._step(self.k, tau),
            (tau, by_tau),
            (self.rate, lambda _: (self.k - x) * self._step(self.k, tau)),
        )

    def sample_f(self, draw: Draw) -> Any:
        if self.k == 1:
            return self.sample_p(draw)
        return _steps(self.k + 1, draw) * draw() / self.rate

    def sample_p(self, draw: Draw) -> Any:
        return _steps(self.k, draw) / self.rate

    def _x(self, tau: Any) -> Any:
        return dr.detach(self.rate) * dr.detach(tau)

    def _q(self, tau: Any) -> Any:
        """``Q(k, x)``."""
        return poisson_sum(self._x(tau), [1.0] * self.k)

    def _step(self, k: int, tau: Any) -> Any:
        """``x^(k-1) e^-x/(k-1)!``, density of x after k steps."""
        return poisson_sum(self._x(tau), [0.0] * (k - 1) + [1.0])


def _steps(count: int, draw: Draw) -> Any:
    """Sum of ``count`` exponential variables of mean 1."""
    if count == 1:
        return -log1p(-draw())
    total: Any = 0.0
    while count:
        product = 1 - draw()  # at least 2^-23: five factors stay in the range of float32
        for _ in range(min(count, 5) - 1):
            product = product * (1 - draw())
        total = total + dr.abs(dr.log(product))
        count -= min(count, 5)
    return total
