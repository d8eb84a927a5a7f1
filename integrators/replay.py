"""Derivatives of images: which parameters have one, and the two passes that give them."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from .adjoint import Adjoint, Wanted, leave_one_out

_KINDS = {
    "sigma_t": "extinction",
    "scale": "extinction",
    "extinction": "extinction",
    "transmittance": "law",
    "albedo": "albedo",
    "phase_function": "phase",
    "emission": "emission",
}
"""First part of a medium's parameter -> what depends on it."""

_PLACES = {"to_world", "position", "direction", "vertex_positions", "vertex_normals", "faces"}
"""Parameters of geometry: they would move what a path meets."""


def replay(integrator: Any, scene: mi.Scene, sensor: Any) -> Any:
    """An integrator of Mitsuba's path replay kind whose paths are those of ``integrator``."""
    wanted = wanted_of(scene)
    sensor = scene.sensors()[sensor] if isinstance(sensor, int) else sensor
    medium = sensor.get_medium()
    base: Any = mi.ad.integrators.common.RBIntegrator

    class Replay(base):
        def sample(
            self,
            mode: dr.ADMode,
            scene: mi.Scene,
            sampler: mi.Sampler,
            ray: mi.Ray3f,
            δL: Any = None,
            state_in: Any = None,
            active: Any = True,
            **_: Any,
        ) -> tuple[Any, Any, list[Any], Any]:
            if mode == dr.ADMode.Primal:
                path = integrator.trace(scene, sampler, ray, medium, active, regular=True)
                return path.radiance, path.opaque, [], path.radiance
            # Without bias only if the other samples of a pixel know nothing of this one.
            independent = sampler.class_name() == "IndependentSampler"
            count = sampler.sample_count() if independent else 1
            baseline = leave_one_out(state_in, count) if count > 1 else None
            adjoint = Adjoint(mode, state_in, δL, baseline, wanted)
            path = integrator.trace(scene, sampler, ray, medium, active, adjoint, regular=True)
            self.residual = state_in - path.radiance
            result = path.tangent if mode == dr.ADMode.Forward else δL
            return result, path.opaque, [], state_in

    return Replay(mi.Properties("replay"))


def wanted_of(scene: mi.Scene) -> Wanted:
    """What derivatives are wanted by: the parameters of a scene that have gradients enabled.

    ``ValueError`` for one by which there is none.
    """
    parameters = mi.traverse(scene)
    media: dict[int, set[str]] = {}
    surfaces = emitters = False
    for key in parameters.keys():
        if not dr.grad_enabled(parameters[key]):
            continue
        if int(parameters.properties[key][3]) & int(mi.ParamFlags.NonDifferentiable):
            raise ValueError(f"no derivative by {key}: it is not differentiable")
        owner, path = _owner(parameters, key)
        tail = key.split(".")[-1]
        if tail in _PLACES or owner is None:
            raise ValueError(f"no derivative by {key}: it would move what paths meet")
        if isinstance(owner, mi.Medium):
            media.setdefault(id(owner), set()).add(_kind(owner, key, path))
        elif isinstance(owner, mi.BSDF):
            _check_surface(owner, key)
            surfaces = True
        else:
            emitters = True
    return Wanted({k: frozenset(v) for k, v in media.items()}, surfaces, emitters)


def _owner(parameters: Any, key: str) -> tuple[Any, str]:
    """The medium, BSDF or emitter that a parameter belongs to, and its name there."""
    node = parameters.properties[key][2]
    chain = [node]
    while node in parameters.hierarchy and parameters.hierarchy[node][0] is not None:
        node = parameters.hierarchy[node][0]
        chain.append(node)
    for depth, node in enumerate(chain):
        if isinstance(node, mi.Medium | mi.BSDF | mi.Emitter):
            return node, ".".join(key.split(".")[-(depth + 1) :])
    return None, key


def _kind(medium: Any, key: str, path: str) -> str:
    if getattr(medium, "remembers", False):
        raise ValueError(
            f"no derivative by {key}: a medium with memory has none; use nonexp.inverse.differences"
        )
    kind = next((kind for name, kind in _KINDS.items() if name in path.split(".")), None)
    model = getattr(medium, "model", None)
    if kind is None or (model is None and not medium.is_homogeneous()):
        raise ValueError(f"no derivative by {key}: only nonexp's media and homogeneous ones have")
    density = getattr(medium, "density", None)
    if density is not None and key.endswith("sigma_t.data"):
        if len(medium.ratios) > 1:
            raise ValueError(
                f"no derivative by {key}: its channels are multiples of one grid; give one density "
                "and the parameter extinction"
            )
        kind = "density"
    if kind in ("extinction", "law", "density") and model is not None and model.jumps is None:
        raise ValueError(
            f"no derivative by {key}: flights of {type(model).__name__} have point masses, or "
            "densities that are not bounded or not declared; use nonexp.inverse.differences"
        )
    return kind


def _check_surface(bsdf: Any, key: str) -> None:
    if mi.has_flag(bsdf.flags(), mi.BSDFFlags.Delta) or mi.has_flag(
        bsdf.flags(), mi.BSDFFlags.Null
    ):
        raise ValueError(
            f"no derivative by {key}: this surface also reflects or lets through in single "
            "directions; use nonexp.inverse.differences"
        )
