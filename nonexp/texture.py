"""The Mitsuba object that carries a transmittance model into a scene.

Evaluated anew for each variant by :mod:`nonexp.plugins`.
"""

from __future__ import annotations

import dataclasses

import drjit as dr
import mitsuba as mi

from nonexp import models
from nonexp.transmittance import Transmittance


class TransmittanceTexture(mi.Texture):
    """Plugin ``transmittance_<model>``: a model and its parameters.

    Mitsuba has no plugin type for transmittance laws; a texture can be nested in a medium, named,
    shared by id, and reached by ``mi.traverse``. Its parameters are the model's fields; each is
    differentiable, and is checked when the scene is loaded and at every ``params.update()``.
    """

    def __init__(self, key: str, props: mi.Properties) -> None:
        super().__init__(props)
        self.key = key
        fields = [f.name for f in dataclasses.fields(models.registry[key])]  # type: ignore[arg-type]
        given = {name: props[name] for name in props.keys() if name != "id"}
        checked = models.create(key, **given)
        self.values = {name: mi.Float(getattr(checked, name)) for name in fields}
        self._accepted: dict[str, mi.Float] = {}
        self._accept()

    @property
    def model(self) -> Transmittance:
        """The model with the present values of its parameters, as arrays of width 1."""
        return self._model

    def _accept(self) -> None:
        """Check the values; go back to the last good ones if they are refused."""
        try:
            self._model = models.create(self.key, **self.values)
        except ValueError:
            for name, value in self._accepted.items():
                mi.set_property(self.values[name], value)
            raise
        dr.make_opaque(self.values)  # other values, same kernel
        self._accepted = {name: mi.Float(value) for name, value in self.values.items()}

    def traverse(self, callback: mi.TraversalCallback) -> None:
        for name, value in self.values.items():
            callback.put(name, value, mi.ParamFlags.Differentiable)

    def parameters_changed(self, keys: list[str]) -> None:
        self._accept()

    def to_string(self) -> str:
        values = ", ".join(f"{name}={float(v[0]):g}" for name, v in self.values.items())
        return f"transmittance_{self.key}[{values}]"
