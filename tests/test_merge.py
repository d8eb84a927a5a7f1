"""Merging renders with different seeds, and comparing images."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
from tiers import THOROUGH

from nonexp import cli
from nonexp.images import compare as comparing
from nonexp.images import merge as merging
from nonexp.images import read
from nonexp.images.exr import Picture, write_exr
from nonexp.images.moments import Array, Moments

IDENTITY = {"files": {"a.xml": "1"}, "size": [12, 10], "versions": {"mitsuba": "3.9.1"}}


def picture(images: Any, seed: int = 0, pass_spp: int = 4, **metadata: Any) -> Picture:
    """What ``nonexp render`` would have written of these passes, but in double precision."""
    moments = Moments()
    for image in images:
        moments = moments.plus(image)
    values = {
        "spp": pass_spp * moments.passes,
        "passes": moments.passes,
        "seed": seed,
        "seconds": 2.0,
        "identity": json.dumps(IDENTITY),
        **metadata,
    }
    return Picture(Path(f"{seed}.exr"), moments.mean, moments.stderr, values)


def noise(seed: int, passes: int, pass_spp: int = 4, shape: Any = (10, 12, 3)) -> Array:
    """Passes of an image of brightness 2; pixels differ in noise, which falls with pass_spp."""
    rng = np.random.default_rng(seed)
    sigma = np.linspace(0.5, 1.5, shape[1])[None, :, None]
    return 2 + sigma / np.sqrt(pass_spp) * rng.normal(size=(passes, *shape))


# --------------------------------------------------------------------- merge


def test_parts_make_the_whole() -> None:
    passes = noise(1, 31)
    parts = (passes[:9], passes[9:10], passes[10:])
    image, metadata = merging.merge([picture(p, seed) for seed, p in enumerate(parts)])
    whole = picture(passes)
    np.testing.assert_allclose(image.mean, whole.mean, rtol=1e-13)
    np.testing.assert_allclose(image.stderr, whole.stderr, rtol=1e-12)
    assert (image.spp, image.passes, image.seconds) == (124, 31, 6.0)
    assert (metadata["spp"], metadata["passes"], metadata["seeds"]) == (124, 31, "[0, 1, 2]")


def test_merging_in_steps_is_merging_at_once() -> None:
    a, b, c = (picture(noise(seed, 8 + seed), seed) for seed in (1, 2, 3))
    image, metadata = merging.merge([a, b])
    step = Picture(Path("ab.exr"), image.mean, image.stderr, metadata)
    twice, _ = merging.merge([step, c])
    once, _ = merging.merge([a, b, c])
    np.testing.assert_allclose(twice.mean, once.mean, rtol=1e-13)
    np.testing.assert_allclose(twice.stderr, once.stderr, rtol=1e-12)


def test_the_variance_is_right_whatever_the_parts() -> None:
    """Parts of 9 passes of 4 samples and of 20 passes of 16; 200 merged images of 120 pixels.

    The pooled ratio of variances has a relative deviation of sqrt(2/200/360) = 0.5 %, times about
    1.2 for the pixels' different noise.
    """
    merged = [
        merging.merge([picture(noise(2 * i, 9, 4), 0, 4), picture(noise(2 * i + 1, 20, 16), 1, 16)])
        for i in range(200)
    ]
    spread = np.mean([(image.mean - 2) ** 2 for image, _ in merged], axis=0)
    claimed = np.mean([image.stderr**2 for image, _ in merged], axis=0)
    assert (spread / claimed).mean() == pytest.approx(1, abs=0.03)
    sigma = np.linspace(0.5, 1.5, 12)[None, :, None]
    expected = np.broadcast_to(sigma**2 / (9 * 4 + 20 * 16), (10, 12, 3))
    assert (spread / expected).mean() == pytest.approx(1, abs=0.03)  # the best weights


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"seed": 1}, r"1\.exr and 1\.exr both hold seed 1"),
        ({"seeds": "[7, 1]"}, "both hold seed 1"),
        ({"identity": json.dumps({**IDENTITY, "size": [6, 5]})}, "size was 12x10, is 6x5"),
        (
            {"identity": json.dumps({**IDENTITY, "files": {"a.xml": "2"}})},
            r"1\.exr and 2\.exr are not of one scene: file a\.xml has changed",
        ),
        (
            {"identity": json.dumps({**IDENTITY, "versions": {"mitsuba": "3.10"}})},
            r"version mitsuba was 3\.9\.1, is 3\.10",
        ),
    ],
)
def test_what_cannot_be_merged_is_refused(change: dict[str, Any], message: str) -> None:
    other = picture(noise(2, 8), **{"seed": 2, **change})
    with pytest.raises(ValueError, match=message):
        merging.merge([picture(noise(1, 8), 1), other])


def test_foreign_images_are_refused() -> None:
    ours, foreign = picture(noise(1, 8), 1), picture(noise(2, 8), 2)
    del foreign.metadata["identity"]
    with pytest.raises(ValueError, match=r"2\.exr is not an image of nonexp render: .*identity"):
        merging.merge([ours, foreign])
    with pytest.raises(ValueError, match="there is one image"):
        merging.merge([ours])


# --------------------------------------------------------------------- compare

SHAPE = (48, 64, 3)


def test_images_without_noise_are_compared_exactly() -> None:
    a = picture([np.full((360, 480, 3), 1.0)] * 8)
    b = picture([np.full((360, 480, 3), 1.1)] * 8, seed=1)
    for other, differ in ((a, False), (b, True)):
        test = comparing.compare(a, other).test
        assert test is not None
        assert (test.worst > test.limit) == differ


@THOROUGH
def test_noise_alone_is_seldom_called_a_difference() -> None:
    """300 pairs of equal images, of 8 and of 20 passes, with 1 % false alarms claimed.

    More than 9 false alarms have a probability of 1e-3. The mean of the squared deviations is 1 if
    the standard errors are used rightly; it is off by 10 % for dividing by n in them.
    """
    alarms, chi2 = 0, []
    for i in range(300):
        a, b = picture(noise(2 * i, 8, 4, SHAPE), 1), picture(noise(2 * i + 1, 20, 4, SHAPE), 2)
        found = comparing.compare(a, b)
        assert found.test is not None
        alarms += not found.test.same
        chi2.append(found.test.chi2)
        assert found.noise is not None
        assert found.mse == pytest.approx(found.noise, rel=0.1)
    assert alarms <= 9
    assert np.mean(chi2) == pytest.approx(1, abs=0.03)


@pytest.mark.parametrize("where", ["everywhere", "in one block"])
def test_a_planted_bias_is_found(where: str) -> None:
    """1.5 % everywhere, or 30 % in one block: found in all of 20 pairs, and nothing of a third."""
    for i in range(20):
        changed = noise(2 * i, 8, 4, SHAPE)
        if where == "everywhere":
            changed *= 1.015
        else:
            changed[:, 8:16, 40:48] *= 1.3
        a, b = picture(changed, 1), picture(noise(2 * i + 1, 8, 4, SHAPE), 2)
        found = comparing.compare(a, b)
        assert found.test is not None and not found.test.same
        if where == "everywhere":
            assert found.bias == pytest.approx(0.015, abs=0.006)
            assert found.test.seen < 0.015
        else:
            assert found.test.place == (44, 12)


def test_equal_images_have_no_difference() -> None:
    a = picture(noise(1, 8), 1)
    found = comparing.compare(a, a)
    assert (found.mse, found.rel_mse, found.bias) == (0, 0, 0)
    assert found.test is not None and found.test.same and found.test.worst == 0


def test_without_standard_errors_there_is_no_verdict() -> None:
    a, b = picture(noise(1, 8), 1), picture(noise(2, 1), 2)
    found = comparing.compare(a, b)
    assert found.test is None and found.noise is None
    assert found.mse > 0


def test_sizes_must_agree() -> None:
    with pytest.raises(ValueError, match=r"1\.exr is 12x10 and 2\.exr is 64x48 pixels"):
        comparing.compare(picture(noise(1, 8), 1), picture(noise(2, 8, 4, SHAPE), 2))


def test_the_difference_picture_is_red_where_a_is_brighter() -> None:
    a, b = picture(noise(1, 8), 1), picture(noise(2, 8), 2)
    a.mean[0, 0], b.mean[9, 11] = 100, 100
    colours, scale = comparing.picture(a, b)
    assert colours.shape == (10, 12, 3)
    assert colours[0, 0] == pytest.approx([0.70, 0.09, 0.17])
    assert colours[9, 11] == pytest.approx([0.13, 0.40, 0.67])
    assert scale == pytest.approx(3 * np.sqrt(np.mean(a.stderr**2 + b.stderr**2)))  # type: ignore[operator]
    equal, _ = comparing.picture(a, a)
    assert (equal == 1).all()


# --------------------------------------------------------------------- the commands

Command = Callable[..., tuple[int, str, str]]


@pytest.fixture
def command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Command:
    """Run a command line in a folder with the images a, b (seeds 1, 2) and c (brighter)."""
    monkeypatch.chdir(tmp_path)
    for name, seed, factor in (("a", 1, 1.0), ("b", 2, 1.0), ("c", 3, 1.1)):
        made = picture(factor * noise(seed, 16, 4, SHAPE), seed, filter="BoxFilter")
        assert made.stderr is not None
        layers = {"": made.mean, "stderr.": made.stderr}
        write_exr(Path(f"{name}.exr"), layers, made.metadata)
    Path("text.exr").write_text("text")

    def run(*arguments: str) -> tuple[int, str, str]:
        code = cli.main(arguments)
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return run


def test_merge_writes_one_image(command: Command) -> None:
    code, out, err = command("merge", "a.exr", "b.exr", "-o", "ab.exr")
    assert (code, err) == (0, "")
    assert out.startswith("ab.exr: 128 samples per pixel in 32 passes of 2 images, error ")
    assert Path("ab.png").is_file()
    merged = read(Path("ab.exr"))
    assert merged.metadata["seeds"] == "[1, 2]"
    expected = (read(Path("a.exr")).mean + read(Path("b.exr")).mean) / 2
    np.testing.assert_allclose(merged.mean, expected, rtol=1e-6)
    assert command("merge", "ab.exr", "b.exr", "-o", "abb.exr")[0] == 2
    assert not Path("abb.exr").exists()


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (("a.exr", "b.exr"), 0, "The images differ by noise alone, as far as can be seen: a bias"),
        (("a.exr", "c.exr"), 1, "The images differ by more than noise, over the whole image."),
        (("a.exr", "a.exr"), 0, "to be doubted: both images hold seed 1"),
        (("a.exr", "b.exr", "-o", "d.png"), 0, "d.png: full colour is a difference of 0."),
    ],
)
def test_compare_gives_a_verdict(
    command: Command, arguments: tuple[str, ...], code: int, said: str
) -> None:
    found, out, err = command("compare", *arguments)
    assert (found, err) == (code, "")
    assert said in out
    assert "mean squared error" in out and "\x1b" not in out


def test_compare_writes_the_difference_as_numbers(command: Command) -> None:
    assert command("compare", "a.exr", "b.exr", "-o", "d.exr")[0] == 0
    a, b, d = (read(Path(f"{name}.exr")) for name in "abd")
    np.testing.assert_allclose(d.mean, a.mean - b.mean, atol=1e-6)
    np.testing.assert_allclose(d.stderr, np.hypot(a.stderr, b.stderr), rtol=1e-6)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("compare", "a.exr", "gone.exr"), "image 'gone.exr' does not exist"),
        (("compare", "a.exr", "text.exr"), "image 'text.exr' is not an EXR file, or is damaged"),
        (("compare", "a.exr", "b.exr", "-o", "d.jpg"), "output is 'd.jpg': it must end in .png or"),
        (("compare", "a.exr", "b.exr", "-o", "no/d.png"), "its folder 'no' does not exist"),
        (("merge", "a.exr", "-o", "x.exr"), "there is one image: merging takes two or more"),
        (("merge", "a.exr", "a.exr", "-o", "x.exr"), "a.exr and a.exr both hold seed 1"),
        (("merge", "a.exr", "b.exr", "-o", "x.jpg"), "output is 'x.jpg': it must be a file name"),
        (("merge", "-o", "x.exr"), "there are no images: merging takes two or more"),
    ],
)
def test_errors_are_one_sentence(
    command: Command, tmp_path: Path, arguments: tuple[str, ...], message: str
) -> None:
    before = sorted(tmp_path.iterdir())
    code, out, err = command(*arguments)
    assert (code, out) == (2, "")
    assert err.startswith("nonexp: error: ") and message in err
    assert err.count("\n") == 1
    assert sorted(tmp_path.iterdir()) == before


def test_channels_are_named_where_colour_is_missing(tmp_path: Path) -> None:
    path = tmp_path / "grey.exr"
    OpenEXR.File({}, {"Y": np.ones((2, 2), np.float32)}).write(str(path))
    with pytest.raises(ValueError, match=r"has no channels R, G and B \(but Y\)"):
        read(path)
