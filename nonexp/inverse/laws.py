"""The law of a medium within a scene, and others in its place."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import mitsuba as mi

from .. import models
from ..scene import walk
from ..transmittance import Transmittance
from ..transmittance.kinds import kind_of, parameters_of, single
from .derivatives import numbers
from .unknowns import Bounds, Unknown, unknowns

__all__ = ["Candidate", "Place", "candidates"]

Laws = Mapping[str, Mapping[str, Any]] | Iterable[str | Transmittance] | str | Transmittance


@dataclass(frozen=True)
class Candidate:
    """A law to be tried, and which of its parameters are held."""

    label: str
    model: Transmittance
    held: frozenset[str]


def candidates(laws: Laws, fixed: Mapping[str, Any]) -> list[Candidate]:
    """The laws that a user names: keys of models, models, or keys with the values to start at.

    ``ValueError`` for those that do not exist or have no such parameters.
    """
    if isinstance(laws, str | Transmittance):
        laws = [laws]
    if isinstance(laws, Mapping):
        given = [(key, dict(start)) for key, start in laws.items()]
    else:
        given = [_taken_apart(law) for law in laws]
    if not given:
        raise ValueError("laws is empty: it must name at least one law")
    known = {name for key, _ in given for name in _fields(key)}
    for name in fixed:
        if name not in known:
            raise ValueError(f"none of the laws has a parameter {name!r}, which is to be held")
    found: list[Candidate] = []
    for key, start in given:
        own = {name: value for name, value in fixed.items() if name in _fields(key)}
        model = models.create(key, **{**start, **own})
        labels = [one.label for one in found]
        number = 1 + sum(label.partition(" (")[0] == key for label in labels)
        label = key if number == 1 else f"{key} ({number})"
        found.append(Candidate(label, model, frozenset(own)))
    return found


def _fields(key: str) -> dict[str, Any]:
    if key not in models.registry:
        raise ValueError(f"law is {key!r}: it must be one of {', '.join(models.names())}")
    return dict(parameters_of(models.registry[key]))


def _taken_apart(law: str | Transmittance) -> tuple[str, dict[str, Any]]:
    if isinstance(law, str):
        return law, {}
    keys = [key for key, cls in models.registry.items() if cls is type(law)]
    if not keys:
        raise ValueError(f"law is {law!r}: it must be a registered model, or the key of one")
    values = {name: getattr(law, field.name) for name, field in parameters_of(law).items()}
    return keys[0], values


class Place:
    """A medium of a scene, in which laws are exchanged."""

    def __init__(self, scene: mi.Scene, medium: str | None = None) -> None:
        found = {_path(scene, one): one for one in walk.media(scene) if _takes_laws(one)}
        chosen = [path for path in found if medium is None or medium in (path, found[path].id())]
        if len(chosen) != 1:
            names = ", ".join(sorted(found))
            if not found:
                raise ValueError(
                    "the scene has no medium of nonexp's with a law: no law can be fit"
                )
            if medium is None:
                raise ValueError(f"the scene has several media: medium must be one of {names}")
            raise ValueError(f"medium is {medium!r}: it must be one of {names}")
        self.scene, self.path, self.medium = scene, chosen[0], found[chosen[0]]

    @property
    def key(self) -> str:
        """The key of the law that the medium has."""
        return str(self.medium.transmittance.key)

    @property
    def model(self) -> Transmittance:
        """The law that the medium has, with plain numbers."""
        texture = self.medium.transmittance
        key, values = _taken_apart(texture.model)
        plain = {
            name: tuple(map(single, value)) if isinstance(value, tuple) else single(value)
            for name, value in values.items()
        }
        return models.create(key, **plain)

    def put(self, model: Transmittance) -> None:
        """Give the medium another law."""
        self._put(mi.load_dict(models.to_dict(model)))

    def _put(self, texture: Any) -> None:
        before, self.medium.transmittance = self.medium.transmittance, texture
        try:
            self.medium.parameters_changed(["transmittance"])
        except ValueError:
            self.medium.transmittance = before
            raise

    @contextlib.contextmanager
    def kept(self) -> Iterator[None]:
        """Afterwards the medium has the law that it has now."""
        before = self.medium.transmittance
        try:
            yield
        finally:
            self._put(before)

    def unknowns(
        self, held: Iterable[str], bounds: Mapping[str, Bounds], others: Iterable[Unknown]
    ) -> list[Unknown]:
        """The numbers of the medium's law that can be fitted beside ``others``.

        Whole numbers stay, and of what only repeats something else one number: of weights, of which
        only ratios count, and of lengths in optical depth, if the extinction is fitted too.
        """
        parameters = mi.traverse(self.scene)
        prefix = f"{self.path}.transmittance."
        extinction = {f"{self.path}.{name}" for name in ("sigma_t", "scale", "extinction")}
        fields = parameters_of(self.medium.model)
        lengths = any(other.key.startswith(tuple(extinction)) for other in others)
        lengths &= not any(_scales(fields[name]) for name in held if name in fields)
        taken = {(other.key, other.item) for other in others}
        found: list[Unknown] = []
        for key in parameters.keys():
            short = key.removeprefix(prefix)
            if short == key or short in held:
                continue
            node = parameters.properties[key][2]
            field = parameters_of(models.registry[node.key])[key.rpartition(".")[2]]
            kind: Any = kind_of(field)
            if not kind or not kind.differentiable:
                continue
            own = unknowns(parameters, key, None, bounds.get(short), short)
            own = [one for one in own if (one.key, one.item) not in taken]
            array = numbers(parameters[key])
            repeats = lengths and kind.scales and array.max() > 0
            if repeats or (kind.relative and len(array) > 1):
                own = [one for one in own if one.item != int(array.argmax())]
                lengths = lengths and not repeats
            found += own
        return found


def _scales(field: Any) -> bool:
    kind = kind_of(field)
    return kind is not None and kind.scales != 0


def _takes_laws(medium: Any) -> bool:
    return hasattr(medium, "transmittance") and not getattr(medium, "remembers", False)


def _path(scene: mi.Scene, medium: Any) -> str:
    """What ``mi.traverse`` calls a medium."""
    parameters = mi.traverse(scene)
    for key in parameters.keys():
        if key.endswith(".scale") and parameters.properties[key][2] is medium:
            return key.removesuffix(".scale")
    return str(medium.id())
