"""The sampler nonexp_sobol: nets, independence, passes; and how renders use it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy import stats
from tiers import THOROUGH, quick

import nonexp
from nonexp import cli, rendering
from nonexp.images import read
from nonexp.images.moments import Replicates
from nonexp.numerics import sobol
from nonexp.rendering import checkpoint, sampling

pytestmark = pytest.mark.usefixtures("several_threads")


def sampler(count: int, pixels: int = 1, seed: int = 0, first: int = 0, **given: Any) -> Any:
    """A seeded sampler of ``count`` samples for each of the pixels."""
    made: Any = mi.load_dict({"type": "nonexp_sobol", "sample_count": count, **given})
    made.first = first
    made.seed(seed, count * pixels)
    return made


def numbers(source: Any, dimensions: int, pixels: int = 1) -> Any:
    """The next numbers of all samples: (dimensions, pixels, samples of a pixel)."""
    drawn = np.array([np.array(source.next_1d()) for _ in range(dimensions)], dtype=np.float64)
    return drawn.reshape(dimensions, pixels, -1)


# --------------------------------------------------------------------- points


def test_points_are_those_of_scipy() -> None:
    from scipy.stats import qmc

    expected = qmc.Sobol(sobol.DIMENSIONS, scramble=False, bits=32).random(64)
    for first, count in ((0, 64), (0, 5), (5, 7), (48, 16), (3, 1)):
        reversed_bits = dr.brev(mi.UInt32(sobol.points(first, count).ravel()))
        found = np.array(reversed_bits).reshape(sobol.DIMENSIONS, count).T * 2.0**-32
        np.testing.assert_array_equal(found, expected[first : first + count])
    with pytest.raises(ValueError, match=r"there are 2\^32 points, not the"):
        sobol.points(2**32 - 8, 16)


@pytest.mark.parametrize("count", quick([1, 2, 16, 256], lambda n: n == 16))
def test_nets_are_nets_after_scrambling(count: int) -> None:
    """Of the 2^m points from a multiple of 2^m on, each elementary interval holds one.

    In each single dimension, and in the first two of them for all shapes of intervals.
    """
    pixels = 7
    for block in (0, 1, 6):
        drawn = numbers(sampler(count, pixels, 3, block * count), sobol.DIMENSIONS, pixels)
        assert 0 <= drawn.min() and drawn.max() < 1
        cells = np.sort(np.floor(drawn * count), axis=2)
        np.testing.assert_array_equal(cells, np.broadcast_to(np.arange(count), cells.shape))
        for wide in (1 << k for k in range(count.bit_length())):
            x, y = np.floor(drawn[0] * wide), np.floor(drawn[1] * (count // wide))
            cells = np.sort(x * (count // wide) + y, axis=1)
            np.testing.assert_array_equal(cells, np.broadcast_to(np.arange(count), cells.shape))


def test_scrambling_flips_a_bit_by_higher_ones_only() -> None:
    """And is one-to-one; flips are as likely as not, by the bits above and by the seed."""
    x = np.random.default_rng(1).integers(0, 2**32, 4096, dtype=np.uint32)
    for bit in (0, 5, 17, 31):
        lower = np.uint32(2**bit - 1)
        changed = sobol.scrambled(mi.UInt32(x ^ (1 << bit)), mi.UInt32(7))
        difference = np.array(changed) ^ np.array(sobol.scrambled(mi.UInt32(x), mi.UInt32(7)))
        assert not (difference & lower).any() and ((difference >> bit) & 1).all()


def test_flips_are_independent_and_as_likely_as_not() -> None:
    """Of bit k, for all 2^k patterns of the bits before it, over 2^14 seeds; k = 0 to 4.

    Means and correlations of all 31 flips have a standard deviation of 2^-7 and 2^-7: 5.5 of these
    in one of 496 have a probability below 1e-4.
    """
    seeds = sobol.mixed(dr.arange(mi.UInt32, 2**14) * 3)
    flips = []
    for k in range(5):
        for pattern in range(2**k):
            found = np.array(sobol.scrambled(mi.UInt32(pattern), seeds))
            flips.append(1.0 - 2.0 * ((found >> k) & 1))
    signs = np.array(flips)
    assert len(np.unique(np.array(seeds))) == 2**14
    assert np.abs(signs.mean(axis=1)).max() < 5.5 / 2**7
    correlation = signs @ signs.T / 2**14 - np.eye(len(signs))
    assert np.abs(correlation).max() < 5.5 / 2**7


# --------------------------------------------------------------------- the sampler


@THOROUGH
def test_each_number_is_uniform_and_independent_of_other_pixels_and_seeds() -> None:
    """Sample 5 of 16 in 2^14 pixels: dimensions of points, and hashed ones; two seeds.

    A chi-square of 64 cells for each, and correlations between all, also with the pixel beside.
    """
    pixels, shown = 2**14, [0, 1, 2, 17, 31, 32, 33, 40]
    rows = []
    for seed in (0, 1):
        drawn = numbers(sampler(16, pixels, seed), 41, pixels)[shown, :, 5]
        rows += [drawn, np.roll(drawn, 1, axis=1)]
    drawn = np.concatenate(rows)
    for row in drawn:
        cells = np.bincount((row * 64).astype(int), minlength=64)
        assert stats.chisquare(cells).pvalue > 1e-5
    correlation = np.corrcoef(drawn) - np.eye(len(drawn))
    assert np.abs(correlation).max() < 5.5 / 2**7  # of 496: below 1e-4


def test_hashed_dimensions_are_independent_between_samples() -> None:
    pixels = 2**11
    drawn = numbers(sampler(8, pixels), 36, pixels)
    correlation = np.corrcoef(drawn[33].T) - np.eye(8)
    assert np.abs(correlation).max() < 5 / np.sqrt(pixels)
    before = np.corrcoef(drawn[3].T) - np.eye(8)  # of a net: not twice in one interval
    assert np.abs(before).max() > 5 / np.sqrt(pixels)


@pytest.mark.parametrize("count", [16, 12])
def test_parts_continue_the_sequence(count: int) -> None:
    """By ``first``, by ``advance`` in one wavefront, and by both: the same numbers to the bit."""
    pixels = 5
    whole = numbers(sampler(count, pixels, 9, 32), 40, pixels)
    size = count // 4
    parts = [numbers(sampler(size, pixels, 9, 32 + k * size), 40, pixels) for k in range(4)]
    np.testing.assert_array_equal(np.concatenate(parts, axis=2), whole)
    source: Any = mi.load_dict({"type": "nonexp_sobol", "sample_count": count})
    source.first = 32
    source.set_samples_per_wavefront(size)
    source.seed(9, pixels * size)
    parts = []
    for _ in range(4):
        parts.append(numbers(source, 40, pixels))
        source.advance()
        source.schedule_state()
    np.testing.assert_array_equal(np.concatenate(parts, axis=2), whole)


def test_masks_leave_dimensions_aligned() -> None:
    one, other = sampler(8, 3), sampler(8, 3)
    one.next_1d(dr.arange(mi.UInt32, 24) % 3 == 0)
    one.next_2d(False)
    for _ in range(3):
        other.next_1d()
    np.testing.assert_array_equal(numbers(one, 2), numbers(other, 2))


def test_a_loop_draws_what_single_calls_do() -> None:
    """With a different number of turns in each lane, beyond the last planned dimension."""
    count, pixels = 16, 4
    turns = dr.arange(mi.UInt32, count * pixels) % 37

    def body(source: Any, turn: Any, total: Any) -> Any:
        point = source.next_2d()
        return source, turn + 1, total + point.x * point.y

    source, _, total = dr.while_loop(
        (sampler(count, pixels, 2), mi.UInt32(0), mi.Float(0)),
        lambda source, turn, total: turn < turns,
        body,
    )
    after = np.array(source.next_1d())
    drawn = numbers(sampler(count, pixels, 2), 74).reshape(37, 2, -1)
    expected = [drawn[:n, :, lane].prod(axis=1).sum() for lane, n in enumerate(np.array(turns))]
    np.testing.assert_allclose(np.array(total), expected, rtol=1e-5)
    following = drawn.reshape(74, -1)[2 * np.array(turns) % 74, np.arange(count * pixels)]
    np.testing.assert_array_equal(after, following.astype(np.float32))


def test_clones_go_on_and_forks_begin() -> None:
    source: Any = mi.load_dict({"type": "nonexp_sobol", "seed": 2})
    source.first = 8
    source.seed(3, 24)
    source.next_2d()
    clone, fork = source.clone(), source.fork()
    clone.next_1d()
    assert clone.wavefront_size() == 24 and (fork.sample_count(), fork.first) == (4, 8)
    expected = numbers(source, 3)
    np.testing.assert_array_equal(numbers(clone, 2), expected[1:])
    fork.seed(3, 24)
    np.testing.assert_array_equal(numbers(fork, 5)[2:], expected)
    np.testing.assert_array_equal(numbers(sampler(4, 6, 5, 8), 5)[2:], expected)  # 2 + 3


def integrand(source: Any, count: int, pixels: int) -> Any:
    """Mean over the samples of a pixel of a smooth function of 4 numbers, whose mean is 1."""
    x = numbers(source, 4, pixels)
    return np.prod(1 + 0.5 * np.sin(2 * np.pi * x), axis=0).mean(axis=1)


@pytest.mark.parametrize("count", quick([64, 100, 256], lambda n: n != 256))
def test_means_have_no_bias_and_little_noise(count: int) -> None:
    """Also for a number of samples that is no power of two: there with a smaller gain.

    Over 2000 pixels; the variance of independent samples is (1.125^4 - 1) / n.
    """
    pixels = 2000
    means = integrand(sampler(count, pixels, 1), count, pixels)
    assert abs(means.mean() - 1) < 4.5 * stats.sem(means)
    gain = (1.125**4 - 1) / count / means.var()
    assert gain > {64: 25, 100: 6, 256: 150}[count]


def test_only_whole_seeds_and_counts() -> None:
    with pytest.raises(RuntimeError, match="sample_count is 0: it must be a whole number >= 1"):
        mi.load_dict({"type": "nonexp_sobol", "sample_count": 0})
    fresh: Any = mi.load_dict({"type": "nonexp_sobol"})
    assert fresh.sample_count() == 4 and fresh.wavefront_size() == 0
    with pytest.raises(RuntimeError, match="has no numbers before its first call of seed"):
        fresh.next_1d()
    with pytest.raises(ValueError, match="wavefront_size is not given, as it must be at the first"):
        fresh.seed(1)
    with pytest.raises(RuntimeError):
        fresh.set_samples_per_wavefront(3)


# --------------------------------------------------------------------- renders

PLACE = mi.ScalarTransform4f


def scene(sampler: str | None = None, integrator: Any = None, spp: int = 8, **camera: Any) -> Any:
    """A grey ball under a lamp, with noise in every pixel of it."""
    named = {"sampler": {"type": sampler, "sample_count": spp}} if sampler else {}
    film = {"type": "hdrfilm", "width": 12, "height": 10, "rfilter": {"type": "box"}}
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": integrator or {"type": "path", "max_depth": 3},
            "camera": {
                "type": "perspective",
                "to_world": PLACE().look_at([0, 0, 3], [0, 0, 0], [0, 1, 0]),
                "fov": 30,
                "film": film,
                **named,
                **camera,
            },
            "lamp": {"type": "sphere", "center": [2, 2, 2], "emitter": {"type": "area"}},
            "ball": {"type": "sphere"},
        }
    )


def test_a_render_takes_sobol_for_independent_and_leaves_others() -> None:
    def mean_of_renders(target: Any, spp: int, passes: int) -> Any:
        seeds = [rendering.pass_seed(5, number) for number in range(passes)]
        images = [np.array(mi.render(target, spp=spp, seed=seed)) for seed in seeds]
        return np.mean(np.array(images, dtype=np.float64), axis=0)

    asked: dict[str, Any] = {"spp": 8, "seed": 5, "pass_spp": 2}
    plain, named = scene(), scene("multijitter")
    single, jittered = mean_of_renders(plain, 2, 4), mean_of_renders(named, 2, 4)
    sobol_image = mean_of_renders(scene("nonexp_sobol"), 2, 4)
    for target, sampler, expected, plugin, independent in (
        (plain, None, sobol_image, "nonexp_sobol", 4),
        (plain, "independent", single, "independent", 4),
        (scene("independent"), "sobol", sobol_image, "nonexp_sobol", 4),
        (scene("nonexp_sobol"), None, sobol_image, "nonexp_sobol", 4),
        (scene("nonexp_sobol"), "independent", single, "independent", 4),
        (named, None, jittered, "multijitter", 4),
        (named, "sobol", sobol_image, "nonexp_sobol", 4),
        (named, "independent", single, "independent", 4),
    ):
        image = nonexp.render(target, sampler=sampler, **asked)
        np.testing.assert_allclose(image.mean, expected, rtol=1e-12)
        assert sampling.sampler_of(target.sensors()[0], sampler) == plugin
        assert image.independent == independent
    with pytest.raises(ValueError, match="sampler is 'halton': it must be sobol or independent"):
        nonexp.render(plain, sampler="halton")


@THOROUGH
def test_a_batch_of_sensors_and_scalar_variants_keep_their_sampler() -> None:
    film = {"type": "hdrfilm", "width": 8, "height": 4, "rfilter": {"type": "box"}}
    one = {"type": "perspective", "to_world": PLACE().look_at([0, 0, 3], [0, 0, 0], [0, 1, 0])}
    batch: dict[str, Any] = {"type": "batch", "a": one, "b": one, "film": film}
    parts = {"i": {"type": "direct"}, "light": {"type": "constant"}, "ball": {"type": "sphere"}}
    target = mi.load_dict({"type": "scene", **parts, "camera": batch})
    assert nonexp.render(target, spp=8).independent == 8
    with pytest.raises(ValueError, match="'sobol': a batch of sensors renders with"):
        nonexp.render(target, spp=8, sampler="sobol")
    batch["sampler"] = {"type": "nonexp_sobol"}
    target = mi.load_dict({"type": "scene", **parts, "camera": batch})
    assert nonexp.render(target, spp=16).independent == 4
    assert target.sensors()[0].sampler().first == 0
    mi.set_variant("scalar_rgb")
    target = mi.load_dict({"type": "scene", **parts, "camera": {**one, "film": film}})
    assert nonexp.render(target, spp=8).independent == 8
    with pytest.raises(ValueError, match="'sobol': scalar_rgb renders with"):
        nonexp.render(target, spp=8, sampler="sobol")


def test_passes_of_a_replicate_are_parts_of_one_image() -> None:
    target, plan = scene(), rendering.Plan(6, 4)
    parts = list(rendering.render_passes(target, plan, 3, count=2))
    for replicate in (0, 1):
        seed = rendering.pass_seed(3, replicate)
        whole = np.array(mi.render(scene("nonexp_sobol"), spp=12, seed=seed))
        np.testing.assert_allclose(np.mean(parts[replicate::2], axis=0), whole, atol=2e-6)
    by_default = list(rendering.render_passes(target, plan, 3))
    assert not np.array_equal(by_default[2], parts[2]) and np.array_equal(by_default[0], parts[0])
    later = list(rendering.render_passes(target, plan, 3, start=4))
    np.testing.assert_array_equal(later, by_default[4:])


@THOROUGH
def test_replicates_know_their_noise() -> None:
    """Against NumPy where all are equal; where they are not, the mean square is right."""
    images = np.random.default_rng(1).normal(2, 1, (4000, 11, 3, 1, 1))
    state = Replicates(4)
    for image in images[0][:8]:
        state = state.plus(image)
    each = images[0][:8].reshape(2, 4, 3, 1, 1).mean(axis=0)
    np.testing.assert_allclose(state.mean, images[0][:8].mean(axis=0), rtol=1e-14)
    np.testing.assert_allclose(state.stderr, stats.sem(each), rtol=1e-12)
    assert (state.independent, state.passes) == (4, 8)
    squares = []
    for run in images:
        state = Replicates(4)
        for image in run:
            state = state.plus(image)
        squares.append(state.stderr**2)
    assert np.mean(squares) == pytest.approx(1 / 11, rel=0.03)  # sqrt(2/3/12000): 0.7 %
    assert Replicates(4).plus(images[0][0]).independent == 1
    assert np.isnan(Replicates(4).plus(images[0][0]).stderr).all()


@THOROUGH
def test_a_checkpoint_keeps_replicates_and_sampler(tmp_path: Path) -> None:
    path, target = tmp_path / "c", scene()
    first = nonexp.render(target, spp=64, pass_spp=8, checkpoint=path)
    state = checkpoint.read(path)
    assert isinstance(state.moments, Replicates) and state.identity["sampler"] == "nonexp_sobol"
    assert (first.independent, first.passes, len(state.moments.sums)) == (4, 8, 4)
    longer = nonexp.render(target, spp=320, checkpoint=path)
    afresh = nonexp.render(target, spp=320, pass_spp=8)
    assert (longer.independent, afresh.independent) == (4, 8)
    parts = list(rendering.render_passes(target, rendering.Plan(40, 8), count=4))
    np.testing.assert_allclose(longer.mean, np.mean(parts, axis=0), rtol=1e-13)
    with pytest.raises(ValueError, match="sampler was nonexp_sobol, is independent"):
        nonexp.render(target, spp=320, checkpoint=path, sampler="independent")


def test_all_passes_are_one_kernel() -> None:
    target = scene()
    for spp, pass_spp in ((8, 4), (80, 8)):
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
            dr.kernel_history_clear()
            nonexp.render(target, spp=spp, pass_spp=pass_spp, seed=spp)
            kernels = dr.kernel_history([dr.KernelType.JIT])
        largest = max(kernel["operation_count"] for kernel in kernels)
        hashes = {k["hash"] for k in kernels if k["operation_count"] == largest}
        assert len(hashes) == 1
        if pass_spp == 4:
            before = hashes
    assert hashes == before  # also of another pass size


@pytest.mark.parametrize(
    "camera",
    [
        {"type": "thinlens", "aperture_radius": 0.3, "focus_distance": 2.0},
        {"shutter_close": 1.0},
        {"film": {"type": "hdrfilm", "width": 12, "height": 10, "rfilter": {"type": "box"},
                  "crop_width": 5, "crop_height": 4, "crop_offset_x": 4, "crop_offset_y": 3}},
    ],
    ids=["lens", "shutter", "crop"],
)  # fmt: skip
def test_a_sensor_with_another_sampler_sees_the_same(camera: dict[str, Any]) -> None:
    one = nonexp.render(scene("independent", **camera), spp=8, sampler="independent")
    other = nonexp.render(scene("multijitter", **camera), spp=8, sampler="independent")
    np.testing.assert_array_equal(other.mean, one.mean)
    assert one.mean.std() > 0.005


def fog(sampler: str | None, size: tuple[int, int] = (6, 5), inside: bool = False) -> Any:
    """A ball of fog before a lamp, or around the camera."""
    width, height = size
    film = {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "box"}}
    law = {"type": "transmittance_gamma", "alpha": 1.0}
    medium = {"type": "nonexp_homogeneous", "sigma_t": 1.5, "albedo": 0.8, "transmittance": law}
    lamp = PLACE().translate([0, 0, -3]).scale(3)
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "nonexp_volpath", "max_depth": 6},
            "medium": {**medium, "id": "fog"},
            "camera": {
                "type": "perspective",
                "to_world": PLACE().look_at([0, 0, 0.5 if inside else 4], [0, 0, 0], [0, 1, 0]),
                "fov": 35,
                "film": film,
                **({"sampler": {"type": sampler, "sample_count": 4}} if sampler else {}),
                **({"medium": {"type": "ref", "id": "fog"}} if inside else {}),
            },
            "ball": {
                "type": "sphere",
                "bsdf": {"type": "null"},
                "interior": {"type": "ref", "id": "fog"},
            },
            "lamp": {"type": "rectangle", "to_world": lamp, "emitter": {"type": "area"}},
        }
    )


@THOROUGH
def test_a_camera_in_a_medium_stays_there() -> None:
    one = nonexp.render(fog(None, inside=True), spp=8, sampler="independent")
    other = nonexp.render(fog("multijitter", inside=True), spp=8, sampler="independent")
    np.testing.assert_array_equal(other.mean, one.mean)


@THOROUGH
def test_mitsuba_may_split_a_render() -> None:
    """By ``samples_per_pass``: without bias, and with less noise than independent numbers."""
    integrator = {"type": "path", "max_depth": 3, "samples_per_pass": 4}
    truth = nonexp.render(scene(), spp=2048).mean
    errors = {}
    for sampler in ("independent", "nonexp_sobol"):
        target = scene(sampler, integrator)
        images = np.array([np.array(mi.render(target, spp=16, seed=seed)) for seed in range(16)])
        scores = (images.mean(axis=(1, 2, 3)) - truth.mean()) / truth.mean()
        assert abs(scores.mean()) < 4 * stats.sem(scores) + 1e-3
        errors[sampler] = np.square(images - truth).mean()
    assert errors["nonexp_sobol"] < 0.9 * errors["independent"]


@THOROUGH
def test_derivatives_have_no_bias_and_agree_both_ways() -> None:
    """With 4 samples per pixel, where the mean of the others as a baseline would be off by 25 %."""
    slopes = {}
    for name, seeds in (("independent", 16), ("nonexp_sobol", 8)):
        target = fog(name, size=(16, 12))
        parameters: Any = mi.traverse(target)
        (key,) = [key for key in parameters.keys() if key.endswith("sigma_t.value.value")]
        value = type(parameters[key])(parameters[key])
        found = []
        for seed in range(seeds):
            by: Any = type(value)(value)
            dr.enable_grad(by)
            parameters[key] = by
            parameters.update()
            dr.backward(dr.mean(mi.render(target, parameters, seed=seed).array))
            found.append(float(np.array(dr.grad(by)).sum()))
        dr.enable_grad(by := type(value)(value))
        parameters[key] = by
        parameters.update()
        dr.set_grad(by, 1.0)
        forward = dr.forward_to(mi.render(target, parameters, seed=seeds - 1))
        assert np.array(forward).mean() == pytest.approx(found[-1], rel=1e-4)
        slopes[name] = np.array(found)
    error = np.hypot(*(stats.sem(one) for one in slopes.values()))
    first, second = (one.mean() for one in slopes.values())
    assert abs(first - second) < 4 * error
    assert error < 0.04 * abs(first)


@pytest.mark.parametrize("variant", ["llvm_ad_mono", "llvm_ad_spectral"], indirect=True)
@THOROUGH
def test_other_variants(variant: str) -> None:
    image = nonexp.render(scene(), spp=16, seed=1)
    assert image.independent == 4 and image.mean.mean() > 0.01
    expected = nonexp.render(scene(), spp=256, seed=2, sampler="independent")
    assert image.mean.mean() == pytest.approx(expected.mean.mean(), rel=0.05)


FILE = """<scene version="3.0.0">
    <integrator type="path"/> <emitter type="constant"/> <shape type="sphere"/>
    <sensor type="perspective"> SAMPLER
        <transform name="to_world">
            <lookat origin="0, 0, 4" target="0, 0, 0" up="0, 1, 0"/>
        </transform>
        <film type="hdrfilm"> <rfilter type="box"/>
            <integer name="width" value="6"/> <integer name="height" value="5"/>
        </film>
    </sensor>
</scene>"""


@THOROUGH
def test_the_command_says_which_sampler(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("plain.xml").write_text(FILE.replace("SAMPLER", ""))
    Path("named.xml").write_text(FILE.replace("SAMPLER", '<sampler type="nonexp_sobol"/>'))
    job = ["--variant", "llvm_ad_rgb", "--spp", "16"]
    for name, seed, given in (("a", 1, []), ("b", 2, []), ("c", 3, ["--sampler", "independent"])):
        words = ["render", "plain.xml", *job, "--seed", str(seed), *given, "-o", f"{name}.exr"]
        assert cli.main(words) == 0
    headers = [read(Path(f"{name}.exr")).metadata for name in "abc"]
    assert [header["sampler"] for header in headers] == ["nonexp_sobol"] * 2 + ["independent"]
    assert [header["independent"] for header in headers] == [4, 4, 8]
    assert cli.main(["merge", "a.exr", "b.exr", "-o", "ab.exr"]) == 0
    assert read(Path("ab.exr")).metadata["independent"] == 8
    assert cli.main(["merge", "a.exr", "c.exr", "-o", "ac.exr"]) == 2
    assert "sampler was nonexp_sobol, is independent" in capsys.readouterr().err
    assert cli.main(["render", "plain.xml", *job, "--sampler", "halton"]) == 2
    said = capsys.readouterr().err
    assert said == "nonexp: error: --sampler is 'halton': it must be sobol or independent\n"
    for name, row in (
        ("plain", "replaced by nonexp_sobol (--sampler independent keeps it)"),
        ("named", "Sobol points, continued over passes"),
    ):
        assert cli.main(["info", f"{name}.xml", "--variant", "llvm_ad_rgb"]) == 0
        assert row in " ".join(capsys.readouterr().out.split())
