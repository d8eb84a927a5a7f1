"""Every law once more, in 60-digit arithmetic and in its textbook form.

References take the exact values of the parameters that a model holds (a float32 number is a
rational one), so that what differs is rounding inside the model, or a wrong formula. They share no
code with the models and avoid their rearrangements: nothing here is written against cancellation.
"""

from __future__ import annotations

import bisect
import dataclasses
import itertools
from collections.abc import Callable
from typing import Any

import drjit as dr
import numpy as np
from stability_series import Series, erfc, exp, log1p, mp

from nonexp import models, parameters
from nonexp.transmittance import Transmittance

Moments = Callable[[int, Any], Any]
"""E[X^k exp(-X tau)] of (k, tau), X >= 0"""

LAWS: dict[str, type[Law]] = {}
"""Reference of every model, by key."""


def exact(value: Any) -> Any:
    """The rational number that a Python float or a Dr.Jit array of width 1 holds."""
    return mp.mpf(float(dr.detach(value)[0] if dr.is_array_v(value) else value))


def exact_places(model: Transmittance) -> list[Any]:
    """Where the atoms of a model are, all evaluated by one kernel."""
    places = [where for where, _ in model.atoms]
    dr.eval(places)
    return [exact(where) for where in places]


def key_of(model: Transmittance) -> str:
    return next(key for key, cls in models.registry.items() if type(model) is cls)


def reference(model: Transmittance, changes: dict[str, Any] | None = None) -> Law:
    """The law of a model; ``changes`` replaces parameters by path, such as ``models[0].b``.

    Raises ``LookupError`` for a model that has no reference.
    """
    key = key_of(model)
    if key not in LAWS:
        raise LookupError(
            f"model {key} has no reference in tests/stability/stability_reference.py: "
            "add a subclass of Law with its textbook formulas"
        )
    return LAWS[key].of(model, changes or {})


def law(key: str) -> Callable[[type[Law]], type[Law]]:
    def add(cls: type[Law]) -> type[Law]:
        LAWS[key] = cls
        return cls

    return add


def collected(model: Transmittance, changes: dict[str, Any]) -> dict[str, Any]:
    """Parameters of a model as exact numbers, lists of them, or references of its components."""
    given: dict[str, Any] = {}
    for field in dataclasses.fields(model):  # type: ignore[arg-type]
        name, kind, value = field.name, parameters.kind_of(field), getattr(model, field.name)
        if isinstance(kind, parameters.Components):
            given[name] = []
            for position, component in enumerate(value):
                prefix = f"{name}[{position}]."
                inner = {
                    path.removeprefix(prefix): v
                    for path, v in changes.items()
                    if path.startswith(prefix)
                }
                given[name].append(reference(component, inner))
        elif isinstance(kind, parameters.Vector):
            paths = [f"{name}[{position}]" for position in range(len(value))]
            given[name] = [
                changes.get(path, exact(v)) for path, v in zip(paths, value, strict=True)
            ]
        elif isinstance(kind, parameters.Whole):
            given[name] = value
        else:
            given[name] = changes.get(name, exact(value))
    return given


class Law:
    """``ff``, ``pf`` and ``pp`` (less atoms) at ``tau`` >= 0, sigma_bar, and where a density jumps.

    A law defines T = ``ff``, of numbers and of series, and its mean extinction; the other functions
    are derivatives of T, unless a law knows another formula for them. At a kink the functions are
    the limits from the right.
    """

    sigma_bar: Any = mp.one
    end: Any = mp.zero
    """T(inf): the share of light that nothing ever stops"""
    singular: bool = False
    """At tau = 0 derivatives, or differences that would show them, do not exist."""
    step: Any = mp.mpf(10) ** -20
    """Relative step of differences that tests may take"""
    kinks: tuple[Any, ...] = ()
    atoms: tuple[tuple[Any, Any], ...] = ()

    @classmethod
    def of(cls, model: Transmittance, changes: dict[str, Any]) -> Law:
        return cls(**collected(model, changes))

    def ff(self, tau: Any) -> Any:
        raise NotImplementedError

    def fp(self, tau: Any) -> Any:
        return self.sigma_bar * self.pf(tau)

    def pf(self, tau: Any) -> Any:
        return self.fall(1, tau) / self.sigma_bar if self.sigma_bar else mp.one

    def pp(self, tau: Any) -> Any:
        return self.fall(2, tau) / self.sigma_bar if self.sigma_bar else mp.zero

    def fall(self, order: int, tau: Any) -> Any:
        """(-d/dtau)^order T, right of ``tau``."""
        found = self.ff(Series.variable(tau, order))
        if not isinstance(found, Series):  # constant there
            return mp.zero
        return (-1) ** order * mp.factorial(order) * found.of[order]


@law("exponential")
class Exponential(Law):
    def ff(self, tau: Any) -> Any:
        return exp(-tau)


@law("constant")
class Constant(Law):
    sigma_bar = mp.zero
    end = mp.one

    def ff(self, tau: Any) -> Any:
        return mp.one


@law("power")
class Power(Law):
    def __init__(self, b: Any, n: Any) -> None:
        self.b, self.n = b, n
        self.sigma_bar = n / b
        self.kinks = (b,)
        self.atoms = ((b, mp.one),) if n == 1 else ()

    def ff(self, tau: Any) -> Any:
        return (1 - tau / self.b) ** self.n if tau < self.b else mp.zero


@law("linear")
class Linear(Power):
    def __init__(self, b: Any) -> None:
        super().__init__(b, 1)


@law("quadratic")
class Quadratic(Power):
    def __init__(self, b: Any) -> None:
        super().__init__(b, 2)


@law("gamma")
class Gamma(Law):
    def __init__(self, alpha: Any) -> None:
        self.alpha = alpha

    def ff(self, tau: Any) -> Any:
        return (1 + tau / self.alpha) ** -self.alpha


@law("erlang")
class Erlang(Law):
    """Flights from a particle are the sum of k exponential ones, so that pf is Q(k, rate tau).

    By the regularised incomplete gamma function Q in ``ff``, and by its finite sum in ``pf``.
    """

    def __init__(self, k: int, rate: Any) -> None:
        self.k, self.rate = k, rate
        self.sigma_bar = rate / k

    def ff(self, tau: Any) -> Any:
        x = self.rate * tau
        upper = [mp.gammainc(k, x, regularized=True) for k in (self.k + 1, self.k)]
        return upper[0] - x / self.k * upper[1] if x else mp.one

    def pf(self, tau: Any) -> Any:
        x = self.rate * tau
        return mp.exp(-x) * mp.fsum(x**i / mp.factorial(i) for i in range(self.k))

    def pp(self, tau: Any) -> Any:
        x = self.rate * tau
        return self.rate * x ** (self.k - 1) * mp.exp(-x) / mp.factorial(self.k - 1)


@law("davis_weinstein")
class DavisWeinstein(Law):
    """At h = 1/2 sigma_bar jumps; it does not where the parameter is only shifted there."""

    singular = True

    def __init__(self, h: Any, c: Any, white: bool) -> None:
        self.B = 2 * h - 1
        self.C = c ** (1 + self.B)
        self.sigma_bar = mp.log1p(c) / c if white else mp.one

    @classmethod
    def of(cls, model: Transmittance, changes: dict[str, Any]) -> Law:
        return cls(**collected(model, changes), white=exact(model.h) == 0.5)  # type: ignore[attr-defined]

    def ff(self, tau: Any) -> Any:
        return exp(-(tau ** (1 - self.B)) / self.C * log1p(self.C * tau**self.B))

    def pf(self, tau: Any) -> Any:
        return super().pf(tau) if tau else mp.one

    def pp(self, tau: Any) -> Any:
        return super().pp(tau) if tau or self.B in (0, 1) else mp.inf


@law("hard_rod")
class HardRod(Law):
    def __init__(self, d: Any, l: Any) -> None:  # noqa: E741
        self.d, self.l = d, l
        self.sigma_bar = 1 / (d + l)
        self.kinks = (d,) if d else ()

    def ff(self, tau: Any) -> Any:
        if tau < self.d:
            return 1 - self.sigma_bar * tau
        return self.sigma_bar * self.l * exp(-(tau - self.d) / self.l)


@law("pulse")
class Pulse(Law):
    """Sums over the pulses, at the places where the model has them, rounded as they are."""

    def __init__(self, a: Any, b: Any, n: int, places: Any = None) -> None:
        regular = [a + (i + mp.mpf(1) / 2) * (b - a) / n for i in range(n)]
        self.places = regular if places is None else list(places)
        self.n = n
        self.sigma_bar = 2 / (a + b)
        self.kinks = tuple(self.places)
        self.atoms = tuple((place, mp.one / n) for place in self.places)
        self.sums = [mp.fsum(self.places[i:]) for i in range(n + 1)]

    @classmethod
    def of(cls, model: Transmittance, changes: dict[str, Any]) -> Law:
        # A shifted parameter shifts the places: then they are where the formula says.
        places = None if changes else exact_places(model)
        return cls(**collected(model, changes), places=places)

    def ff(self, tau: Any) -> Any:
        passed = bisect.bisect_right(self.places, tau)
        return self.sigma_bar / self.n * (self.sums[passed] - (self.n - passed) * tau)


@law("mixture")
class Mixture(Law):
    def __init__(self, models: list[Law], weight: list[Any]) -> None:
        weight = weight or [mp.one] * len(models)
        whole = mp.fsum(weight)
        self.terms = [(w / whole, m) for w, m in zip(weight, models, strict=True)]
        self.end = mp.fsum(w * m.end for w, m in self.terms)
        self.sigma_bar = mp.fsum(w * m.sigma_bar for w, m in self.terms)
        self.kinks = tuple(sorted({kink for _, m in self.terms for kink in m.kinks}))
        self.atoms = tuple(
            (where, w * m.sigma_bar * probability / self.sigma_bar)
            for w, m in self.terms
            for where, probability in m.atoms
        )

    def ff(self, tau: Any) -> Any:
        return mp.fsum(w * m.ff(tau) for w, m in self.terms)

    def over_flights(self, values: list[Any]) -> Any:
        """Mean over the laws, weighted by how many collisions each has."""
        if not self.sigma_bar:
            return values[0]
        parts = [w * m.sigma_bar * v for (w, m), v in zip(self.terms, values, strict=True)]
        return mp.fsum(parts) / self.sigma_bar

    def pf(self, tau: Any) -> Any:
        return self.over_flights([m.pf(tau) for _, m in self.terms])

    def pp(self, tau: Any) -> Any:
        return self.over_flights([m.pp(tau) for _, m in self.terms])


@law("custom")
@law("tabulated")
class Polyline(Law):
    """The curve that the model made of its data: -T' is linear between knots.

    Behind the last one T falls exponentially with that slope, or stays as it is.
    """

    def __init__(self, knots: list[Any], slopes: list[Any], rest: Any) -> None:
        self.knots, self.slopes, self.rest = knots, slopes, rest
        self.sigma_bar = slopes[0]
        self.end = mp.zero if slopes[-1] else rest
        self.left = [rest]  # T at the knots
        for i in range(len(knots) - 1, 0, -1):
            area = (knots[i] - knots[i - 1]) * (slopes[i] + slopes[i - 1]) / 2
            self.left.insert(0, self.left[0] + area)
        bends = [self.bend(i) for i in range(len(knots))]
        jumps = [abs(b - a) > 1e-9 * abs(a) for a, b in itertools.pairwise(bends)]
        self.kinks = tuple(knot for knot, jump in zip(knots[1:], jumps, strict=True) if jump)
        if not rest and slopes[-1]:
            self.atoms = ((knots[-1], slopes[-1] / slopes[0]),)
            self.kinks = tuple(sorted({*self.kinks, knots[-1]}))

    @classmethod
    def of(cls, model: Transmittance, changes: dict[str, Any]) -> Law:
        curve: Any = model._curve  # type: ignore[attr-defined]
        knots, slopes = (
            [exact(number) for number in column] for column in (curve.knots, curve.slope)
        )
        return cls(knots, slopes, exact(curve.rest))

    def bend(self, i: int) -> Any:
        """T'' right of a knot."""
        if i < len(self.knots) - 1:
            width = self.knots[i + 1] - self.knots[i]
            return (self.slopes[i] - self.slopes[i + 1]) / width
        return self.slopes[-1] ** 2 / self.rest if self.rest else mp.zero

    def derivatives(self, tau: Any) -> tuple[Any, Any, Any]:
        """T, -T' and T''."""
        i = bisect.bisect_right(self.knots, tau) - 1
        if i < len(self.knots) - 1:
            along = tau - self.knots[i]
            slope = self.slopes[i] - along * self.bend(i)
            return self.left[i] - along * (self.slopes[i] + slope) / 2, slope, self.bend(i)
        if not self.rest:
            return mp.zero, mp.zero, mp.zero
        fading = mp.exp(-(tau - self.knots[-1]) * self.slopes[-1] / self.rest)
        return self.rest * fading, self.slopes[-1] * fading, self.bend(i) * fading

    def ff(self, tau: Any) -> Any:
        return self.derivatives(tau)[0]

    def pf(self, tau: Any) -> Any:
        return self.derivatives(tau)[1] / self.sigma_bar

    def pp(self, tau: Any) -> Any:
        return self.derivatives(tau)[2] / self.sigma_bar


class Extinctions(Law):
    """E[exp(-S tau)], from the moments E[S^k exp(-S tau)]."""

    def moment(self, k: int, tau: Any) -> Any:
        raise NotImplementedError

    def prepare(self) -> Law:
        self.sigma_bar = self.moment(1, mp.zero)
        return self

    def ff(self, tau: Any) -> Any:
        return self.moment(0, tau)

    def pf(self, tau: Any) -> Any:
        return self.moment(1, tau) / self.sigma_bar

    def pp(self, tau: Any) -> Any:
        return self.moment(2, tau) / self.sigma_bar


class Shifted(Extinctions):
    """S = loc + scale X, from ``standard(k, tau)`` = E[X^k exp(-X tau)]."""

    def __init__(self, standard: Moments, loc: Any = mp.zero, scale: Any = mp.one) -> None:
        self.standard, self.loc, self.scale = standard, loc, scale

    def moment(self, k: int, tau: Any) -> Any:
        terms = [
            mp.binomial(k, i) * self.loc ** (k - i) * self.scale**i
            * self.standard(i, self.scale * tau)
            for i in range(k + 1)
            if self.loc or i == k
        ]  # fmt: skip
        return mp.exp(-self.loc * tau) * mp.fsum(terms)


class Integrated(Extinctions):
    """By the trapezoidal rule, which converges exponentially here: 13 digits in float64.

    From numbers on a grid, their density times the spacing, and X of them; S = loc + scale X.
    """

    singular = True
    step = mp.mpf(10) ** -4

    def __init__(self, weights: Any, x: Any, loc: Any = 0.0, scale: Any = 1.0) -> None:
        self.weights, self.values = weights, float(loc) + float(scale) * x

    def moment(self, k: int, tau: Any) -> Any:
        with np.errstate(under="ignore"):
            terms = self.weights * self.values**k * np.exp(-self.values * float(tau))
        return mp.mpf(float(np.sum(terms)))


class Poisson(Extinctions):
    def __init__(self, mu: Any) -> None:
        self.mu = mu
        self.end = mp.exp(-mu)

    def moment(self, k: int, tau: Any) -> Any:
        x = self.mu * mp.exp(-tau)
        touchard = (1, x, x + x**2, x + 3 * x**2 + x**3)
        return touchard[k] * mp.exp(x - self.mu)


class TableOfExtinctions(Extinctions):
    def __init__(self, sigma: list[Any], weight: list[Any]) -> None:
        whole = mp.fsum(weight)
        self.terms = [(s, w / whole) for s, w in zip(sigma, weight, strict=True)]
        self.end = mp.fsum(w for s, w in self.terms if s == 0)

    def moment(self, k: int, tau: Any) -> Any:
        return mp.fsum(w * s**k * mp.exp(-s * tau) for s, w in self.terms)


def gamma(a: Any) -> Moments:
    return lambda k, t: mp.rf(a, k) * (1 + t) ** -(a + k)


def beta(a: Any, b: Any) -> Moments:
    def moment(k: int, t: Any) -> Any:
        return mp.rf(a, k) / mp.rf(a + b, k) * mp.hyp1f1(a + k, a + b + k, -t)

    return moment


def uniform(k: int, t: Any) -> Any:
    if t < mp.mpf(10) ** -12:  # next term: t^2/2
        return mp.one / (k + 1) - t / (k + 2)
    return mp.gammainc(k + 1, 0, t) / t ** (k + 1)


def loguniform(low: Any, high: Any) -> Moments:
    def moment(k: int, t: Any) -> Any:
        if not t:
            return (high**k - low**k) / k / mp.log(high / low) if k else mp.one
        return mp.gammainc(k, low * t, high * t) / t**k / mp.log(high / low)

    return moment


def pareto(b: Any) -> Moments:
    return lambda k, t: b * mp.expint(b + 1 - k, t)


class Transform(Law):
    """E[exp(-X tau)] as a formula, of which the moments are derivatives."""

    def __init__(self, formula: Callable[[Any], Any]) -> None:
        self.formula = formula

    def ff(self, tau: Any) -> Any:
        return self.formula(tau)


def derived(formula: Callable[[Any], Any]) -> Moments:
    transform = Transform(formula)
    return lambda k, t: transform.fall(k, t) if k else formula(t)


def triangular(c: Any) -> Moments:
    """Mean of two uniform numbers."""
    assert c == 0.5
    inside = derived(lambda t: ((1 - exp(-t / 2)) / (t / 2)) ** 2)
    return lambda k, t: inside(k, t) if t else (mp.one, mp.one / 2, mp.mpf(7) / 24)[k]


def inverse_gaussian(mu: Any) -> Moments:
    return derived(lambda t: exp((1 - (1 + 2 * mu**2 * t) ** mp.mpf(0.5)) / mu))


def truncated_normal(low: Any, high: Any) -> Moments:
    def between(t: Any) -> Any:
        return erfc((low + t) / mp.sqrt(2)) - erfc((high + t) / mp.sqrt(2))

    return derived(lambda t: exp(t * t / 2) * between(t) / between(mp.zero))


def lognormal(s: Any, *place: Any) -> Law:
    z = np.arange(-40, 40 + 4 * float(s), 0.01)
    weights = 0.01 / np.sqrt(2 * np.pi) * np.exp(-0.5 * z**2)
    return Integrated(weights, np.exp(float(s) * z), *place)


def weibull(c: Any, *place: Any) -> Law:
    y = np.arange(-80, 8, 0.005)
    return Integrated(0.005 * np.exp(y - np.exp(y)), np.exp(y / float(c)), *place)


def binomial(n: Any, p: Any) -> Law:
    n = int(n)
    weights = [mp.binomial(n, k) * p**k * (1 - p) ** (n - k) for k in range(n + 1)]
    return TableOfExtinctions(list(map(mp.mpf, range(n + 1))), weights)


DISTRIBUTIONS: dict[str, Callable[..., Any]] = {
    "gamma": lambda a, *place: Shifted(gamma(a), *place),
    "expon": lambda *place: Shifted(gamma(mp.one), *place),
    "beta": lambda a, b, *place: Shifted(beta(a, b), *place),
    "uniform": lambda *place: Shifted(uniform, *place),
    "loguniform": lambda low, high, *place: Shifted(loguniform(low, high), *place),
    "pareto": lambda b, *place: Shifted(pareto(b), *place),
    "triang": lambda c, *place: Shifted(triangular(c), *place),
    "invgauss": lambda mu, *place: Shifted(inverse_gaussian(mu), *place),
    "truncnorm": lambda low, high, *place: Shifted(truncated_normal(low, high), *place),
    "lognorm": lognormal,
    "weibull_min": weibull,
    "poisson": Poisson,
    "binom": binomial,
}
"""Laws of extinction with an expectation of their own here, by their names in scipy.stats."""


@law("exponential_mixture")
class ExponentialMixture(TableOfExtinctions):
    def __init__(self, sigma: list[Any], weight: list[Any]) -> None:
        super().__init__(sigma, weight or [mp.one] * len(sigma))
        self.prepare()


@law("ensemble")
class Ensemble(Law):
    @classmethod
    def of(cls, model: Transmittance, changes: dict[str, Any]) -> Law:
        given: Any = model
        if given.law:
            arguments = [exact(number) for number in given.args]
            return DISTRIBUTIONS[given.law](*arguments).prepare()  # type: ignore[no-any-return]
        sigma = [exact(number) for number in given.sigma]
        weight = [exact(number) for number in given.weight] or [mp.one] * len(sigma)
        return TableOfExtinctions(sigma, weight).prepare()
