"""The benchmark's harness: it finds what is planted, and nothing where nothing is."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from scipy import stats
from tiers import THOROUGH, quick

from nonexp import cli
from nonexp.bench import gradients, measure, references, report, results, run, scaling
from nonexp.bench.competitors import COMPETITORS, Competitor, competing, known, reference_competitor
from nonexp.bench.measure import Budget
from nonexp.bench.results import CaseResult, Results, Row
from nonexp.bench.scenes import SCENES, Case, Filling, cases
from nonexp.bench.statistics import Estimate, Reference, analyse, fit_slope
from nonexp.models.linear import Linear

SHAPE = (12, 18, 3)


def noisy(count: int, seed: int, bias: float = 0.0, spread: float = 0.1, truth: float = 0.5) -> Any:
    """Passes of an image whose pixels are independent, and whose noise is skewed."""
    rng = np.random.default_rng(seed)
    noise = rng.gamma(1.0, 1.0, (count, *SHAPE)) - 1
    return truth * (1 + bias) + spread * noise


def exact(truth: float = 0.5) -> Reference:
    return Reference.exact(truth, (SHAPE[1], SHAPE[0]), "exact")


def measured(spread: float, seed: int) -> Reference:
    """A reference with noise of its own."""
    passes = noisy(16, seed, spread=spread)
    grey = stats.sem(passes.mean(axis=3))
    return Reference(passes.mean(axis=0), stats.sem(passes), grey, "measured")


def small(name: str, law: str = "exponential", spp: int = 64) -> Case:
    """A case of the benchmark on 16 x 16 pixels."""
    scene = next(scene for scene in SCENES if scene.name == name)
    return Case(dataclasses.replace(scene, size=(16, 16), spp=spp), law)


# --------------------------------------------------------------------- statistics


@THOROUGH
def test_slope_of_unbiased_passes_is_minus_one() -> None:
    """Within its interval in 95 % of all cases: at least 50 of 60 (p < 1e-4 otherwise), and close
    to -1 on average."""
    found = [analyse(noisy(32, seed), np.ones(32), exact()).slope for seed in range(60)]
    assert sum(slope.low < -1 < slope.high for slope in found) >= 50
    assert abs(np.mean([slope.value for slope in found]) + 1) < 0.01


def test_slope_of_a_power_law_and_of_a_floor() -> None:
    """Passes that all agree in their error have slope 0; G of a pure floor and noise lies between.
    The slope is that of (D - O)/n + O."""
    count = 16
    gram = np.full((count, count), 0.3) + np.diag(np.full(count, 0.7))
    sizes = 2.0 ** np.arange(5)
    expected = np.polyfit(np.log(sizes), np.log(0.7 / sizes + 0.3), 1)[0]
    assert fit_slope(gram).value == pytest.approx(expected)
    assert fit_slope(np.ones((count, count))).value == pytest.approx(0)
    assert fit_slope(np.eye(count)).value == pytest.approx(-1)
    assert fit_slope(gram, noise=0.3).value == pytest.approx(-1)


def test_errors_are_corrected_for_the_reference() -> None:
    """The reference's noise is as large as that of the passes' mean; 20 % is seven sigma."""
    passes = noisy(16, 1)
    points = analyse(passes, np.ones(16), measured(0.1, 2)).curve
    for point in points:
        assert point.mse == pytest.approx(0.01 / point.passes, rel=0.2)
        assert point.relmse == pytest.approx(0.01 / 0.2525 / point.passes, rel=0.25)
        assert point.seconds == point.passes
    slope = analyse(passes, np.ones(16), measured(0.1, 2)).slope
    assert slope.low < -1 < slope.high


@THOROUGH
def test_noise_is_not_called_bias() -> None:
    """Skewed noise of passes, or more of it in the reference: no false alarm in 60, and no floor in
    about half of them (8 to 22 of 30: p < 0.01 otherwise, seeds are fixed)."""
    for reference_spread in (0.0, 0.4):
        floors = 0
        for seed in range(30):
            reference = measured(reference_spread, 100 + seed) if reference_spread else exact()
            bias = analyse(noisy(16, seed), np.ones(16), reference).bias
            assert not bias.found
            floors += bias.floor > 0
        assert 8 <= floors <= 22


def test_bias_is_found_in_the_whole_and_in_a_tile() -> None:
    bias = analyse(noisy(16, 3, bias=0.01, spread=0.02), np.ones(16), exact()).bias
    assert bias.found and bias.mean == pytest.approx(0.01, abs=4 * bias.stderr)
    assert bias.floor == pytest.approx(0.01, rel=0.2) and bias.floor_high > 0.01
    tile = noisy(16, 4, spread=0.02)
    tile[:, :2, :3] += 0.02
    tile[:, 2:4, :3] -= 0.02  # the mean stays
    bias = analyse(tile, np.ones(16), exact()).bias
    assert bias.found and abs(bias.mean) < 3 * bias.stderr


def test_passes_without_noise() -> None:
    """Rounding alone is no error, of which a slope or an efficiency could be told."""
    passes = np.full((8, 6, 6, 3), 0.3, dtype=np.float32)
    passes[::2] *= np.float32(1 + 1e-7)
    figures = analyse(passes, np.ones(8), Reference.exact(0.3, (6, 6), ""))
    assert figures.variance == 0 and figures.efficiency.value == math.inf
    assert math.isnan(figures.slope.value) and not figures.bias.found
    passes[0] *= 1.0001
    assert analyse(passes, np.ones(8), Reference.exact(0.3, (6, 6), "")).variance > 0


@THOROUGH
def test_efficiency_and_its_interval() -> None:
    """1/(variance * time); the interval holds the true value in 95 % of all cases: in at least
    48 of 60 (p < 1e-4 otherwise, as the bootstrap is a little narrow)."""
    held = 0
    for seed in range(60):
        time = np.random.default_rng(seed).uniform(1.9, 2.1, 32)
        estimate = analyse(noisy(32, seed), time, exact()).efficiency
        held += estimate.low < 1 / (0.01 * 2) < estimate.high
        assert estimate.value == pytest.approx(50, rel=0.15)
    assert held >= 48


def test_too_few_or_other_passes_are_refused() -> None:
    with pytest.raises(ValueError, match="at least 4"):
        analyse(noisy(3, 0), np.ones(3), exact())
    with pytest.raises(ValueError, match="at least 4 of"):
        analyse(noisy(8, 0)[:, :5], np.ones(8), exact())


# --------------------------------------------------------------------- measuring


BIASED = """
import mitsuba as mi

class Biased(mi.SamplingIntegrator):
    def __init__(self, props):
        super().__init__(props)
        self.right = mi.load_dict({"type": "volpath", "rr_depth": 5})
        props.mark_queried("max_depth")
        props.mark_queried("rr_depth")

    def sample(self, scene, sampler, ray, medium=None, active=True):
        light, valid, aovs = self.right.sample(scene, sampler, ray, medium, active)
        return 1.01 * light, valid, aovs

mi.register_integrator("biased_volpath", Biased)
"""


@THOROUGH
def test_a_planted_bias_is_flagged_and_copies_agree(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """1 % is fifteen standard errors. Whole processes, on the furnace."""
    (tmp_path / "biased_plugin.py").write_text(BIASED, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    competitors = [
        Competitor("one", "volpath", medium={}),
        Competitor("two", "volpath", medium={}),
        Competitor("biased", "biased_volpath", medium={}, module="biased_plugin"),
        Competitor("nonsense", "no_such_integrator", medium={}),
    ]
    case = small("furnace", spp=256)
    seen: list[str] = []
    reference = references.load(case, tmp_path)
    rows = measure.run_case(
        case, competitors, reference, Budget(0.1, 16, 16), seed=1, on_pass=seen.append
    )
    one, two, biased, nonsense = rows
    assert [row.name for row in rows] == ["one", "two", "biased", "nonsense"]
    assert seen[-1] == "furnace-exponential: round 16 of 16"
    assert nonsense.error is not None and "no_such_integrator" in nonsense.error
    assert one.figures and two.figures and biased.figures
    assert biased.figures.bias.found and not one.figures.bias.found
    assert biased.figures.bias.mean == pytest.approx(0.01, abs=4 * biased.figures.bias.stderr)
    a, b = one.figures.bias, two.figures.bias
    assert a.mean != b.mean, "copies must not share random numbers"
    assert abs(a.mean - b.mean) < 3 * math.hypot(a.stderr, b.stderr)
    assert one.operations == two.operations > 500
    assert one.passes == 16 and one.spp == 256 and one.memory > 0


def test_options_that_the_plugin_does_not_know_are_left_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    case = small("dragon")
    assert not known(Competitor("x", "nonexp_volpath", {"no_such_option": 1}), case.scene)
    assert not known(Competitor("x", "no_such_plugin"), case.scene)
    odd = Competitor("odd", "nonexp_volpath", {"no_such_option": 1})
    monkeypatch.setattr("nonexp.bench.competitors.COMPETITORS", (*COMPETITORS, odd))
    assert "odd" not in [competitor.name for competitor in competing(case)]


# --------------------------------------------------------------------- tables


@pytest.mark.parametrize(
    "case",
    quick(cases(("all",)), lambda case: case.usual or "grid" not in case.scene.tags),
    ids=lambda case: case.name,
)
def test_every_case_can_be_built_by_all_its_competitors(case: Case) -> None:
    competitors = competing(case)
    names = [competitor.name for competitor in competitors]
    assert names[0] == "nonexp" and len({*names}) == len(names)
    assert (len(names) > 2) == case.stock or {"glass", "grid"} & case.scene.tags
    assert {*[c.name for c in competing(case, quick=True)]} <= {*names}
    for competitor in competitors:
        assert competitor.integrator(case.scene) is not None
    for filling in {c.filling(case).law: c.filling(case) for c in competitors}.values():
        built = case.scene.build(filling, (16, 12))
        assert tuple(built.sensors()[0].film().size()) == (16, 12)
    if case.stock:
        assert reference_competitor(case).plugin == "volpath"


def test_scenes_are_chosen_by_name() -> None:
    def chosen(*names: str) -> list[str]:
        return [case.name for case in cases(names)]

    assert chosen("slab", "fog_sphere-gamma") == [
        "fog_sphere-gamma",
        "slab-exponential",
        "slab-linear",
        "slab-memory",
    ]
    assert chosen("fog") == ["fog-exponential", "fog-linear"] and chosen("cornell") == ["cornell"]
    clouds, every = chosen("cloud"), chosen("all")
    assert len(clouds) == 18 and len(chosen("cloud-128")) == 9 and {*clouds} < {*every}
    usual = {"cloud-32-medium-exponential", "cloud-128-medium-gamma"}
    assert {*every} - {*chosen()} == {*clouds} - usual
    with pytest.raises(ValueError, match="'moon': it must be all, one of dragon"):
        cases(("moon",))
    with pytest.raises(ValueError, match="'clou'"):
        cases(("clou",))


def test_a_cloud_has_the_same_density_in_mitsubas_medium_and_in_ours() -> None:
    """Data and scale: the mean optical depth along z, over the middle quarter of the face."""
    for name, depth in (("cloud-32-thin", 0.14), ("cloud-32-thick", 7.0)):
        case = small(name)
        tracked = {one.name: one.filling(case).tracking for one in competing(case)}
        assert tracked["nonexp regular"] == "regular" and tracked["nonexp delta"] == "delta"
        for filling in (Filling("linear"), Filling("exponential", tracking="delta"), Filling(None)):
            built = case.scene.build(filling, (8, 8))
            (cube,) = built.shapes()
            medium = cube.interior_medium()
            values = mi.traverse(medium)
            data = next(np.array(values[key]) for key in values.keys() if key.endswith("data"))
            scale = float(np.ravel(values["scale"])[0])
            middle = data[:, 8:24, 8:24, 0].mean()
            assert 2 * scale * middle == pytest.approx(depth, rel=1e-5)
            if filling.law == "exponential":
                assert medium.tracked
            elif filling.law:
                assert isinstance(medium.model, Linear) and not medium.tracked
            else:
                assert "Heterogeneous" in medium.class_name()
    assert [one.name for one in competing(small("cloud-32-thin", "linear"))] == [
        "nonexp",
        "nonexp sobol",
    ]
    assert len(competing(small("cloud-32-thin", "gamma"))) == 4
    assert reference_competitor(small("cloud-32-thin", "gamma")).tracking == "regular"


@THOROUGH
def test_all_ways_through_a_cloud_show_the_same_image() -> None:
    """Means of the image within five standard errors, which are below 1 %."""
    case = small("cloud-32-thick")
    means = {}
    for competitor in competing(case):
        if competitor.name not in ("nonexp regular", "nonexp delta", "volpath"):
            continue
        built = case.scene.build(competitor.filling(case), case.scene.size)
        integrator = competitor.integrator(case.scene)
        grey = [
            np.array(integrator.render(built, seed=seed, spp=64))[:, :, :3].mean()
            for seed in range(16)
        ]
        means[competitor.name] = (np.mean(grey), stats.sem(grey))
    assert len(means) == 3
    expected, error = means.pop("volpath")
    for mean, own in means.values():
        assert abs(mean - expected) < 5 * math.hypot(own, error) < 0.05 * expected


# --------------------------------------------------------------------- references


@THOROUGH
def test_reference_is_what_is_rendered(tmp_path: Path) -> None:
    """Each channel of the chromatic ball by itself: the same as by spectral sampling, within five
    standard errors of the mean of the image."""
    case = small("chromatic")
    told: list[float] = []
    made = references.rebuild(case, tmp_path, 0.01, command="the command", on_pass=told.append)
    read = references.load(case, tmp_path)
    assert told[-1] == 1 and "volpath" in read.origin and "512 spp" in read.origin
    np.testing.assert_allclose(read.mean, made.mean, rtol=1e-6)
    np.testing.assert_allclose(read.stderr, made.stderr, rtol=1e-3, atol=1e-6)
    grey_stderr = np.sqrt(np.sum(read.stderr**2, axis=2)) / 3  # channels of their own seeds
    np.testing.assert_allclose(read.grey_stderr, grey_stderr, rtol=2e-3, atol=1e-6)
    scene = case.scene.build(Filling("exponential"), case.scene.size)
    integrator = mi.load_dict({"type": "nonexp_volpath", "max_depth": 64})
    other = np.array([mi.render(scene, integrator=integrator, spp=64, seed=s) for s in range(8)])
    grey = other.mean(axis=(1, 2, 3))
    error = math.hypot(stats.sem(grey), references.relative_stderr(read) * grey.mean())
    assert abs(grey.mean() - read.mean.mean()) < 5 * error < 0.05 * grey.mean()


def test_references_say_how_they_were_made_and_stay_if_a_new_one_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import OpenEXR

    case = small("cornell", spp=4)
    references.rebuild(case, tmp_path, 0.01, seed=5, command="nonexp bench --again")
    file = references.path(case, tmp_path)
    with OpenEXR.File(str(file)) as exr:
        header = exr.header()
        assert header["nonexp:command"] == "nonexp bench --again"
        assert (header["nonexp:spp"], header["nonexp:seed"]) == (32, 5)
        assert header["nonexp:integrator"] == "volpath" and header["nonexp:stderr"] > 0
    before = file.read_bytes()

    def fails(self: Any, name: str) -> None:
        Path(name).write_bytes(b"half a file")
        raise OSError("no space left")

    monkeypatch.setattr(OpenEXR.File, "write", fails)
    with pytest.raises(OSError, match="no space"):
        references.rebuild(case, tmp_path, 0.01)
    assert file.read_bytes() == before and [*tmp_path.iterdir()] == [file]


def test_references_that_are_missing_or_of_another_size(tmp_path: Path) -> None:
    case = small("cornell", spp=4)
    with pytest.raises(FileNotFoundError, match=r"cornell has no reference .*rebuild-references"):
        references.load(case, tmp_path)
    references.rebuild(case, tmp_path, 0.01)
    other = Case(dataclasses.replace(case.scene, size=(8, 8)), case.law)
    with pytest.raises(ValueError, match="has 16 x 16 pixels: cornell has 8 x 8"):
        references.load(other, tmp_path)
    with pytest.raises(ValueError, match="must be > 0"):
        references.rebuild(case, tmp_path, 0)


def test_reference_of_a_cloud_says_how_it_was_tracked(tmp_path: Path) -> None:
    case = small("cloud-32-thin", "gamma", spp=4)
    references.rebuild(case, tmp_path, 0.01)
    read = references.load(case, tmp_path)
    assert read.origin == "nonexp_volpath, tracking regular, 32 spp, seed 1"


def test_closed_forms_need_no_file(tmp_path: Path) -> None:
    slab = references.load(small("slab", "linear"), tmp_path)
    assert slab.mean[3, 4, 1] == pytest.approx(0.3) and np.all(slab.stderr == 0)
    assert np.all(references.load(small("furnace", "gamma"), tmp_path).mean == 1)


# --------------------------------------------------------------------- results


def made(seed: int, slower: float = 1.0, noisier: float = 1.0, bias: float = 0.0) -> Results:
    """Results of three competitors in two cases; the third in the first case may be changed."""
    found = []
    for number, name in enumerate(("a-exponential", "b-exponential")):
        rows = []
        for place, who in enumerate(("volpath", "nonexp", "other")):
            changed = number == 0 and place == 2
            rng = np.random.default_rng([seed, number, place])
            time = rng.normal(0.1 * (1 + place), 0.003, 32) * (slower if changed else 1)
            spread = 0.1 * (noisier**0.5 if changed else 1)
            own = 1000 * seed + 10 * number + place
            passes = noisy(32, own, bias=bias if changed else 0, spread=spread)
            medium: dict[str, Any] | None = {} if place == 0 else None
            row = Row(who, who, {}, medium, 16, 32, analyse(passes, time, exact()), 1000 + place)
            rows.append(dataclasses.replace(row, compile_seconds=1.0, memory=10**6))
        found.append(CaseResult(name, "text", (18, 12), "exact: 0.5", 0.0, "volpath", rows))
    about = {"date": "2026-01-01T00:00:00", "commit": "abc", "processor": "some", "load": 0.0}
    return Results(found, about, ["fog has no reference"])


def test_results_survive_a_file(tmp_path: Path) -> None:
    before = made(1)
    path = tmp_path / "results.json"
    path.write_text(before.to_json(), encoding="utf-8")
    assert Results.read(path) == before
    data = json.loads(before.to_json())
    assert data["schema"] == results.SCHEMA and data["cases"][0]["rows"][0]["name"] == "volpath"


def test_other_files_are_refused() -> None:
    newer = made(1).to_json().replace('"schema": 1', '"schema": 99')
    with pytest.raises(ValueError, match="has schema 99: this version reads schema 1"):
        Results.from_json(newer, "x.json")
    for text in ("{", "[]", "{}", '{"schema": 1}'):
        with pytest.raises(ValueError, match=r"x\.json does not hold results of nonexp bench"):
            Results.from_json(text, "x.json")


@THOROUGH
def test_compare_finds_nothing_in_a_repeated_run() -> None:
    """96 figures, of other random numbers."""
    for seed in range(2, 10):
        assert results.changes(made(1), made(seed)) == []


@pytest.mark.parametrize(
    ("planted", "expected"),
    [
        ({"slower": 1.3}, {("s per pass", False), ("efficiency", False)}),
        ({"slower": 0.8}, {("s per pass", True), ("efficiency", True)}),
        ({"noisier": 2.0}, {("efficiency", False)}),
        ({"bias": 0.05}, {("bias", False)}),
    ],
    # The names must be the same in every process: a set has no order.
    ids=["slower", "faster", "noisier", "biased"],
)
def test_compare_finds_what_is_planted_and_no_other(
    planted: dict[str, float], expected: set[tuple[str, bool]]
) -> None:
    found = results.changes(made(1), made(2, **planted))
    assert {(c.case, c.competitor) for c in found} == {("a-exponential", "other")}
    assert {(c.what, c.better) for c in found} == expected


def test_compare_takes_the_machine_out() -> None:
    """All take twice as long: so do Mitsuba's own integrators. Also where these do not compete."""
    new = made(2)
    for case in new.cases:
        for row in case.rows:
            assert row.figures is not None
            seconds = tuple(2 * s for s in row.figures.seconds)
            half = dataclasses.replace(
                row.figures.efficiency,
                **{key: value / 2 for key, value in vars(row.figures.efficiency).items()},
            )
            row.figures = dataclasses.replace(row.figures, seconds=seconds, efficiency=half)
    factor = results.machine_factor(made(1), new)
    assert factor.value == pytest.approx(2, rel=0.05) and factor.low < factor.value < factor.high
    assert results.changes(made(1), new) == []
    del new.cases[1].rows[0]
    assert results.changes(made(1), new) == []


def test_compare_finds_kernels_memory_and_failures() -> None:
    new = made(1)
    row = new.cases[1].rows[1]
    row.operations, row.memory = 2 * row.operations, row.memory // 2
    new.cases[0].rows[2] = Row("other", "other", {}, None, 16, error="out of memory")
    found = {(c.case[0], c.competitor, c.what, c.better) for c in results.changes(made(1), new)}
    assert found == {
        ("b", "nonexp", "operations", False),
        ("b", "nonexp", "memory", True),
        ("a", "other", "fails", False),
    }


# --------------------------------------------------------------------- report


def test_report_tells_all(tmp_path: Path) -> None:
    done = made(3, bias=0.05)
    done.cases[1].rows[2] = Row("other", "other", {}, None, 16, error="it broke")
    written = run.write(done, tmp_path / "out")
    names = ["results.json", "results.md", "main.png", "error.png", "efficiency.png"]
    assert [path.name for path in written] == names
    assert all(path.stat().st_size > 500 for path in written)
    text = written[1].read_text(encoding="utf-8")
    assert "`other` is biased in a-exponential" in text
    assert "`other` fails in b-exponential: it broke" in text
    assert "Left out: fog has no reference" in text
    (summary,) = [line for line in text.splitlines() if line.startswith("| a-exponential |")]
    assert summary.split("|")[2:4] != ["", ""] and "(*)" in summary
    widths = {line.count("|") for line in text.splitlines() if line.startswith("| nonexp |")}
    assert widths == {13}


@THOROUGH
def test_report_names_slopes_that_are_off() -> None:
    """The one with a floor, and nothing that misses its own interval by chance."""
    for seed in range(8):
        assert "none in intervals that hold all" in report.summary(made(seed))[-1]
        off = report.summary(made(seed, bias=0.5))[-1]
        assert "`other` in a-exponential (" in off and off.count(" in a-") == 1 and "b-" not in off


@THOROUGH
def test_a_failing_plot_leaves_the_old_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from matplotlib.figure import Figure

    path = tmp_path / "error.png"
    assert report.error_plot(made(1), path)
    before = path.read_bytes()

    def fails(self: Any, *args: Any, **kw: Any) -> None:
        raise OSError("no space left")

    monkeypatch.setattr(Figure, "savefig", fails)
    with pytest.raises(OSError, match="no space"):
        report.error_plot(made(2), path)
    assert path.read_bytes() == before and [*tmp_path.iterdir()] == [path]


# --------------------------------------------------------------------- derivatives


@THOROUGH
def test_derivatives_are_those_of_prbvolpath() -> None:
    """What is timed is right: by extinction, albedo and phase function, to 12 %."""
    found = []
    for plugin, law in (("nonexp_volpath", "exponential"), ("prbvolpath", None)):
        built = gradients.build("white sky", plugin, law, 16)
        passes = np.array([gradients.measure(built, seed, 256)[0] for seed in range(6)])
        found.append((passes.mean(axis=0), passes.std(axis=0, ddof=1) / 6**0.5))
    (ours, error), (theirs, other) = found
    error = np.hypot(error, other)
    assert np.all(5 * error[:2] < 0.12 * np.abs(theirs[:2])), error / theirs
    assert np.all(np.abs(ours - theirs) < 5 * error), (ours, theirs, error)


def test_a_table_of_derivatives(tmp_path: Path) -> None:
    timing = gradients.Timing(0.05, Estimate(2.2, 2.0, 2.4))
    gain = Estimate(30.0, 20.0, 40.0)
    rows = [
        gradients.Row("lamp", plugin, "exponential", name, -0.5, 0.01, timing, efficiency)
        for plugin, efficiency in (("nonexp_volpath", gain), ("prbvolpath", None))
        for name in gradients.PARAMETERS
    ]
    lines = gradients.table(rows)
    assert len(lines) == 2 + len(rows) and "30.00 (20.00 to 40.00)" in lines[2]
    names = [path.name for path in gradients.write(rows, {}, tmp_path)]
    assert names == ["gradients.json", "gradients.md"]
    assert len(json.loads((tmp_path / names[0]).read_text())["rows"]) == len(rows)


# --------------------------------------------------------------------- scaling


@THOROUGH
def test_scaling_tells_exponents(tmp_path: Path) -> None:
    samples = [
        scaling.Sample(axis.name, line.name, value, 0.01 * value**1.5, 10**6)
        for axis in scaling.AXES
        for line in scaling.lines(axis)
        for value in axis.values
    ]
    told = scaling.sentences(samples)
    assert len(told) == sum(len(scaling.lines(axis)) for axis in scaling.AXES)
    assert all("as the power 1.50; memory from 1 to 1 MB." in line for line in told)
    names = [path.name for path in scaling.write(samples, {}, tmp_path)]
    assert names == ["scaling.json", "scaling.md", "scaling.png"]
    assert len(json.loads((tmp_path / "scaling.json").read_text())["samples"]) == len(samples)


@pytest.mark.parametrize("axis", scaling.AXES, ids=lambda axis: axis.name)
def test_scaling_scenes_can_be_built(axis: scaling.Axis) -> None:
    for line in scaling.lines(axis):
        assert axis.build(Filling(line.law), axis.values[0]).sensors()


# --------------------------------------------------------------------- command line


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--scenes", "moon"], "scene is 'moon': it must be all, one of dragon"),
        (["--time", "soon"], "--time is 'soon': it must be a time > 0"),
        (["--seed", "-1"], "--seed is '-1'"),
        (["--list", "--scaling"], "--list and --scaling exclude each other"),
        (["--compare", "a", "b", "c"], "--compare got 3 files"),
        (["--compare", "no_such.json"], "no_such.json"),
        (["--variant", "cuda_no_such"], "variant 'cuda_no_such' is unknown"),
        (["--scenes", "cornell", "--references", "/nowhere"], "cornell has no reference"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_bad_usage_is_one_sentence(
    arguments: list[str],
    message: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    code = cli.main(["bench", "--out", str(tmp_path / "out"), *arguments])
    error = capsys.readouterr().err
    assert code == 2 and error.count("error:") == 1 and message in error
    assert "Traceback" not in error


def test_output_must_be_a_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("mine")
    assert cli.main(["bench", "--out", str(tmp_path / "file")]) == 2
    assert "it must be a folder" in capsys.readouterr().err
    assert (tmp_path / "file").read_text() == "mine"


def test_compare_two_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    old, same, worse = (tmp_path / f"{name}.json" for name in ("old", "same", "worse"))
    for path, data in ((old, made(1)), (same, made(2)), (worse, made(3, slower=1.5))):
        path.write_text(data.to_json(), encoding="utf-8")
    assert cli.main(["bench", "--compare", str(old), str(same)]) == 0
    assert "nothing changed beyond the noise" in capsys.readouterr().out
    assert cli.main(["bench", "--compare", str(old), str(worse)]) == 1
    told = capsys.readouterr().out
    assert "a-exponential" in told and "s per pass" in told and "worse" in told
    assert "b-exponential" not in told
    assert cli.main(["bench", "--compare", str(worse), str(old)]) == 0


def test_list(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["bench", "--list", "--scenes", "slab"]) == 0
    told = capsys.readouterr().out
    assert "slab-linear" in told and "volpathmis" in told and "dragon" not in told
