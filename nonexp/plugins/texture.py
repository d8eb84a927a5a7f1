"""The Mitsuba object that carries a transmittance model into a scene.

:mod:`nonexp.plugins` reloads this module for each variant.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from nonexp import models
from nonexp.numerics.lookup import tables_in
from nonexp.transmittance import Transmittance, parameters
from nonexp.transmittance.functions import load_function
from nonexp.transmittance.kinds import kind_of, parameters_of


class TransmittanceTexture(mi.Texture):
    """Plugin ``transmittance_<model>``: a model and its parameters.

    Mitsuba has no plugin type for transmittance laws; a texture can be nested in a medium, named,
    shared by id, and reached by ``mi.traverse``. Its parameters are the model's fields, checked
    when the scene is loaded and at every ``params.update()``. Numbers and vectors are
    differentiable as far as the model is. Component models are nested textures, in order;
    ``mi.traverse`` calls them ``model_0``, ``model_1``, and so on.
    """

    def __init__(self, key: str, props: mi.Properties) -> None:
        super().__init__(props)
        self.key = key
        self._fields = parameters_of(models.registry[key])
        self._kinds = {name: kind_of(field) for name, field in self._fields.items()}
        # Each parameter of the model is in one of these:
        self.values: dict[str, Any] = {}  # arrays, which mi.traverse finds
        self._components: dict[str, list[TransmittanceTexture]] = {}
        self._fixed: dict[str, Any] = {}  # names, files and functions
        self._accepted: dict[str, Any] = {}  # the last values that were not refused

        checked = models.create(key, **self._given(props))
        for name, kind in self._kinds.items():
            value = getattr(checked, self._fields[name].name)
            if isinstance(kind, parameters.Components):
                if name not in self._components:
                    parts = [models.to_dict(model) for model in value]
                    self._components[name] = [type(self)._of(part) for part in parts]
            elif isinstance(kind, parameters.Vector):
                if len(value):
                    self.values[name] = mi.Float([parameters.number(item) for item in value])
            elif isinstance(kind, parameters.Whole):
                self.values[name] = mi.UInt32(value)
            elif isinstance(kind, parameters.Number) or kind is None:
                self.values[name] = mi.Float(value)
            else:
                self._fixed.setdefault(name, value)
        if any(_differentiable(kind) for kind in self._kinds.values()):
            self._accept()
        else:
            self._adopt(checked)  # it may have made tables: not a second time

    # Each variant has a class of its own, under this one name: hence type(self), above and below.

    @classmethod
    def _of(cls, scene: dict[str, Any]) -> TransmittanceTexture:
        """The texture of a component that the scene did not name: a default of its model."""
        props = mi.Properties(scene["type"])
        for name, value in scene.items():
            if name != "type":
                props[name] = cls._of(value) if isinstance(value, dict) else value
        return cls(scene["type"].removeprefix("transmittance_"), props)

    @property
    def model(self) -> Transmittance:
        """The model with the current values of its parameters, as arrays of width 1."""
        return self._model

    def _given(self, props: mi.Properties) -> dict[str, Any]:
        """The parameters given in the scene, as models take them."""
        kinds = self._kinds.items()
        nested = next((name for name, k in kinds if isinstance(k, parameters.Components)), None)
        given: dict[str, Any] = {}
        for name in props.keys():
            value, kind = props[name], self._kinds.get(name)
            if name == "id":
                continue
            if nested and isinstance(value, type(self)):
                self._components.setdefault(nested, []).append(value)
                continue
            if isinstance(kind, parameters.Text) and kind.is_file and isinstance(value, str):
                value = self._fixed[name] = str(mi.file_resolver().resolve(value))
            elif isinstance(kind, parameters.Function):
                label = f"{models.registry[self.key].__name__}.{name}"
                folders = [str(folder) for folder in mi.file_resolver()]
                value = self._fixed[name] = load_function(label, value, folders)
            given[name] = value
        return given | self._models()

    def _models(self) -> dict[str, list[Transmittance]]:
        """The component models, by field."""
        return {name: [t.model for t in ts] for name, ts in self._components.items()}

    def _accept(self) -> None:
        """Adopt the current values; if they are refused, restore the last accepted ones."""
        try:
            model = self._create()
        except ValueError:
            for name, value in self._accepted.items():
                mi.set_property(self.values[name], value)
            if self._accepted and self._components:
                self._adopt(self._create())  # of its components' current values
            raise
        self._adopt(model)

    def _create(self) -> Transmittance:
        return models.create(self.key, **self.values, **self._fixed, **self._models())

    def _adopt(self, model: Transmittance) -> None:
        self._model = model
        dr.make_opaque(self.values)  # so that other values need no other kernel
        for name, kind in self._kinds.items():
            if isinstance(kind, parameters.Vector):
                dr.eval(getattr(model, self._fields[name].name))
        self._accepted = {name: type(value)(value) for name, value in self.values.items()}
        # dr.freeze finds what a kernel reads in attributes: tables too, which first use makes.
        for law in (model.ff, model.pf):
            law(mi.Float(1))
        for sample in (model.sample_f, model.sample_p):
            sample(lambda: mi.Float(0.5))
        self._tables = [a for table in tables_in(model) for a in table.arrays(mi.Float)]

    def traverse(self, callback: mi.TraversalCallback) -> None:
        flags = mi.ParamFlags
        for name, value in self.values.items():
            differentiable = _differentiable(self._kinds[name])
            flag = flags.Differentiable if differentiable else flags.NonDifferentiable
            callback.put(name, value, flag)
        for textures in self._components.values():
            for position, texture in enumerate(textures):
                callback.put(f"model_{position}", texture, flags.Differentiable)

    def parameters_changed(self, keys: list[str]) -> None:
        self._accept()

    def to_string(self) -> str:
        parts = [f"{name}={_shown(value)}" for name, value in self.values.items()]
        parts += [f"{name}={value}" for name, value in self._fixed.items()]
        parts += [str(t.to_string()) for textures in self._components.values() for t in textures]
        return f"transmittance_{self.key}[{', '.join(parts)}]"


def _differentiable(kind: parameters.Kind | None) -> bool:
    return kind is None or kind.differentiable


def _shown(values: Any) -> str:
    numbers = [f"{float(v):g}" for v in dr.detach(values)]
    return " ".join(numbers if len(numbers) < 9 else [*numbers[:8], "..."])
