"""The Davis-Weinstein law: extinction whose fluctuations are correlated over all lengths."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import drjit as dr
import numpy as np

from ..numerics import log1p, select, with_derivative
from ..numerics.special import LogLogSpline, log1p_excess_ratio
from ..transmittance import Draw, Transmittance
from ..transmittance.parameters import number, parameter


@dataclass(frozen=True, eq=False)
class DavisWeinstein(Transmittance):
    """T = exp(-tau ln(1+x)/x), x = c (c tau)^(2h-1): clustering at all scales (Davis, Weinstein).

    The mean of ``exp(-s tau)`` where the extinction ``s``, averaged over the flight, follows a
    gamma distribution of mean 1 and of variance ``x/tau = c^2 (c tau)^(2h-2)``, as in a medium of
    Hurst exponent ``h``. ``h = 1`` is the gamma law of ``alpha = 1/c^2``; ``h = 1/2`` an
    exponential one, of extinction ``ln(1+c)/c``. As ``c`` tends to 0 the law tends to the
    exponential one of extinction 1.

    For ``1/2 < h < 1`` the density ``pp`` grows without bound towards ``tau = 0``; below 1e-30 it
    is held constant. As ``h`` falls to 1/2, some of the flights from a particle shrink to length
    zero; at ``h = 1/2`` they are left out, so that ``sigma_bar``, ``pf`` and ``pp`` jump there.
    Derivatives by ``h`` do not include the jump. In single precision flights may be infinite where
    ``h`` is near 1 and ``c`` is large.
    """

    h: Any = parameter(0.75, least=0.5, most=1, doc="Hurst exponent of the fluctuations")
    c: Any = parameter(1.0, above=0, doc="strength of the fluctuations")
    examples: ClassVar[tuple[dict[str, Any], ...]] = (
        {},
        {"h": 0.65, "c": 0.3},
        {"h": 0.9, "c": 3.0},
    )

    def prepare(self) -> None:
        _ = self._stretch  # made now: parameters cannot be read inside a kernel

    @cached_property
    def _stretch(self) -> LogLogSpline:
        """``tau/e`` as a function of ``e = -ln T(tau)``."""
        h, c = number(self.h), number(self.c)
        return LogLogSpline(lambda e: _log_stretch(e, 2 * h - 1, 2 * h * np.log(c)), -53, 6, 16)

    @property
    def sigma_bar(self) -> Any:
        at = _At(1.0, self)
        return with_derivative(at.sigma_bar, (self.c, lambda _: at.sigma_bar * at.log_sigma_bar_c))

    @property
    def jumps(self) -> tuple[tuple[Any, Any], ...] | None:
        return ()

    def ff(self, tau: Any) -> Any:
        at = _At(tau, self)
        return with_derivative(
            at.ff,
            (tau, lambda _: -at.fp),
            (self.h, lambda _: at.ff_h),
            (self.c, lambda _: at.ff_c),
        )

    def pf(self, tau: Any) -> Any:
        at = _At(tau, self)
        return with_derivative(
            at.pf,
            (tau, lambda _: -at.pp),
            (self.h, lambda _: at.pf_h),
            (self.c, lambda _: at.pf_c),
        )

    def pp(self, tau: Any) -> Any:
        at = _At(tau, self)
        return with_derivative(
            at.pp,
            (tau, lambda _: at.pp_tau),
            (self.h, lambda _: at.pp_h),
            (self.c, lambda _: at.pp_c),
        )

    def sample_f(self, draw: Draw) -> Any:
        at = _At(self._invert(draw), self)
        return with_derivative(
            at.tau, (self.h, lambda _: at.ff_h / at.fp), (self.c, lambda _: at.ff_c / at.fp)
        )

    def sample_p(self, draw: Draw) -> Any:
        # pf = T q is the survival function of the nearer of two collisions, one of which is drawn
        # as from a fixed point. The other, of survival q = (1-B) ln(1+x)/x + B/(1+x), is at
        # x = s/((1-s) w) with s uniform, and w = 1 with probability B, else uniform.
        one = _At(1.0, self)
        tau, s, w = self._invert(draw), draw(), draw()
        w = dr.minimum((1 - w) / dr.maximum(1 - one.b, 1e-30), 1.0)
        log_x = dr.log2(dr.maximum(s, 1e-30) / ((1 - s) * w))
        log_other = dr.clip((log_x - one.log_c) / dr.maximum(one.b, 1e-30), -200.0, 127.0)
        at = _At(dr.minimum(tau, select(one.b > 0, dr.exp2(log_other), dr.inf)), self)
        return with_derivative(
            at.tau, (self.h, lambda _: at.pf_h / at.pp), (self.c, lambda _: at.pf_c / at.pp)
        )

    def _invert(self, draw: Draw) -> Any:
        """Flight from a fixed point, where ``tau ln(1+x)/x = -ln(1-u)``."""
        e = -log1p(-draw())
        return select(e > 0, e * self._stretch(e), 0.0)


class _At:
    """Values at one ``tau``, detached, and their derivatives by tau, h and c (suffixes).

    With B = 2h-1, L = ln(1+x)/x and the derivatives by ln x: phi = -L', r = (1 - 1/(1+x))' and
    m = -q' = (1-B) phi + B r; by tau T' = -q T and x' = B x/tau.
    """

    def __init__(self, tau: Any, law: DavisWeinstein) -> None:
        self.tau, self.h, self.c = dr.detach(tau), dr.detach(law.h), dr.detach(law.c)
        self.b = 2 * self.h - 1
        kind = self.tau + self.b
        single = dr.is_array_v(kind) and dr.type_v(kind) == dr.VarType.Float32
        end = 126 if single else 1000
        # With these all below stays finite, also at 0 and at infinity.
        self.t = dr.clip(self.tau, 2.0 ** (26 - end), 2.0**end)
        self.log_t, self.log_c = dr.log2(self.t), 2 * self.h * dr.log2(self.c)
        self.x = dr.exp2(dr.clip(self.b * self.log_t + self.log_c, -end, end))
        self._end = end
        self.ratio = log1p(self.x) / self.x
        self.q = (1 - self.b) * self.ratio + self.b / (1 + self.x)
        self.sigma_bar = select(self.b > 0, 1.0, self.ratio)  # of h = 1/2: x is constant

    @cached_property
    def ff(self) -> Any:
        return dr.exp(-self.tau * self.ratio)

    @cached_property
    def pf(self) -> Any:
        return self.ff * dr.minimum(select(self.tau > 0, self.q / self.sigma_bar, 1.0), 1.0)

    @property
    def fp(self) -> Any:
        return self.sigma_bar * self.pf

    @cached_property
    def pp(self) -> Any:
        return self.ff * self.curvature / self.sigma_bar

    @cached_property
    def curvature(self) -> Any:
        """``T''/T``."""
        return self.q * self.q + self.b * self.m_t

    @cached_property
    def m_t(self) -> Any:
        """m/t, by way of x/t, which rounds less where both are small."""
        log = self.log_c - (1 - self.b) * dr.maximum(self.log_t, -100.0)
        return self.m / self.x * dr.exp2(dr.minimum(log, self._end))

    @cached_property
    def phi(self) -> Any:
        return log1p_excess_ratio(self.x)

    @cached_property
    def r(self) -> Any:
        return self.x / (1 + self.x) / (1 + self.x)

    @cached_property
    def m(self) -> Any:
        return (1 - self.b) * self.phi + self.b * self.r

    @cached_property
    def m_x(self) -> Any:
        """Derivative of m by ln x."""
        bend = self.r * ((1 - self.x) / (1 + self.x))
        return (1 - self.b) * (self.r - self.phi) + self.b * bend

    @property
    def log_x_h(self) -> Any:
        return 2 * (dr.log(self.t) + dr.log(self.c))

    @property
    def log_x_c(self) -> Any:
        return 2 * self.h / self.c

    @property
    def log_sigma_bar_c(self) -> Any:
        return select(self.b > 0, 0.0, -self.phi / (self.ratio * self.c))

    @property
    def ff_x(self) -> Any:
        """Derivative of ff by ln x."""
        return self.ff * self.t * self.phi

    @property
    def pf_x(self) -> Any:
        return self.ff / self.sigma_bar * (self.q * self.t * self.phi - self.m)

    @property
    def pp_x(self) -> Any:
        slope = self.b * self.m_x / self.t - 2 * self.q * self.m
        return self.ff / self.sigma_bar * (self.curvature * self.t * self.phi + slope)

    @property
    def ff_h(self) -> Any:
        return self.ff_x * self.log_x_h

    @property
    def ff_c(self) -> Any:
        return self.ff_x * self.log_x_c

    @property
    def pf_h(self) -> Any:
        return self.pf_x * self.log_x_h - 2 * self.ff / self.sigma_bar * self.phi

    @property
    def pf_c(self) -> Any:
        return self.pf_x * self.log_x_c - self.pf * self.log_sigma_bar_c

    @property
    def pp_tau(self) -> Any:
        slope = 2 * self.q * self.b * self.m + self.b * (self.m - self.b * self.m_x) / self.t
        return -self.ff / self.sigma_bar * (self.q * self.curvature + slope / self.t)

    @property
    def pp_h(self) -> Any:
        by_b = self.m_t + self.b * ((self.r - self.phi) / self.t) - 2 * self.q * self.phi
        return self.pp_x * self.log_x_h + 2 * self.ff / self.sigma_bar * by_b

    @property
    def pp_c(self) -> Any:
        return self.pp_x * self.log_x_c - self.pp * self.log_sigma_bar_c


def _log_stretch(e: Any, b: float, log_c: float) -> tuple[Any, Any]:
    """``ln(tau/e)`` where ``-ln T(tau) = e``, and its derivative by ln e.

    With v = ln(1+x) this is ``(1-b) ln(e^v - 1) + b ln v = b ln(e) + log_c``, solved by
    Newton's method in ln v: the left side is convex there, so from above it comes down to the root.
    """
    target = b * np.log(e) + log_c
    with np.errstate(over="ignore", divide="ignore"):
        bound = np.maximum((target + 1) / (1 - b), 2) if b < 1 else np.inf
        v = np.minimum(np.exp(target), bound)
    for _ in range(30):
        log_x, gain = _log_expm1(v)
        slope = (1 - b) * gain + b
        v = v * np.exp((target - (1 - b) * log_x - b * np.log(v)) / slope)
    log_x, gain = _log_expm1(v)
    return log_x - np.log(v), b * (gain - 1) / ((1 - b) * gain + b)


def _log_expm1(v: Any) -> tuple[Any, Any]:
    """``ln(e^v - 1)`` and its derivative by ln v, for v > 0."""
    rest = -np.expm1(-v)
    return v + np.log(rest), v / rest
