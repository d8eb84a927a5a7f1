"""A law of one's own, from its transmittance alone."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import drjit as dr
import numpy as np

from ..system import machine
from ..transmittance.parameters import function
from ..transmittance.piecewise import Curve, Piecewise, hermite

_END = 1e-8  # where ff is below, its table ends
_TOLERANCE = 8e-6  # errors of ff and pf allowed at the probes: less than 1e-5 everywhere
_RELATIVE = 1e-3  # relative errors allowed in the tail, down to pf = 1e-6
_ROUNDING = 1e-9  # errors of ff and pf that are not held against the function
_MOST_NODES = 4096


def wigner(tau: Any) -> Any:
    """T = erfc(sqrt(pi) tau/2): flights distributed as Wigner's spacings of levels that repel."""
    return 1 - dr.erf(0.5 * math.sqrt(math.pi) * tau)


class Error(NamedTuple):
    """Largest differences found between a function and its table."""

    ff: float
    pf: float


@dataclass(frozen=True, eq=False)
class Custom(Piecewise):
    """T = your function: give ff alone, and densities, samplers and derivatives follow.

    ``ff`` (the field ``function``) is a Python function of an array of optical depths, written with
    Dr.Jit's operations (``drjit.exp``, not ``math.exp``), or the string ``module:function`` that
    names one; scenes also find the module beside the scene file. It must start at 1, never rise,
    and be convex, with a finite slope at 0; where it is not, ``ValueError`` names the depth.

    When the model is made, ff and its first derivative (by automatic differentiation) are tabulated
    in double precision on adaptive nodes; the law is the curve through both, with pf continuous and
    piecewise linear, pp piecewise constant, and one more knot between two nodes (Schumaker 1983).
    Samples follow the curve exactly. Nodes are as close as it takes for errors of ff and pf below
    1e-5, or one thousandth where that is less (down to pf = 1e-6). ``model.error`` holds the
    largest absolute errors (ff, pf) found at other depths between 0 and the last knot. There ff is
    below 1e-8 or flat; beyond it decays exponentially or stays constant.

    A jump of the slope becomes a ramp between neighbouring single-precision numbers, on which
    errors are not measured; where ff ends with a slope, there is an atom. At most 4096 nodes are
    used. A law pickles if its function does: a lambda does not, nor in another process a function
    of a module that cannot be imported there.
    """

    function: Any = function(
        scene_name="ff", doc="transmittance: a function of optical depth, or module:function"
    )
    examples: ClassVar[tuple[dict[str, Any], ...]] = ({"ff": "nonexp.models.custom:wigner"},)

    @property
    def error(self) -> Error:
        """Largest absolute errors of ff and pf found between the nodes of the table."""
        return self._tabulated[1]

    def make_curve(self) -> Curve:
        return self._tabulated[0]

    @cached_property
    def _tabulated(self) -> tuple[Curve, Error]:
        return _tabulate(_Probe("Custom.ff", self.function))


# ------------------------------------------------------------------------------- the function


@dataclass(frozen=True)
class _Probe:
    """The user's function and its slope, as NumPy arrays."""

    label: str
    function: Any

    def at(self, tau: Any) -> tuple[Any, Any]:
        """ff and -ff' at an array of depths, unchecked."""
        kind = machine.array_types().Float64
        with dr.resume_grad():
            x = kind(tau)
            dr.enable_grad(x)
            try:
                y = self.function(x)
            except Exception as error:
                raise ValueError(
                    f"{self.label} fails with {type(error).__name__}: {error}"
                ) from error
            if isinstance(y, (int, float)) or (type(y) is kind and len(y) == 1 < len(tau)):
                raise ValueError(
                    f"{self.label} returns {y!r} for all tau: constant transmittance, as of "
                    "vacuum, is the model constant"
                )
            if type(y) is not kind or len(y) != len(tau):
                raise ValueError(
                    f"{self.label} returns {_described(y)} for {_described(x)}: it must return an "
                    "array of the same type and width, made with Dr.Jit's functions"
                )
            slope = kind(0)
            if dr.grad_enabled(y):
                dr.set_grad(x, 1.0)
                slope = dr.forward_to(y)
            dr.eval(y, slope)
        return np.array(y), np.broadcast_to(-np.array(slope), len(tau))

    def at_ascending(self, tau: Any) -> tuple[Any, Any]:
        """ff and -ff' at ascending depths; ``ValueError`` where they belong to no law."""
        ff, slope = self.at(tau)
        self.require_convex(tau, ff, slope)
        return ff, slope

    def require_convex(self, tau: Any, ff: Any, slope: Any) -> None:
        """Raise ``ValueError`` at the first depth where a law cannot have these values."""
        self._refuse(tau, ff, slope, ~np.isfinite(ff), "it must be finite")
        self._refuse(tau, ff, slope, ~np.isfinite(slope), "its slope must be finite")
        outside = (ff < -_ROUNDING) | (ff > 1 + _ROUNDING)
        self._refuse(tau, ff, slope, outside, "it must be in [0, 1]")

        def before(bad: Any) -> Any:
            return np.append(False, bad)

        rises = (np.diff(ff) > _ROUNDING) | (slope[1:] < -_ROUNDING * slope[0])
        self._refuse(tau, ff, slope, before(rises), "it must not increase")
        width, fall = np.diff(tau), -np.diff(ff)
        bent = np.diff(slope) > _ROUNDING * slope[0]
        bent |= fall > slope[:-1] * width + _ROUNDING
        bent |= fall < slope[1:] * width - _ROUNDING
        self._refuse(tau, ff, slope, before(bent), "it must be continuous and convex")

    def _refuse(self, tau: Any, ff: Any, slope: Any, bad: Any, words: str) -> None:
        for i in np.flatnonzero(bad):
            message = (
                f"{self.label} at tau = {tau[i]:.9g} is {ff[i]:.9g} with slope {-slope[i]:.9g}"
            )
            if i > 0:
                message += (
                    f", after {ff[i - 1]:.9g} with slope {-slope[i - 1]:.9g} "
                    f"at tau = {tau[i - 1]:.9g}"
                )
            raise ValueError(f"{message}: {words}")


def _described(value: Any) -> str:
    cls = type(value)
    name = f"{cls.__module__}.{cls.__qualname__}".removeprefix("builtins.")
    return f"{name} of width {len(value)}" if hasattr(value, "__len__") else name


# ------------------------------------------------------------------------------- the table


def _tabulate(probe: _Probe) -> tuple[Curve, Error]:
    tau = _first_nodes(probe)
    ff, slope = probe.at_ascending(tau)
    open_cells = np.arange(len(tau) - 1)
    while len(open_cells) and len(tau) < _MOST_NODES:
        # Three probes in each cell that is not settled; cells that fail are cut in the middle.
        a, b = tau[open_cells], tau[open_cells + 1]
        middle = _rounded((a + b) / 2)
        divisible = (middle > a) & (middle < b)
        open_cells, a, b = open_cells[divisible], a[divisible], b[divisible]
        if not len(open_cells):
            break
        inside = np.stack([(3 * a + b) / 4, middle[divisible], (a + 3 * b) / 4], axis=1)
        ff_in, slope_in = (v.reshape(inside.shape) for v in probe.at(inside.ravel()))
        where = np.repeat(open_cells + 1, 3)
        probe.require_convex(
            *(
                np.insert(v, where, w.ravel())
                for v, w in zip((tau, ff, slope), (inside, ff_in, slope_in), strict=True)
            )
        )
        fitted = _curve(tau, ff, slope).at(inside)
        failed = np.any(_excess(*fitted, ff_in, slope_in, slope[0]) > 1, axis=1)
        cut = open_cells[failed] + 1
        tau = np.insert(tau, cut, inside[failed, 1])
        ff = np.insert(ff, cut, ff_in[failed, 1])
        slope = np.insert(slope, cut, slope_in[failed, 1])
        left = cut - 1 + np.arange(len(cut))
        open_cells = np.sort(np.concatenate([left, left + 1]))
    curve = _curve(*_ended(tau, ff, slope))
    return curve, _measured(probe, curve)


def _first_nodes(probe: _Probe) -> Any:
    """0, then four in each octave from where ff has hardly fallen to where the table ends."""
    octaves = np.append(0, 2.0 ** np.arange(-100, 101))
    ff, slope = probe.at(octaves)
    probe.require_convex(octaves[:1], ff[:1], slope[:1])
    if abs(ff[0] - 1) > _ROUNDING:
        raise ValueError(f"{probe.label} at tau = 0 is {ff[0]:.9g}: it must be 1")
    if np.all(ff == 1):
        raise ValueError(f"{probe.label} is 1 for all tau: use the model constant")
    if not 1e-25 < slope[0] < 1e25:
        raise ValueError(
            f"{probe.label} at tau = 0 has slope {-slope[0]:.9g}: it must be negative and finite"
        )
    grown = octaves * slope[0] >= 1
    done = grown & ((ff <= _END) | (slope * octaves <= _ROUNDING * ff))
    last = int(np.argmax(done)) if np.any(done) else len(octaves) - 1
    beyond = octaves[last : last + 2], ff[last : last + 2], slope[last : last + 2]
    if np.all(np.isfinite(beyond)):  # (1 - tau/2)^2 is over at 2, but comes back
        probe.require_convex(*beyond)
    first = int(np.argmax(octaves * slope[0] > 0.01))
    quarters = octaves[first:last, None] * (1 + np.arange(4) / 4)
    return np.concatenate([[0], quarters.ravel(), octaves[last : last + 1]])


def _curve(tau: Any, ff: Any, slope: Any) -> Curve:
    ff = np.append(1, np.minimum.accumulate(np.clip(ff[1:], 0, 1)))
    return hermite(tau, ff, np.minimum.accumulate(np.maximum(slope, 0)))


def _excess(ff: Any, slope: Any, ff_true: Any, slope_true: Any, sigma_bar: Any) -> Any:
    """Errors over what is allowed of them."""
    pf, pf_true = slope / sigma_bar, slope_true / sigma_bar
    allowed_ff = np.minimum(_TOLERANCE, _RELATIVE * np.maximum(ff_true, _END))
    allowed_pf = np.minimum(_TOLERANCE, _RELATIVE * np.maximum(pf_true, 1e-6))
    return np.maximum(np.abs(ff - ff_true) / allowed_ff, np.abs(pf - pf_true) / allowed_pf)


def _ended(tau: Any, ff: Any, slope: Any) -> tuple[Any, Any, Any]:
    """Nodes up to where the law ends or is flat."""
    over = np.flatnonzero((ff <= 0) | (slope <= 0))
    count = over[0] + 1 if len(over) else len(tau)
    tau, ff, slope = tau[:count].copy(), ff[:count].copy(), slope[:count].copy()
    if ff[-1] > 0:
        if slope[-1] * tau[-1] <= _ROUNDING * ff[-1]:
            slope[-1] = 0
        return tau, ff, slope
    a, b = tau[-2:]
    straight = a + ff[-2] / slope[-2]
    if straight >= b - 1e-6 * (b - a) or _rounded((a + b) / 2) in (a, b):
        # The slope jumps to 0 there: the law ends on its straight line, with an atom.
        tau[-1], slope[-1] = _rounded(straight), slope[-2]
        if tau[-1] == a:
            tau, ff, slope = tau[:-1], np.append(ff[:-2], 0), slope[:-1]
    elif slope[-1] <= _ROUNDING * slope[0]:
        slope[-1] = 0
    return tau, ff, slope


def _measured(probe: _Probe, curve: Curve) -> Error:
    a, b = curve.knots[:-1], curve.knots[1:]
    wide = b - a > 4 * np.spacing(np.float32(b))
    a, b = a[wide, None], b[wide, None]
    tau = (a + (b - a) * np.array([0.002, 0.3, 0.5, 0.7, 0.998])).ravel()
    ff, slope = curve.at(tau)
    ff_true, slope_true = probe.at_ascending(tau)
    sigma_bar = curve.slope[0]
    return Error(
        float(np.max(np.abs(ff - ff_true))),
        float(np.max(np.abs(slope - slope_true)) / sigma_bar),
    )


def _rounded(tau: Any) -> Any:
    return np.float64(np.float32(tau))
