"""Laws made of tables: the piecewise curve, ``tabulated`` and ``custom``."""

from __future__ import annotations

import math
import re
import time
from fractions import Fraction
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import mpmath
import numpy as np
import pytest
from build import FURNACE, ball, beam, medium, scene
from drjit.llvm.ad import PCG32, Float, Float64
from scipy import special, stats
from tiers import THOROUGH

import nonexp
from nonexp import models
from nonexp.models.custom import Custom, wigner
from nonexp.models.tabulated import Tabulated
from nonexp.numerics.lookup import Table
from nonexp.transmittance.piecewise import Curve, Piecewise, hermite

FALSE_ALARM = 1e-6
PACKING = Path(__file__).resolve().parent.parent / "scenes" / "media" / "packing.csv"


def tabulated(**parameters: Any) -> Any:
    return models.create("tabulated", **parameters)


def exponential(tau: Any) -> Any:
    return dr.exp(-tau)


def ramp(tau: Any) -> Any:
    return dr.maximum(1 - tau, 0)


def gamma(alpha: float) -> Any:
    return lambda tau: dr.exp(-alpha * dr.log(1 + tau / alpha))


class Free(Piecewise):
    """A law from knots, for tests of the machinery."""

    def __init__(self, knots: Any, slope: Any, rest: float) -> None:
        object.__setattr__(self, "given", Curve(np.array(knots), np.array(slope), rest))
        self.prepare()

    def make_curve(self) -> Curve:
        return self.given  # type: ignore[attr-defined, no-any-return]


LAWS: dict[str, Piecewise] = {
    "hard core": tabulated(**Tabulated.examples[0]),
    "straight": tabulated(**Tabulated.examples[1]),
    "ends": tabulated(**Tabulated.examples[2]),
    "packing": tabulated(filename=str(PACKING)),
    "wigner": Custom(wigner),
    "heavy tail": Custom(gamma(0.3)),
    "step inside": Custom(lambda tau: 0.4 * ramp(tau / 0.3) + 0.6 * dr.exp(-tau)),
    "plateau": Custom(lambda tau: 0.3 + 0.7 * dr.exp(-tau)),
    "atom and plateau": Custom(lambda tau: 0.25 + 0.75 * ramp(tau / 0.7)),
    "early knots": tabulated(tau=(1e-9, 3e-9, 1.0, 9.0), ff=(1 - 2e-9, 1 - 6e-9, 0.4, 1e-12)),
    "far knots": tabulated(tau=(1e6, 1e7, 1e8), ff=(0.3, 0.01, 1e-6)),
    "steep": Free([0, 1, np.nextafter(np.float32(1), 2), 3, 4], [1, 1, 1e-3, 1e-5, 1e-12], 1e-20),
}
every_law = pytest.mark.parametrize("name", LAWS)


def exact(law: Piecewise, tau: float) -> tuple[Any, Any, Any]:
    """ff, pf, pp by the definition in 40 digits, on the law's own knots."""
    knots, slope, rest = law._curve.knots, law._curve.slope, law._curve.rest
    t, s, depth = ([Fraction(float(x)) for x in v] for v in (knots, slope, [rest, tau]))
    rest, tau = depth
    if tau >= t[-1]:
        if s[-1] == 0 or rest == 0:
            return mpf(rest), mpmath.mpf(0), mpmath.mpf(0)
        rate = s[-1] / rest
        fade = mpmath.exp(-mpf(rate * (tau - t[-1])))
        return mpf(rest) * fade, mpf(s[-1] / s[0]) * fade, mpf(rate * s[-1] / s[0]) * fade
    i = max(j for j in range(len(t) - 1) if t[j] <= tau)
    density = (s[i] - s[i + 1]) / (t[i + 1] - t[i])
    here = s[i + 1] + density * (t[i + 1] - tau)
    area = sum((s[j] + s[j + 1]) / 2 * (t[j + 1] - t[j]) for j in range(i + 1, len(t) - 1))
    ff = rest + area + (here + s[i + 1]) / 2 * (t[i + 1] - tau)
    return mpf(ff), mpf(here / s[0]), mpf(density / s[0])


def mpf(x: Fraction) -> Any:
    return mpmath.mpf(x.numerator) / x.denominator


# ------------------------------------------------------------------------------- look-up


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 8, 9])
@pytest.mark.parametrize("width", [1, 3, 6])
def test_tables_find_the_last_row_that_is_not_above(count: int, width: int) -> None:
    rows = np.arange(count)[:, None] * 10 + np.arange(width)
    table = Table(rows)
    column = width - 1
    x = np.array([-5, 0, 5, 10, 12, 19.9, 20, 35, 40, 80, 81, 99, math.inf, -math.inf, math.nan])
    expected = [max(int(np.sum(rows[:, column] <= value)) - 1, 0) for value in x]
    assert [table.find(float(value), column) for value in x] == expected
    for kind in (Float, Float64):
        index = table.find(kind(x), column)
        assert np.broadcast_to(np.array(index), len(x)).tolist() == expected
        for got, wanted in zip(table.row(kind(x), index), rows[expected].T, strict=True):
            assert np.all(np.array(got) == wanted)
        assert [v[0] for v in table.row(kind(x), count - 1)] == rows[-1].tolist()
    assert table.row(0.0, count - 1) == tuple(rows[-1])


# ------------------------------------------------------------------------------- the curve


@THOROUGH
@every_law
def test_single_precision_is_as_good_as_exact_arithmetic(name: str) -> None:
    law = LAWS[name]
    knots = law._curve.knots.astype(np.float32)
    some = knots[np.linspace(0, len(knots) - 1, 24).astype(int)]
    near = [some + k * np.spacing(some) for k in range(-4, 5)]
    far = knots[-1] * (1 + np.geomspace(1e-3, 50, 20))
    tau = np.concatenate([[0], np.geomspace(1e-8, 1e8, 100), far, *near]).astype(np.float32)
    tau = tau[tau >= 0]
    with mpmath.workdps(40):
        expected = [exact(law, float(x)) for x in tau]
        for position, method in enumerate(("ff", "pf", "pp")):
            got = np.array(getattr(law, method)(Float(tau)), dtype=float)
            wide = np.array(getattr(law, method)(Float64(tau)))
            assert np.all(got >= 0)
            assert method == "pp" or np.all(got <= 1)
            scale = max(float(row[position]) for row in expected)
            for x, y, z, row in zip(tau, got, wide, expected, strict=True):
                value = row[position]
                if value > 1e-30:
                    bar = 2e-6 * (1 + abs(float(mpmath.log(value))))
                    assert abs(y - value) <= bar * value, (x, y, value)
                    # The table is rounded to double precision: its smallest densities less well.
                    assert abs(z - value) <= 1e-9 * value + 1e-15 * scale, (x, z, value)
                else:
                    assert y <= 2e-30


@every_law
@pytest.mark.parametrize("origin", ["f", "p"])
@pytest.mark.parametrize("single", [True, False])
def test_samples_are_the_inverse_of_the_law(name: str, origin: str, single: bool) -> None:
    law = LAWS[name]
    u = np.concatenate([np.arange(512), 2**23 - 1 - np.arange(512), np.arange(0, 2**23, 997)])
    u = np.sort(u) * 2.0**-23
    kind = Float if single else Float64
    sample, survival = (law.sample_f, law.ff) if origin == "f" else (law.sample_p, law.pf)
    tau = np.array(sample(lambda: kind(u)), dtype=float)
    assert not np.any(np.isnan(tau))
    assert np.all(tau >= 0)
    if origin == "f":
        assert tau[0] == 0
        assert np.count_nonzero(tau == math.inf) == np.count_nonzero(1 - u <= law.ff(math.inf))
    atoms = dict(law.atoms)
    finite = np.isfinite(tau) & ((origin == "f") | ~np.isin(tau, list(atoms)))
    held = np.minimum(tau, 1e38)
    rounding = np.spacing(np.float32(held)) if single else 1e-13 * held

    known = np.isfinite(tau)
    assert np.all(np.diff(tau[known]) >= -2 * rounding[known][1:])
    assert np.all(known[: np.count_nonzero(known)])

    # Where the density is high the last bit of tau is a probability of its own.
    below = np.array(survival(Float64(np.maximum(tau - rounding, 0))))
    above = np.array(survival(Float64(tau + rounding)))
    slack = 4 * 2.0**-24 if single else 1e-12
    assert np.all((1 - u <= below + slack)[finite])
    assert np.all((1 - u >= above - slack)[finite])
    if origin == "p":
        for where, probability in atoms.items():
            assert np.count_nonzero(tau == where) / len(u) == pytest.approx(
                np.count_nonzero(1 - u <= probability) / len(u), abs=1e-3
            )


@every_law
@pytest.mark.parametrize("origin", ["f", "p"])
def test_numbers_are_sampled_like_arrays(name: str, origin: str) -> None:
    sample = getattr(LAWS[name], f"sample_{origin}")
    for u in (0.0, 0.1, 0.5, 0.9, 1 - 2**-23):
        narrow = float(sample(lambda u=u: u))
        wide = float(np.array(sample(lambda u=u: Float64(u))).item())
        assert narrow == pytest.approx(wide, rel=1e-12)


@every_law
def test_the_law_is_consistent(name: str) -> None:
    """T starts at 1, and pf integrates to (1 - T(inf))/sigma_bar: the mean flight of renewal."""
    law = LAWS[name]
    curve = law._curve
    assert law.ff(0.0) == 1 and law.pf(0.0) == 1
    assert np.all(np.diff(curve.slope) <= 0) and np.all(curve.slope >= 0)
    assert curve.values[0] == pytest.approx(1, abs=1e-15)
    np.testing.assert_allclose(law.ff(Float64(curve.knots)), curve.values, rtol=1e-12)
    areas = np.diff(curve.knots) * (curve.slope[1:] + curve.slope[:-1]) / 2
    tail = curve.rest if curve.slope[-1] > 0 else 0
    assert areas.sum() + tail == pytest.approx(1 - float(law.ff(math.inf)), abs=1e-14)


@every_law
def test_kinks_are_where_densities_jump(name: str) -> None:
    law = LAWS[name]
    kinks = np.array(law.kinks)
    assert np.all(np.diff(kinks) > 0)
    assert set(kinks) <= set(law._curve.knots)
    assert {where for where, _ in law.atoms} <= set(kinks)
    ends = np.concatenate([[0], kinks, [2 * kinks[-1]]])
    wide = np.diff(ends) > 4 * np.spacing(np.float32(ends[1:]))
    inside = [(ends[:-1] + x * np.diff(ends))[wide] for x in (0.1, 0.5, 0.9)]
    pp = [np.array(law.pp(Float64(x))) for x in inside]
    tail = inside[0] >= law._curve.knots[-1]
    for other in pp[1:]:
        np.testing.assert_allclose(pp[0][~tail], other[~tail], rtol=1e-6, atol=1e-13)


@every_law
@pytest.mark.parametrize("kind", [Float, Float64])
def test_gradients_are_those_of_the_curve(name: str, kind: Any) -> None:
    law = LAWS[name]
    tau = np.concatenate([np.geomspace(1e-8, 1e8, 200), law._curve.knots, [0, 3e38]])
    for method, derivative in ((law.ff, law.fp), (law.pf, law.pp)):
        x = kind(tau)
        dr.enable_grad(x)
        y = method(x)
        dr.backward(y)
        expected = np.broadcast_to(np.array(derivative(kind(tau)), dtype=float), len(tau))
        slope = -np.array(x.grad, dtype=float)
        np.testing.assert_allclose(
            slope, expected, rtol=1e-5 if kind is Float else 1e-11, atol=1e-37
        )
        x = kind(tau)
        dr.enable_grad(x)
        dr.backward(law.pp(x))
        assert np.all(np.isfinite(np.array(x.grad)))


def test_tables_of_one_size_share_a_kernel() -> None:
    def kernels(law: Piecewise, kind: Any) -> set[Any]:
        u, tau = kind([0.1, 0.5, 0.9]), kind([0.2, 1.2, 4])
        dr.eval(u, tau)
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            dr.eval(law.ff(tau), law.fp(tau), law.pp(tau), law.sample_f(lambda: u))
            dr.eval(law.sample_p(lambda: u))
            history = dr.kernel_history([dr.KernelType.JIT])
        return {entry["hash"] for entry in history}

    tau = np.linspace(0.1, 4, 24)
    for kind in (Float, Float64):
        a = tabulated(tau=tau, ff=np.exp(-1.1 * tau))
        b = tabulated(tau=tau[:-2], ff=np.exp(-tau[:-2]))
        c = tabulated(tau=tau[:5], ff=np.exp(-tau[:5]))
        assert len(a._curve.knots) != len(b._curve.knots)
        assert kernels(a, kind) == kernels(b, kind) != kernels(c, kind)


def test_the_curve_meets_values_and_slopes() -> None:
    tau = np.array([0, 0.25, 1, 3])
    ff, slope = np.exp(-tau), np.exp(-tau)
    curve = hermite(tau, ff, slope)
    values, slopes = curve.at(tau)
    np.testing.assert_allclose(values, ff, rtol=1e-14)
    np.testing.assert_allclose(slopes, slope, rtol=1e-14)
    assert np.all(np.diff(curve.slope) < 0)
    parabola = hermite(tau[:3], (1 - tau[:3] / 2) ** 2, 1 - tau[:3] / 2)
    np.testing.assert_array_equal(parabola.knots, tau[:3])  # no knot that is not needed


# ------------------------------------------------------------------------------- tabulated


SMOOTH = {
    "exponential": (lambda t: np.exp(-t), lambda t: np.exp(-t), 6.0),
    "gamma": (lambda t: (1 + t / 2) ** -2, lambda t: (1 + t / 2) ** -3, 6.0),
    "quadratic": (lambda t: (1 - t / 2) ** 2, lambda t: 1 - t / 2, 2.0),
}


@pytest.mark.parametrize("name", SMOOTH)
def test_the_fit_tends_to_the_law_as_rows_get_closer(name: str) -> None:
    """Errors of ff below h^3/8, of pf below h^2/3; h^2/50 and h/8 for a law that ends."""
    ff, pf, end = SMOOTH[name]
    x = np.linspace(0, end, 4001)[:-1]
    for rows in (13, 25, 49, 97):
        tau = np.linspace(0, end, rows)
        h = tau[1]
        law = tabulated(tau=tau, ff=ff(tau))
        np.testing.assert_allclose(law.ff(Float64(tau)), ff(tau), rtol=1e-6, atol=1e-15)
        ends = name == "quadratic"
        assert np.max(np.abs(np.array(law.ff(Float64(x))) - ff(x))) < (
            h**2 / 50 if ends else h**3 / 8
        )
        assert np.max(np.abs(np.array(law.pf(Float64(x))) - pf(x))) < (h / 8 if ends else h**2 / 3)
        assert law.sigma_bar == pytest.approx(1, abs=h**2 / 3)


def test_straight_tables_are_the_linear_law() -> None:
    for rows in (2, 3, 8):
        tau = np.linspace(0, 1.5, rows)
        law = tabulated(tau=tau, ff=1 - tau / 1.5)
        assert law.atoms == ((1.5, pytest.approx(1, rel=1e-12)),)
        assert law.sigma_bar == pytest.approx(1 / 1.5, rel=1e-12)
        assert law.sample_p(lambda: 0.25) == 1.5
        assert law.ff(0.5) == pytest.approx(2 / 3, rel=1e-12)
        assert law.pf(1.5) == 0
    straight_then_curved = tabulated(tau=(0.25, 0.5, 1, 2), ff=(0.75, 0.5, 0.25, 0.06))
    assert straight_then_curved.pf(0.4) == 1
    assert straight_then_curved.sigma_bar == 1


def test_the_table_goes_on_as_its_end_suggests() -> None:
    tau = np.array([0.5, 1.0, 1.5])
    law = tabulated(tau=tau, ff=np.exp(-tau))
    assert law.ff(10.0) == pytest.approx(math.exp(-10), rel=1e-9)
    two = tabulated(tau=(0, 2), ff=(1, math.exp(-3)))
    assert two.sigma_bar == pytest.approx(1.5)
    assert two.ff(4.0) == pytest.approx(math.exp(-6), rel=1e-9)

    flat = tabulated(tau=(0, 1, 2, 3), ff=(1, 0.5, 0.4, 0.4))
    assert flat.ff(math.inf) == flat.ff(2.0) == pytest.approx(0.4)
    assert flat.pf(2.0) == 0
    draws = np.array(flat.sample_f(PCG32(2**18, 3).next_float32))
    assert stats.binomtest(int(np.isinf(draws).sum()), len(draws), 0.4).pvalue > FALSE_ALARM
    assert np.all(np.isfinite(np.array(flat.sample_p(PCG32(2**18, 4).next_float32))))

    over = tabulated(tau=(0, 1, 2, 3), ff=(1, 0.25, 0, 0))
    assert over.ff(2.0) == over.pf(2.0) == 0


@pytest.mark.parametrize(
    "content",
    [
        "0.5,0.6\n1,0.37\n2,0.13\n",
        "tau, ff\n0, 1\n0.5, 0.6\n1, 0.37\n2, 0.13\n",
        "# measured\r\ntau\tff\r\n0\t1\r\n0.5\t6e-1 # sic\r\n\r\n1\t0.37\r\n2\t0.13",
        "\ufeff0.5  0.6\n 1.0  0.37\n 2.0  0.13\n",
        "0.5;0.6\n1;0.37\n2;0.13",
    ],
)
def test_text_tables(content: str, tmp_path: Path) -> None:
    path = tmp_path / "law.csv"
    path.write_text(content, encoding="utf-8", newline="")
    law = tabulated(filename=str(path))
    direct = tabulated(tau=(0.5, 1, 2), ff=(0.6, 0.37, 0.13))
    assert law.sigma_bar == direct.sigma_bar
    assert tabulated(filename=path).ff(0.7) == law.ff(0.7) == direct.ff(0.7)


def test_archives(tmp_path: Path) -> None:
    path = tmp_path / "law.npz"
    for dtype in (np.float64, np.float32):
        tau = np.linspace(0, 3, 3001).astype(dtype)  # rounded numbers do not lie straight
        np.savez(path, tau=tau, ff=1 - tau / dtype(3))
        law = tabulated(filename=str(path))
        assert law.ff(1.5) == pytest.approx(0.5, abs=1e-6)
        assert law.sigma_bar == pytest.approx(1 / 3, rel=1e-3)
    np.savez(path, tau=tau)
    with pytest.raises(
        ValueError, match=r"it has the arrays tau: it must have tau \(or distance\) and ff"
    ):
        tabulated(filename=str(path))
    np.savez(path, tau=tau, ff=tau[1:])
    with pytest.raises(ValueError, match=r"ff has shape \(3000,\): it must be \(3001,\)"):
        tabulated(filename=str(path))
    np.savez(path, tau=[0, 1, 2], ff=[1, 0.2, 0.3])
    with pytest.raises(ValueError, match=r"row 3 has ff = 0.3 at tau = 2: it must not be above"):
        tabulated(filename=str(path))
    path.write_bytes(b"PK not an archive")
    with pytest.raises(ValueError, match="it is not an NPZ file of numbers"):
        tabulated(filename=str(path))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (
            "tau,ff\n0,1\n1,.5\n.5,.4\n",
            "line 3 has ff = 0.5 at tau = 1: it must not be above line 4",
        ),
        (
            "0,1\n1,.5\n1,.4\n",
            "line 3 has ff = 0.4 at tau = 1: tau must not be the same as in line 2",
        ),
        ("0,1\n1,.5\n2,.6\n3,.1", "line 3 has ff = 0.6 at tau = 2: it must not be above line 2"),
        ("#\n0,1\n1,.8\n2,.1\n3,0", "line 3 has ff = 0.8 at tau = 1: the table must be convex"),
        ("1,.2\n2,.19\n\n3,.1\n4,.09", "line 2 has ff = 0.19 at tau = 2: .* at most 0.15"),
        ("0,1\n1,nan\n", "line 2 has ff = nan at tau = 1: both must be finite"),
        ("0,1\n1,.5\ninf,.4\n", "line 3 has ff = 0.4 at tau = inf: both must be finite"),
        ("0,1\n1,-.1\n", "line 2 has ff = -0.1 at tau = 1: ff must be in"),
        ("0,1.1\n1,.1\n", "line 1 has ff = 1.1 at tau = 0: ff must be in"),
        ("0,.9\n1,.1\n", "line 1 has ff = 0.9 at tau = 0: at tau = 0 it must be 1"),
        ("-1,1\n1,.1\n", "line 1 has ff = 1 at tau = -1: tau must be 0, or in"),
        ("0,1\n1,.1,3\n", "line 2 has 3 columns, line 1 has 2"),
        ("0,1\n1 half\n", "line 2 has 'half' for ff: it must be a number"),
        ("tau,ff\nm,1\n", "line 2 has 'm' for tau: it must be a number"),
        ("", "it holds no numbers"),
        ("1,.5", "there are 1 rows: there must be at least 2"),
        ("0,1\n1,1\n2,1\n", "ff is 1 in all rows: use the model constant"),
    ],
)
def test_bad_tables_are_refused_with_the_row(content: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "law.csv"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(ValueError, match=message) as error:
        tabulated(filename=str(path))
    assert str(error.value).startswith(f"Tabulated.filename is {str(path)!r}: ")


def test_other_bad_input_of_tabulated(tmp_path: Path) -> None:
    both = "Tabulated needs either a filename or both tau and ff"
    with pytest.raises(ValueError, match=both):
        tabulated()
    with pytest.raises(ValueError, match=both):
        tabulated(filename=str(PACKING), tau=(0, 1), ff=(1, 0))
    with pytest.raises(ValueError, match=r"Tabulated\.ff: ff has shape \(0,\): it must be \(2,\)"):
        tabulated(tau=(0, 1))
    with pytest.raises(ValueError, match=r"Tabulated\.ff: row 2 has ff = 0.9 at tau = 1: the"):
        tabulated(tau=(0, 1, 2), ff=(1, 0.9, 0))
    with pytest.raises(ValueError, match=r"is '.*nowhere\.csv': there is no such file"):
        tabulated(filename=str(tmp_path / "nowhere.csv"))
    with pytest.raises(ValueError, match="it is a folder, not a table"):
        tabulated(filename=str(tmp_path))
    (tmp_path / "image.csv").write_bytes(b"\x89PNG\xff\xfe\0")
    with pytest.raises(ValueError, match="it is not a text file"):
        tabulated(filename=str(tmp_path / "image.csv"))


def test_a_measured_table_is_a_law_within_its_noise() -> None:
    """A noisy table with standard deviations becomes the convex curve nearest to it."""
    path = PACKING.parent.parent.parent / "examples" / "measured.csv"
    distance, ff, sigma = nonexp.fitting.read_table(path)
    assert sigma is not None
    law = tabulated(filename=str(path))
    off = (law.ff(distance) - ff) / sigma
    assert 0.1 < np.abs(off).max() < 3
    tau = np.linspace(0, 2 * distance[-1], 2000)
    assert np.all(np.diff(law.ff(tau), 2) > -1e-12)
    fit = models.fit("hard_rod", distance, ff, sigma=sigma)
    assert law.sigma_bar == pytest.approx(fit.extinction, rel=0.1)
    with pytest.raises(ValueError, match="the table must be convex"):
        tabulated(tau=distance, ff=ff)


def test_noise_does_not_excuse_what_is_no_law(tmp_path: Path) -> None:
    path = tmp_path / "law.csv"
    tau = np.linspace(0.25, 4, 16)
    np.savetxt(path, np.stack([tau, np.exp(-tau), np.full(16, 1e-3)], axis=1))
    smooth = tabulated(filename=path)  # convex as it is: not moved
    np.testing.assert_allclose(smooth.ff(tau), np.exp(-tau), rtol=1e-6)
    arc = np.cos(tau / 4) + 1e-3 * np.random.default_rng(1).normal(size=16)
    np.savetxt(path, np.stack([tau, arc, np.full(16, 1e-3)], axis=1))
    with pytest.raises(ValueError, match=r"line \d+ has .* 5 standard deviations .* away"):
        tabulated(filename=path)
    path.write_text("1,.5,.1\n2,.4,0\n3,.45,.1\n")
    with pytest.raises(ValueError, match="line 2: sigma is 0, it must be"):
        tabulated(filename=path)


def test_one_depth_measured_twice_is_one_row_of_the_law(tmp_path: Path) -> None:
    path = tmp_path / "law.csv"
    path.write_text("1,.5,.01\n1,.52,.01\n2,.25,.01\n")
    assert tabulated(filename=path).ff(1.0) == pytest.approx(0.51, abs=1e-3)


def test_a_dense_table_that_is_slightly_concave_is_refused() -> None:
    """No row is far above its neighbours' line, but the arc is."""
    tau = np.linspace(0, 1, 4001)
    with pytest.raises(ValueError, match=r"row \d+ has .*the table must be convex"):
        tabulated(tau=tau, ff=1 - tau / 2 - 1e-4 * tau**2)


# ------------------------------------------------------------------------------- custom


CLOSED: dict[str, tuple[Any, Any]] = {
    "exponential": (exponential, models.create("exponential")),
    "gamma 2": (gamma(2.0), models.create("gamma", alpha=2.0)),
    "gamma .3": (gamma(0.3), models.create("gamma", alpha=0.3)),
    "linear": (ramp, models.create("linear")),
    "linear 1.72": (lambda tau: ramp(tau / 1.72), models.create("linear", b=1.72)),
    "quadratic": (lambda tau: ramp(tau / 2) ** 2, models.create("quadratic")),
}


@pytest.mark.parametrize("name", CLOSED)
def test_custom_is_the_law_that_its_function_says(name: str) -> None:
    function, true = CLOSED[name]
    law = Custom(function)
    assert law.error.ff < 1e-5 and law.error.pf < 1e-5
    end = law._curve.knots[-1]
    tau = np.concatenate([np.geomspace(1e-6, 1, 3001), np.linspace(0, 0.9999, 3001)]) * end
    ff, pf = (np.array(getattr(law, key)(Float64(tau))) for key in ("ff", "pf"))
    true_ff, true_pf = (np.array(getattr(true, key)(Float64(tau))) for key in ("ff", "pf"))
    assert np.max(np.abs(ff - true_ff)) <= 1.5 * law.error.ff + 1e-15
    assert np.max(np.abs(pf - true_pf)) <= 1.5 * law.error.pf + 1e-15
    np.testing.assert_allclose(ff, true_ff, rtol=2e-3, atol=1e-9)
    assert law.sigma_bar == pytest.approx(float(true.sigma_bar), rel=1e-7)
    assert [p for _, p in law.atoms] == pytest.approx([p for _, p in true.atoms])
    for origin in ("f", "p"):
        draws = np.array(getattr(law, f"sample_{origin}")(PCG32(2**18, 5).next_float32))
        if origin == "p" and true.atoms:
            assert np.all(draws == np.float32(true.atoms[0][0]))
        else:
            survival = true.ff if origin == "f" else true.pf
            result = stats.kstest(draws, lambda t, s=survival: 1 - np.array(s(Float64(t))))
            assert result.pvalue > FALSE_ALARM


def test_the_example_is_the_wigner_law() -> None:
    law = Custom("nonexp.models.custom:wigner")
    assert law.sigma_bar == pytest.approx(1, abs=1e-12)
    tau = np.linspace(0, 6, 500)
    scaled = math.sqrt(math.pi) / 2 * tau
    assert np.max(np.abs(np.array(law.ff(Float64(tau))) - special.erfc(scaled))) < 1e-6
    assert np.max(np.abs(np.array(law.pf(Float64(tau))) - np.exp(-(scaled**2)))) < 1e-5


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_any_unit_of_depth_will_do(scale: float) -> None:
    law = Custom(lambda tau: dr.exp(-scale * tau))
    assert law.sigma_bar == pytest.approx(scale, rel=1e-12)
    assert 100 < len(law._curve.knots) < 2000
    assert law.error.pf < 1e-5


def test_tables_are_made_quickly() -> None:
    Custom(exponential)  # compiles what all share
    start = time.perf_counter()
    for name in ("heavy tail", "step inside", "plateau"):
        Custom(LAWS[name].function)
    assert (time.perf_counter() - start) / 3 < 0.3


def test_steps_of_the_slope_end_the_search() -> None:
    def staircase(tau: Any) -> Any:
        return sum(ramp(tau / ((i + 0.5) / 10)) * (i + 0.5) / 200 for i in range(20))

    law = Custom(staircase)
    assert law.error.ff < 1e-6 and law.error.pf < 1e-5
    pulse = models.create("pulse", a=0.0, b=2.0, n=20)
    tau = Float64(np.linspace(0, 2, 777))
    assert np.max(np.abs(np.array(law.ff(tau)) - np.array(pulse.ff(tau)))) < 1e-6
    assert len(law._curve.knots) < 2000


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda tau: 0.9 * dr.exp(-tau), r"at tau = 0 is 0\.9: it must be 1"),
        (lambda tau: 1.2 - 0.2 * dr.exp(tau), r"at tau = \S+ is -\S+ with .*in \[0, 1\]"),
        (lambda tau: dr.cos(tau), "at tau = 0 has slope -?0: it must be negative and finite"),
        (lambda tau: 1 / (1 + tau * tau), "at tau = 0 has slope -?0: it must be negative"),
        (lambda tau: dr.exp(-dr.sqrt(tau)), "at tau = 0 is 1 with slope -?(inf|nan): its slope"),
        (lambda tau: 1 + tau, "at tau = 0 has slope 1: it must be negative and finite"),
        (lambda tau: (1 - tau / 2) ** 2, "at tau = 4 is 1 with .*it must not increase"),
        (lambda tau: 1 - tau / 2, "at tau = 4 is -1 with .*: it must be in"),
        (lambda tau: dr.log(1 - tau) + 1, r"at tau = 1 is -?(inf|nan).*: it must be finite"),
        (
            lambda tau: dr.exp(-tau) * (1 + 0.5 * dr.sin(2 * tau) ** 2),
            r"at tau = \S+ is 0\.\d+ with slope .*, after .* at tau = .*: it must",
        ),
        (
            lambda tau: dr.select(tau < 1.25, 1, 0.5) * dr.exp(-tau),
            r"at tau = 1\.25\S* is 0\.1\d+ with .*: it must be continuous and convex",
        ),
        (
            lambda tau: dr.minimum(dr.exp(-0.5 * tau), dr.exp(1.25 - 1.5 * tau)),
            r"at tau = 1\.\d+ is .* it must be continuous and convex",
        ),
        (lambda tau: 1.0, "returns 1.0 for all tau: .* the model constant"),
        (lambda tau: Float64(1.0), "the model constant"),
        (lambda tau: tau * 0 + 1, "is 1 for all tau: use the model constant"),
        (lambda tau: np.exp(-np.array(tau)), r"returns numpy\.ndarray .*it must return an array"),
        (lambda tau: dr.exp(-Float(tau)), r"returns drjit\.llvm\.ad\.Float of width .*: it must"),
        (lambda tau: None, "returns NoneType for drjit"),
        (lambda tau: dr.exp(-tau)[0], "for all tau"),
        (lambda tau: Float64([1, 0.5, 0]), "returns drjit.llvm.ad.Float64 of width 3 for"),
        (lambda tau: math.exp(-tau), "fails with TypeError"),
        (lambda: 1, "fails with TypeError: .*takes 0 positional arguments"),
    ],
)
def test_inadmissible_functions_are_refused_with_the_depth(function: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message) as error:
        Custom(function)
    assert str(error.value).startswith("Custom.ff ")


def test_custom_needs_a_function() -> None:
    with pytest.raises(ValueError, match=r"Custom\.ff is missing"):
        Custom()
    with pytest.raises(ValueError, match=r"Custom\.ff is 3: it must be a function"):
        Custom(3)
    with pytest.raises(ValueError, match=r"module nonexp\.models\.custom has no function weaver"):
        Custom("nonexp.models.custom:weaver")


def test_the_function_is_still_known() -> None:
    law = Custom(wigner)
    assert models.to_dict(law) == {
        "type": "transmittance_custom",
        "ff": "nonexp.models.custom:wigner",
    }
    again = Custom(law.function)  # not a table of a table
    np.testing.assert_array_equal(again._curve.slope, law._curve.slope)
    table = tabulated(**Tabulated.examples[0])
    assert table.values == Tabulated.examples[0]["ff"]
    assert "values=(0.875, 0.75" in repr(table)
    assert models.to_dict(table)["ff"].startswith("0.875, 0.75")
    texture = mi.load_dict(models.to_dict(table))
    assert texture.model.sigma_bar == table.sigma_bar


def test_a_function_can_be_tabulated_where_derivatives_are_suspended() -> None:
    with dr.suspend_grad():
        assert Custom(exponential).sigma_bar == pytest.approx(1)


# ------------------------------------------------------------------------------- scenes


SCENE = """
<scene version="3.0.0">
    <integrator type="nonexp_volpath"/>
    <sensor type="perspective">
        <transform name="to_world"><lookat origin="0,0,4" target="0,0,0" up="0,1,0"/></transform>
        <film type="hdrfilm"><integer name="width" value="4"/><integer name="height" value="4"/>
            <rfilter type="box"/></film>
    </sensor>
    <emitter type="constant"/>
    <shape type="sphere">
        <bsdf type="null"/>
        <medium type="nonexp_homogeneous" name="interior">
            <float name="sigma_t" value="1"/>
            <float name="albedo" value="0.5"/>
            {texture}
        </medium>
    </shape>
</scene>
"""


def rendered(folder: Path, texture: str) -> Any:
    path = folder / "scene.xml"
    path.write_text(SCENE.format(texture=texture), encoding="utf-8")
    return mi.load_file(str(path))


def test_table_and_module_beside_the_scene_file(tmp_path: Path) -> None:
    tau = np.linspace(0, 12, 1201)
    lines = [f"{t:.17g}, {math.exp(-t):.17g}" for t in tau]
    (tmp_path / "beside.csv").write_text("\n".join(lines), encoding="utf-8")
    (tmp_path / "beside_the_scene.py").write_text(
        "import drjit as dr\n\ndef law(tau):\n    return dr.exp(-tau)\n", encoding="utf-8"
    )
    images = {}
    for name, texture in {
        "exponential": '<texture type="transmittance_exponential" name="transmittance"/>',
        "tabulated": '<texture type="transmittance_tabulated" name="transmittance">'
        '<string name="filename" value="beside.csv"/></texture>',
        "vectors": '<texture type="transmittance_tabulated" name="transmittance">'
        f'<string name="tau" value="{" ".join(map(repr, tau.tolist()))}"/>'
        f'<string name="ff" value="{" ".join(map(repr, np.exp(-tau).tolist()))}"/></texture>',
        "custom": '<texture type="transmittance_custom" name="transmittance">'
        '<string name="ff" value="beside_the_scene:law"/></texture>',
    }.items():
        images[name] = np.array(mi.render(rendered(tmp_path, texture), spp=1024, seed=2))
    for image in images.values():
        # The same random numbers, and samplers that are monotone in them.
        np.testing.assert_allclose(image, images["exponential"], rtol=2e-3)
        assert np.min(image) < 0.9
    with pytest.raises(RuntimeError, match="there is no such file"):
        rendered(
            tmp_path,
            '<texture type="transmittance_tabulated" name="transmittance">'
            '<string name="filename" value="elsewhere.csv"/></texture>',
        )


@pytest.mark.thorough
@pytest.mark.parametrize("variant", ["llvm_ad_rgb", "llvm_ad_spectral", "llvm_ad_rgb_double"])
def test_light_that_crosses(variant: str) -> None:
    if variant not in mi.variants():
        pytest.skip("not in this Mitsuba")
    mi.set_variant(variant)
    for case in (
        ("tabulated", Tabulated.examples[0]),
        ("tabulated", {"filename": str(PACKING)}),
        ("custom", {"ff": "nonexp.models.custom:wigner"}),
    ):
        law = models.create(*case[:1], **case[1])
        inside = medium(*case, sigma_t=0.6, albedo=0.0)
        built = scene(sensor=beam(), ball=ball(inside), sky=FURNACE)
        image = np.array(mi.render(built, spp=2**12, seed=9))
        spread = 5 * math.sqrt(0.25 / 2**18)
        assert image[:, :, :3].mean() == pytest.approx(float(law.ff(1.2)), abs=spread)


def test_messages_name_the_field_like_other_models() -> None:
    with pytest.raises(ValueError, match=re.escape("Tabulated.tau[1] is -1: it must be")):
        tabulated(tau=(0, -1), ff=(1, 0))


def test_rounding_beyond_the_range_is_taken_back() -> None:
    table = models.create("tabulated", tau=(0.0, 1.0, 2.0), ff=(1 + 1e-9, 0.4, 0.0))
    assert table.ff(0.0) == 1
