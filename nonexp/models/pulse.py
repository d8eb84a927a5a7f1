"""The pulse law: flights from a particle have one of a few lengths."""

from dataclasses import dataclass
from typing import Any, ClassVar

import drjit as dr

from ..numerics import filled, select
from ..transmittance import Draw, Transmittance
from ..transmittance.parameters import number, parameter, whole


@dataclass(frozen=True, eq=False)
class Pulse(Transmittance):
    """T = 2/(a+b)/n sum of (tau_i - tau)+, tau_i = a + (i+1/2)(b-a)/n: flights of n lengths.

    From a particle the next collision is at one of ``n`` optical depths, the centres of equal
    parts of [a, b], all equally likely (atoms); ``T`` is a polyline. ``n = 1`` is the linear law
    of flight length (a+b)/2; with ``a = 0`` the law tends to the quadratic one as ``n`` grows.
    """

    a: Any = parameter(
        0.0, least=0, scales=1, doc="where the flights' range begins, in optical depth"
    )
    b: Any = parameter(2.0, above=0, scales=1, doc="where it ends, greater than a")
    n: int = whole(4, least=1, most=1000, doc="number of lengths")
    examples: ClassVar[tuple[dict[str, Any], ...]] = (
        {},
        {"n": 1},
        {"a": 0.25, "b": 1.75, "n": 3},
        {"n": 32},
    )

    def prepare(self) -> None:
        a, b = number(self.a), number(self.b)
        if not b > a:
            raise ValueError(f"Pulse.b is {b:g}: it must be a finite number > Pulse.a = {a:g}")

    @property
    def sigma_bar(self) -> Any:
        return 2 / (self._place(0) + self._place(self.n - 1))

    @property
    def atoms(self) -> tuple[tuple[Any, Any], ...]:
        return tuple((self._place(i), 1 / self.n) for i in range(self.n))

    def ff(self, tau: Any) -> Any:
        first, last = self._place(0), self._place(self.n - 1)
        passed = self._passed(tau)
        following = self._place(dr.minimum(passed, self.n - 1))
        tau = dr.minimum(last, tau)
        return self._rest(passed) * (((following - tau) + (last - tau)) / (first + last))

    def pf(self, tau: Any) -> Any:
        return self._rest(self._passed(tau))

    def pp(self, tau: Any) -> Any:
        return filled(tau, 0.0)

    def sample_f(self, draw: Draw) -> Any:
        # A place x in [a, b] with density ~ x lies in part i with a probability ~ tau_i.
        a, u = dr.detach(self.a) / dr.detach(self.b), draw()
        x = u * (1 + a) / dr.maximum(a + dr.sqrt(a * a + u * ((1 - a) * (1 + a))), 1e-20)
        return draw() * self._place(dr.minimum(dr.floor(self.n * x), self.n - 1))

    def sample_p(self, draw: Draw) -> Any:
        return self._place(dr.floor(self.n * draw()))

    def _place(self, i: Any) -> Any:
        """Optical depth of atom ``i``; always this expression, so that depths compare equal."""
        return dr.fma(i + 0.5, (self.b - self.a) / self.n, self.a)

    def _passed(self, tau: Any) -> Any:
        """Number of atoms at or before ``tau``: one comparison, in the part that ``tau`` is in."""
        tau, a, b = dr.detach(tau), dr.detach(self.a), dr.detach(self.b)
        part = dr.floor(dr.clip((tau - a) * (self.n / (b - a)), 0, self.n - 1))
        return part + select(dr.detach(self._place(part)) <= tau, 1.0, 0.0)

    def _rest(self, passed: Any) -> Any:
        return select(passed == 0, 1.0, (self.n - passed) / self.n)
