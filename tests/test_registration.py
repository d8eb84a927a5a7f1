"""Plugins are known in every variant, whatever the order of imports; others refuse clearly."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from build import FURNACE, ball, medium, perspective, scene
from tiers import thorough

from nonexp import plugins

pytestmark = pytest.mark.usefixtures("several_threads")

ROOT = Path(__file__).resolve().parent.parent
UNSUPPORTED = [v for v in mi.variants() if not plugins.supported(v) and "cuda" not in v]

MAKE = """
mi.load_dict({"type": "nonexp_volpath"})
mi.load_dict({"type": "nonexp_homogeneous"})
mi.load_dict({"type": "transmittance_gamma", "alpha": 1.5})
"""


def run(code: str, cwd: Path = ROOT) -> None:
    subprocess.run([sys.executable, "-c", code], check=True, cwd=cwd, timeout=120)


def test_import_before_the_variant_is_set() -> None:
    run(f"import nonexp\nimport mitsuba as mi\nmi.set_variant('llvm_ad_rgb'){MAKE}")


@pytest.mark.thorough
def test_import_after_the_variant_is_set(tmp_path: Path) -> None:
    run(f"import mitsuba as mi\nmi.set_variant('llvm_ad_mono')\nimport nonexp{MAKE}", tmp_path)


@pytest.mark.thorough
def test_entry_point_module_registers_and_bears_reloading() -> None:
    # Mitsuba 3.10 loads it by entry point; 3.9, which runs here, has no such mechanism.
    run(
        "import mitsuba as mi, importlib\nmi.set_variant('llvm_ad_rgb')\n"
        f"import nonexp.plugins.entry as e{MAKE}\n"
        f"mi.set_variant('llvm_ad_mono'); importlib.reload(e){MAKE}"
    )


@pytest.mark.thorough
def test_metal_is_supported_and_registered() -> None:
    """As far as it can be seen without a Mac: with the classes of another variant."""
    assert plugins.supported("metal_ad_rgb") and not plugins.supported("metal_rgb_polarized")
    run(
        "import nonexp, mitsuba as mi\nfrom nonexp.plugins import registration\n"
        "mi.set_variant('llvm_ad_rgb')\nreal, mi.variant = mi.variant, lambda: 'metal_ad_rgb'\n"
        f"nonexp.plugins.register()\nmi.variant = real{MAKE}"
        "make = registration._textures['metal_ad_rgb']\n"
        "assert make.__name__ == 'TransmittanceTexture', make"
    )


@pytest.mark.parametrize("variant", UNSUPPORTED)
def test_unsupported_variants_say_so_in_one_sentence(variant: str) -> None:
    mi.set_variant(variant)
    for plugin in ("nonexp_volpath", "nonexp_homogeneous", "transmittance_gamma", "nonexp_sobol"):
        with pytest.raises(RuntimeError) as error:
            mi.load_dict({"type": plugin})
        last = str(error.value).strip().splitlines()[-1]
        assert f"{plugin} does not work in variant {variant}" in last
        assert "llvm_ad_rgb" in last


def picture(seed: int = 1, alpha: float = 2.0) -> tuple[object, np.ndarray]:
    built = scene(
        sensor=perspective([0, 0, 4], [0, 0, 0]),
        ball=ball(medium("gamma", {"alpha": alpha}, sigma_t=1.0, albedo=0.8)),
        sky=FURNACE,
    )
    return built, np.array(mi.render(built, spp=16, seed=seed))


@pytest.mark.thorough
def test_switching_variants_back_and_forth() -> None:
    built, first = picture()
    mi.set_variant("llvm_ad_mono")
    _, grey = picture()
    assert grey.shape[2] == 1
    mi.set_variant("llvm_ad_spectral")
    _, spectral = picture()
    mi.set_variant("llvm_ad_rgb")
    # The scene of old, and one that is loaded anew.
    np.testing.assert_array_equal(np.array(mi.render(built, spp=16, seed=1)), first)
    np.testing.assert_array_equal(picture()[1], first)
    assert grey.mean() == pytest.approx(first.mean(), rel=0.05)
    assert spectral.mean() == pytest.approx(first.mean(), rel=0.1)


def test_scenes_loaded_together_do_not_disturb_each_other() -> None:
    one, alone = picture(alpha=0.5)
    two, other = picture(alpha=50.0)
    three, _ = picture(alpha=3.0)
    del three
    np.testing.assert_array_equal(np.array(mi.render(one, spp=16, seed=1)), alone)
    np.testing.assert_array_equal(np.array(mi.render(two, spp=16, seed=1)), other)
    assert abs(alone.mean() - other.mean()) > 0.001


def test_loading_in_parallel_with_plugins_that_read_files() -> None:
    """A plugin's constructor must leave the global file resolver alone: of 100 loads like this,
    6 failed when it did not."""
    gold = {"type": "roughconductor", "material": "Au"}
    for _ in range(100):
        scene(
            fog={"type": "nonexp_homogeneous", "id": "fog", "albedo": 0.9},
            ball={**ball({"type": "ref", "id": "fog"}), "exterior": {"type": "nonexp_homogeneous"}},
            gold={"type": "sphere", "bsdf": gold},
            sky=FURNACE,
        )


@pytest.mark.parametrize("version", [*thorough(14, 15), 16])
def test_an_llvm_that_would_abort_the_process_is_refused(version: int) -> None:
    """With it a kernel must not even be tried: Dr.Jit calls abort()."""
    run(
        "import nonexp\nfrom nonexp.system import machine\nimport mitsuba as mi\n"
        f"machine._llvm = lambda: ('/usr/lib/libLLVM.so', ({version}, 0, 0))\n"
        "mi.set_variant('llvm_ad_rgb')\n"
        "for plugin in ('nonexp_volpath', 'nonexp_homogeneous', 'transmittance_gamma'):\n"
        "    try:\n        mi.load_dict({'type': plugin})\n"
        "    except RuntimeError as error:\n"
        "        expected = plugin + ' cannot render in variant llvm_ad_rgb: '\n"
        f"        assert expected + 'LLVM is version {version}' in str(error), error\n"
        "    else:\n        raise AssertionError(plugin)\n"
    )


@pytest.mark.parametrize("given", [{"max_depth": 2**32}, {"rr_depth": 0}, {"max_depth": True}])
def test_depths_out_of_range_are_refused(given: dict[str, int]) -> None:
    with pytest.raises(RuntimeError, match=r"_depth is .*: it must be"):
        mi.load_dict({"type": "nonexp_volpath", **given})
