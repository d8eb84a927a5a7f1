"""Samplers against the law of their flights: at the ends of the random numbers, and in bulk.

The exact cumulative distributions are the survival functions ff and pf in float64: they must have
been found right before. With the :data:`DRAWS` of a check Kolmogorov-Smirnov finds any probability
P(tau <= t) that is off by 0.35 %; the chi-square test a share of flights that is 9 % off in any of
100 bins of equal mass, and one of 0.01 % at either end that is 60 % off; the moments a mean that is
off by 0.6 % of the standard deviation. Each raises a false alarm with probability 1e-6.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy import special, stats

from ..numerics.lookup import tables_in
from ..system.machine import array_types
from ..transmittance import Transmittance
from .arrays import with_arrays
from .faults import Fault

__all__ = [
    "DRAWS",
    "FALSE_ALARM",
    "FAR",
    "NEAR",
    "STEP",
    "Flights",
    "around",
    "assert_fit",
    "atoms",
    "bins",
    "distribution",
    "draw_flights",
    "ends",
    "moments",
    "quantiles",
    "sample",
    "sampler",
    "stream",
    "survival_of",
]

DRAWS = 2**20
FALSE_ALARM = 1e-6

STEP = 2.0**-23
"""Random numbers in single precision are multiples of it, in [0, 1)."""

NEAR, FAR = 1e-29, 1e35
"""Depths that samplers may call 0 and infinity: there intermediate results leave float32."""


@dataclasses.dataclass(frozen=True)
class Flights:
    """Sampled flights of a law from an origin, ``f`` or ``p``, ascending, beside their exact law.

    Flights below :data:`NEAR` are 0, those beyond ``far`` infinite. ``survival`` is P(tau > t) of
    NumPy arrays, ``other`` that of the other origin; ``atoms`` and ``kinks`` are those of the law.
    """

    origin: str
    tau: Any
    survival: Callable[[Any], Any]
    other: Callable[[Any], Any]
    far: float
    atoms: tuple[tuple[float, float], ...]
    kinks: tuple[float, ...]
    collides: bool

    @property
    def name(self) -> str:
        """The sampler, as messages call it."""
        return f"sampler of {self.origin}f"


def sample(law: Transmittance, origin: str, draw: Callable[[], Any], count: int) -> Any:
    """``count`` flights as float64 numbers."""
    tau = getattr(law, f"sample_{origin}")(draw)
    return np.broadcast_to(np.array(tau, dtype=np.float64), (count,))


def stream(count: int, seed: int) -> Callable[[], Any]:
    """Independent random numbers; PCG32 in neighbouring lanes is not random enough for this."""
    generator, kind = np.random.default_rng(seed), array_types().Float

    def draw() -> Any:
        return kind((generator.integers(0, 2**23, count) * STEP).astype(np.float32))

    return draw


def survival_of(law: Transmittance, origin: str, far: float = FAR) -> Callable[[Any], Any]:
    """P(tau > t), by float64; what is nearer than :data:`NEAR` is at 0, what is far at infinity.

    ``law`` holds its parameters in float64 arrays.
    """
    function, kind = law.ff if origin == "f" else law.pf, array_types().Float64

    def survival(t: Any) -> Any:
        t = np.asarray(t, dtype=float)
        inside = np.clip(t, NEAR, far)
        if not inside.size:
            return inside
        values = np.broadcast_to(np.array(function(kind(inside.ravel()))), inside.size)
        values = np.where(t < 0, 1.0, values.reshape(t.shape))
        return np.where(t == np.inf, 0.0, values)

    return survival


def draw_flights(
    narrow: Transmittance,
    wide: Transmittance,
    origin: str,
    *,
    count: int = DRAWS,
    seed: int = 7,
    far: float = FAR,
) -> Flights:
    """Flights of a law with parameters in float32, beside the same law in float64."""
    tau = sample(narrow, origin, stream(count, seed), count)
    tau = np.sort(tau.astype(np.float32)).astype(float)  # what it was: sorted sooner
    tau = np.where(tau > far, np.inf, np.where(tau < NEAR, 0, tau))
    return Flights(
        origin=origin,
        tau=tau,
        survival=survival_of(wide, origin, far),
        other=survival_of(wide, "p" if origin == "f" else "f", far),
        far=far,
        atoms=tuple((_number(where), _number(p)) for where, p in narrow.atoms),
        kinks=tuple(_number(kink) for kink in wide.kinks),
        collides=_number(wide.sigma_bar) > 0,
    )


def _number(value: Any) -> float:
    return float(np.ravel(np.array(value, dtype=float))[0])


def around(tau: Any) -> tuple[Any, Any]:
    """Two float32 numbers down and up: no law can be told from one that is rounded by less."""
    at, result = tau.astype(np.float32), []
    for direction in (-np.inf, np.inf):
        end = np.float32(direction)
        with np.errstate(over="ignore"):
            result.append(np.nextafter(np.nextafter(at, end), end).astype(float))
    return result[0], result[1]


def quantiles(survival: Callable[[Any], Any], levels: Any) -> Any:
    """The least float32 depths that a flight does not pass with these probabilities.

    By bisection over the bit patterns, which ascend with the numbers; infinity if there is none.
    """
    low, high = np.full(len(levels), -1), np.full(len(levels), np.float32(np.inf).view(np.int32))
    while np.any(high - low > 1):
        middle = (low + high) // 2
        reached = 1 - survival(middle.astype(np.int32).view(np.float32)) >= levels
        low, high = np.where(reached, low, middle), np.where(reached, middle, high)
    return high.astype(np.int32).view(np.float32).astype(float)


# --------------------------------------------------------------------- in bulk


def distribution(flights: Flights) -> None:
    """Kolmogorov and Smirnov's test, of the distribution within rounding of each sample."""
    tau = flights.tau
    if np.isnan(tau[-1]):  # NaN is sorted to the end
        raise Fault(f"{flights.name}: {np.count_nonzero(np.isnan(tau))} of {len(tau)} are NaN")
    if tau[0] < 0:
        raise Fault(f"{flights.name}: the distance {tau[0]:.6g} is negative")
    distance, at = _distance(tau, flights.survival, flights.far)
    if special.kolmogorov(distance * np.sqrt(len(tau))) <= FALSE_ALARM:
        raise Fault(f"{flights.name}: {_diagnosis(flights, at)}")


def _distance(tau: Any, survival: Callable[[Any], Any], far: float) -> tuple[float, float]:
    """Largest difference of the distributions, and the depth where it is."""
    last = np.flatnonzero(np.append(tau[1:] != tau[:-1], True))
    counts = np.diff(last, prepend=-1)
    # Both functions ascend: between neighbours of these they differ by at most 2^-16 more.
    steps = (last + 1) * 2**16 // len(tau)
    ends = np.diff(steps, append=steps[-1] + 1) > 0
    ends[:-1] |= ends[1:] & (counts[1:] * 2**16 > len(tau))  # before an atom, too
    ends[0] = True
    at, counts, last = tau[last[ends]], counts[ends], last[ends]
    share = (last + 1) / len(tau)
    below, above = around(at)
    below[at == np.inf] = far
    too_many = share - (1 - survival(above))
    too_few = 1 - survival(below) - (share - counts / len(tau))
    worst = np.maximum(too_many, too_few)
    return max(float(np.max(worst)), 0.0), float(at[int(np.argmax(worst))])


def _diagnosis(flights: Flights, at: float) -> str:
    """What kind of wrong the distribution is."""
    tau, passed = flights.tau, 2 * FALSE_ALARM

    def agrees(tau: Any, survival: Callable[[Any], Any]) -> bool:
        distance, _ = _distance(tau, survival, flights.far)
        return bool(special.kolmogorov(distance * np.sqrt(len(tau))) > passed)

    if agrees(tau, flights.other):
        origins = ("a particle (pf)", "a fixed point (ff)")
        drawn, wanted = origins if flights.origin == "f" else origins[::-1]
        return f"flights are those from {drawn}, not from {wanted}"
    collide = 1 - float(flights.survival(flights.far))
    levels = collide * np.linspace(0.1, 0.9, 17)
    right = quantiles(flights.survival, levels)
    found = tau[(levels * len(tau)).astype(int)]
    with np.errstate(all="ignore"):
        ratio = found / right
    usable = np.isfinite(ratio) & (right > 0)
    if np.any(usable):
        factor = float(np.median(ratio[usable]))
        if factor > 0 and agrees(tau / factor, flights.survival):
            word = "long" if factor > 1 else "short"
            error = 100 / np.sqrt(len(tau))
            return f"distances too {word} by {100 * abs(factor - 1):.1f} % (± {error:.1f} %)"
    share = float(np.mean(tau <= at))
    expected = 1 - float(flights.survival(at))
    return f"wrong distribution: {share:.4%} of flights end by {at:.4g}, not {expected:.4%}"


def assert_fit(found: Any, expected: Any, name: str = "") -> None:
    """Chi-square test of counts, of which neighbours are taken together where few are expected."""
    if not np.all(found[expected < 1e-6] == 0):
        raise Fault(f"{name}: flights end where none can")
    starts, total = [0], 0.0
    for i, number in enumerate(expected):
        total += number
        if total >= 10 and np.sum(expected[i + 1 :]) >= 10:
            starts.append(i + 1)
            total = 0.0
    found, expected = np.add.reduceat(found, starts), np.add.reduceat(expected, starts)
    terms = (found - expected) ** 2 / expected
    p = stats.chi2.sf(np.sum(terms), max(len(found) - 1, 1))
    if p <= FALSE_ALARM:
        i = int(np.argmax(terms))
        raise Fault(
            f"{name}: bin {i + 1} of {len(found)} holds {found[i]:.0f} flights, "
            f"{expected[i]:.1f} are expected (chi-square test, p = {p:.1e})"
        )


def bins(flights: Flights) -> None:
    """In 100 bins of equal mass and in small ones at both ends, found without the sampler."""
    tails = np.array([1e-4, 1e-3])
    levels = np.concatenate([tails, np.linspace(0.01, 0.99, 99), 1 - tails[::-1]])
    edges = np.unique(quantiles(flights.survival, levels))
    edges = edges[edges < np.inf]
    if flights.survival(flights.far) == 1 and not np.all(flights.tau == np.inf):
        raise Fault(f"{flights.name}: flights end, although nothing collides")
    # A sample is the float32 number nearest to an exact one: bins end between two such numbers.
    # Off an atom, whose place is rounded.
    after = around(edges)[1].astype(np.float32)
    between = (after + np.nextafter(after, np.float32(np.inf), dtype=np.float32).astype(float)) / 2
    beyond = np.concatenate([[1.0], flights.survival(between), [0.0]])
    expected = -np.diff(beyond) * len(flights.tau)
    found = np.diff([0, *np.searchsorted(flights.tau, between), len(flights.tau)])
    assert_fit(found, expected, flights.name)


def atoms(flights: Flights) -> None:
    """Flights end exactly at the atoms of the law, as often as it says."""
    held = [(float(np.float32(where)), p) for where, p in flights.atoms]
    if not held or flights.origin == "f":
        return
    where, index = np.unique([w for w, _ in held], return_inverse=True)
    expected = np.bincount(index, [p for _, p in held]) * len(flights.tau)
    first, last = (np.searchsorted(flights.tau, where, side) for side in ("left", "right"))
    rest = len(flights.tau) - np.array([np.sum(last - first), np.sum(expected)])
    found, right = np.append(last - first, rest[0]), np.append(expected, rest[1])
    assert_fit(found, right, f"{flights.name}, flights that end at atoms")


def moments(flights: Flights) -> tuple[float, float]:
    """First and second moment of the flights, cut off at a length that one in 1000 exceeds.

    With S the survival function E[min(tau, L)] is the integral of S over [0, L], and
    E[min(tau, L)^2] twice that of t S. The cut makes both finite for every law. Returns the cut and
    the exact first moment.
    """
    if not flights.collides:
        return 0.0, 0.0
    collide = 1 - float(flights.survival(flights.far))
    (cut,) = quantiles(flights.survival, np.array([0.999 * collide]))
    kinks = [kink for kink in flights.kinks if kink < cut]
    graded = cut * 0.5 ** np.arange(1, 60)
    breaks = np.unique(np.concatenate([[0.0, cut], graded, cut - graded, kinks]))
    nodes, weights = np.polynomial.legendre.leggauss(24)
    half, middle = np.diff(breaks)[:, None] / 2, (breaks[1:] + breaks[:-1])[:, None] / 2
    x = middle + half * nodes
    survival = flights.survival(x)
    first = float(np.sum(half * weights * survival) / cut)
    second = float(np.sum(half * weights * 2 * (x / cut) * survival) / cut)

    tau = np.minimum(flights.tau, cut) / cut
    for name, values, expected in (("", tau, first), ("squared ", tau**2, second)):
        deviation = abs(np.mean(values) - expected) - 1e-6 * expected
        bound = -special.ndtri(FALSE_ALARM / 2) * np.std(values) / np.sqrt(len(values))
        if deviation > bound:
            off = np.mean(values) / expected - 1
            raise Fault(f"{flights.name}: the mean {name}distance is off by {off:+.2%}")
    return float(cut), first * float(cut)


# --------------------------------------------------------------------- single numbers


def ends(
    narrow: Transmittance, origin: str, *, never: bool, clear: bool, name: str | None = None
) -> None:
    """All pairs of a first and of all further numbers: no NaN, and infinity only where it is due.

    ``never``: the law has no flights beyond the horizon; ``clear``: some flights never end.
    """
    name = name or f"sampler of {origin}f"
    numbers = np.array([*(k * STEP for k in range(9)), 0.25, 0.5, 1 - 2 * STEP, 1 - STEP])
    first, others = (axis.ravel() for axis in np.meshgrid(numbers, numbers, indexing="ij"))
    kind = array_types().Float
    draws = iter([kind(first)])
    tau = sample(narrow, origin, lambda: next(draws, kind(others)), len(first))

    def refuse(bad: Any, what: str) -> None:
        if np.any(bad):
            i = int(np.argmax(bad))
            raise Fault(
                f"{name}: the distance is {tau[i]:g} for the random numbers {first[i]:.9g}, "
                f"{others[i]:.9g}, ...{what}"
            )

    refuse(np.isnan(tau), "")
    refuse(tau < 0, "")
    if never:
        refuse(tau == np.inf, ", though all flights end")
    if origin == "f" and not clear:
        refuse((first == 0) & (others == 0) & (tau != 0), ": 0 must give depth 0")
        refuse((first > 0) & (others > 0) & (tau <= 0), ": only 0 may give depth 0")


def sampler(law: Transmittance, origin: str) -> None:
    """All of this for one origin: the ends of the random numbers, the distribution, bins, atoms and
    moments of 2^20 flights."""
    types = array_types()
    narrow, wide = with_arrays(law, types.Float)[0], with_arrays(law, types.Float64)[0]
    # Parameters are rounded to float32 in both.
    clear = float(law.ff(np.inf)) > 0
    far = 1e10 if any(tables_in(narrow)) else FAR  # where tables end
    ends(narrow, origin, never=float(survival_of(wide, origin, far)(FAR)) == 0, clear=clear)
    flights = draw_flights(narrow, wide, origin, far=far)
    distribution(flights)
    bins(flights)
    atoms(flights)
    moments(flights)
