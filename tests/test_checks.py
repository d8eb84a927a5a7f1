"""The public checks find planted errors, name their kind, and pass what is right."""

from __future__ import annotations

import dataclasses
import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from build import FURNACE, ball, medium, orthographic, scene
from tiers import THOROUGH

import nonexp
from nonexp import cli, models
from nonexp.numerics import filled, select
from nonexp.testing import (
    Fault,
    assert_mean,
    assert_same_image,
    check_integrator,
    check_law,
    exponential,
    law_checks,
    laws,
)

ROOT = Path(__file__).resolve().parent.parent
PLUGIN = ROOT / "nonexp" / "testing" / "pytest_plugin" / "__init__.py"


@dataclasses.dataclass(frozen=True, eq=False)
class Exponential(nonexp.Transmittance):
    """T = exp(-tau/s): right, and easy to make wrong."""

    s: Any = nonexp.parameter(1.0, above=0, doc="mean flight")

    @property
    def sigma_bar(self) -> Any:
        return 1 / self.s

    @property
    def jumps(self) -> Any:
        return ()

    def ff(self, tau: Any) -> Any:
        return dr.exp(-tau / self.s)

    def pf(self, tau: Any) -> Any:
        return dr.exp(-tau / self.s)

    def pp(self, tau: Any) -> Any:
        return dr.exp(-tau / self.s) / self.s

    def sample_f(self, draw: nonexp.Draw) -> Any:
        return -self.s * dr.log(1 - draw())

    def sample_p(self, draw: nonexp.Draw) -> Any:
        return -self.s * dr.log(1 - draw())


@dataclasses.dataclass(frozen=True, eq=False)
class Linear(nonexp.Transmittance):
    """T = (1 - tau/b)+, whose functions differ from each other; an atom, and kinks."""

    b: Any = nonexp.parameter(1.5, above=0, doc="length of a flight")

    @property
    def sigma_bar(self) -> Any:
        return 1 / self.b

    @property
    def atoms(self) -> Any:
        return ((self.b, 1.0),)

    def ff(self, tau: Any) -> Any:
        return dr.maximum(1 - tau / self.b, 0)

    def pf(self, tau: Any) -> Any:
        return select(tau < self.b, filled(tau, 1.0), 0.0)

    def pp(self, tau: Any) -> Any:
        return 0 * dr.minimum(tau, 1)

    def sample_f(self, draw: nonexp.Draw) -> Any:
        return self.b * draw()

    def sample_p(self, draw: nonexp.Draw) -> Any:
        return self.b + 0 * draw()


class Gamma(models.registry["gamma"]):  # type: ignore[name-defined,misc]
    """T = (1 + tau/alpha)^-alpha, to be spoilt."""


def spoilt(cls: type, **members: Any) -> Any:
    """A law of that class of which some members are others."""
    made = type("Spoilt", (cls,), members)
    return dataclasses.dataclass(frozen=True, eq=False)(made)()


def longer(cls: Any, origin: str, factor: float) -> dict[str, Any]:
    old = getattr(cls, f"sample_{origin}")
    return {f"sample_{origin}": lambda self, draw: factor * old(self, draw)}


PLANTED: dict[str, tuple[Any, str]] = {
    "sampler of ff off by 1 %": (
        lambda: spoilt(Exponential, **longer(Exponential, "f", 1.01)),
        r"sampler of ff: .*distances too long by (0\.9|1\.[01]) %",
    ),
    "sampler of pf off by 1 %": (
        lambda: spoilt(Gamma, **longer(Gamma, "p", 0.99)),
        r"sampler of pf: .*distances too short by (0\.9|1\.[01]) %",
    ),
    "pf for ff": (
        lambda: spoilt(Gamma, pf=lambda self, tau: self.ff(tau)),
        r"pf is -ff'/sigma_bar: pf equals ff",
    ),
    "pp for fp": (
        lambda: spoilt(Gamma, pp=lambda self, tau: self.fp(tau)),
        r"pp is -pf': pp equals fp",
    ),
    "wrong sigma_bar": (
        lambda: spoilt(Gamma, sigma_bar=property(lambda self: 1.01)),
        r"sigma_bar is 1\.01, but -ff'\(0\) is 1, too large by 1 %",
    ),
    "wrong sigma_bar where pf is ff": (
        lambda: spoilt(Exponential, sigma_bar=property(lambda self: 0.98 / self.s)),
        r"sigma_bar is 0\.98, but -ff'\(0\) is 1, too small by 2 %",
    ),
    "wrong normalisation of pf": (
        lambda: spoilt(Exponential, pf=lambda self, tau: 0.99 * dr.exp(-tau)),
        r"normalisation of pf: pf\(0\) is 0\.99, not 1",
    ),
    "wrong normalisation of pp": (
        lambda: spoilt(Exponential, pp=lambda self, tau: 2 * dr.exp(-tau)),
        r"normalisation of pp: it is too large by 100 %",
    ),
    "a forgotten atom": (
        lambda: spoilt(Linear, atoms=()),
        r"densities integrate to 1: normalisation of fp: .*is an atom or a kink not declared",
    ),
    "samplers exchanged": (
        lambda: spoilt(Gamma, sample_f=lambda self, draw: self.sample_p(draw)),
        r"sampler of ff: .*flights are those from a particle \(pf\)",
    ),
    "the number 0 gives infinity": (
        lambda: spoilt(Exponential, sample_f=lambda self, draw: -dr.log(draw())),
        r"sampler of ff: .*the distance is inf for the random numbers 0",
    ),
    "single precision lost": (
        lambda: spoilt(Exponential, ff=lambda self, tau: 1 - (1 - dr.exp(-tau)), jumps=None),
        r"single precision: rounding of ff",
    ),
    "no convex function": (
        lambda: spoilt(Exponential, ff=lambda self, tau: dr.exp(-tau * tau)),
        r"ff falls and is convex: ff is not convex around",
    ),
    "numbers selected in single precision": (
        lambda: spoilt(Linear, pf=lambda self, tau: dr.select(tau < self.b, 1.0, 0.0)),
        r"floats and arrays: pf of a float64 array is of single precision",
    ),
    "Python's own functions": (
        lambda: spoilt(Exponential, ff=lambda self, tau: np.exp(-float(tau))),
        r"floats and arrays: ff fails on a Dr\.Jit array with TypeError",
    ),
}


@pytest.mark.parametrize("kind", PLANTED)
def test_planted_error_in_a_law_is_named(kind: str) -> None:
    make, words = PLANTED[kind]
    with pytest.raises(Fault, match=words) as error:
        check_law(make(), rendered=False)
    assert "Spoilt" in str(error.value)


@pytest.mark.parametrize("cls", [Exponential, Linear])
@THOROUGH
def test_right_laws_pass(cls: Any) -> None:
    outcomes = check_law(cls, rendered=False)
    assert all(outcome.passed for outcome in outcomes)
    assert [outcome.check for outcome in outcomes] == [
        c for c in laws.CHECKS if c.stage < laws.RENDERED
    ]


def test_renders_of_a_law_find_its_samplers() -> None:
    """Run by themselves: as part of all checks they presuppose the samplers."""
    wrong = spoilt(Exponential, **longer(Exponential, "f", 1.02))
    checks = {check.name: check for check in laws.CHECKS}
    with pytest.raises(Fault, match=r"transmittance of a ball of depth 0\.[18]5?: share "):
        checks["rendered transmittance"].run(wrong)
    outcome = laws.LawChecks(wrong).outcome(checks["rendered transmittance"])
    assert outcome.skipped is not None and outcome.skipped.startswith("sampler of ff: ")
    assert "Spoilt" not in {cls.__name__ for cls in models.registry.values()}


def strangers_law() -> str:
    """The file that docs/own-model.md shows."""
    page = (ROOT / "docs" / "own-model.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    return next(block for block in blocks if "class SoftRepulsion" in block)


@pytest.fixture
def stranger(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    before = dict(models.registry)
    file = tmp_path / "strange_laws.py"
    file.write_text(strangers_law(), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    yield file
    models.registry.clear()
    models.registry.update(before)
    sys.modules.pop("strange_laws", None)


@THOROUGH
def test_law_of_a_stranger_is_checked_by_the_command(
    stranger: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["check", stranger.name]) == 0
    shown = capsys.readouterr().out
    for check in laws.CHECKS:
        assert re.search(rf"^{re.escape(check.name)} +passed ", shown, re.MULTILINE)
    assert "1 law: nothing is wrong" in shown


def test_law_of_a_stranger_that_is_wrong_is_named_by_the_command(
    stranger: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = stranger.read_text(encoding="utf-8")
    spoilt = text.replace("self.s * dr.atanh(draw())", "1.01 * self.s * dr.atanh(draw())")
    assert spoilt != text
    stranger.write_text(spoilt, encoding="utf-8")
    assert cli.main(["check", f"{stranger.name}:SoftRepulsion", "--skip-renders"]) == 1
    shown = capsys.readouterr().out
    assert re.search(r"sampler of ff: distances too long by 1\.[01] % \(± 0\.1 %\)", shown)
    assert "1 law: 1 fault\n" in shown


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "LAWS is missing"),
        (["nowhere.py"], "there is no file nowhere.py"),
        (["no_such_module:Law"], "No module named 'no_such_module'"),
        (["strange_laws.py:Nothing"], "has no function Nothing"),
        (["json"], "there is no class of nonexp.Transmittance in it"),
        (["json:loads"], "it must be a class of nonexp.Transmittance"),
        (["--integrator", "no_such_plugin"], "no_such_plugin"),
        (["--integrator", "volpath", "--case", "moon"], "case is 'moon': it must be one of"),
        (["gamma", "--variant", "scalar_rgb"], "variant 'scalar_rgb' is not supported"),
    ],
)
def test_bad_input_is_one_sentence(
    arguments: list[str], words: str, stranger: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["check", *arguments]) == 2
    said = capsys.readouterr().err
    assert words in said and said.count("\n") == 1


def test_what_is_no_law_is_refused() -> None:
    for wrong in (int, nonexp.Transmittance):
        with pytest.raises(ValueError, match=r"it must be a subclass of nonexp\.Transmittance"):
            law_checks(wrong)


# --------------------------------------------------------------------- images


def fog(radiance: float = 1.0, size: int = 12) -> Any:
    camera = orthographic(1.2)
    camera["film"] = {**camera["film"], "width": size, "height": size}
    sky = {"type": "constant", "radiance": radiance}
    inside = medium(sigma_t=1.0, albedo=0.8)
    return scene(sensor=camera, ball=ball(inside), sky=sky)


def test_a_bias_of_one_percent_in_an_image_is_found() -> None:
    built = fog()
    right = assert_same_image(built, built, within=0.01)
    assert right.finds <= 0.01 and "would have been found" in str(right)
    words = r"the first is brighter than the second by [01]\.\d+% .*everywhere by the same factor"
    with pytest.raises(AssertionError, match=words):
        assert_same_image(fog(1.01), built, within=0.01)
    with pytest.raises(AssertionError, match=r"too weak: a bias of 0\.01% needs about \d+ samples"):
        assert_same_image(built, built, within=1e-4, spp=256)


@THOROUGH
def test_kinds_of_images(tmp_path: Path) -> None:
    """Passes, images with standard errors, files, integrators by name."""
    built = fog()
    assert_same_image("nonexp_volpath", "nonexp_volpath", scene=built, within=0.02)
    image = nonexp.render(built, spp=1024, seed=5, pass_spp=16)
    assert_same_image(image, built, within=0.05)
    brighter = dataclasses.replace(image, mean=1.05 * image.mean)
    with pytest.raises(
        AssertionError, match=r"images differ, .*: the first is brighter .* by (4\.9|5\.)"
    ):
        assert_same_image(brighter, built, within=0.05)
    rng = np.random.default_rng(1)
    one, other = (1 + 0.1 * rng.standard_normal((64, 12, 10, 3)) for _ in range(2))
    assert_same_image(one, other)
    for part in (np.s_[:, :2, :2], np.s_[:, 6:, :, 2]):  # a block, a channel of half the image
        spoilt = other.copy()
        spoilt[part] *= 1.1
        with pytest.raises(AssertionError, match="differ"):
            assert_same_image(one, spoilt, within=0.05)
    with pytest.raises(ValueError, match="the images differ in size: 10x12 and 12x10 pixels"):
        assert_same_image(one, other.transpose(0, 2, 1, 3))
    for a, words in (
        ("nonexp_volpath", "scene is missing"),
        (one[:8], "a holds 8 passes: they must be at least 32"),
        (one[0], "a is ndarray: it must be a scene"),
    ):
        with pytest.raises(ValueError, match=words):
            assert_same_image(a, other)
    with pytest.raises(ValueError, match="within is 0"):
        assert_same_image(one, other, within=0)


@THOROUGH
def test_mean_of_a_scene() -> None:
    inside = medium("linear", {"b": 2.0}, sigma_t=0.5, albedo=1.0)
    furnace = scene(sensor=orthographic(0.7), ball=ball(inside), sky=FURNACE)
    assert assert_mean(furnace, 1.0).finds <= 0.01
    with pytest.raises(AssertionError, match=r"expected 1\.01: -\d+\.\d standard errors"):
        assert_mean(furnace, 1.01)
    with pytest.raises(ValueError, match="it must be a Mitsuba scene, or independent samples"):
        assert_mean(3.0, 3.0)


# --------------------------------------------------------------------- integrators


@pytest.fixture
def forgetful() -> Iterator[None]:
    """Mitsuba's volpath that takes all albedos for 1."""

    class Forgetful(mi.SamplingIntegrator):
        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.inner = mi.load_dict({"type": "volpath"})

        def sample(self, scene: Any, *args: Any, **kw: Any) -> Any:
            parameters = mi.traverse(scene)
            for key in parameters.keys():
                if key.endswith("albedo.value.value"):
                    parameters[key] = dr.full(type(parameters[key]), 1.0)
            parameters.update()
            return self.inner.sample(scene, *args, **kw)

    mi.register_integrator("forgetful", Forgetful)
    yield


@THOROUGH
def test_integrator_that_forgets_the_albedo_is_named(
    forgetful: None, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(Fault, match=r"null-constant: missing albedo .*: means differ"):
        check_integrator("forgetful", cases=["null-constant"])
    assert cli.main(["check", "--integrator", "forgetful", "--case", "null-constant"]) == 1
    shown = capsys.readouterr().out
    assert re.search(r"^null-constant +WRONG +0\.6%", shown, re.MULTILINE)
    assert "missing albedo" in shown


@THOROUGH
def test_integrators_that_are_right_pass() -> None:
    (verdict,) = check_integrator("volpathmis", cases=["null-constant"], seed=11)
    assert verdict.case == "null-constant" and verdict.agreement is not None
    assert verdict.agreement.finds <= 1.05 * verdict.within


def test_unknown_case_is_named() -> None:
    with pytest.raises(ValueError, match="case is 'moon': it must be one of null-area"):
        check_integrator("volpath", cases=["moon"])
    assert set(exponential.MATRIX) < set(exponential.CASES)


# --------------------------------------------------------------------- pytest


def pytest_run(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "pytest", "-p", "no:nonexp_pytest", "-p", "no:cacheprovider"]
    command += ["-p", "nonexp.testing.pytest_plugin", *arguments]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True)


@THOROUGH
def test_plugin_adds_the_checks_of_a_law(stranger: Path) -> None:
    text = stranger.read_text(encoding="utf-8")
    text = text.replace("1 / self.s\n", "1.01 / self.s\n", 1)
    stranger.write_text(text, encoding="utf-8")
    (stranger.parent / "test_mine.py").write_text("def test_mine():\n    pass\n")
    run = pytest_run(stranger.parent, "-q", "-rs", "--nonexp-law", "strange_laws:SoftRepulsion")
    assert run.returncode == 1, run.stdout + run.stderr
    assert "sigma_bar is 1.01, but -ff'(0) is 1, too large by 1 %" in run.stdout
    assert "Traceback" not in run.stdout and "presupposes" in run.stdout
    (counts,) = re.findall(r"^(\d+ failed.*) in ", run.stdout, re.MULTILINE)
    total = sum(int(n) for n in re.findall(r"(\d+) (?:failed|passed|skipped)", counts))
    assert total == len(laws.CHECKS) + 1
    chosen = ("-q", "--collect-only", "-k", "sampler", "--nonexp-law", "strange_laws.py")
    listed = pytest_run(stranger.parent, *chosen).stdout
    assert len(re.findall(r"^strange_laws\.py::.* sampler of [fp]f$", listed, re.MULTILINE)) == 2
    run = pytest_run(stranger.parent, "-q", "--nonexp-law", "strange_laws:Nothing")
    assert run.returncode == pytest.ExitCode.USAGE_ERROR
    assert "--nonexp-law: law is 'strange_laws:Nothing'" in run.stderr


def test_plugin_loads_nothing_where_it_is_not_asked() -> None:
    """pytest imports it in every run, also of people who do not use nonexp."""
    code = f"""
import json, sys, pytest
before = set(sys.modules)
import importlib.util
spec = importlib.util.spec_from_file_location("nonexp_pytest", {str(PLUGIN)!r})
module = importlib.util.module_from_spec(spec)
sys.modules["nonexp_pytest"] = module
spec.loader.exec_module(module)
pytest.main(["--collect-only", "-qqq", "-p", "no:cacheprovider", "--noconftest",
    "-o", "addopts=", "-p", "no:xdist", {str(ROOT / "tests" / "tiers.py")!r}], [module])
heavy = {{name.partition(".")[0] for name in set(sys.modules) - before}}
print(json.dumps(sorted(heavy & {{"nonexp", "mitsuba", "drjit", "numpy", "scipy"}})))
"""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert json.loads(run.stdout.splitlines()[-1]) == [], run.stdout + run.stderr


@THOROUGH
def test_testing_needs_no_pytest() -> None:
    code = """import sys; sys.modules['pytest'] = None; import nonexp
assert 'nonexp.testing' not in sys.modules; import nonexp.testing"""
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)


def test_package_tells_pytest_of_the_plugin() -> None:
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    assert '[project.entry-points.pytest11]\nnonexp_pytest = "nonexp_pytest"' in project
    assert f'nonexp_pytest = "{PLUGIN.parent.relative_to(ROOT).as_posix()}"' in project
