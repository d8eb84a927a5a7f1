"""Every law against 60-digit arithmetic, in single precision and over 16 decades of depth.

The bar is a relative error of 2e-6 (1 + |ln value|), the rounding of float32 times the condition of
an exponential, at log-spaced depths from 1e-8 to 1e8 and at 4 float32 steps to both sides of every
kink. References and models hold the same float32 parameters.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import pytest
from drjit.llvm.ad import Float, Float64
from stability_cases import CASES, EXTREMES, KERNELS, every_case
from stability_reference import LAWS, Extinctions, exact, mp
from stability_values import BAR, compare, narrow, some, wide

from nonexp import models

every_kernel = pytest.mark.parametrize("kernel", KERNELS)

BAR_64 = {"ensemble": 5e-8}
"""In float64 ensembles are as good as their quadrature at a pole; all others keep 11 digits."""


@pytest.mark.parametrize("key", models.names())
def test_every_model_is_under_stress(key: str) -> None:
    assert key in LAWS, f"model {key} has no reference in tests/stability/stability_reference.py"
    named = EXTREMES.get(key)
    assert named is not None, f"model {key} has no entry in tests/stability/stability_cases.py"
    if models.create(key, **models.registry[key].examples[0]).__dataclass_fields__:  # type: ignore[attr-defined]
        assert named, f"model {key} has no extreme parameters in tests/stability/stability_cases.py"


@every_case
def test_references_are_laws(position: int) -> None:
    """They obey fp = -ff' and pp = -pf', by differences: a slip in one of them shows."""
    _, law = narrow(position)
    flight = 1 / law.sigma_bar if law.sigma_bar else mp.one
    ends = [mp.zero, *law.kinks]
    assert abs(law.ff(mp.zero) - 1) < 1e-7  # places of pulses are rounded
    assert abs(law.pf(mp.zero) - 1) < 1e-15
    step, error = law.step, 10 * law.step ** mp.mpf(0.5)
    for tau in (flight * mp.mpf(t) for t in ("1e-4", "0.31", "0.97", "1.7", "23")):
        assert all(abs(tau - end) > 2 * step * tau for end in ends)
        for survival, density in ((law.ff, law.fp), (law.pf, law.pp)):
            fall = survival(tau * (1 - step)) - survival(tau * (1 + step))
            here = density(tau)
            assert abs(fall / (2 * step * tau) - here) <= error * here + mp.mpf(10) ** -30
    if not isinstance(law, Extinctions):  # they know P(S = 0)
        far, half_way = (law.ff(mp.mpf(10) ** power) for power in (60000, 30000))
        # Tails as heavy as tau^-1e-6 have still not arrived.
        assert abs(far - law.end) < 1e-5 or far < 0.99 * half_way


def masses(atoms: Any) -> Any:
    """Probability at each place that has one."""
    found: dict[float, float] = {}
    dr.eval(atoms)  # by one kernel
    for where, probability in atoms:
        place = float(np.float32(exact(where)))
        found[place] = found.get(place, 0.0) + float(exact(probability))
    return np.reshape(sorted((where, p) for where, p in found.items() if p), (-1, 2))


@every_case
def test_constants_of_a_law(position: int) -> None:
    """sigma_bar, kinks and atoms are where the reference has them."""
    fine = BAR_64.get(CASES[position][0], 1e-14)
    for (model, law), epsilon in ((narrow(position), 3e-7), (wide(position), fine)):
        assert float(exact(model.sigma_bar)) == pytest.approx(float(law.sigma_bar), rel=epsilon)
        found = list(model.kinks)
        dr.eval(found)  # by one kernel
        kinks = sorted({float(exact(kink)) for kink in found} - {0.0})
        assert kinks == pytest.approx(sorted({float(kink) for kink in law.kinks}), rel=epsilon)
        np.testing.assert_allclose(masses(model.atoms), masses(law.atoms), rtol=epsilon)


@every_case
@every_kernel
def test_values_in_float32(position: int, kernel: str, effort: int) -> None:
    model, _ = narrow(position)
    found = compare(position, kernel, 120 if effort == 1 else 1000)
    assert np.all(np.isfinite(found.got) & (found.got >= 0))
    if kernel in ("ff", "pf"):
        assert np.all(found.got <= 1)
    if kernel == "fp":
        assert np.all(found.got <= float(exact(model.sigma_bar)) * (1 + 1e-6))
    worst = np.argmax(found.error)
    assert found.error[worst] <= BAR, (
        f"{kernel}({found.tau[worst]!r}) is {found.got[worst]:.9g}, not {found.exact[worst]:.9g}"
    )
    tiny = found.exact <= 1e-30
    assert np.all(found.got[tiny] <= 2e-30)


@every_case
def test_values_in_float64(position: int) -> None:
    """The same formulas keep double precision."""
    for kernel in KERNELS:
        found = compare(position, kernel, 24, Float64)
        worst = np.argmax(found.error)
        bar = BAR_64.get(CASES[position][0], 1e-11)
        assert found.error[worst] <= bar, (
            f"{kernel}({found.tau[worst]!r}) is {found.got[worst]!r}, not {found.exact[worst]!r}"
        )


@every_case
@every_kernel
def test_values_at_nothing_and_at_infinity(position: int, kernel: str) -> None:
    key, _ = CASES[position]
    model, law = narrow(position)
    function = getattr(law, kernel)
    points = np.array([0, 1e-29, 1e9, 3e38, np.inf], dtype=np.float32)
    values: Any = np.array(getattr(model, kernel)(Float(points)), dtype=float)
    zero, tiny, far, farthest, infinity = np.broadcast_to(values, (5,))
    assert not np.any(np.isnan(values)) and np.all(values >= 0)
    if mp.isfinite(function(mp.zero)):  # else it has a singularity there
        assert zero == pytest.approx(float(function(mp.zero)), rel=1e-6)
        assert tiny == pytest.approx(float(function(exact(points[1]))), rel=BAR)
    there = float(function(exact(points[2])))
    bar = BAR * (1 + abs(np.log(there))) if there else 0
    assert far == pytest.approx(there, rel=bar, abs=2e-30)
    # Further out, where intermediate results overflow, the limit will do.
    end = {"ff": float(law.end), "pf": float(key == "constant")}.get(kernel, 0.0)
    assert end * (1 - 1e-6) <= farthest <= far * (1 + 1e-6)
    assert infinity == pytest.approx(end, rel=1e-6, abs=1e-30)


def test_page_on_accuracy_has_every_model() -> None:
    page = Path(__file__).resolve().parents[2] / "docs" / "accuracy.md"
    lines = page.read_text(encoding="utf-8").splitlines()
    for key in models.names():
        assert any(line.startswith(f"| `{key}` |") for line in lines), (
            f"model {key} is not in docs/accuracy.md: run tools/accuracy.py"
        )


def test_some_takes_first_and_last() -> None:
    assert some(range(5), 12) == [0, 1, 2, 3, 4]
    assert some(range(1000), 12)[0] == 0 and some(range(1000), 12)[-1] == 999
    assert len(some(range(1000), 12)) == 12
