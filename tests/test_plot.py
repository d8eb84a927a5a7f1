"""Figures of models and of fits."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure

from nonexp import fitting, models
from nonexp.fitting import plot as plotting

pytestmark = pytest.mark.thorough

matplotlib.use("Agg")

DRAWS = 2**16


def labels(axes: Any) -> list[str]:
    return axes.get_legend_handles_labels()[1]


def line(axes: Any, label: str) -> tuple[Any, Any]:
    (found,) = (item for item in axes.lines if item.get_label() == label)
    return found.get_xdata(), found.get_ydata()


@pytest.mark.parametrize("name", models.names())
def test_every_model_is_drawn(name: str) -> None:
    model = models.create(name, **models.registry[name].examples[0])
    figure = plotting.plot_model(model, draws=2**12)
    assert len(figure.axes) == (5 if model.atoms else 4)
    for axes in figure.axes[:4]:
        low, high = axes.get_ylim()
        assert np.isfinite([low, high]).all() and high > low
        assert axes.get_xlabel() == "optical depth tau"
    assert figure.get_suptitle().startswith(name)
    assert "T = " in figure.get_suptitle()


def test_a_model_is_shown_with_its_densities_and_its_draws() -> None:
    model = models.create("gamma", alpha=0.5)
    figure = plotting.plot_model(model, draws=2**18)
    linear, logarithmic, first, later = figure.axes
    for axes in (linear, logarithmic):
        assert set(labels(axes)) == {
            "ff, from a fixed point", "pf, from a particle", "exponential law"
        }  # fmt: skip
        assert axes.get_legend() is not None
    assert (logarithmic.get_xscale(), logarithmic.get_yscale()) == ("log", "log")  # a power law
    tau, ff = line(linear, "ff, from a fixed point")
    np.testing.assert_allclose(ff, (1 + 2 * tau) ** -0.5)
    tau, other = line(linear, "exponential law")
    np.testing.assert_allclose(other, np.exp(-tau))
    for axes, name in ((first, "fp"), (later, "pp")):
        assert set(labels(axes)) == {"histogram of draws", name, "exponential law"}
        heights, edges, _ = axes.patches[0].get_data()
        middle = (edges[1:] + edges[:-1]) / 2
        expected = np.array([getattr(model, name)(float(v)) for v in middle])
        count = expected * np.diff(edges) * 2**18
        enough = (count > 100) & (middle > 1)  # away from where the density bends within a bin
        z = (heights - expected) / expected * np.sqrt(count)
        assert np.abs(z[enough]).max() < 5
        assert enough.sum() > 30


def test_the_same_seed_draws_the_same_figure() -> None:
    model = models.create("gamma")
    heights = [
        plotting.plot_model(model, draws=DRAWS, seed=seed).axes[2].patches[0].get_data()[0]
        for seed in (1, 1, 2)
    ]
    np.testing.assert_array_equal(heights[0], heights[1])
    assert not np.array_equal(heights[0], heights[2])


def test_an_exponential_tail_is_drawn_over_linear_depth() -> None:
    logarithmic = plotting.plot_model(models.create("exponential"), draws=DRAWS).axes[1]
    assert (logarithmic.get_xscale(), logarithmic.get_yscale()) == ("linear", "log")


def test_atoms_are_stems_as_high_as_their_probability() -> None:
    model = models.create("pulse", a=0.5, b=1.5, n=4)
    *_, later, masses = plotting.plot_model(model, draws=DRAWS).axes
    assert masses.get_ylabel() == "probability of an atom"
    stems = np.array(masses.collections[0].get_segments())
    np.testing.assert_allclose(stems[:, 1], model.atoms)
    np.testing.assert_allclose(stems[:, 0, 1], 0)
    where, share = line(masses, "share of draws")
    np.testing.assert_allclose(where, [tau for tau, _ in model.atoms])
    np.testing.assert_allclose(share, 0.25, atol=5 * np.sqrt(0.25 * 0.75 / DRAWS))
    assert "pp, less atoms" not in labels(later)  # there is nothing else
    mixed = models.create("mixture")
    assert "pp, less atoms" in labels(plotting.plot_model(mixed, draws=DRAWS).axes[3])


def test_lines_break_where_a_density_jumps() -> None:
    first = plotting.plot_model(models.create("linear", b=2.0), draws=DRAWS).axes[2]
    tau, fp = line(first, "fp")
    (gap,) = np.flatnonzero(np.isnan(tau))
    assert tau[gap - 1] < 2 < tau[gap + 1]
    np.testing.assert_allclose(fp[[gap - 1, gap + 1]], [0.5, 0])
    _, edges, _ = first.patches[0].get_data()
    assert np.isclose(edges, 2).sum() == 1  # and so do the bins


def test_vacuum_says_that_there_are_no_collisions() -> None:
    figure = plotting.plot_model(models.create("constant"))
    assert [axes.texts[0].get_text() for axes in figure.axes[2:]] == ["no collisions"] * 2


def test_a_long_table_has_a_short_title() -> None:
    tau = np.linspace(0, 4, 200)
    model = models.create("tabulated", tau=tau, ff=np.exp(-tau))
    assert len(plotting.plot_model(model, draws=DRAWS).get_suptitle()) < 250


def test_a_fit_is_drawn_with_its_residuals() -> None:
    x = np.linspace(0, 4, 30)
    y = np.exp(-x) + 0.01 * np.random.default_rng(1).normal(size=30)
    fits, _ = fitting.compare(["linear", "exponential"], x, y, sigma=0.01)
    upper, lower = plotting.plot_fit(fits, x, y, 0.01).axes
    assert [text.get_text() for text in upper.get_legend().get_texts()] == [
        "data", "exponential", "linear"
    ]  # fmt: skip
    assert upper.get_ylabel() == "transmittance ff"
    assert lower.get_ylabel() == "data - exponential"
    (residuals,) = (item for item in lower.lines if item.get_marker() == "o")
    np.testing.assert_allclose(residuals.get_ydata(), y - fits[0].ff(x))
    low, high = lower.get_ylim()
    assert low < residuals.get_ydata().min() and residuals.get_ydata().max() < high


@pytest.mark.parametrize(
    ("suffix", "start"), [("png", b"\x89PNG"), ("svg", b"<?xml"), ("PDF", b"%PDF")]
)
def test_figures_are_saved_by_suffix(tmp_path: Path, suffix: str, start: bytes) -> None:
    path = tmp_path / f"figure.{suffix}"
    plotting.check_path(path)
    plotting.save(Figure(), path)
    assert path.read_bytes().startswith(start)
    assert list(tmp_path.iterdir()) == [path]


def test_a_failure_leaves_the_old_figure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(self: Figure, path: Path, **_: Any) -> None:
        path.write_text("half")
        raise OSError("No space left on device")

    path = tmp_path / "figure.png"
    path.write_text("old")
    monkeypatch.setattr(Figure, "savefig", fail)
    with pytest.raises(OSError, match="No space left"):
        plotting.save(Figure(), path)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_without_matplotlib_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(ImportError, match=r"pip install 'nonexp\[plot\]'"):
        plotting.plot_model(models.create("gamma"))
