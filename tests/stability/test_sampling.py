"""Samplers against the exact law of their flights: at the ends of the random numbers, and in bulk.

The checks are those of ``nonexp.testing.samplers``, which says what they find. Statistics are those
of 2^20 flights in single precision per model, case and origin. The exact cumulative distributions
are the survival functions in float64, which test_values.py holds to 11 digits. Each of fewer than
2000 tests raises a false alarm with probability 1e-6: one in 500 suites of other seeds.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from drjit.llvm.ad import PCG32, Float
from stability_cases import CASES, QUICK, case_id, every_case
from stability_reference import exact
from stability_values import narrow, wide
from tiers import quick

from nonexp.testing import samplers
from nonexp.testing.samplers import DRAWS, FAR, NEAR, STEP, around, sample, stream, survival_of

FAR_IN_TABLES = {"ensemble": 1e10}
"""The depth that samplers may call infinity, where a kernel's table of the law ends."""

REUSED: set[tuple[str, str]] = set()
"""Samplers (key, origin) that take one random number, but for two decisions: no inversions."""

KINDS = [(i, origin) for i in range(len(CASES)) for origin in "fp"]
IDS = [f"{case_id(CASES[i])}-{origin}" for i, origin in KINDS]
both_origins = pytest.mark.parametrize("origin", ["f", "p"])


@dataclasses.dataclass(frozen=True)
class Flights(samplers.Flights):
    """Also with the reference of their law."""

    law: Any


def horizon(position: int) -> float:
    return FAR_IN_TABLES.get(CASES[position][0], FAR)


def exact_survival(position: int, origin: str) -> Callable[[Any], Any]:
    return survival_of(wide(position)[0], origin, horizon(position))


@pytest.fixture(scope="module", params=quick(KINDS, lambda kind: kind[0] in QUICK), ids=IDS)
def flights(request: pytest.FixtureRequest, effort: int) -> Flights:
    position, origin = request.param
    model, law = narrow(position)
    drawn = samplers.draw_flights(
        model,
        wide(position)[0],
        origin,
        count=DRAWS * min(effort, 4),
        seed=7 + position,
        far=horizon(position),
    )
    given = {field.name: getattr(drawn, field.name) for field in dataclasses.fields(drawn)}
    kinks = tuple(float(kink) for kink in law.kinks)
    reference = {"atoms": tuple((float(w), float(p)) for w, p in law.atoms), "kinks": kinks}
    return Flights(**{**given, **reference}, law=law)


# --------------------------------------------------------------------------------- in bulk


def test_kolmogorov_smirnov(flights: Flights) -> None:
    samplers.distribution(flights)


def test_chi_square(flights: Flights) -> None:
    samplers.bins(flights)


def test_flights_of_certain_lengths(flights: Flights) -> None:
    if not flights.atoms or flights.origin == "f":
        pytest.skip("no atoms")
    samplers.atoms(flights)


def test_moments(flights: Flights) -> None:
    if not flights.collides:
        pytest.skip("nothing collides")
    cut, first = samplers.moments(flights)
    if flights.origin == "p":
        law = flights.law
        mean = (1 - law.ff(exact(cut))) / law.sigma_bar
        assert first == pytest.approx(float(mean), rel=1e-6)


# --------------------------------------------------------------------------------- single numbers


@every_case
@both_origins
def test_ends_of_the_random_numbers(position: int, origin: str) -> None:
    """Flights of laws that have some beyond the horizon may be infinite, no others."""
    model, law = narrow(position)
    never = exact_survival(position, origin)(FAR) == 0
    samplers.ends(model, origin, never=never, clear=law.end != 0)


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
