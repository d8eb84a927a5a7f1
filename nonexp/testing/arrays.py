"""Laws whose parameters are Dr.Jit arrays, as the renderer has them."""

from __future__ import annotations

import dataclasses
from typing import Any

import drjit as dr
import numpy as np

from ..transmittance import Transmittance, parameters

__all__ = ["with_arrays"]


def with_arrays(
    model: Transmittance, kind: Any, shifts: dict[str, float] | None = None
) -> tuple[Transmittance, dict[str, Any]]:
    """The model with every differentiable parameter, also of its components, rounded to float32
    and held in an opaque array of ``kind``; and these arrays by path: ``alpha``, ``sigma[1]``,
    ``models[0].b``. ``shifts`` are added to the parameters of these paths.
    """
    shifts = shifts or {}
    leaves: dict[str, Any] = {}

    def convert(name: str, kind_of: parameters.Kind | None, value: Any) -> Any:
        if isinstance(kind_of, parameters.Components):
            made = []
            for position, component in enumerate(value):
                prefix = f"{name}[{position}]."
                below = {p.removeprefix(prefix): s for p, s in shifts.items() if prefix in p}
                model, inner = with_arrays(component, kind, below)
                leaves.update({prefix + path: array for path, array in inner.items()})
                made.append(model)
            return made
        if kind_of is None or not kind_of.differentiable:
            return value
        if isinstance(kind_of, parameters.Vector):
            return [leaf(f"{name}[{position}]", item) for position, item in enumerate(value)]
        return leaf(name, value)

    def leaf(path: str, value: Any) -> Any:
        array = kind(float(np.float32(value)) + shifts.get(path, 0.0))
        dr.make_opaque(array)  # a literal would be folded into formulas: 0 inf would be 0
        leaves[path] = array
        return array

    fields = dataclasses.fields(model)  # type: ignore[arg-type]
    given = {f.name: convert(f.name, parameters.kind_of(f), getattr(model, f.name)) for f in fields}
    return type(model)(**given), leaves
