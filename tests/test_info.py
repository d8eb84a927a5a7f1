"""``nonexp info``: what a scene needs, as a table."""

from __future__ import annotations

from pathlib import Path

import pytest

from nonexp import cli

DRAGON = str(Path(__file__).resolve().parent.parent / "scenes" / "dragon.xml")


def table(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, tuple[str, str]]:
    assert cli.main(["info", *arguments]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 100
    starts = [lines[0].index(name) for name in ("in the scene", "found", "in the kernel")]
    rows: list[list[str]] = []
    for line in lines[1:]:
        cells = [line[a:b].strip() for a, b in zip(starts, [*starts[1:], None], strict=True)]
        if not cells[2] and len(line) < starts[2]:  # what is said below the table
            continue
        if rows and not cells[0]:
            cells = [f"{old} {new}".strip() for old, new in zip(rows.pop(), cells, strict=True)]
        rows.append(cells)
    return {row[0]: (row[1], row[2]) for row in rows}


def test_dragon(capsys: pytest.CaptureFixture[str]) -> None:
    found = table(capsys, DRAGON, "-D", "medium=gamma")
    assert found["media"][0] == "1"
    assert found["medium 1"][0].startswith("medium: gamma[alpha=0.5], sigma_t 1.2")
    assert found["medium 1"][1] == "closed, no emitter within: no straight connections from inside"
    assert found["surfaces that let rays straight through"][0] == "none"
    assert found["connections to emitters"] == ("from surfaces", "skipped: media on shadow rays")
    assert found["connections through smooth glass"][0] == "out of lobe"


def test_expected_values(capsys: pytest.CaptureFixture[str]) -> None:
    fog = str(Path(DRAGON).parent / "fog.xml")
    asked = "emission met in media", "collisions in dark media"
    expected = ("medium", "expected"), ("medium", "fewer are kept, and count more")
    for arguments, answers in (
        ([fog], expected),
        ([fog, "-D", "albedo=0.7"], (("medium", "expected, up to 2 mean free paths ahead"), None)),
        ([DRAGON], (None, None)),
    ):
        found = table(capsys, *arguments)
        for question, answer in zip(asked, answers, strict=True):
            assert found[question] == answer if answer else found[question][0] == "none"


def test_vacuum(capsys: pytest.CaptureFixture[str]) -> None:
    for parameter in ("medium=constant", "sigma_t=0"):
        found = table(capsys, DRAGON, "-D", parameter)
        answer = "none (and 1 in which nothing collides)"
        assert found["media"] == (answer, "skipped: flights, phase functions, albedo")
        assert found["connections through smooth glass"][0] == "out of lobe"  # the dragon is inside


def test_colour_and_null_surfaces(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "fog.xml"
    path.write_text(
        """<scene version="3.9.0"><integrator type="nonexp_volpath"/><sensor type="perspective"/>
        <shape type="sphere"><bsdf type="null"/>
            <medium type="nonexp_homogeneous" name="interior">
                <rgb name="sigma_t" value="3, 2, 1"/></medium>
        </shape>
        <emitter type="point"><point name="position" x="0" y="3" z="0"/></emitter>
        </scene>""",
        encoding="utf-8",
    )
    found = table(capsys, str(path))
    assert found["extinction"][0] == "differs between channels"
    assert "sigma_t 1 to 3" in found["medium 1"][0]
    assert found["surfaces that let rays straight through"][0] == "one sphere"
    assert found["emitters"] == ("PointLight", "skipped: emission hit by rays, light from infinity")
    assert found["connections to emitters"] == ("from collisions", "shadow rays")


def test_a_foreign_integrator_is_warned_of(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["info", DRAGON, "-D", "integrator=volpath"]) == 0
    captured = capsys.readouterr()
    assert "The scene's own integrator is volpath." in captured.out
    assert "shows its exponential counterpart" in captured.err


def test_a_missing_scene_is_one_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["info", "nowhere.xml"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_a_medium_with_memory(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "mixture.xml"
    path.write_text(
        """<scene version="3.9.0"><integrator type="nonexp_volpath"/><sensor type="perspective"/>
        <shape type="sphere"><bsdf type="null"/>
            <medium type="nonexp_binary_mixture" name="interior" id="sponge">
                <string name="sigma_t" value="6, 0.5"/><string name="chord" value="0.3, 0.7"/>
            </medium>
        </shape></scene>""",
        encoding="utf-8",
    )
    found = table(capsys, str(path))
    assert found["medium 1"][0] == (
        "sponge: two materials with memory, sigma_t 6 and 0.5, chords 0.3 and 0.7, "
        "IsotropicPhaseFunction"
    )
    assert found["media with memory"] == ("sponge", "paths carry their material")
    found = table(capsys, DRAGON, "-D", "medium=gamma")
    assert found["media with memory"] == ("none", "skipped: the material that a path is in")
