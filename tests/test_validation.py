"""Published numbers beside ours: what they are, that programs still give them, and the command.

The statistics of all rows are those of ``nonexp validate``; here run the rows that cost little.
"""

from __future__ import annotations

import math
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import integrate, special
from tiers import THOROUGH

from nonexp import cli, models
from nonexp.validation import report, run, slabs, study, walks
from nonexp.validation.deon_2018_jctt import exact
from nonexp.validation.study import Effort, Quantity, Row

ROOT = Path(__file__).resolve().parent.parent
FOLDERS = sorted(p.parent.name for p in (ROOT / "nonexp" / "validation").glob("*/numbers.csv"))


@pytest.fixture
def programs(monkeypatch: pytest.MonkeyPatch) -> Any:
    """tools/validation.py, which calls the independent programs."""
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    import validation

    yield validation
    sys.modules.pop("validation", None)


def test_every_folder_is_a_study_that_says_where_its_numbers_stand() -> None:
    assert sorted(run.STUDIES) == FOLDERS
    for name in FOLDERS:
        quantities = study.numbers(f"nonexp.validation.{name}")
        assert quantities and all(q.where and q.error > 0 for q in quantities.values())
        assert all(run.titles(name))


def test_quadrature_agrees_with_what_is_published() -> None:
    rows = list(run.measure("vu_2021", study.QUICK))
    assert len(rows) == 2 and all(run.agrees(row, 2) for row in rows)


def test_independent_programs_give_the_numbers(programs: Any) -> None:
    """Some of each, computed anew."""
    held = study.numbers("nonexp.validation.ho_2024_joss")
    case = "albedo=0.9 thickness=3 g=0.75"
    for light, mu in (("normal", 1.0), ("oblique", 0.3), ("Lambertian", None)):
        for name, value in zip(
            ("reflected", "transmitted"), programs.disort(0.9, 3.0, 0.75, 32, mu), strict=True
        ):
            assert value == pytest.approx(held[f"{case} {light} {name}"].value, rel=2e-6)
    held = study.numbers("nonexp.validation.prahl_2023_pypi")
    found = programs.doubling(0.9, 3.0, 0.0, 1.5, 32)
    quantity = held["albedo=0.9 thickness=3 g=0 index=1.5 normal reflected"]
    assert found[0] == pytest.approx(quantity.value, abs=2 * quantity.error)


def test_independent_programs_agree_with_each_other_and_with_the_list(programs: Any) -> None:
    """Adding and doubling beside discrete ordinates; both beside the atomic mix as published."""
    from nonexp.validation.adams_1989_jqsrt import THICKNESS, atomic_mix

    for light, places in ((1.0, (0, 1)), (None, (2, 3))):
        one, other = programs.disort(0.9, 3.0, 0.0, 32, light), programs.doubling(0.9, 3, 0, 1, 32)
        np.testing.assert_allclose(one, [other[i] for i in places], rtol=4e-4)
    held = study.numbers("nonexp.validation.adams_1989_jqsrt")
    for case in ("1a", "1c", "3a", "3b"):
        sigma_t, albedo = atomic_mix(case)
        found = programs.disort(albedo, THICKNESS * sigma_t, 0.0, 32, None)
        for name, value in zip(("reflected", "transmitted"), found, strict=True):
            quantity = held[f"{case} {name}"]
            assert abs(value - quantity.value) <= 1.01 * quantity.error


def test_numbers_of_the_formula_are_its_integral() -> None:
    for name, quantity in study.numbers("nonexp.validation.deon_2018_jctt").items():
        albedo, inner, outer = _shell(name)
        s = math.sqrt(1 - albedo)
        found, _ = integrate.quad(lambda r, s=s: r * math.exp(-r * s), inner, outer)
        assert quantity.value == pytest.approx(found, rel=1e-6)
        assert exact(albedo, inner, outer) == pytest.approx(found, rel=1e-9)


def _shell(name: str) -> tuple[float, float, float]:
    words = name.split()
    return float(words[0].partition("=")[2]), float(words[2]), float(words[4])


LEAST = Effort(0.1, 1, 2**14, quick=True)


@THOROUGH
@pytest.mark.parametrize("name", ["deon_2018_jctt", "brantley_2011_jqsrt"])
def test_rows_of_a_study_agree(name: str) -> None:
    """Of few samples. Finds, in the most precise row, a number that is off by 3 %."""
    rows = list(run.STUDIES[name].measure(LEAST))
    assert all(run.agrees(row, len(rows)) for row in rows)
    found = run.summary(rows)
    assert found.error < 0.01 and found.chi2 < 4


def test_light_in_slabs_is_conserved() -> None:
    """A white slab reflects what it does not transmit, path by path; so does one of glass."""
    medium = {"type": "nonexp_homogeneous", "albedo": 1.0}
    for index in (1.0, 1.5):
        built = slabs.slab(medium, 1.0, index)
        found = slabs.paths(built, 1.0, slabs.incident(None), 3, 2**12)
        np.testing.assert_allclose(found.sum(axis=0), 1, rtol=1e-5)


@THOROUGH
def test_collisions_are_recorded_path_by_path() -> None:
    """Steps of an equal length between collisions; first depths of the paths that cross."""
    law = models.to_dict(models.create("linear", b=2.0))
    medium = {"type": "nonexp_homogeneous", "sigma_t": 1.0, "transmittance": law}
    place = walks.collisions(medium, 2**10, 5, 1)
    steps = np.linalg.norm(np.diff(place, axis=1), axis=2)
    np.testing.assert_allclose(steps, 2, rtol=1e-5)
    assert np.all(np.linalg.norm(place[:, 0], axis=1) <= 2)

    light, medium = slabs.incident(None), {"type": "nonexp_homogeneous", "albedo": 1.0}
    depth = walks.first_depths(medium, 1.0, light, 3, 2**12)
    crossed = slabs.paths(slabs.slab(medium, 1.0), 1.0, light, 3, 2**12)[1]
    assert np.all(crossed[np.isinf(depth)] == 1)
    assert np.isinf(depth).mean() == pytest.approx(2 * special.expn(3, 1.0), abs=0.03)
    assert np.all(depth[np.isfinite(depth)] <= 1)


# --------------------------------------------------------------------- the command, the page


def rows(ours: float) -> dict[str, list[Row]]:
    quantity = Quantity("albedo=0.5 radius 0 to 1", 0.31656, 1e-7, "somewhere")
    return {"deon_2018_jctt": [Row("deon_2018_jctt", quantity, ours, 1e-4)]}


def test_deviation_is_found() -> None:
    (right,), (wrong,) = rows(0.3166).values(), rows(0.3176).values()
    assert run.agrees(right[0], 1) and not run.agrees(wrong[0], 1)
    assert "| DEVIATES |" in report.page(rows(0.3176)) and "1 beyond the limit" in report.page(
        rows(0.3176)
    )
    assert "| 0.31656 | 0.31660 ± 0.0001 | +0.4 | agrees |" in report.page(rows(0.3166))


def test_command(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["validate", "--list"]) == 0
    shown = capsys.readouterr().out
    assert all(name in shown for name in run.STUDIES)
    assert cli.main(["validate", "vu_2021", "--quick", "--out", str(tmp_path)]) == 0
    assert "2 numbers: all agree" in capsys.readouterr().out
    assert (tmp_path / "images" / "validation.png").stat().st_size > 1000
    assert "# Published numbers" in (tmp_path / "validation.md").read_text(encoding="utf-8")
    monkeypatch.setattr(run, "measure", lambda study, effort: iter(rows(0.4)[study]))
    assert cli.main(["validate", "deon_2018_jctt"]) == 1
    assert "1 number: 1 deviate" in capsys.readouterr().out
    assert cli.main(["validate", "moon"]) == 2
    assert "STUDY is 'moon': it must be one of adams" in capsys.readouterr().err


def test_page_has_every_number() -> None:
    page = (ROOT / "docs" / "validation.md").read_text(encoding="utf-8")
    assert "DEVIATES" not in page and "none beyond the limit" in page
    for name in FOLDERS:
        title = run.titles(name)[0]
        assert f"## {title[0].upper()}{title[1:]}" in page
        for quantity in study.numbers(f"nonexp.validation.{name}").values():
            assert f"| {quantity.name} | {quantity.value:.7g}" in page


# --------------------------------------------------------------------- how we know


HOW = (ROOT / "docs" / "how-we-know.md").read_text(encoding="utf-8")


def plain(text: str) -> str:
    """One line, without the marks of emphasis and links."""
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text)
    return " ".join(text.replace("**", "").replace("\\|", "|").split())


def claims() -> list[str]:
    """What the page quotes from the README."""
    return [plain(quote) for quote in re.findall(r'^\| "(.*?)" \| ', HOW, re.MULTILINE)]


def test_claims_are_those_of_the_readme_and_none_is_left_out() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    for claim in claims():
        assert claim in plain(readme), claim
    section = re.search(r"^## What you can rely on\n(.*?)^## ", readme, re.MULTILINE | re.DOTALL)
    assert section is not None
    points = [plain(point) for point in re.split(r"^\* ", section[1], flags=re.MULTILINE)[1:]]
    assert len(points) > 8
    for point in points:
        assert any(claim in point for claim in claims()), point


def test_what_the_page_names_exists() -> None:
    named = re.findall(r"`((?:tests|nonexp)/[\w/]+\.py)(?:::(\w+))?`", HOW)
    assert len(named) > 45
    for path, test in named:
        text = (ROOT / path).read_text(encoding="utf-8")
        assert not test or re.search(rf"^def {test}\(", text, re.MULTILINE), f"{path}::{test}"
    rows = [line for line in HOW.splitlines() if line.startswith('| "')]
    for row in rows:
        held = row.rpartition('" | ')[2]
        assert re.search(r"`(tests|nonexp)/|\]\(\w|the rows below", held), row
