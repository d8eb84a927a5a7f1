"""The registry of models and the checks of their parameters."""

from __future__ import annotations

import dataclasses
import math
import pkgutil
import subprocess
import sys
from typing import Any

import pytest
from drjit.llvm.ad import Float

import nonexp
from nonexp import models


def test_every_file_is_a_model() -> None:
    files = sorted(
        info.name for info in pkgutil.iter_modules(models.__path__) if info.name[0] != "_"
    )
    assert models.names() == files
    assert {"exponential", "linear", "quadratic", "constant", "gamma"} <= set(files)


@pytest.mark.parametrize("key", models.names())
def test_model_is_an_immutable_value_with_a_manual(key: str) -> None:
    cls = models.registry[key]
    model = models.create(key, **cls.examples[0])
    assert cls.__doc__ and cls.__doc__.startswith("T = ")
    for field in dataclasses.fields(cls):  # type: ignore[arg-type]
        kind = nonexp.parameters.kind_of(field)
        assert kind is not None and kind.doc
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(model, field.name, 1.0)


def test_default_laws_have_unit_mean_extinction() -> None:
    for key in models.names():
        sigma_bar = models.create(key, **models.registry[key].examples[0]).sigma_bar
        assert sigma_bar == pytest.approx(0 if key == "constant" else 1, rel=1e-12)


@pytest.mark.parametrize(
    ("name", "parameters", "message"),
    [
        ("linar", {}, "model is 'linar': it must be one of constant, "),
        ("gamma", {"alhpa": 1}, "gamma has no parameter 'alhpa': its parameters are alpha"),
        ("constant", {"b": 1}, "constant has no parameter 'b': its parameters are none"),
        ("linear", {"b": 0}, "Linear.b is 0: it must be a finite number > 0"),
        ("linear", {"b": -1}, "Linear.b is -1: it must be"),
        ("quadratic", {"b": math.nan}, "Quadratic.b is nan: it must be"),
        ("gamma", {"alpha": math.inf}, "Gamma.alpha is inf: it must be"),
        ("gamma", {"alpha": "two"}, "Gamma.alpha is 'two': it must be"),
        ("gamma", {"alpha": "2"}, "Gamma.alpha is '2': it must be"),
        ("gamma", {"alpha": True}, "Gamma.alpha is True: it must be"),
        ("gamma", {"alpha": Float(-2)}, "Gamma.alpha is -2: it must be"),
        ("gamma", {"alpha": Float(1, 2)}, "Gamma.alpha is"),
    ],
)
def test_bad_input_is_named(name: str, parameters: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message.replace(".", r"\.").replace("|", r"\|")):
        models.create(name, **parameters)


def test_what_is_no_model_is_refused() -> None:
    class Unfinished(nonexp.Transmittance):
        pass

    with pytest.raises(TypeError, match="does not define ff, pf, pp, sample_f"):
        models.register(Unfinished, "unfinished")
    with pytest.raises(TypeError, match="must be a subclass"):
        models.register(int, "whole")  # type: ignore[type-var]


def test_models_need_no_variant() -> None:
    code = """
import mitsuba, nonexp, drjit
assert mitsuba.variant() is None
model = nonexp.models.create("gamma", alpha=2.0)
assert abs(model.ff(1.0) - 4 / 9) < 1e-15
x = drjit.llvm.Float(1.0)
assert abs(model.ff(x)[0] - 4 / 9) < 1e-7
assert mitsuba.variant() is None
"""
    subprocess.run([sys.executable, "-c", code], check=True)
