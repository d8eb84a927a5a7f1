"""Samplers against the exact law of their flights: at the ends of the random numbers, and in bulk.

Statistics are those of 2^20 flights in single precision per model, case and origin. The exact
cumulative distributions are the survival functions in float64, which test_values.py holds to 11
digits. Of a wrong law Kolmogorov-Smirnov finds, with certainty, any probability P(tau <= t) that is
off by 0.35 %; the chi-square test finds a share of flights that is 9 % off in any of 100 bins of
equal mass, and one of 0.01 % at either end that is 60 % off; the moments find a mean that is off by
0.6 % of the standard deviation. Each of fewer than 2000 tests raises a false alarm with probability
1e-6: one in 500 suites of other seeds.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from drjit.llvm.ad import PCG32, Float, Float64
from scipy import special, stats
from stability_cases import CASES, QUICK, case_id, every_case
from stability_reference import exact
from stability_values import narrow, wide
from tiers import quick

DRAWS = 2**20
FALSE_ALARM = 1e-6

STEP = 2.0**-23
"""Random numbers in single precision are multiples of it, in [0, 1)."""

NEAR, FAR = 1e-29, 1e35
"""Depths that samplers may call 0 and infinity: there intermediate results leave float32."""
FAR_IN_TABLES = {"ensemble": 1e10}
"""The same where a kernel's table of the law ends."""

REUSED: set[tuple[str, str]] = set()
"""Samplers (key, origin) that take one random number, but for two decisions: no inversions."""

KINDS = [(i, origin) for i in range(len(CASES)) for origin in "fp"]
IDS = [f"{case_id(CASES[i])}-{origin}" for i, origin in KINDS]
both_origins = pytest.mark.parametrize("origin", ["f", "p"])


@dataclasses.dataclass(frozen=True)
class Flights:
    """Sampled flights of one case and origin, ascending, beside their exact law.

    Flights below ``NEAR`` are 0, those beyond ``far`` infinite.
    """

    model: Any
    law: Any
    origin: str
    tau: Any
    survival: Callable[[Any], Any]
    far: float


def horizon(position: int) -> float:
    return FAR_IN_TABLES.get(CASES[position][0], FAR)


def exact_survival(position: int, origin: str) -> Callable[[Any], Any]:
    """P(tau > t), by float64; what is nearer than ``NEAR`` is at 0, what is far at infinity."""
    model, _ = wide(position)
    function = model.ff if origin == "f" else model.pf

    def survival(t: Any) -> Any:
        t = np.asarray(t, dtype=float)
        inside = np.clip(t, NEAR, horizon(position))
        if not inside.size:
            return inside
        values = np.broadcast_to(np.array(function(Float64(inside.ravel()))), inside.size)
        values = np.where(t < 0, 1.0, values.reshape(t.shape))
        return np.where(t == np.inf, 0.0, values)

    return survival


def sample(model: Any, origin: str, draw: Callable[[], Any], count: int) -> Any:
    tau = getattr(model, f"sample_{origin}")(draw)
    return np.broadcast_to(np.array(tau, dtype=np.float64), (count,))


def stream(count: int, seed: int) -> Callable[[], Any]:
    """Independent random numbers; PCG32 in neighbouring lanes is not random enough for this."""
    generator = np.random.default_rng(seed)

    def draw() -> Any:
        return Float((generator.integers(0, 2**23, count) * STEP).astype(np.float32))

    return draw


@pytest.fixture(scope="module", params=quick(KINDS, lambda kind: kind[0] in QUICK), ids=IDS)
def flights(request: pytest.FixtureRequest, effort: int) -> Flights:
    position, origin = request.param
    model, law = narrow(position)
    count = DRAWS * min(effort, 4)
    tau = sample(model, origin, stream(count, 7 + position), count)
    tau = np.sort(tau.astype(np.float32)).astype(float)  # what it was: sorted sooner
    far = horizon(position)
    tau = np.where(tau > far, np.inf, np.where(tau < NEAR, 0, tau))
    return Flights(model, law, origin, tau, exact_survival(position, origin), far)


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


def assert_fit(found: Any, expected: Any) -> None:
    """Chi-square test of counts, of which neighbours are taken together where few are expected."""
    assert np.all(found[expected < 1e-6] == 0)
    starts, total = [0], 0.0
    for i, number in enumerate(expected):
        total += number
        if total >= 10 and np.sum(expected[i + 1 :]) >= 10:
            starts.append(i + 1)
            total = 0.0
    found, expected = np.add.reduceat(found, starts), np.add.reduceat(expected, starts)
    statistic = np.sum((found - expected) ** 2 / expected)
    assert stats.chi2.sf(statistic, max(len(found) - 1, 1)) > FALSE_ALARM


# --------------------------------------------------------------------------------- in bulk


def test_kolmogorov_smirnov(flights: Flights) -> None:
    """Of the distribution within rounding of each sample."""
    assert flights.tau[0] >= 0 and not np.isnan(flights.tau[-1])  # NaN is sorted to the end
    last = np.flatnonzero(np.append(flights.tau[1:] != flights.tau[:-1], True))
    counts = np.diff(last, prepend=-1)
    # Both functions ascend: between neighbours of these they differ by at most 2^-16 more.
    steps = (last + 1) * 2**16 // len(flights.tau)
    ends = np.diff(steps, append=steps[-1] + 1) > 0
    ends[:-1] |= ends[1:] & (counts[1:] * 2**16 > len(flights.tau))  # before an atom, too
    ends[0] = True
    tau, counts, last = flights.tau[last[ends]], counts[ends], last[ends]
    share = (last + 1) / len(flights.tau)
    below, above = around(tau)
    below[tau == np.inf] = flights.far
    too_many = np.max(share - (1 - flights.survival(above)))
    too_few = np.max(1 - flights.survival(below) - (share - counts / len(flights.tau)))
    distance = max(too_many, too_few, 0)
    assert special.kolmogorov(distance * np.sqrt(len(flights.tau))) > FALSE_ALARM


def test_chi_square(flights: Flights) -> None:
    """In 100 bins of equal mass and in small ones at both ends, found without the sampler."""
    ends = np.array([1e-4, 1e-3])
    levels = np.concatenate([ends, np.linspace(0.01, 0.99, 99), 1 - ends[::-1]])
    edges = np.unique(quantiles(flights.survival, levels))
    edges = edges[edges < np.inf]
    if flights.survival(flights.far) == 1:
        assert np.all(flights.tau == np.inf)
    # A sample is the float32 number nearest to an exact one: bins end between two such numbers.
    # Off an atom, whose place is rounded.
    after = around(edges)[1].astype(np.float32)
    between = (after + np.nextafter(after, np.float32(np.inf), dtype=np.float32).astype(float)) / 2
    beyond = np.concatenate([[1.0], flights.survival(between), [0.0]])
    expected = -np.diff(beyond) * len(flights.tau)
    found = np.diff([0, *np.searchsorted(flights.tau, between), len(flights.tau)])
    assert_fit(found, expected)


def test_flights_of_certain_lengths(flights: Flights) -> None:
    """Flights end exactly at the atoms of the law, as often as it says."""
    atoms = [(float(np.float32(float(w))), float(p)) for w, p in flights.law.atoms]
    if not atoms or flights.origin == "f":
        pytest.skip("no atoms")
    where, index = np.unique([w for w, _ in atoms], return_inverse=True)
    expected = np.bincount(index, [p for _, p in atoms]) * len(flights.tau)
    first, last = (np.searchsorted(flights.tau, where, side) for side in ("left", "right"))
    rest = len(flights.tau) - np.array([np.sum(last - first), np.sum(expected)])
    assert_fit(np.append(last - first, rest[0]), np.append(expected, rest[1]))


def test_moments(flights: Flights) -> None:
    """First and second moment of the flights, cut off at a length that one in 1000 exceeds.

    With S the survival function E[min(tau, L)] is the integral of S over [0, L], and
    E[min(tau, L)^2] twice that of t S. The cut makes both finite for every law.
    """
    if not flights.law.sigma_bar:
        pytest.skip("nothing collides")
    collide = 1 - float(flights.survival(flights.far))
    (cut,) = quantiles(flights.survival, np.array([0.999 * collide]))
    kinks = [float(kink) for kink in flights.law.kinks if kink < cut]
    graded = cut * 0.5 ** np.arange(1, 60)
    breaks = np.unique(np.concatenate([[0.0, cut], graded, cut - graded, kinks]))
    nodes, weights = np.polynomial.legendre.leggauss(24)
    half, middle = np.diff(breaks)[:, None] / 2, (breaks[1:] + breaks[:-1])[:, None] / 2
    x = middle + half * nodes
    survival = flights.survival(x)
    first = np.sum(half * weights * survival) / cut
    second = np.sum(half * weights * 2 * (x / cut) * survival) / cut

    tau = np.minimum(flights.tau, cut) / cut
    for values, expected in ((tau, first), (tau**2, second)):
        deviation = abs(np.mean(values) - expected) - 1e-6 * expected
        bound = -special.ndtri(FALSE_ALARM / 2) * np.std(values) / np.sqrt(len(values))
        assert deviation <= bound
    if flights.origin == "p":
        law = flights.law
        mean = (1 - law.ff(exact(cut))) / law.sigma_bar
        assert first * cut == pytest.approx(float(mean), rel=1e-6)


# --------------------------------------------------------------------------------- single numbers


@every_case
@both_origins
def test_ends_of_the_random_numbers(position: int, origin: str) -> None:
    """All pairs of a first and of all further numbers: no NaN, and infinity only where it is due.

    Flights of laws that have some beyond the horizon may be infinite, no others.
    """
    model, law = narrow(position)
    ends = np.array([*(k * STEP for k in range(9)), 0.25, 0.5, 1 - 2 * STEP, 1 - STEP])
    first, others = (axis.ravel() for axis in np.meshgrid(ends, ends, indexing="ij"))
    numbers = iter([Float(first)])
    tau = sample(model, origin, lambda: next(numbers, Float(others)), len(first))
    assert not np.any(np.isnan(tau)) and np.all(tau >= 0)
    if exact_survival(position, origin)(FAR) == 0:
        assert np.all(tau < np.inf)
    if origin == "f" and law.end == 0:
        assert np.all(tau[(first == 0) & (others == 0)] == 0)
        assert np.all(tau[(first > 0) & (others > 0)] > 0)


@every_case
@both_origins
def test_inversions_return_to_their_random_number(position: int, origin: str) -> None:
    """cdf(sample(u)) = u within 4 2^-24, for a depth within rounding of the sample.

    The samplers of one random number are inversions of the distribution, and ascend with it.
    """
    model, _ = narrow(position)
    rows = [np.arange(64), np.arange(0, 2**23, 127), 2**23 - np.arange(1, 64)]
    u = np.unique(np.concatenate(rows)) * STEP
    drawn = []

    def draw() -> Any:
        drawn.append(Float(u))
        return drawn[-1]

    tau = sample(model, origin, draw, len(u))
    if len(drawn) > 1 or (CASES[position][0], origin) in REUSED:
        pytest.skip("no inversion")
    survival = exact_survival(position, origin)
    far = horizon(position)
    tau = np.where(tau > far, np.inf, np.where(tau < NEAR, 0, tau))
    below, above = around(tau)
    below[tau == np.inf] = far
    if drawn:
        assert np.all(tau[1:] >= tau[:-1])
        assert np.all(1 - survival(below) <= u + 4 * STEP / 2)
        assert np.all(1 - survival(above) >= u - 4 * STEP / 2)
    else:  # certain
        assert np.all(survival(below) == 1) and np.all(survival(above) == 0)


def test_random_numbers_are_those_of_renderings() -> None:
    for u in (PCG32(2**20, 1).next_float32(), stream(2**20, 1)()):
        values = np.array(u, dtype=float)
        assert np.all((values >= 0) & (values <= 1 - STEP))
        assert np.all(values / STEP == np.round(values / STEP))
