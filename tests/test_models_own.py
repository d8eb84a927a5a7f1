"""Adding a model is one class: it is registered, obeys every law of the suite, and renders."""

from __future__ import annotations

import dataclasses
import inspect
import itertools
import math
from collections.abc import Callable, Iterator
from typing import Any, ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import test_exact
import test_laws
from measure import FALSE_ALARM, radiance
from scipy import stats
from tiers import THOROUGH

import nonexp
from nonexp import models
from nonexp.numerics import expm1, log1p


@dataclasses.dataclass(frozen=True, eq=False)
class HalfLogistic(nonexp.Transmittance):
    """T = log2(1 + exp(-k tau)): flights from a particle follow a half-logistic law."""

    k: Any = nonexp.parameter(2 * math.log(2), above=0, doc="decay of the tail")
    examples: ClassVar[tuple[dict[str, Any], ...]] = ({}, {"k": 3.0})

    @property
    def sigma_bar(self) -> Any:
        return self.k / (2 * math.log(2))

    def ff(self, tau: Any) -> Any:
        return log1p(dr.exp(-self.k * tau)) / math.log(2)

    def pf(self, tau: Any) -> Any:
        e = dr.exp(-self.k * tau)
        return 2 * e / (1 + e)

    def pp(self, tau: Any) -> Any:
        e = dr.exp(-self.k * tau)
        return 2 * self.k * e / dr.square(1 + e)

    def sample_f(self, draw: nonexp.Draw) -> Any:
        return -log1p(2 * expm1(-math.log(2) * draw())) / self.k

    def sample_p(self, draw: nonexp.Draw) -> Any:
        u = draw()
        return (log1p(u) - log1p(-u)) / self.k


@pytest.fixture(autouse=True)
def registered() -> Iterator[None]:
    models.register(HalfLogistic, "half_logistic")
    yield
    del models.registry["half_logistic"]


def laws(module: Any) -> list[Any]:
    """Every test of a module that takes a model, with all values of its other parameters."""
    found = []
    for name, test in vars(module).items():
        if not name.startswith("test_") or "case" not in inspect.signature(test).parameters:
            continue
        others = {"effort": [1]}
        for mark in getattr(test, "pytestmark", []):
            if mark.name == "parametrize" and mark.args[0] != "case":
                others[mark.args[0]] = mark.args[1]
        others = {k: v for k, v in others.items() if k in inspect.signature(test).parameters}
        for values in itertools.product(*others.values()):
            given = dict(zip(others, values, strict=True))
            found.append(pytest.param(test, given, id="-".join([name[5:], *map(str, values)])))
    return found


@pytest.mark.parametrize("parameters", HalfLogistic.examples, ids=str)
@pytest.mark.parametrize(("test", "given"), laws(test_laws))
def test_it_obeys_every_law(
    test: Callable[..., None], given: dict[str, Any], parameters: dict[str, Any]
) -> None:
    test(("half_logistic", parameters), **given)


@THOROUGH
@pytest.mark.parametrize(("test", "given"), laws(test_exact))
def test_it_renders_as_exactly_as_the_others(
    test: Callable[..., None], given: dict[str, Any]
) -> None:
    test(("half_logistic", {"k": 3.0}), **given)


def test_scene_files_name_it() -> None:
    for variant in ("llvm_ad_mono", "llvm_ad_rgb"):
        mi.set_variant(variant)
        built = mi.load_string(
            """<scene version="3.0.0"> <integrator type="nonexp_volpath"/>
              <sensor type="orthographic">
                <transform name="to_world">
                  <scale value="1e-4"/> <lookat origin="0 0 5" target="0 0 0" up="0 1 0"/>
                </transform>
              </sensor>
              <emitter type="constant"/>
              <shape type="sphere"> <bsdf type="null"/>
                <medium type="nonexp_homogeneous" name="interior">
                  <float name="sigma_t" value="0.35"/> <float name="albedo" value="0"/>
                  <texture type="transmittance_half_logistic" name="transmittance">
                    <float name="k" value="3"/>
                  </texture>
                </medium>
              </shape>
            </scene>"""
        )
        samples = radiance(built, 2**16, 1)
        expected = math.log2(1 + math.exp(-3 * 0.7))
        assert stats.binomtest(int(samples.sum()), samples.size, expected).pvalue > FALSE_ALARM
        parameters = mi.traverse(built)
        (key,) = (key for key in parameters.keys() if key.endswith("transmittance.k"))
        parameters[key] = 1e-6
        parameters.update()
        assert np.mean(radiance(built, 2**10, 2)) > 0.99
