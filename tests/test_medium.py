"""The medium plugin: parameters and their paths, checks, updates, exponential counterpart."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from build import FURNACE, ball, beam, medium, orthographic, scene, stock
from measure import radiance

JIT = ["llvm_ad_rgb", "llvm_ad_mono", "llvm_ad_spectral"]


def load(**kw: Any) -> Any:
    return mi.load_dict({"type": "nonexp_homogeneous", **kw})


def last_line(error: pytest.ExceptionInfo[BaseException]) -> str:
    return str(error.value).strip().splitlines()[-1]


@pytest.mark.parametrize("variant", JIT, indirect=True)
@pytest.mark.parametrize(
    "parameters",
    [
        {},
        {"sigma_t": 2.0, "albedo": 0.5, "scale": 3.0},
        {"albedo": {"type": "rgb", "value": [0.1, 0.2, 0.3]}, "phase": {"type": "hg", "g": 0.3}},
        {"sigma_t": {"type": "rgb", "value": [0.5, 0.5, 0.5]}, "has_spectral_extinction": False},
        {"sigma_t": {"type": "spectrum", "value": 0.5}, "sample_emitters": False},
    ],
)
def test_parameter_paths_are_those_of_homogeneous(variant: str, parameters: dict[str, Any]) -> None:
    ours, theirs = mi.traverse(load(**parameters)), mi.traverse(mi.load_dict(stock(**parameters)))
    assert set(ours.keys()) == set(theirs.keys())
    for key in theirs.keys():
        if variant == "llvm_ad_spectral" and type(ours[key]) is not type(theirs[key]):
            continue  # a grey rgb extinction: one number here, coefficients of a spectrum there
        np.testing.assert_allclose(np.ravel(ours[key]), np.ravel(theirs[key]), rtol=1e-6)


def test_scene_for_homogeneous_loads_with_its_type_changed() -> None:
    xml = """<scene version="3.0.0"><shape type="sphere">
      <medium type="{}" name="interior">
        <rgb name="albedo" value="0.99, 0.9, 0.96"/> <float name="sigma_t" value="5"/>
        <float name="scale" value="2"/> <boolean name="has_spectral_extinction" value="false"/>
        <boolean name="sample_emitters" value="false"/>
        <phase type="hg"> <float name="g" value="0.7"/> </phase>
      </medium> </shape></scene>"""
    for kind in ("homogeneous", "nonexp_homogeneous"):
        inside = mi.load_string(xml.format(kind)).shapes()[0].interior_medium()
        assert not inside.use_emitter_sampling()
        assert not inside.has_spectral_extinction()
        assert mi.traverse(inside)["phase_function.g"][0] == pytest.approx(0.7)
    assert inside.extinction()[0] == 10


def test_law_is_exponential_by_default_and_needs_no_name() -> None:
    assert "Exponential" in repr(load().model)
    law = {"type": "transmittance_gamma", "alpha": 3}
    assert load(transmittance=law).model.alpha[0] == 3
    assert load(any_name=law).model.alpha[0] == 3
    shared = mi.load_dict(law)
    assert load(transmittance=shared).model is load(transmittance=shared).model


def test_an_extinction_above_one_is_kept() -> None:
    for variant in JIT:
        mi.set_variant(variant)
        thick = load(sigma_t={"type": "rgb", "value": [30, 30, 30]})
        assert thick.extinction()[0] == pytest.approx(30)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"sigma_t": -1.0}, "sigma_t is -1: it must be a finite number >= 0"),
        ({"sigma_t": math.nan}, "sigma_t is nan: it must be a finite number >= 0"),
        ({"sigma_t": math.inf}, "sigma_t is inf: it must be a finite number >= 0"),
        ({"sigma_t": {"type": "rgb", "value": [1, -2, 1]}}, "sigma_t is -2: it must be"),
        ({"albedo": 1.5}, "albedo is 1.5: it must be within [0, 1]"),
        ({"albedo": {"type": "rgb", "value": [0, 0, -0.1]}}, "albedo is -0.1: it must be within"),
        ({"scale": -2.0}, "scale is -2: it must be a finite number >= 0"),
        ({"scale": "two"}, "scale is 'two': it must be a number"),
        ({"sigma_t": 1e30, "scale": 1e30}, "sigma_t * scale is inf: it must be a finite number"),
        ({"phase": {"type": "diffuse"}}, "it must be a nested phase function"),
        ({"transmittance": {"type": "transmittance_gamma", "alpha": "2"}}, "Gamma.alpha is '2'"),
        ({"sigmat": 1.0}, "nonexp_homogeneous has no parameter 'sigmat': its parameters are"),
        ({"transmittance": {"type": "transmittance_linear", "b": 0}}, "Linear.b is 0: it must be"),
        ({"transmittance": {"type": "transmittance_gamma", "b": 1}}, "gamma has no parameter 'b'"),
        ({"transmittance": {"type": "uniform", "value": 1.0}}, "a nested texture of type"),
        (
            {"a": {"type": "transmittance_linear"}, "b": {"type": "transmittance_gamma"}},
            "nonexp_homogeneous holds 2 transmittances: it must be one at most",
        ),
    ],
)
def test_bad_input_is_named(parameters: dict[str, Any], message: str) -> None:
    with pytest.raises(RuntimeError) as error:
        load(**parameters)
    assert message in last_line(error)


WAVELENGTHS: dict[str, dict[str, Any]] = {
    "BlackBodySpectrum": {"type": "blackbody", "temperature": 3000.0},
    "RegularSpectrum": {
        "type": "regular",
        "wavelength_min": 400.0,
        "wavelength_max": 700.0,
        "values": "0.1, 0.4",
    },
    "IrregularSpectrum": {"type": "irregular", "wavelengths": "400, 700", "values": "0.1, 0.4"},
}


@pytest.mark.parametrize("name", ["sigma_t", "albedo"])
@pytest.mark.parametrize("kind", WAVELENGTHS)
def test_spectra_over_wavelengths_need_a_spectral_variant(name: str, kind: str) -> None:
    spectrum = WAVELENGTHS[kind]
    for variant in ("llvm_ad_rgb", "llvm_ad_mono"):
        mi.set_variant(variant)
        for value in (spectrum, {"type": "constvolume", "value": spectrum}):
            with pytest.raises(RuntimeError) as error:
                load(**{name: value})
            expected = f"ValueError: {name} is a spectrum over wavelengths ({kind}), of which "
            assert last_line(error).startswith(f"{expected}variant {variant} has none: ")
            assert "llvm_ad_spectral" in last_line(error)
    mi.set_variant("llvm_ad_spectral")
    if (name, kind) != ("albedo", "BlackBodySpectrum"):  # above 1
        assert load(**{name: spectrum}).chromatic == (name == "sigma_t")


def test_extinction_by_wavelength_in_every_way_to_give_it() -> None:
    for variant in JIT:
        mi.set_variant(variant)
        at = dr.zeros(mi.MediumInteraction3f)
        if mi.is_spectral:
            at.wavelengths = mi.Spectrum([450, 550, 600, 650])
        spectrum = {"type": "spectrum", "value": [(400.0, 1.0), (700.0, 3.0)]}
        for sigma_t in (spectrum, {"type": "rgb", "value": [3, 1, 0.5]}):
            medium = load(sigma_t=sigma_t, scale=2.0)
            assert medium.chromatic == (variant != "llvm_ad_mono")
            values = np.array(medium.extinction(at)).ravel()
            assert len(values) == (dr.size_v(mi.Spectrum) if medium.chromatic else 1)
            if variant == "llvm_ad_rgb" and sigma_t is not spectrum:
                np.testing.assert_allclose(values, [6, 2, 1], rtol=1e-6)
            if variant == "llvm_ad_spectral" and sigma_t is spectrum:
                np.testing.assert_allclose(values, 2 * (1 + np.array([50, 150, 200, 250]) / 150))


# ------------------------------------------------------------------------------- updates


def transmitted(built: Any) -> float:
    return float(radiance(built, 2**16, 1).mean())


def test_updates_take_effect_in_the_next_render() -> None:
    inside = medium("gamma", {"alpha": 2.0}, sigma_t=0.5, albedo=0.0)
    built = scene(sensor=beam(), ball=ball(inside), sky=FURNACE)
    parameters = mi.traverse(built)
    root = "ball.interior_medium."

    assert transmitted(built) == pytest.approx(1.5**-2, abs=0.01)
    parameters[root + "transmittance.alpha"] = 0.5
    parameters.update()
    assert transmitted(built) == pytest.approx(3**-0.5, abs=0.01)
    parameters[root + "sigma_t.value.value"] = 2.0
    parameters[root + "scale"] = 2.0
    parameters.update()
    assert transmitted(built) == pytest.approx(17**-0.5, abs=0.01)
    parameters[root + "scale"] = 0.0
    parameters.update()
    assert transmitted(built) == 1
    parameters[root + "albedo.value.value"] = 1.0
    parameters[root + "scale"] = 1.0
    parameters.update()
    assert transmitted(built) == pytest.approx(1, abs=0.03)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("transmittance.alpha", -1.0, "Gamma.alpha is -1"),
        ("transmittance.alpha", math.nan, "Gamma.alpha is nan"),
        ("sigma_t.value.value", -2.0, "sigma_t is -2"),
        ("scale", math.inf, "scale is inf"),
        ("scale", mi.Float(1, 2), "scale holds 2 numbers"),
        ("albedo.data", mi.TensorXf(np.full((2, 2, 2, 1), 1.4)), "albedo is 1.4"),
    ],
)
def test_a_refused_update_leaves_the_medium_as_it_was(key: str, value: Any, message: str) -> None:
    grid = mi.VolumeGrid(np.full((2, 2, 2), 0.4, dtype=np.float32))
    inside = load(
        sigma_t=0.5,
        albedo={"type": "gridvolume", "grid": grid},
        transmittance={"type": "transmittance_gamma"},
    )
    parameters = mi.traverse(inside)
    before = {k: np.array(v) for k, v in parameters.items()}
    parameters[key] = value
    with pytest.raises(ValueError, match=message):
        parameters.update()
    after = mi.traverse(inside)
    for k, v in before.items():
        np.testing.assert_array_equal(np.array(after[k]), v)
    assert inside.model.alpha[0] == 2
    parameters["scale"] = 3.0
    parameters.update()
    assert inside.extinction()[0] == 1.5


# ------------------------------------------------------------------------------- albedo, stock


def test_volume_albedo_varies_in_space() -> None:
    """One half of the ball absorbs, the other scatters."""
    data = np.zeros((2, 1, 1), dtype=np.float32)
    data[1] = 1.0  # z > 0
    to_world = mi.ScalarTransform4f().translate([-1, -1, -1]).scale(2)
    albedo = {
        "type": "gridvolume",
        "grid": mi.VolumeGrid(data),
        "to_world": to_world,
        "filter_type": "nearest",
    }
    place = mi.ScalarTransform4f()
    for side, lit in ((1, True), (-1, False)):
        camera = orthographic(0.5)
        camera["to_world"] = place.look_at([0, 0, 5 * side], [0, 0, 0], [0, 1, 0])
        built = scene(
            sensor=camera,
            ball=ball({"type": "nonexp_homogeneous", "sigma_t": 20.0, "albedo": albedo}),
            sky=FURNACE,
        )
        mean = radiance(built, 2**12, 1).mean()
        assert (mean > 0.5) == lit


def test_stock_integrator_shows_the_exponential_counterpart() -> None:
    inside = medium("linear", {"b": 0.5}, sigma_t=0.35, albedo=0.0)  # sigma_bar 2
    built = scene("volpath", sensor=beam(), ball=ball(inside), sky=FURNACE)
    assert transmitted(built) == pytest.approx(math.exp(-1.4), abs=0.01)


def test_medium_and_law_describe_themselves() -> None:
    text = str(load(sigma_t=2.0, transmittance={"type": "transmittance_gamma", "alpha": 3}))
    assert "transmittance_gamma[alpha=3]" in text
    assert "NonexpHomogeneous" in text
