"""Figures of a model, and of fits beside their data, with matplotlib (the extra ``plot``)."""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from .. import models
from ..system.files import check_writable, replacing
from ..system.machine import array_types
from ..transmittance import Transmittance
from ..transmittance.kinds import number, parameters_of
from ..transmittance.shown import brief
from .fit import Fit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["STYLE", "check_path", "plot_fit", "plot_model", "require", "save"]

Array = npt.NDArray[np.float64]

# The palette of Okabe and Ito, safe for colour blindness.
BLUE, ORANGE, GREEN, PURPLE, GREY = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#666666"
_COLOURS = (ORANGE, BLUE, GREEN, PURPLE, "#E69F00", "#56B4E9")
_STYLES = ("-", "--", "-.", ":")
_SUFFIXES = (".png", ".svg", ".pdf")
STYLE: dict[Any, Any] = {
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "0.9",
    "axes.axisbelow": True,
    "legend.frameon": False,
    "lines.linewidth": 1.8,
    "svg.hashsalt": "nonexp",
}


def require() -> None:
    """Raise ``ImportError``, in one sentence, where matplotlib is missing."""
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        raise ImportError(
            "plots need matplotlib, which is not installed: pip install 'nonexp[plot]'"
        ) from None


def check_path(path: Path) -> None:
    """Raise ``ValueError`` or ``OSError`` unless a figure can be written there."""
    if path.suffix.lower() not in _SUFFIXES:
        raise ValueError(f"output is {str(path)!r}: it must end in {', '.join(_SUFFIXES)}")
    check_writable(path)


def save(figure: Figure, path: Path) -> None:
    """Write a figure as the PNG, SVG or PDF that the name says.

    An existing file is replaced when the new one is complete.
    """
    with replacing(path) as (aside,):
        figure.savefig(aside, format=path.suffix[1:].lower(), dpi=150)


# --------------------------------------------------------------------------------------- a model


def plot_model(model: Transmittance, *, draws: int = 2**19, seed: int = 0) -> Figure:
    """Transmittances and densities of a model over optical depth, and what it samples.

    Above ``ff`` and ``pf``, on linear and logarithmic axes; below ``fp`` and ``pp`` over histograms
    of that many ``draws`` from ``sample_f`` and ``sample_p``. Point masses are stems, whose height
    is their probability, with the share of the draws as crosses. The dashed lines are the
    exponential law of the same mean extinction.

    Raises ``ImportError`` where matplotlib is missing.
    """
    require()
    import matplotlib
    from matplotlib.figure import Figure

    law = _Law(model)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(9.6, 6.8), layout="constrained")
        figure.suptitle(f"{_title(model)}\n{_formula(model)}", fontsize=10.5)
        (linear, logarithmic), (first, later) = figure.subplots(2, 2)
        end = law.reach(0.02, 10)
        _transmittances(linear, law, np.linspace(0, end, 600))
        linear.set(xlim=(0, end), ylim=(0, 1.04), title="transmittance")
        linear.legend()
        _logarithmic(logarithmic, law)
        _density(first, law, "fp", ORANGE, law.draw("f", draws, seed), end, [])
        first.set_title("first collision, from a fixed point")
        _density(later, law, "pp", PURPLE, law.draw("p", draws, seed), end, law.atoms)
        later.set_title("next collision, from a particle")
        for axes in (linear, logarithmic, first, later):
            axes.set_xlabel("optical depth tau")
    return figure


class _Law:
    """A model on NumPy arrays, in double precision, with what the panels need to know."""

    def __init__(self, model: Transmittance) -> None:
        self.model = model
        self.sigma_bar = number(model.sigma_bar)
        self.mean = 1 / self.sigma_bar if self.sigma_bar else 1.0
        self.kinks = np.array([number(kink) for kink in model.kinks])
        self.atoms = [(number(tau), number(p)) for tau, p in model.atoms]

    def __call__(self, name: str, tau: Array) -> Array:
        return np.asarray(getattr(self.model, name)(tau))

    def reach(self, level: float, most: float) -> float:
        """Optical depth at which ``ff`` and ``pf`` are within ``level`` of their limits, at most
        ``most`` mean flights."""
        tau = self.mean * np.geomspace(1e-3, 1e9, 4000)
        left = np.maximum(*(self(name, tau) - self(name, tau[-1:]) for name in ("ff", "pf")))
        if not self.sigma_bar:
            return 5.0
        return 1.08 * min(float(tau[np.argmax(left <= level)]), most * self.mean)

    def with_breaks(self, tau: Array) -> Array:
        """The depths, and both sides of each kink with NaN between."""
        kinks = self.kinks[(self.kinks > tau[0]) & (self.kinks < tau[-1])]
        sides = np.concatenate([tau, kinks * (1 - 1e-9), kinks * (1 + 1e-9)])
        points = np.sort(sides[~np.isin(sides, kinks)])
        return np.insert(points, np.searchsorted(points, kinks), np.nan)

    def draw(self, origin: str, count: int, seed: int) -> Array:
        """Samples, drawn in single precision as in a render."""
        types = array_types()
        random = types.PCG32(count, initstate=types.UInt64(seed))
        samples = getattr(self.model, f"sample_{origin}")(random.next_float32)
        return np.broadcast_to(np.array(types.Float(samples), dtype=np.float64), (count,))


def _transmittances(axes: Axes, law: _Law, tau: Array) -> None:
    broken = law.with_breaks(tau)
    axes.plot(tau, law("ff", tau), color=BLUE, linewidth=2.8, label="ff, from a fixed point")
    axes.plot(broken, law("pf", broken), color=GREEN, linewidth=1.4, label="pf, from a particle")
    _exponential(axes, tau, np.exp(-law.sigma_bar * tau))


def _logarithmic(axes: Axes, law: _Law) -> None:
    """Logarithmic in depth, too, for laws with a tail that an exponential would leave behind."""
    end = law.reach(1e-4, 1e4)
    heavy = end > 30 * law.mean
    tau = np.geomspace(0.01 * law.mean, end, 600) if heavy else np.linspace(0, end, 600)
    _transmittances(axes, law, tau)
    axes.set(yscale="log", xlim=(tau[0], tau[-1]), ylim=(1e-4, 1.5), title="on logarithmic axes")
    if heavy:
        axes.set_xscale("log")
    axes.legend()


def _density(
    axes: Axes,
    law: _Law,
    name: str,
    colour: str,
    samples: Array,
    end: float,
    atoms: Sequence[tuple[float, float]],
) -> None:
    if not law.sigma_bar:
        axes.text(0.5, 0.5, "no collisions", transform=axes.transAxes, ha="center", color=GREY)
        axes.set(xlim=(0, end), ylim=(0, 1), ylabel=name)
        return
    smooth = samples
    for where, _ in atoms:
        smooth = smooth[np.abs(smooth - where) > 1e-5 * where]
    cuts = law.kinks[(law.kinks > 0) & (law.kinks < end)]
    edges = np.unique(np.concatenate([np.linspace(0, end, 81), cuts]))
    edges = edges[np.r_[True, np.diff(edges) > 1e-6 * end]]
    heights = np.histogram(smooth, edges)[0] / (len(samples) * np.diff(edges))
    if len(smooth):
        axes.stairs(heights, edges, fill=True, color=colour, alpha=0.25, label="histogram of draws")
    tau = law.with_breaks(np.concatenate([[1e-9 * end], np.linspace(0, end, 1000)[1:]]))
    values = law(name, tau)
    has_density = bool(np.nanmax(values) > 0)
    if has_density:
        axes.plot(tau, values, color=colour, label=name if not atoms else f"{name}, less atoms")
    exponential = law.sigma_bar * np.exp(-law.sigma_bar * tau)
    _exponential(axes, tau, exponential)
    top = max(heights.max(), law.sigma_bar, min(np.nanmax(values), 2 * heights.max()))
    axes.set(xlim=(0, end), ylim=(0, (1.45 if atoms else 1.08) * top), ylabel="density")
    if not atoms:
        axes.legend()
        return

    masses = axes.twinx()
    where, probabilities = np.array(atoms).T
    shares = [np.mean(np.abs(samples - tau) <= 1e-5 * tau) for tau in where]
    masses.vlines(where, 0, probabilities, color=BLUE, label="atoms of pp")
    masses.plot(where, shares, "x", color="black", markersize=5, label="share of draws")
    masses.set(ylim=(0, 1.45 * probabilities.max()), ylabel="probability of an atom")
    masses.spines["right"].set_visible(True)
    masses.grid(False)
    handles = [*axes.get_legend_handles_labels()[0], *masses.get_legend_handles_labels()[0]]
    masses.legend(handles=handles, loc="upper right")


def _exponential(axes: Axes, tau: Array, values: Array) -> None:
    axes.plot(tau, values, "--", color=GREY, linewidth=1.2, label="exponential law")


def _title(model: Transmittance) -> str:
    names = {cls: key for key, cls in models.registry.items()}
    shown = []
    for name, field in parameters_of(model).items():
        text = brief(getattr(model, field.name))
        if text:
            shown.append(f"{name} = {text}")
    return ", ".join([names.get(type(model), type(model).__name__), *shown])


def _formula(model: Transmittance) -> str:
    return (inspect.getdoc(type(model)) or "").partition("\n")[0]


# ------------------------------------------------------------------------------------------- a fit


def plot_fit(fits: Sequence[Fit], tau: Any, ff: Any, sigma: Any = None) -> Figure:
    """Data and the fitted transmittances, the best first, above the residuals of each.

    Raises ``ImportError`` where matplotlib is missing.
    """
    require()
    import matplotlib
    from matplotlib.figure import Figure

    x, y = np.asarray(tau, dtype=np.float64), np.asarray(ff, dtype=np.float64)
    bars = None if sigma is None else np.broadcast_to(np.asarray(sigma, dtype=np.float64), x.shape)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(7.2, 5.8), layout="constrained")
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
        many = len(x) > 200
        marks: dict[str, Any] = {"color": "black", "elinewidth": 0.8, "zorder": 1}
        marks |= {"fmt": "." if many else "o", "markersize": 3 if many else 4}
        upper.errorbar(x, y, bars, label="data", **marks)
        lower.axhline(0, color=GREY, linewidth=0.8)
        curve = np.linspace(0, x.max(), 600)
        for i, fitted in reversed([*enumerate(fits)]):
            colour, style = _COLOURS[i % len(_COLOURS)], _STYLES[i // len(_COLOURS) % 4]
            upper.plot(curve, fitted.ff(curve), style, color=colour, label=fitted.name)
            if i:  # where this model lies, seen from the best one
                lower.plot(curve, fitted.ff(curve) - fits[0].ff(curve), style, color=colour)
        residuals = y - fits[0].ff(x)
        lower.errorbar(x, residuals, bars, **marks)
        size = 1.1 * np.max(np.abs(residuals) + (0 if bars is None else bars))
        lower.set_ylim(-max(size, 1e-9), max(size, 1e-9))
        upper.set(ylabel="transmittance ff", ylim=(min(0, 1.1 * y.min()), None))
        upper.set_xlim(0, 1.02 * x.max())
        handles, labels = upper.get_legend_handles_labels()
        upper.legend(handles[::-1], labels[::-1])
        lower.set(xlabel="distance (or optical depth)", ylabel=f"data - {fits[0].name}")
    return figure
