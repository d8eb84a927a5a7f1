"""Scenes fitted to images: what fits recover, what they claim to know, what they say and refuse."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from build import FURNACE, ball, medium, orthographic, perspective, scene, square_film
from scipy import stats
from tiers import THOROUGH, thorough

import nonexp
from nonexp import cli, inverse, models
from nonexp.images import exr
from nonexp.inverse.equations import Images
from nonexp.inverse.laws import Place
from nonexp.inverse.unknowns import find, starts_of, write
from nonexp.inverse.views import views

SIGMA = "ball.interior_medium.sigma_t.value.value"
TRUTH = {"sigma_t": 3.0, "alpha": 0.5}
CHANCE = 1e-4
"""Of failing where all is right, for each statistical test."""
WALL = {
    "type": "rectangle",
    "to_world": mi.ScalarTransform4f().translate([0, 0, -2]).scale(4),
    "emitter": {
        "type": "area",
        "radiance": {
            "type": "checkerboard",
            "color0": 0.1,
            "color1": 1.0,
            "to_uv": mi.ScalarTransform4f().scale(4),
        },
    },
}


def pictured(inside: dict[str, Any], size: int = 16, **more: Any) -> Any:
    """A ball of a medium before a chequered wall, under a dim sky."""
    camera = perspective([0, 0, 4], [0, 0, 0], 32) | {"film": square_film(size)}
    sky = {"type": "constant", "radiance": 0.2}
    parts = {"sensor": camera, "ball": ball(inside), "wall": WALL, "sky": sky, **more}
    return scene({"type": "nonexp_volpath", "max_depth": 8}, **parts)


def gamma(alpha: float = 0.5, **kw: Any) -> dict[str, Any]:
    return medium("gamma", {"alpha": alpha}, **{"sigma_t": 3.0, "albedo": 0.5, **kw})


def photograph(of: Any, spp: int, seed: int = 1000, sensor: int = 0) -> Any:
    return np.array(mi.render(of, spp=spp, seed=seed, sensor=sensor))


def state(of: Any) -> str:
    parameters = mi.traverse(of)
    return str([(key, str(parameters[key])) for key in sorted(parameters.keys())])


# ---------------------------------------------------------------------- what is recovered


@THOROUGH
def test_one_image_tells_the_law_and_its_parameters(effort: int) -> None:
    size, start = (24, 1.0) if effort == 1 else (64, 4.0)
    photo = nonexp.render(pictured(gamma(), size), spp=1024 * effort, pass_spp=64, seed=9)
    made = pictured(medium(sigma_t=1.0, albedo=0.5), size)
    before = state(made)
    laws = {"exponential": {}, "gamma": {"alpha": start}}
    first = {"sigma_t": 2.0 if effort == 1 else 1.0}
    report = inverse.fit(made, first, photo, laws=laws, spp=256 * effort)
    assert state(made) == before, "the scene is not what it was"
    assert report.best.law == "gamma"
    for name, true in TRUTH.items():
        error = report.best.errors[name]
        assert abs(report.best.values[name] - true) < 4.5 * error, report
        assert error < (0.1 if effort == 1 else 0.02) * true, report
    ratio, least = report.ratio("exponential")
    assert ratio > 10 and least, report
    assert abs(report.best.loss) < 4 * report.best.loss_error
    assert all(one.converged for one in report.fits)
    assert set(report.best.ways.values()) == {"replay"}
    report.best.apply(made)
    parameters = mi.traverse(made)
    assert parameters[SIGMA][0] == pytest.approx(report.best.values["sigma_t"])
    alpha = parameters["ball.interior_medium.transmittance.alpha"][0]
    assert alpha == pytest.approx(report.best.values["alpha"])
    _check_shown(report)


def _check_shown(report: inverse.Report) -> None:
    lines = str(report).splitlines()
    assert re.match(r"fitted to 1 image of \d+x\d+ pixels$", lines[0])
    assert re.match(r"law +loss +by the best +parameters$", lines[1])
    assert re.match(r"gamma +-?\S+ ± \S+ +sigma_t = \S+ ± \S+, alpha = \S+ ± \S+$", lines[2])
    assert re.match(r"exponential +\S+ ± \S+ +> \S+ +sigma_t = \S+ ± \S+$", lines[3])
    assert "<table>" in report._repr_html_()
    told = json.loads(json.dumps(report.to_dict(), allow_nan=False))
    assert [one["law"] for one in told["fits"]] == ["gamma", "exponential"]
    assert told["fits"][0]["transmittance"]["type"] == "transmittance_gamma"
    titles = [axes.get_title() for axes in report.plot().axes]
    assert titles[:3] == ["image", "gamma", "exponential"]


@THOROUGH
def test_errors_are_what_estimates_scatter_by(effort: int) -> None:
    """Fits to images with noise of their own: errors off by a factor 1.7 would be found."""
    made, count = pictured(gamma()), 20 * effort
    true = np.array([3.0, 0.5])
    squares, found = 0.0, []
    for seed in range(count):
        photo = photograph(made, 128, 1000 + seed)
        one = inverse.fit(made, ["sigma_t", "albedo"], photo, spp=64, seed=seed).best
        off = np.array(list(one.values.values())) - true
        squares += off @ np.linalg.solve(one.covariance, off)
        found.append(off / np.array(list(one.errors.values())))
    low, high = stats.chi2.ppf([CHANCE / 2, 1 - CHANCE / 2], 2 * count)
    assert low < squares < high
    bias = np.mean(found, axis=0) * math.sqrt(count)
    assert np.all(np.abs(bias) < stats.norm.isf(CHANCE / 4)), bias


def test_noise_of_the_render_is_in_no_loss() -> None:
    """At the truth the loss of a noisy render is 0; the square of its noise is not."""
    made = pictured(gamma())
    seen = views(made, photograph(made, 4096), None, None)
    unknowns = starts_of(mi.traverse(made), {"sigma_t": 3.0}, {})
    images = Images(made, seen, unknowns, lambda at: None, False)
    random = np.random.default_rng(1)
    seed = lambda: int(random.integers(2**31))  # noqa: E731
    at = np.array([one.coordinate(one.start) for one in unknowns])
    fitted = [images.at(at, 8, seed) for _ in range(8)]
    loss = np.array([one.loss for one in fitted])
    error = math.sqrt(sum(one.error**2 for one in fitted)) / 8
    noise = np.mean([(one.mean(0) - seen[0].image) ** 2 for one in fitted])
    assert abs(loss.mean()) < 4.5 * error
    assert error < noise / 10
    assert 0.5 < loss.std(ddof=1) / fitted[0].error < 2


@THOROUGH
def test_laws_with_atoms_are_fitted_by_differences() -> None:
    photo = photograph(pictured(medium("linear", sigma_t=1.5, albedo=0.6)), 1024)
    made = pictured(medium("exponential", sigma_t=1.0, albedo=0.6))
    report = inverse.fit(made, {"sigma_t": 1.0}, photo, laws=["linear", "exponential"], spp=512)
    one = report["linear"]
    assert one.ways == {"sigma_t": "differences"} and report.best is one
    assert abs(one.values["sigma_t"] - 1.5) < 4.5 * one.errors["sigma_t"] < 0.3
    assert one.model is not None and float(one.model.sigma_bar) == 1


@THOROUGH
def test_several_views_colours_exposures_and_masks() -> None:
    albedo = {"type": "rgb", "value": [0.9, 0.5, 0.2]}
    side = perspective([4, 0, 0], [0, 0, 0], 32) | {"film": square_film(16)}
    lamp = {"type": "directional", "direction": [0, 0, -1], "irradiance": 2.0}
    more = {"side": side, "lamp": lamp}
    truth = pictured(gamma(albedo=albedo), **more)
    photos = [photograph(truth, 512, sensor=i) * (1 + i) for i in range(2)]
    photos[0][:4] = np.nan
    mask = np.ones((16, 16))
    mask[:4] = 0
    made = pictured(gamma(albedo={"type": "rgb", "value": [0.5, 0.5, 0.5]}), **more)
    weights = [mask, np.ones((16, 16))]
    report = inverse.fit(made, "albedo", photos, exposure="free", weights=weights, spp=128)
    one = report.best
    names = ["albedo[0]", "albedo[1]", "albedo[2]", "exposure[0]", "exposure[1]"]
    assert list(one.values) == names
    off = np.array(list(one.values.values())) - [0.9, 0.5, 0.2, 1.0, 2.0]
    errors = np.array(list(one.errors.values()))
    assert np.all(np.abs(off) < 4.5 * errors), report
    assert np.all(errors < [0.1, 0.1, 0.1, 0.05, 0.1]), report
    assert one.exposures == pytest.approx(tuple(one.values.values())[-2:])


@THOROUGH
def test_a_grid_is_found_by_gradient_descent() -> None:
    """Smoke before a bright sky: voxels that are full, and those that are empty."""
    full = np.zeros((4, 4, 4), np.float32)
    full[1:3, 1:3, :2] = 1
    place = mi.ScalarTransform4f().translate(-1).scale(2)

    def smoke(values: Any) -> Any:
        grid = {"type": "gridvolume", "grid": mi.VolumeGrid(values), "to_world": place}
        inside = gamma(alpha=1.0, albedo=0.3, sigma_t=grid, scale=2.0)
        film = square_film() | {"width": 32}
        sides = {
            f"view_{i}": orthographic(side=side) for i, side in enumerate(((0, 0, 1), (1, 0, 0)))
        }
        for one in sides.values():
            del one["film"]
        box = {
            "type": "cube",
            "bsdf": {"type": "null"},
            "interior": inside | {"type": "nonexp_heterogeneous"},
        }
        sensor = {"type": "batch", "film": film | {"width": 16, "height": 8}, **sides}
        return scene(
            {"type": "nonexp_volpath", "max_depth": 4}, sensor=sensor, box=box, sky=FURNACE
        )

    photo = photograph(smoke(full), 512)
    made = smoke(np.full_like(full, 0.2))
    before = state(made)
    found = inverse.descend(made, "sigma_t.data", photo, iterations=20, rate=0.5, spp=32)
    assert state(made) == before
    (values,) = found.values.values()
    assert values.shape == (4, 4, 4, 1) and values.min() >= 0
    assert found.losses[-5:].mean() < 0.1 * found.losses[0]
    assert values[..., 0][full == 1].mean() > 3 * values[..., 0][full == 0].mean()
    found.apply(made)
    assert np.allclose(np.array(mi.traverse(made)["box.interior_medium.sigma_t.data"]), values)
    assert len(found.plot().axes) == 1


# ---------------------------------------------------------------------- what is said


@THOROUGH
def test_what_sits_at_a_limit_has_no_error() -> None:
    photo = photograph(pictured(gamma(albedo=0.9)), 256)
    made = pictured(gamma(albedo=0.3))
    one = inverse.fit(made, "albedo", photo, bounds={"albedo": (0.0, 0.6)}, spp=64).best
    assert one.values["albedo"] == pytest.approx(0.6)
    assert math.isnan(one.errors["albedo"])
    assert "albedo is at the limit of its range, 0.6." in one.notes
    assert "(at its limit)" in str(one)


@THOROUGH
@pytest.mark.parametrize(
    ("names", "inside", "note"),
    [
        (["sigma_t", "scale"], gamma(), "sigma_t and scale cannot be told apart"),
        (["g"], gamma(albedo=0.0, phase={"type": "hg", "g": 0.2}), "g is not determined"),
    ],
)
def test_what_images_do_not_determine(names: list[str], inside: Any, note: str) -> None:
    made = pictured(inside, 8)
    one = inverse.fit(made, names, photograph(made, 256), spp=32).best
    assert any(text.startswith(note) for text in one.notes), one.notes
    assert all(math.isinf(one.errors[name]) for name in names)


@THOROUGH
def test_searches_that_are_too_short_say_so() -> None:
    made = pictured(gamma(sigma_t=0.1), 8)
    one = inverse.fit(made, "sigma_t", photograph(pictured(gamma(), 8), 256), steps=1, spp=64).best
    assert not one.converged
    assert re.match(
        r"The search did not converge in \d steps: the last moved sigma_t from", one.notes[-1]
    )


@THOROUGH
def test_laws_that_fit_equally_well() -> None:
    made = pictured(medium(sigma_t=1.0, albedo=0.5), 8)
    photo = photograph(made, 256)
    laws = [models.create("erlang", k=1), "exponential", "constant"]
    report = inverse.fit(made, "sigma_t", photo, laws=laws, spp=64)
    assert "cannot be told apart: their losses differ by less than two standard errors" in str(
        report
    )
    assert report["constant"].errors["sigma_t"] == math.inf


def test_numbers_that_only_repeat_others_are_held() -> None:
    """Weights count by their ratios; a length of the law repeats the extinction."""
    made = pictured(medium(sigma_t=1.0), 8)
    place = Place(made)
    sigma = starts_of(mi.traverse(made), {"sigma_t": None}, {})
    expected: dict[str, tuple[list[str], list[str]]] = {
        "gamma": (["alpha"], ["alpha"]),
        "erlang": ([], ["rate"]),
        "exponential_mixture": (["sigma[0]", "weight[1]"], ["sigma[0]", "sigma[1]", "weight[1]"]),
        "pulse": (["a"], ["a", "b"]),
    }
    for key, (with_sigma, alone) in expected.items():
        with place.kept():
            place.put(models.create(key))
            assert [one.label for one in place.unknowns((), {}, sigma)] == with_sigma, key
            assert [one.label for one in place.unknowns((), {}, ())] == alone, key
            names = {name.partition("[")[0] for name in alone}
            assert place.unknowns(names, {}, ()) == []
    assert place.key == "exponential"


def test_coordinates_stay_where_numbers_may_lie() -> None:
    made = pictured(gamma(), 8)
    parameters = mi.traverse(made)
    bounds = {"albedo": (0.1, 0.9)}
    found = starts_of(parameters, {"sigma_t": 2.0, "albedo": 0.5, "x_fov": 30.0}, bounds)
    sigma, albedo, fov = found
    assert sigma.logarithmic and albedo.logarithmic and not fov.logarithmic
    assert fov.limits == (-math.inf, math.inf)
    for one in found:
        u = one.coordinate(one.start)
        assert one.value(u) == pytest.approx(one.start)
        slope = (one.value(u + 1e-6) - one.value(u - 1e-6)) / 2e-6
        assert one.slope(u) == pytest.approx(slope, rel=1e-6)
        assert one.limits[0] < u < one.limits[1]
    assert [albedo.value(u) for u in albedo.limits] == pytest.approx([0.1, 0.9])
    write(parameters, found, [1.5, 0.25, 20.0])
    assert parameters[SIGMA][0] == 1.5 and parameters["sensor.x_fov"][0] == 20.0
    assert find(parameters, "sigma_t") == (SIGMA, None)
    (single,) = starts_of(parameters, {"sigma_t[0]": 1.0}, {})
    assert single.label == "sigma_t[0]"


# ---------------------------------------------------------------------- what is refused

IMAGE = np.ones((8, 8, 3))
REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "name": ({"parameters": "sigma"}, "the scene has no parameter 'sigma'"),
    "names": ({"parameters": "value"}, "'value' is a part of several parameters' names"),
    "item": ({"parameters": "sigma_t[1]"}, "has fewer numbers"),
    "twice": ({"parameters": ["sigma_t", SIGMA]}, "is given twice"),
    "kind": ({"parameters": "film.size"}, "only real numbers can be fitted"),
    "start": ({"parameters": {"albedo": 1.5}}, r"albedo starts at 1.5: it must be in \[0, 1\]"),
    "starts": ({"parameters": {"albedo": [1, 0]}}, "it must be one number, or 1"),
    "bounds": ({"bounds": {"sigma_t": (2, 1)}}, "bounds of sigma_t are 2 and 1"),
    "bounded": ({"bounds": {"beta": (0, 1)}}, "bounds has 'beta', which is not fitted"),
    "nothing": ({"parameters": []}, "there is nothing to fit"),
    "images": ({"images": []}, "images is empty"),
    "size": ({"images": np.ones((4, 8, 3))}, "image 0 is 8x4: it must be 8x8"),
    "shape": ({"images": np.ones((8, 8, 2))}, r"image 0 has the shape \(8, 8, 2\)"),
    "finite": ({"images": np.full((8, 8, 3), np.nan)}, "64 pixels that are not finite"),
    "file": ({"images": "gone.exr"}, "image 'gone.exr' does not exist"),
    "sensors": ({"images": [IMAGE, IMAGE]}, "sensor is 1: it must be one of the scene's"),
    "sensor": ({"sensors": [0, 0]}, "there are 1 images and 2 sensors"),
    "weights": ({"weights": np.zeros((8, 8))}, "the weights of image 0 must be finite"),
    "law": ({"laws": ["gama"]}, "law is 'gama': it must be one of"),
    "laws": ({"laws": []}, "laws is empty"),
    "law start": ({"laws": {"gamma": {"alpha": 0}}}, "Gamma.alpha is 0"),
    "law's": ({"parameters": "alpha", "laws": "gamma"}, "alpha belongs to the law: give it in"),
    "fixed": ({"laws": "gamma", "fixed": {"b": 1}}, "none of the laws has a parameter 'b'"),
    "medium": ({"laws": "gamma", "medium": "fog"}, "medium is 'fog': it must be one of ball.int"),
    "exposure": ({"exposure": "auto"}, "exposure is 'auto'"),
    "spp": ({"spp": 2}, "spp is 2: it must be a whole number >= 4"),
    "steps": ({"steps": 0}, "steps is 0"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_fitted(case: str) -> None:
    made = pictured(gamma(), 8)
    before = state(made)
    given, message = REFUSED[case]
    with pytest.raises((ValueError, KeyError), match=message):
        inverse.fit(**{"scene": made, "parameters": "sigma_t", "images": IMAGE, **given})
    assert state(made) == before


def test_scenes_that_cannot_be_fitted() -> None:
    other = ball(gamma(alpha=2.0), radius=0.2) | {"center": [0, 1.5, 0]}
    two = pictured(gamma(), 8, other=other)
    with pytest.raises(ValueError, match=r"several media: medium must be one of ball.* other"):
        inverse.fit(two, [], IMAGE, laws="gamma")
    grid = {"type": "gridvolume", "grid": mi.VolumeGrid(np.ones((5, 5, 5), np.float32))}
    foggy = gamma(sigma_t=grid) | {"type": "nonexp_heterogeneous"}
    made = pictured(foggy, 8)
    with pytest.raises(ValueError, match=r"125 numbers: fit takes up to 64.*inverse\.descend"):
        inverse.fit(made, "sigma_t", IMAGE)
    for given, message in {
        "rate": ({"rate": -1}, "rate is -1"),
        "item": ({"parameters": "sigma_t[0]"}, "descend takes whole parameters"),
        "start": ({"parameters": {"sigma_t": [1, 2]}}, "start has the shape"),
        "kind": ({"parameters": "film.size"}, "only real numbers can"),
    }.values():
        with pytest.raises(ValueError, match=message):
            inverse.descend(**{"scene": made, "parameters": "sigma_t", "images": IMAGE, **given})
    stock = scene("volpath", sensor=orthographic(), ball=ball(gamma()), sky=FURNACE)
    with pytest.raises(ValueError, match="descend needs nonexp_volpath"):
        inverse.descend(stock, "sigma_t", IMAGE)


# ---------------------------------------------------------------------- the command line

XML = """
<scene version="3.0.0">
    <default name="albedo" value="0.5"/>
    <integrator type="nonexp_volpath"><integer name="max_depth" value="6"/></integrator>
    <sensor type="orthographic">
        <transform name="to_world"><lookat origin="0,0,4" target="0,0,0" up="0,1,0"/></transform>
        <film type="hdrfilm"><rfilter type="box"/></film>
    </sensor>
    <emitter type="constant"/>
    <shape type="sphere">
        <bsdf type="null"/>
        <medium type="nonexp_homogeneous" name="interior">
            <float name="sigma_t" value="2"/><float name="albedo" value="$albedo"/>
        </medium>
    </shape>
</scene>
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a scene and its photograph."""
    (tmp_path / "scene.xml").write_text(XML)
    exr.write_exr(tmp_path / "photo.exr", {"": np.full((6, 8, 3), 0.6)}, {})
    exr.write_exr(tmp_path / "small.exr", {"": np.full((4, 4, 3), 0.6)}, {})
    (tmp_path / "other.json").write_text("{}")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@THOROUGH
def test_the_command_line(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    asked = ["render", "scene.xml", "--size", "12x10", "--spp", "256", "-o", "photo.exr"]
    assert cli.main([*asked, "--variant", "llvm_ad_rgb"]) == 0
    capsys.readouterr()
    asked = ["fit", "scene.xml", "--image", "photo.exr", "-p", "sigma_t=1", "-D", "albedo=0.5"]
    asked += ["--model", "gamma", "--model", "exponential", "--start", "alpha=1", "--spp", "64"]
    assert cli.main([*asked, "--variant", "llvm_ad_rgb", "-o", "fit.svg"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert out.endswith("\nfit.svg\nfit.json\n")
    assert re.search(r"^law +loss +by the best +parameters", out)
    assert '<texture type="transmittance_' in out
    told = json.loads((folder / "fit.json").read_text())
    assert {one["law"] for one in told["fits"]} == {"gamma", "exponential"}
    assert told["images"] == ["photo.exr"] and told["parameters"] == {"albedo": "0.5"}
    (exponential,) = (one for one in told["fits"] if one["law"] == "exponential")
    value, error = (exponential[name]["sigma_t"] for name in ("values", "errors"))
    assert abs(value - 2) < 4.5 * error < 1
    assert (folder / "fit.svg").read_text().startswith("<?xml")


COMMANDS: dict[str, tuple[list[str], str]] = {
    "name": (["-p", "sigma"], "the scene has no parameter 'sigma'"),
    "nothing": ([], "there is nothing to fit"),
    "start": (["-p", "sigma_t=x"], "-p is 'sigma_t=x': it must be NAME or NAME=START"),
    "image": (["-p", "sigma_t", "--image", "gone.exr"], "image 'gone.exr' does not exist"),
    "sizes": (["-p", "sigma_t", "--image", "small.exr"], "differ in size: photo.exr is 8x6, small"),
    "results": (["-p", "sigma_t", "-o", "other.png"], "'other.json' exists and is no result"),
    "output": (["-p", "sigma_t", "-o", "fit.exr"], "output is 'fit.exr': it must end in .png"),
    "model": (["-p", "sigma_t", "--model", "gama"], "model is 'gama': it must be one of"),
    "parameter": (
        ["--model", "gamma", "--start", "b=1"],
        "none of the models to fit has a parameter 'b'",
    ),
    "own law": (["-p", "sigma_t", "--fix", "alpha=1"], "--fix is for the parameters of a --model"),
    "sigma_t": (["--sigma-t", "2"], "--sigma-t goes with a table"),
    "definition": (["-D", "beta=1"], "has no parameter 'beta'"),
}


@pytest.mark.parametrize("case", [*thorough(*COMMANDS)])
def test_errors_on_the_command_line_are_one_sentence(
    folder: Path, capsys: pytest.CaptureFixture[str], case: str
) -> None:
    before = sorted(folder.rglob("*"))
    options, message = COMMANDS[case]
    code = cli.main(["fit", "scene.xml", "--image", "photo.exr", *options])
    out, err = capsys.readouterr()
    assert (code, out) == (2, "")
    assert err.startswith("nonexp: error: ") and err.count("\n") == 1
    assert re.search(message, err), err
    assert sorted(folder.rglob("*")) == before


def test_options_for_images_need_images(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for option in ("--parameter", "--medium", "--spp", "-D"):
        value = {"--spp": "8", "-D": "a=1"}.get(option, "sigma_t")
        assert cli.main(["fit", "data.csv", option, value]) == 2
        assert re.search(rf"{option} goes with --image", capsys.readouterr().err)
