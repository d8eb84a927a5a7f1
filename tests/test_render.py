"""Rendering in passes: the plan, the seeds, the mean and its standard error."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from tiers import THOROUGH

import nonexp
from nonexp import rendering
from nonexp.images import tone_map
from nonexp.rendering import passes

pytestmark = pytest.mark.usefixtures("several_threads")


def scene(
    width: int = 16, height: int = 12, spp: int = 4, rfilter: str = "box", **film: Any
) -> mi.Scene:
    """A grey sphere under a light: noise in every pixel that it covers."""
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 3},
            "sensor": {
                "type": "perspective",
                "to_world": mi.ScalarTransform4f().look_at([0, 0, 3], [0, 0, 0], [0, 1, 0]),
                "fov": 30,
                "sampler": {"type": "independent", "sample_count": spp},
                "film": {
                    "type": "hdrfilm",
                    "width": width,
                    "height": height,
                    "rfilter": {"type": rfilter},
                    **film,
                },
            },
            "light": {
                "type": "sphere",
                "center": [2, 2, 2],
                "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [3, 2, 1]}},
            },
            "ball": {"type": "sphere"},
        }
    )


# --------------------------------------------------------------------- plan and seeds


@pytest.mark.parametrize(
    "pixels", [1, 12 * 16, 128 * 128, 300 * 200, 480 * 360, 1920 * 1080, 16384 * 16384]
)
@pytest.mark.parametrize("spp", [1, 7, 8, 20, 64, 100, 1000, 4096, 100_000])
def test_a_plan_rounds_up_by_less_than_a_pass_and_repeats_to_the_bit(spp: int, pixels: int) -> None:
    plan = rendering.plan(spp, pixels)
    assert plan.passes is not None and plan.spp is not None
    assert 0 <= plan.spp - spp < plan.pass_spp
    assert plan.passes >= min(spp, passes.MIN_PASSES)
    assert plan.pass_spp & (plan.pass_spp - 1) == 0
    samples = pixels * plan.pass_spp
    assert samples <= passes.MAX_PASS_SAMPLES or plan.pass_spp == 1
    # No two of 64 threads share a pixel: blocks of 2^14 samples, or two packets of 8 per pixel.
    assert (samples >= 2**15 * 64 and plan.pass_spp <= 2**14) or plan.pass_spp <= 2 * 8


@pytest.mark.parametrize(
    "pixels", [1, 12 * 16, 128 * 128, 300 * 200, 480 * 360, 1920 * 1080, 16384 * 16384]
)
def test_the_pass_size_without_spp_is_that_of_large_spp_and_repeats_to_the_bit(
    pixels: int,
) -> None:
    plan = rendering.plan(None, pixels)
    assert plan.passes is None and plan.spp is None
    assert plan.pass_spp <= 2 * 8
    if pixels > passes.MAX_PASS_SAMPLES / 32:
        assert plan.pass_spp == rendering.plan(1024, pixels).pass_spp
        assert plan.pass_spp == rendering.plan(4096, pixels).pass_spp


@pytest.mark.parametrize("spp", [0, -1])
def test_a_plan_for_no_samples_is_refused(spp: int) -> None:
    with pytest.raises(ValueError, match=f"spp is {spp}: it must be"):
        rendering.plan(spp, 100)


def test_no_two_passes_of_neighbouring_seeds_are_the_same() -> None:
    seeds = [rendering.pass_seed(seed, k) for seed in range(100) for k in range(64)]
    assert len(set(seeds)) == len(seeds)
    assert all(0 <= seed < 2**32 for seed in seeds)
    assert np.mean(seeds) == pytest.approx(2**31, rel=0.03)  # 4 sigma


def test_passes_of_neighbouring_seeds_are_different_images() -> None:
    target = scene()
    plan = rendering.Plan(passes=3, pass_spp=4)
    images = [
        p.tobytes() for seed in (0, 1, 2) for p in rendering.render_passes(target, plan, seed)
    ]
    assert len(set(images)) == 9


# --------------------------------------------------------------------- render


@pytest.mark.parametrize(("spp", "size"), [(8, (33, 17)), (200, (33, 17)), (24, (97, 61))])
def test_the_same_seed_gives_the_same_bits(spp: int, size: tuple[int, int]) -> None:
    target = scene(*size)
    first = nonexp.render(target, spp=spp, seed=3)
    for again in (target, target, scene(*size)):
        image = nonexp.render(again, spp=spp, seed=3)
        np.testing.assert_array_equal(image.mean, first.mean)
        np.testing.assert_array_equal(image.stderr, first.stderr)
    assert not np.array_equal(nonexp.render(target, spp=spp, seed=4).mean, first.mean)


def test_other_filters_repeat_to_rounding() -> None:
    target = scene(rfilter="gaussian")
    first, second = (nonexp.render(target, spp=32, seed=3).mean for _ in range(2))
    np.testing.assert_allclose(second, first, atol=1e-5)


def test_a_pass_launches_what_one_render_of_mitsuba_does(tmp_path: Path) -> None:
    ball = scene(spp=1)
    np.array(mi.render(ball, spp=2))

    def launches(render: Callable[[], Any]) -> int:
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
            dr.kernel_history_clear()
            render()
            return len(dr.kernel_history())

    once = launches(lambda: np.array(mi.render(ball, spp=2, seed=1)))
    file = tmp_path / "checkpoint"

    def passes(count: int, checkpoint: Path | None) -> int:
        arguments = {"spp": 2 * count, "pass_spp": 2, "checkpoint": checkpoint, "resume": False}
        return launches(lambda: nonexp.render(ball, **arguments))

    few, many = passes(1, file), passes(9, file)
    assert 1 < (many - few) / 8 <= once
    assert passes(9, None) <= 9 * once


def test_the_mean_is_the_mean_of_the_passes() -> None:
    target = scene()
    plan = rendering.planned(target, 20)
    seen: list[nonexp.Progress] = []
    image = nonexp.render(target, spp=20, seed=5, on_progress=seen.append)
    np.testing.assert_allclose(
        image.mean, np.mean(list(rendering.render_passes(target, plan, 5)), axis=0), rtol=1e-12
    )
    assert (image.spp, image.passes, image.seed) == (20, 10, 5)
    assert [p.done for p in seen] == list(range(1, 11))
    assert {p.passes for p in seen} == {10}
    assert 0 < seen[0].seconds <= seen[-1].seconds <= image.seconds


@THOROUGH
def test_stderr_is_the_spread_of_repeated_renders() -> None:
    """Mean square of stderr against the variance of 100 renders, over all pixels that have noise.

    With 8 passes the ratio has a relative deviation of about sqrt(2/99 + 2/(7*100)) = 15 % per
    pixel; pooled over more than 100 independent pixels, less than 1.5 %. The bound, 4 of these,
    would be broken by dividing by n instead of n - 1 (a factor of 8/7).
    """
    target = scene()
    images = [nonexp.render(target, spp=8, seed=seed) for seed in range(100)]
    spread = np.var([image.mean for image in images], axis=0, ddof=1)
    claimed = np.mean([image.stderr**2 for image in images], axis=0)
    assert np.count_nonzero(spread[:, :, 0]) > 100
    assert spread.sum() / claimed.sum() == pytest.approx(1, abs=0.06)


def test_the_default_is_the_sampler_of_the_scene_which_stays_as_it_was() -> None:
    target = scene(spp=24)
    assert nonexp.render(target).spp == 24
    assert nonexp.render(target, spp=9).spp == 9
    assert nonexp.render(target).spp == 24


def test_a_sampler_that_rounds_is_counted_as_it_samples() -> None:
    target = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "direct"},
            "sensor": {
                "type": "perspective",
                "sampler": {"type": "stratified", "sample_count": 16},
                "film": {"type": "hdrfilm", "width": 2, "height": 2},
            },
            "light": {"type": "constant"},
        }
    )
    image = nonexp.render(target, spp=64)
    assert (image.passes, image.spp) == (8, 72)  # 8 samples cannot be stratified, 9 can


@pytest.mark.parametrize("pixel_format", ["rgba", "xyz", "xyza", "luminance", "luminance_alpha"])
def test_only_colour_is_kept(pixel_format: str) -> None:
    mean = nonexp.render(scene(pixel_format=pixel_format), spp=8, seed=1).mean
    rgb = nonexp.render(scene(), spp=8, seed=1).mean
    luminance = rgb @ [0.212671, 0.715160, 0.072169]
    grey = pixel_format.startswith("luminance")
    expected = np.repeat(luminance[..., None], 3, axis=2) if grey else rgb
    np.testing.assert_allclose(mean, expected, rtol=1e-4, atol=1e-5)


def test_a_film_of_bands_is_refused() -> None:
    mi.set_variant("llvm_ad_spectral")
    band = {"type": "spectrum", "value": [(400, 1), (500, 1)]}
    film = {"type": "specfilm", "band": band, "width": 2, "height": 2}
    sensor = {"type": "perspective", "film": film}
    target = mi.load_dict({"type": "scene", "i": {"type": "path"}, "sensor": sensor})
    with pytest.raises(ValueError, match="the film is a specfilm: it must be an hdrfilm"):
        nonexp.render(target, spp=2)


def test_pixels_that_are_not_numbers_are_told() -> None:
    image = np.ones((4, 5, 3))
    image[1, 2, 0], image[0, 0] = np.inf, np.nan
    with pytest.warns(UserWarning, match="2 of 20 pixels are not finite numbers"):
        nonexp.render(scene(5, 4), spp=4, source=lambda *_: iter([image] * 4))


def test_channels_of_an_aov_integrator_are_dropped() -> None:
    target = scene()
    integrator = mi.load_dict(
        {"type": "aov", "aovs": "depth:depth", "image": {"type": "path", "max_depth": 3}}
    )
    plan = rendering.Plan(1, 4)
    (plain,) = rendering.render_passes(target, plan)
    (image,) = rendering.render_passes(target, plan, integrator=integrator)
    assert image.shape == plain.shape
    np.testing.assert_allclose(image, plain, rtol=1e-5)


@pytest.mark.parametrize("variant", ["llvm_ad_mono"], indirect=True)
def test_mono_images_are_grey(variant: str) -> None:
    mean = nonexp.render(scene(), spp=8).mean
    assert mean.max() > 0
    np.testing.assert_array_equal(mean[:, :, 0], mean[:, :, 1])
    np.testing.assert_array_equal(mean[:, :, 0], mean[:, :, 2])


def test_stopping_from_the_callback_leaves_the_scene_usable() -> None:
    def stop(progress: nonexp.Progress) -> None:
        raise KeyboardInterrupt

    target = scene(spp=24)
    with pytest.raises(KeyboardInterrupt):
        nonexp.render(target, spp=8, on_progress=stop)
    assert nonexp.render(target).spp == 24


def test_whole_numbers_of_numpy_are_understood() -> None:
    target, whole = scene(), np.int64
    image = nonexp.render(
        target, spp=whole(16), seed=np.uint8(3), pass_spp=whole(2), sensor=np.int32(0)
    )
    plain = nonexp.render(target, spp=16, seed=3, pass_spp=2)
    assert (image.spp, image.passes, image.seed) == (16, 8, 3)
    assert type(image.seed) is int
    np.testing.assert_array_equal(image.mean, plain.mean)
    assert rendering.plan(whole(64), 100) == rendering.plan(64, 100)
    assert rendering.planned(target, whole(64), sensor=whole(0)) == rendering.planned(target, 64)


def two_sensors() -> Any:
    film = {"type": "hdrfilm", "width": 4, "height": 4, "rfilter": {"type": "box"}}
    back = mi.ScalarTransform4f().look_at([0, 0, 3], [0, 0, 0], [0, 1, 0])
    light = {"type": "envmap", "bitmap": mi.Bitmap(np.linspace(0, 1, 96, dtype=np.float32).reshape(
        4, 8, 3))}  # fmt: skip
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path"},
            "light": light,
            "front": {"type": "perspective", "film": film},
            "back": {"type": "perspective", "film": film, "to_world": back},
        }
    )


def test_a_sensor_is_chosen_by_number_id_or_itself(tmp_path: Path) -> None:
    target = two_sensors()
    numbers = {one.id(): number for number, one in enumerate(target.sensors())}
    front, back = numbers["front"], numbers["back"]
    chosen = [nonexp.render(target, spp=8, sensor=one).mean for one in (back, "back", f"{back}")]
    chosen.append(nonexp.render(target, spp=8, sensor=target.sensors()[back]).mean)
    for mean in chosen[1:]:
        np.testing.assert_array_equal(mean, chosen[0])
    assert not np.allclose(nonexp.render(target, spp=8, sensor="front").mean, chosen[0])
    path = tmp_path / "checkpoint"
    nonexp.render(target, spp=8, sensor="front", checkpoint=path)
    with pytest.raises(ValueError, match=f"sensor was {front}, is {back}"):
        nonexp.render(target, spp=8, sensor="back", checkpoint=path)
    for wrong in ("top", 2, -1, 0.5, two_sensors().sensors()[0]):
        with pytest.raises(ValueError, match=r"sensor is .*: it must be one of the scene's: 0 \("):
            nonexp.render(target, spp=8, sensor=wrong)


FILE = """<scene version="3.0.0"><integrator type="direct"/><emitter type="constant"/>
    <sensor type="perspective"><film type="hdrfilm"><rfilter type="box"/>
        <integer name="width" value="5"/><integer name="height" value="4"/>
    </film></sensor><shape type="sphere"><transform name="to_world"><translate z="3"/></transform>
    </shape></scene>"""


def test_a_scene_file_is_loaded(tmp_path: Path) -> None:
    path, state = tmp_path / "scene.xml", tmp_path / "checkpoint"
    path.write_text(FILE)
    expected = nonexp.render(mi.load_file(str(path)), spp=16).mean
    for name in (path, str(path)):
        np.testing.assert_array_equal(nonexp.render(name, spp=16).mean, expected)
    nonexp.render(path, spp=16, checkpoint=state)
    path.write_text(FILE.replace('z="3"', 'z="4"'))
    with pytest.raises(ValueError, match=r"another render: file scene\.xml has changed"):
        nonexp.render(path, spp=16, checkpoint=state)
    with pytest.raises(ValueError, match=r"scene file 'gone\.xml' does not exist"):
        nonexp.render("gone.xml")


def in_a_process(code: str) -> str:
    run = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])},
        capture_output=True,
        text=True,
    )
    assert run.returncode == 0, run.stderr
    return run.stdout


def test_without_a_variant_it_is_said_what_to_call() -> None:
    said = in_a_process(
        "import nonexp\ntry: nonexp.render('a.xml')\nexcept ValueError as error: print(error)"
    )
    assert said == "no variant is set: call mitsuba.set_variant('llvm_ad_rgb') first\n"


@pytest.mark.thorough
def test_threads_render_one_after_the_other() -> None:
    """Without a lock Dr.Jit mixes up what the threads record, and aborts or raises."""
    said = in_a_process(
        """
import threading
import mitsuba as mi
import numpy as np
import nonexp

mi.set_variant("llvm_ad_rgb")
film = {"type": "hdrfilm", "width": 32, "height": 32, "rfilter": {"type": "box"}}
scene = mi.load_dict({
    "type": "scene",
    "integrator": {"type": "nonexp_volpath", "max_depth": 8},
    "light": {"type": "constant"},
    "ball": {"type": "sphere", "bsdf": {"type": "null"}, "interior": {"type": "nonexp_homogeneous",
        "transmittance": {"type": "transmittance_gamma", "alpha": 0.5}}},
    "camera": {"type": "perspective", "film": film,
        "to_world": mi.ScalarTransform4f().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0])},
})
found = {}

def work(first):
    for seed in range(first, first + 4):
        found[seed] = nonexp.render(scene, spp=64, seed=seed).mean

threads = [threading.Thread(target=work, args=(first,)) for first in (0, 4)]
for thread in threads: thread.start()
for thread in threads: thread.join()
print(sorted(found), all(np.array_equal(nonexp.render(scene, spp=64, seed=seed).mean, mean)
    for seed, mean in found.items()))
"""
    )
    assert said == "[0, 1, 2, 3, 4, 5, 6, 7] True\n"


def test_a_render_within_a_render_is_no_deadlock() -> None:
    target, inner = scene(), []

    def look(progress: nonexp.Progress) -> None:
        inner.append(nonexp.render(target, spp=1).passes)

    nonexp.render(target, spp=8, pass_spp=4, on_progress=look)
    assert inner == [1, 1]


def test_an_error_and_a_time_can_be_text() -> None:
    target = scene()
    text, number = (nonexp.render(target, error=e, pass_spp=4) for e in ("40%", 0.4))
    assert text.stopped == number.stopped == "error"
    np.testing.assert_array_equal(text.mean, number.mean)
    assert nonexp.render(target, time="1.5s", spp=8).stopped == "spp"
    assert nonexp.render(target, time=np.float32(0.01)).stopped == "time"


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("gone/a", r"checkpoint is '.*gone/a': its folder '.*gone' does not exist"),
        (".", "checkpoint is '.*': it is a folder"),
        ("/proc/a", "checkpoint is '/proc/a': its folder '/proc' must be writable"),
    ],
)
def test_a_checkpoint_that_cannot_be_written_is_told_first(
    tmp_path: Path, name: str, message: str
) -> None:
    never = lambda *_: pytest.fail("it was rendered")  # noqa: E731
    with pytest.raises(OSError, match=message):
        nonexp.render(scene(), spp=8, checkpoint=tmp_path / name, source=never)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("where", ["terminal", "jupyter", "file"])
def test_a_progress_bar_is_shown_where_it_can_be(
    where: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("FORCE_COLOR" if where == "terminal" else "NO_COLOR", "1")
    monkeypatch.setattr("rich.console._is_jupyter", lambda: where == "jupyter")
    shown: list[str] = []
    if where == "jupyter":
        pytest.importorskip("ipywidgets")
        monkeypatch.setattr("IPython.display.display", lambda what: shown.append(str(what)))
    called: list[int] = []
    nonexp.render(scene(), spp=16, progress=True, on_progress=lambda p: called.append(p.spp))
    out, err = capsys.readouterr()
    assert called == [2, 4, 6, 8, 10, 12, 14, 16]
    assert ("16 spp" in err) == bool(err) == (where == "terminal")
    assert bool(shown) == (where == "jupyter") and not out
    nonexp.render(scene(), spp=4)
    assert capsys.readouterr() == ("", "")


def test_a_black_image_is_warned_of() -> None:
    target = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path"},
            "sensor": {"type": "perspective", "film": {"type": "hdrfilm", "width": 4, "height": 4}},
        }
    )
    with pytest.warns(
        UserWarning, match="the image is black everywhere: no light reaches the"
    ) as w:
        image = nonexp.render(target, spp=8, error=0.01)
    assert w[0].filename == __file__
    assert image.black and np.isnan(image.error) and image.stopped == "spp"
    with pytest.raises(ValueError, match=r"error is 0\.01, which cannot be reached: after 64 "):
        nonexp.render(target, error=0.01)


def test_an_image_is_one_line_and_a_picture() -> None:
    values = np.linspace(0, 2, 7 * 5 * 3).reshape(5, 7, 3)
    image = nonexp.Image(values, 0.1 * values, 64, 8, 3, 1.25, 0.0123, "error")
    said = "Image(7x5, spp=64, passes=8, seed=3, seconds=1.25, error=1.23%, stopped='error')"
    assert repr(image) == said
    single = nonexp.Image(values, values * np.nan, 1, 1, 0, 0.5)
    assert "error=unknown" in repr(single) and "\n" not in repr(single)
    shown = image._repr_png_()
    assert shown.startswith(b"\x89PNG")
    stream = mi.MemoryStream()
    stream.write(shown)
    stream.seek(0)
    picture = np.array(mi.Bitmap(stream, mi.Bitmap.FileFormat.PNG))
    np.testing.assert_array_equal(picture, np.round(255 * tone_map(values)))


@pytest.mark.parametrize("pass_spp", [1, 4, 16])
def test_the_pass_size_can_be_chosen(pass_spp: int) -> None:
    image = nonexp.render(scene(), spp=30, pass_spp=pass_spp)
    assert (image.pass_spp, image.passes) == (pass_spp, -(-30 // pass_spp))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"spp": 2.5}, "spp is 2.5: it must be a whole number >= 1"),
        ({"spp": 0}, "spp is 0: it must be a whole number >= 1"),
        ({"pass_spp": 0}, "pass_spp is 0: it must be a whole number >= 1"),
        ({"seed": 1.5}, "seed is 1.5: it must be a whole number >= 0"),
        ({"seed": -1}, "seed is -1: it must be a whole number >= 0"),
        ({"sensor": 3}, "sensor is 3: it must be one of the scene's: it has none"),
        ({"time": 0}, "time is 0: it must be a time > 0, as in 90"),
        ({"error": 1.0}, "error is 1.0: it must lie between 0 and 1"),
        ({"error": -0.1}, "error is -0.1: it must lie between 0 and 1"),
        ({"interval": -1}, "interval is -1: it must be a number of seconds >= 0"),
    ],
)
def test_bad_arguments_are_named(arguments: dict[str, Any], message: str) -> None:
    target = mi.load_dict({"type": "scene"}) if "sensor" in arguments else scene()
    with pytest.raises(ValueError, match=re.escape(message)):
        nonexp.render(target, **arguments)
