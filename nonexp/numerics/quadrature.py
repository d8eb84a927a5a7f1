"""Probability laws of ``scipy.stats`` as few weighted values.

For any function that varies smoothly over a factor of two in its argument, the expectation over the
nodes agrees with that over the law to about ten digits, whatever part of the law it weights.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

__all__ = ["MOST_NODES", "nodes_of_law"]

MOST_NODES = 8192

# The range of S in which a law is resolved. Outside, only its mass and its mean are kept.
_LEAST, _MOST = 1e-16, 1e11
_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(16)
_MOST_PANELS = 256
_NARROWEST = 1e-10


def nodes_of_law(owner: str, name: str, args: Sequence[float]) -> tuple[Any, Any]:
    """Ascending values and their probabilities for the law ``scipy.stats.<name>(*args)`` of S >= 0.

    Both arrays have shape (n,), n <= ``MOST_NODES``. Continuous laws are integrated by Gauss rules
    over the logarithm of S (of its distance to the smallest value), bisected until they agree with
    their halves; laws of discrete values are listed.

    Raises ``ValueError``, with ``owner.law`` or ``owner.args`` as its subject, where there is no
    such law, it has other parameters, or S has negative values or no finite mean.
    """
    label = f"{owner}.law {_spelt(name, args)}"
    with np.errstate(all="ignore"):
        law, low, high = _frozen(owner, name, args)
        if low < -1e-6 * abs(float(law.median())):  # else a rounded zero
            raise ValueError(f"{label} begins at {low:g}: extinction must be >= 0")
        listed = hasattr(law.dist, "pmf")
        sigma, weight = (_listed if listed else _resolved)(label, law, low, high)
    total = weight.sum()
    if not abs(total - 1) < 1e-4:
        found = f"from {_LEAST:g} to {_MOST:g} its density adds up to {total:.6g}"
        raise ValueError(f"{label} cannot be integrated: {found}")
    sigma = np.maximum(sigma, 0)
    # Leave out values too rare, and too small a part of the moments, to change any expectation
    # above 1e-30.
    felt = weight > 1e-60
    felt &= (sigma <= weight @ sigma) | (weight * sigma**2 > 1e-18 * (weight @ sigma**2))
    if np.count_nonzero(felt) > MOST_NODES:
        raise ValueError(f"{label} takes more than {MOST_NODES} values that matter")
    return sigma[felt], weight[felt] / weight[felt].sum()


def _frozen(owner: str, name: str, args: Sequence[float]) -> tuple[Any, float, float]:
    """The distribution with its parameters, and the ends of its support."""
    from scipy import stats  # takes longer to import than all of nonexp

    kinds = (stats.rv_continuous, stats.rv_discrete)
    family = getattr(stats, name, None)
    if not isinstance(family, kinds):
        known = [key for key, value in vars(stats).items() if isinstance(value, kinds)]
        close = difflib.get_close_matches(name.lower(), known) or ["gamma", "lognorm", "uniform"]
        hint = f"it must name a distribution of scipy.stats, such as {', '.join(close)}"
        raise ValueError(f"{owner}.law is {name!r}: {hint}")
    places = ["loc", "scale"] if isinstance(family, stats.rv_continuous) else ["loc"]
    if not family.numargs <= len(args) <= family.numargs + len(places):
        order = (f"{family.shapes}[, " if family.shapes else "[") + ", ".join(places) + "]"
        count = f"{len(args)} number{'' if len(args) == 1 else 's'}"
        raise ValueError(f"{owner}.args has {count}: {name} takes {order}")
    try:
        law = family(*args)
        low, high = (float(end) for end in law.support())
    except (TypeError, ValueError):  # parameters that are no numbers
        low = high = np.nan
    if not low <= high:
        raise ValueError(f"{owner}.args is {_spelt('', args)}: {name} does not allow that")
    return law, low, high


def _spelt(name: str, args: Sequence[float]) -> str:
    return f"{name}({', '.join(f'{a:g}' for a in args)})"


# ------------------------------------------------------------------------------- discrete laws


def _listed(label: str, law: Any, low: float, high: float) -> tuple[Any, Any]:
    reach = max(64.0, 2 * np.ceil(law.median() - low))
    while reach < 2**20 and reach < high - low and reach**3 * law.pmf(low + reach) > 1e-12:
        reach *= 2
    if not reach < 2**20:
        raise ValueError(f"{label} takes more than {MOST_NODES} values that matter")
    values = low + np.arange(min(reach, high - low + 1))
    return values, law.pmf(values)


# ----------------------------------------------------------------------------- continuous laws


class _TooManyPanels(Exception):
    pass


def _resolved(label: str, law: Any, low: float, high: float) -> tuple[Any, Any]:
    """Nodes in x = ln t, t = S - low, and one for each end that is left out."""
    quarter, median, three = law.ppf((0.25, 0.5, 0.75)) - low
    if three - quarter < 1e-7 * (low + median):
        return np.array([low + median]), np.ones(1)
    first = max(_LEAST, 1e-7 * low)
    last = min((1 - 1e-8) * (high - low), _MOST)

    def log_density(t: Any) -> Any:
        value = law.logpdf(low + t)
        return np.where(np.isnan(value), -np.inf, value)

    def density(x: Any) -> Any:
        return np.exp(log_density(np.exp(x)) + x)

    octaves = np.linspace(np.log(first), np.log(last), int(np.log2(last / first)) + 2)
    # A narrow law must not fall between the points: add panels of its own width about its median.
    steps = (three - quarter) * np.concatenate([[0], 2.0 ** np.arange(60)])
    around = np.concatenate([median - steps, median + steps])
    around = np.log(around[(around > first) & (around < last)])
    edges = np.unique(np.concatenate([octaves, around]))
    for tolerance in (1e-11, 1e-9, 1e-7, 1e-5):
        try:
            x, weight = _panels(density, edges, tolerance)
            break
        except _TooManyPanels:
            continue
    else:
        raise ValueError(f"{label} cannot be integrated: its density is too rough")

    # Beyond the ends the density is taken for a power of the distance.
    below, near = _lump(log_density, first, 0.5)
    if high < np.inf:
        above, left = _lump(lambda d: log_density((high - low) - d), (high - low) - last, 0.5)
        far = (high - low) - left
    else:
        above, far = _lump(log_density, last, 2.0)
    if not far < np.inf:
        raise ValueError(f"{label} has no finite mean, or too large a one: it must have one")
    t = np.concatenate([[near], np.exp(x), [far]])
    return low + t, np.concatenate([[below], weight, [above]])


def _lump(log_density: Callable[[Any], Any], t: float, ratio: float) -> tuple[float, float]:
    """Mass and mean of what lies beyond t, on the side of ``ratio * t``, of a density C t^(k-1)."""
    here, there = (float(value) for value in log_density(np.array([t, ratio * t])))
    if not here > -200:
        return 0.0, t
    mass, k = t * np.exp(here), 1 + (there - here) / np.log(ratio)
    if not np.isfinite(k):
        return mass, t
    if ratio < 1:
        k = max(k, 1e-6)
    elif k > -1 - 1e-6:
        return mass, np.inf
    return mass / abs(k), t * k / (k + 1)


def _panels(density: Callable[[Any], Any], edges: Any, tolerance: float) -> tuple[Any, Any]:
    """Points and weights of Gauss rules on panels that are halved until halving changes nothing.

    The allowed error of a panel follows from the smallest expectation that it contributes to, that
    of ``S^2 exp(-S tau)``: ``tolerance`` times the second moment of this panel and all below.
    """

    def rule(low: Any, high: Any) -> Any:
        x = (low + high)[:, None] / 2 + (high - low)[:, None] / 2 * _POINTS
        return density(x) * _WEIGHTS * (high - low)[:, None] / 2

    low, high = edges[:-1], edges[1:]
    mass, settled = rule(low, high), np.zeros(len(low), dtype=bool)  # mass: (panel, point)
    while not settled.all():
        if len(low) > _MOST_PANELS:
            raise _TooManyPanels
        middle = (low + high) / 2
        (halved,) = np.nonzero(~settled)
        left, right = rule(low[halved], middle[halved]), rule(middle[halved], high[halved])
        error = np.abs((left + right - mass[halved]).sum(axis=1))
        second = np.cumsum(mass.sum(axis=1) * np.exp(2 * (high - high[-1])))
        allowed = tolerance * (second * np.exp(-2 * (high - high[-1])))[halved] + 1e-70
        good = (error <= allowed) | (high[halved] - low[halved] < _NARROWEST)
        settled[halved[good]] = True
        halved, left, right = halved[~good], left[~good], right[~good]

        edges = np.sort(np.concatenate([low, high[-1:], middle[halved]]))
        order = np.argsort(np.concatenate([np.delete(low, halved), low[halved], middle[halved]]))
        low, high = edges[:-1], edges[1:]
        mass = np.concatenate([np.delete(mass, halved, axis=0), left, right])[order]
        settled = np.concatenate([np.delete(settled, halved), np.zeros(2 * len(halved), bool)])
        settled = settled[order]
    x = (low + high)[:, None] / 2 + (high - low)[:, None] / 2 * _POINTS
    return x.ravel(), mass.ravel()
