"""The ensemble: extinction drawn from any law."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import drjit as dr
import numpy as np

from ..numerics import log1p, with_derivative
from ..numerics.laplace import AliasTable, LaplaceTransform
from ..numerics.quadrature import MOST_NODES, nodes_of_law
from ..transmittance import Draw, Transmittance
from ..transmittance.choice import weights
from ..transmittance.parameters import text, vector


@dataclass(frozen=True, eq=False)
class Ensemble(Transmittance):
    """T = E[exp(-S tau)] for an extinction S of any law: fluctuations from flight to flight.

    Each flight has one extinction, drawn from the law of S; ``sigma_bar = E[S]``. The law is given
    by the name of a distribution of ``scipy.stats`` and its positional arguments (shapes, then loc
    and scale), such as ``law="lognorm", args=(0.5, 0, 1)``, or by a table of values ``sigma`` with
    their ``weight`` (normalised; equal where none is given). If S has a single value the model is
    the exponential law; the more of S lies near 0, the longer the tail, and T tends to P(S = 0).
    The gamma model is the ensemble of a gamma distribution. S needs a finite mean. The mean of S^2,
    which is ``pp`` at 0 times ``sigma_bar``, may be infinite; ``pp`` is then accurate from about
    tau = 1e-8 on.

    When the model is made, a continuous law is replaced by about a thousand weighted values that
    reproduce all four functions to ten digits. Python floats are evaluated by that sum; kernels
    interpolate it to the precision of their numbers. Samplers draw one of the values, with a
    probability proportional to its weight (after a collision, to its weight times the value), then
    an exponential flight: samples follow the sum itself, not its interpolation.
    """

    law: Any = text("", doc="name of a distribution of scipy.stats")
    args: Any = vector((), differentiable=False, doc="its arguments: shapes, then loc and scale")
    sigma: Any = vector(
        (), least=0, most=1e12, differentiable=False, scales=-1, doc="values of S, if no law"
    )
    weight: Any = vector(
        (), least=0, differentiable=False, relative=True, doc="their weights; default: equal"
    )
    examples: ClassVar[tuple[dict[str, Any], ...]] = (
        {"law": "gamma", "args": (2.0, 0.0, 0.5)},
        {"law": "lognorm", "args": (1.0, 0.0, 0.6)},
        {"law": "beta", "args": (0.5, 0.5, 0.5, 1.0)},
        {"sigma": (0.0, 0.5, 3.0), "weight": (0.2, 0.6, 0.2)},
    )

    def prepare(self) -> None:
        _ = self._transform, self._draw_f, self._draw_p  # made now: errors belong to construction

    @property
    def sigma_bar(self) -> Any:
        return (1 - self._clear) * self._transform.moments[1]

    @property
    def extinctions(self) -> tuple[Any, Any]:
        return self._nodes

    @property
    def jumps(self) -> tuple[tuple[Any, Any], ...] | None:
        return ()

    def ff(self, tau: Any) -> Any:
        rest = self._transform(0, tau)
        return with_derivative(rest + self._clear * (1 - rest), (tau, lambda t: -self.fp(t)))

    def pf(self, tau: Any) -> Any:
        return with_derivative(self._transform(1, tau), (tau, lambda t: -self.pp(t)))

    def pp(self, tau: Any) -> Any:
        _, first, second, third = self._transform.moments
        value = second / first * self._transform(2, tau)
        return with_derivative(value, (tau, lambda t: -third / first * self._transform(3, t)))

    def sample_f(self, draw: Draw) -> Any:
        return _flight(self._draw_f, draw)

    def sample_p(self, draw: Draw) -> Any:
        return _flight(self._draw_p, draw)

    @cached_property
    def _nodes(self) -> tuple[Any, Any]:
        """Values of S, the most likely positive one first, and their probabilities."""
        if bool(self.law) == bool(self.sigma):
            given = f"law is {self.law!r} and sigma has {len(self.sigma)} values"
            raise ValueError(f"Ensemble.{given}: exactly one of the two must be given")
        if self.law:
            if self.weight:
                raise ValueError("Ensemble.weight belongs to sigma: it must not be given with law")
            sigma, weight = nodes_of_law("Ensemble", self.law, self.args)
        else:
            if self.args:
                raise ValueError("Ensemble.args belongs to law: it must not be given with sigma")
            if len(self.sigma) > MOST_NODES:
                raise ValueError(
                    f"Ensemble.sigma has {len(self.sigma)} values: at most {MOST_NODES}"
                )
            sigma, weight = np.array(self.sigma), np.array(weights(self, self.weight, "sigma"))
            sigma, weight = sigma[weight > 0], weight[weight > 0] / weight.max()
        sigma, weight = np.where(sigma > 1e-30, sigma, 0), weight / weight.sum()
        if not sigma @ weight > 1e-30:
            name = "law" if self.law else "sigma"
            raise ValueError(f"Ensemble.{name} has mean {sigma @ weight:g}: it must be > 1e-30")
        order = np.argsort(np.where(sigma > 0, -weight, np.inf))
        return sigma[order], weight[order]

    @cached_property
    def _clear(self) -> float:
        """P(S = 0), the transmittance at infinity."""
        sigma, weight = self._nodes
        return float(weight[sigma == 0].sum())

    @cached_property
    def _transform(self) -> LaplaceTransform:
        sigma, weight = self._nodes
        return LaplaceTransform(sigma[sigma > 0], weight[sigma > 0])

    @cached_property
    def _draw_f(self) -> AliasTable:
        return AliasTable(*self._nodes)

    @cached_property
    def _draw_p(self) -> AliasTable:
        sigma, weight = self._nodes
        return AliasTable(sigma, sigma * weight)


def _flight(table: AliasTable, draw: Draw) -> Any:
    """An exponential flight through an extinction that is drawn."""
    sigma = table(draw(), draw())
    length = -log1p(-draw())
    if not dr.is_array_v(sigma):
        return length / sigma if sigma > 0 else math.inf
    return dr.select(sigma > 0, length / sigma, dr.inf)
