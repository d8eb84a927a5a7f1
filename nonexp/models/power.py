"""The power law of bounded support, from the linear to the exponential law."""

from dataclasses import dataclass
from typing import Any, ClassVar

import drjit as dr

from ..numerics import expm1, filled, log1p, select
from ..transmittance import Draw, Transmittance
from ..transmittance.parameters import number, parameter


class BoundedPower:
    """The formulas of ``T = (1 - tau/b)^n``, which the models that fix ``n`` share.

    Cheap where ``n`` is the Python integer 1 or 2.
    """

    b: Any
    n: Any

    @property
    def sigma_bar(self) -> Any:
        return self.n / self.b

    @property
    def atoms(self) -> tuple[tuple[Any, Any], ...]:
        if dr.is_array_v(self.n):
            return ((self.b, select(self.n == 1, 1.0, filled(self.n, 0.0))),)
        return ((self.b, 1.0),) if self.n == 1 else ()

    @property
    def kinks(self) -> tuple[Any, ...]:
        return (self.b,)

    @property
    def jumps(self) -> tuple[tuple[Any, Any], ...] | None:
        if number(self.n) == 2:
            return ((self.b, -1 / self.b),)
        return () if number(self.n) > 3 else None  # else the variance of derivatives is infinite

    def ff(self, tau: Any) -> Any:
        return self._power(tau, self.n)

    def pf(self, tau: Any) -> Any:
        return self._power(tau, self.n - 1)

    def pp(self, tau: Any) -> Any:
        if isinstance(self.n, int) and self.n == 1:
            return filled(tau, 0.0)
        return self._power(tau, self.n - 2, (self.n - 1) / self.b)

    def sample_f(self, draw: Draw) -> Any:
        return self._sample(draw, self.n)

    def sample_p(self, draw: Draw) -> Any:
        return self._sample(draw, self.n - 1)

    def _power(self, tau: Any, k: Any, factor: Any = 1.0) -> Any:
        """``factor (1 - tau/b)^k`` below ``b``, else 0. A negative ``k`` is finite below ``b``."""
        inside = tau < self.b
        if isinstance(k, int) and k == 0:
            return select(inside, factor, filled(tau, 0.0))
        tau = dr.minimum(self.b, tau)
        rest = self.b - tau
        if isinstance(k, int) and k in (1, 2):
            return factor * (rest / self.b) ** k
        # 1/(1 - tau/b) = 1 + tau/(b - tau) keeps all digits for small tau and near b.
        logarithm = -log1p(tau / select(inside, rest, self.b))
        return select(inside, factor * dr.exp(k * logarithm), 0.0)

    def _sample(self, draw: Draw, k: Any) -> Any:
        """An optical depth whose survival function is ``(1 - tau/b)^k``."""
        if isinstance(k, int) and k == 0:
            return self.b
        u = draw()
        if isinstance(k, int) and k == 1:
            return self.b * u
        if isinstance(k, int) and k == 2:
            return self.b * (u / (1 + dr.sqrt(1 - u)))  # 1 - sqrt(1-u) without cancellation
        tau = -self.b * expm1(log1p(-u) / dr.maximum(k, 1e-20))
        half_ulp = dr.epsilon(u) if dr.is_array_v(u) else 2**-53
        below = self.b * (1 - half_ulp)  # a flight of length b itself would have density 0
        return select(k > 0, dr.minimum(tau, below), self.b)


@dataclass(frozen=True, eq=False)
class Power(BoundedPower, Transmittance):
    """T = (1 - tau/b)^n up to tau = b, then 0: from even spacing to independent particles.

    ``n = 1`` is the linear law (all flights from a particle have length ``b``, an atom), ``n = 2``
    the quadratic one (they are uniform on [0, b]). With ``b = n``, the default, which makes the
    mean extinction 1, the law tends to the exponential one as ``n`` grows. Between 1 and 2 the
    density of the next collision grows without bound towards ``b``.
    """

    n: Any = parameter(2.0, least=1, doc="exponent: the larger, the less ordered the particles")
    b: Any = parameter(above=0, same_as="n", scales=1, doc="longest flight, in optical depth")
    examples: ClassVar[tuple[dict[str, Any], ...]] = (
        {},
        {"n": 1.5},
        {"n": 5.0, "b": 2.0},
        {"n": 1e4},
    )
