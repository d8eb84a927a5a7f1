"""Fitting the parameters of a scene, and the law of a medium, to images."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mitsuba as mi
import numpy as np

from ..rendering.passes import whole
from ..rendering.progress import row
from ..transmittance.kinds import parameters_of
from .derivatives import restored
from .equations import Images
from .laws import Laws, Place, candidates
from .report import Report, compared
from .result import ImageFit
from .search import Solution, Step, search
from .unknowns import Bounds, Unknown, listed, starts_of, values_of, write
from .views import Array, View, views

__all__ = ["fit"]

_FIRST_SPP = 16

_REACH = math.log(1e6)
"""How far from its start the logarithm of an exposure may go."""

_VAGUE = 2.0
"""Standard error of a logarithm from which on a number counts as not determined."""
_REPORTED = 0.3
"""Share of an unknown in a direction that the images do not determine, to be named with it."""


def fit(
    scene: mi.Scene,
    parameters: str | Sequence[str] | Mapping[str, Any],
    images: Any,
    *,
    laws: Laws | None = None,
    medium: str | None = None,
    fixed: Mapping[str, Any] | None = None,
    bounds: Mapping[str, Bounds] | None = None,
    exposure: str = "fixed",
    sensors: Sequence[Any] | None = None,
    weights: Any = None,
    spp: int = 1024,
    steps: int = 20,
    seed: int = 0,
    progress: bool = False,
) -> Report:
    """Fit parameters of a scene to images, by Gauss-Newton with independent halves.

    ``parameters`` are names as ``mi.traverse(scene)`` gives them, or parts that only one of them
    has, such as ``sigma_t``; a mapping says where to start, otherwise that is what the scene holds.
    Each number of a colour is fitted by itself, or only ``albedo[0]``. ``images`` is an image or a
    list: arrays of height x width x 3, linear; EXR files; bitmaps; results of ``nonexp.render``,
    whose own noise then does not count as misfit. They belong to the scene's first ``sensors``, or
    to those that are named.

    With ``laws`` the medium's law is exchanged and all of its continuous parameters are fitted too:
    ``{"gamma": {"alpha": 4}, "exponential": {}}``, where values are starts; names; or models. Laws
    are compared by their loss. ``fixed`` holds parameters of laws at a value. ``medium`` says which
    one it is, where the scene has several.

    ``bounds`` replaces the range of a parameter, which is that of its law, [0, 1] for albedos and
    reflectances, and >= 0 for extinction and light. ``exposure="free"`` fits a factor on the image
    of each sensor. ``weights``, height x width for each image, are 0 where pixels do not count.

    Renders grow from 16 samples per pixel to ``spp``, for each of the two halves, in the last step.
    There are at most so many ``steps``; the report says if the search did not converge.
    Derivatives are found by path replay, or by differences where that refuses. Afterwards the scene
    is what it was; ``report.best.apply(scene)`` gives it the result.

    Raises ``KeyError`` for parameters that the scene does not have, ``ValueError`` for arguments
    that are not allowed, for images that do not fit the sensors, and if no law can be fitted.
    """
    spp, steps = whole("spp", spp, 4), whole("steps", steps, 1)
    if exposure not in ("fixed", "free"):
        raise ValueError(f"exposure is {exposure!r}: it must be 'fixed' or 'free'")
    task = _Task(
        scene,
        views(scene, images, sensors, weights),
        exposure == "free",
        spp,
        steps,
        np.random.default_rng(whole("seed", seed, 0)),
    )
    wanted, limits = _wanted(parameters), dict(bounds or {})
    fits: list[ImageFit] = []
    refused: dict[str, str] = {}
    with contextlib.ExitStack() as stack:
        traversed = mi.traverse(scene)
        own = starts_of(traversed, wanted, limits)
        for key in dict.fromkeys(one.key for one in own):
            stack.enter_context(restored(traversed, key))
        update = stack.enter_context(row("fit")) if progress else lambda share, state: None
        if laws is None:
            _check_bounds(limits, wanted)
            place = _only_place(scene, medium)
            fits.append(task.solve(place.key if place else "scene", place, own, update))
        else:
            place = Place(scene, medium)
            _check_apart(own, place)
            tried = candidates(laws, fixed or {})
            _check_bounds(limits, wanted, *(one.model for one in tried))
            for number, candidate in enumerate(tried):
                told = _part(update, number, len(tried))
                try:
                    with place.kept():
                        place.put(candidate.model)
                        found = [*own, *place.unknowns(candidate.held, limits, own)]
                        fits.append(task.solve(candidate.label, place, found, told))
                except ValueError as error:
                    if len(tried) == 1:
                        raise
                    refused[candidate.label] = str(error)
    if not fits:
        raise ValueError("; ".join(f"{law}: {why}" for law, why in refused.items()))
    fits.sort(key=lambda one: one.loss)
    targets = tuple(view.image for view in task.views)
    return Report(tuple(fits), refused, targets, tuple(compared(fits)))


@dataclass(frozen=True, eq=False)
class _Task:
    """What is the same for all laws."""

    scene: mi.Scene
    views: list[View]
    exposed: bool
    spp: int
    steps: int
    random: np.random.Generator

    def seed(self) -> int:
        return int(self.random.integers(2**31))

    def solve(
        self, label: str, place: Place | None, found: list[Unknown], told: Callable[..., None]
    ) -> ImageFit:
        """Fit one law, which the scene has."""
        parameters = mi.traverse(self.scene)
        count = len(found)
        if not count:
            raise ValueError("there is nothing to fit: name parameters of the scene, or laws")

        def put(at: Array) -> None:
            write(parameters, found, values_of(found, at[:count]))

        images = Images(self.scene, self.views, found, put, self.exposed)
        start = np.array([one.coordinate(one.start) for one in found])
        limits = [one.limits for one in found]
        if self.exposed:
            start = np.concatenate([start, np.zeros(len(self.views))])
            factors = images.exposures(start, _FIRST_SPP, self.seed)
            if not np.all(factors > 0):
                raise ValueError("the images at the start are black: no exposure fits them")
            start[count:] = np.log(factors)
            limits += [(u - _REACH, u + _REACH) for u in start[count:]]

        def shown(step: Step) -> None:
            share = math.log2(step.spp / _FIRST_SPP + 1) / math.log2(self.spp / _FIRST_SPP + 1)
            loss = f"loss {step.loss:.3g} ± {step.error:.1g}"
            told(min(share, 1.0), f"{label}, {step.spp} spp, {loss}")

        solution = search(
            images,
            start,
            limits,
            spp=self.spp,
            first_spp=_FIRST_SPP,
            most=self.steps,
            seed=self.seed,
            told=shown,
        )
        put(solution.at)
        return self._fit(label, place, found, images, solution)

    def _fit(
        self,
        label: str,
        place: Place | None,
        found: list[Unknown],
        images: Images,
        solution: Solution,
    ) -> ImageFit:
        """The result, while the scene has the fitted parameters."""
        numbers = [*found, *self._exposures(solution)]
        at, first = solution.at, solution.steps[0].at
        slopes = np.array([one.slope(u) for one, u in zip(numbers, at, strict=True)])
        errors, notes = _errors(numbers, solution, slopes)
        weights = sum(view.count for view in self.views)
        noise = sum(view.noise * view.count for view in self.views) / weights
        fitted = solution.fitted
        return ImageFit(
            law=label,
            model=place.model if place else None,
            values=dict(zip((one.label for one in numbers), values_of(numbers, at), strict=True)),
            errors=errors,
            covariance=solution.covariance * np.outer(slopes, slopes),
            start={one.label: one.value(u) for one, u in zip(numbers, first, strict=True)},
            exposures=tuple(map(float, np.exp(at[len(found) :]))) or (1.0,) * len(self.views),
            loss=fitted.loss - noise,
            loss_error=fitted.error,
            steps=tuple(solution.steps),
            converged=solution.converged,
            images=tuple(fitted.mean(number) for number in range(len(self.views))),
            ways=dict(images.ways),
            notes=tuple(notes),
            medium=place.path if place else None,
            unknowns=tuple(found),
        )

    def _exposures(self, solution: Solution) -> list[Unknown]:
        if not self.exposed:
            return []
        start = np.exp(solution.steps[0].at[-len(self.views) :])
        names = [f"exposure[{i}]" if len(start) > 1 else "exposure" for i in range(len(start))]
        pairs = zip(names, start, strict=True)
        return [Unknown("", 0, name, float(value), 0.0, math.inf) for name, value in pairs]


def _errors(
    numbers: list[Unknown], solution: Solution, slopes: Array
) -> tuple[dict[str, float], list[str]]:
    """Standard errors, and what to say of them."""
    notes: list[str] = []
    spread = np.sqrt(np.maximum(np.diag(solution.covariance), 0))
    errors = dict(zip((one.label for one in numbers), map(float, spread * slopes), strict=True))
    for i, one in enumerate(numbers):
        if solution.limits[i]:
            value = one.value(solution.at[i])
            ends = [end for end in (one.low, one.high) if math.isfinite(end)]
            if any(math.isclose(value, end, rel_tol=1e-5, abs_tol=1e-9) for end in ends):
                errors[one.label] = math.nan
                notes.append(f"{one.label} is at the limit of its range, {value:g}.")
            else:
                errors[one.label] = math.inf
                notes.append(f"{one.label} is not determined: no finite value is best.")
        elif one.logarithmic and spread[i] > _VAGUE:
            errors[one.label] = math.inf
            notes.append(f"{one.label} is not determined by these images, not even roughly.")
    for direction in solution.blind:
        share = np.abs(direction) / np.abs(direction).max()
        names = [one.label for one, part in zip(numbers, share, strict=True) if part > _REPORTED]
        errors |= dict.fromkeys(names, math.inf)
        if len(names) == 1:
            notes.append(f"{names[0]} is not determined by these images.")
        else:
            listed = f"{', '.join(names[:-1])} and {names[-1]}"
            notes.append(f"{listed} cannot be told apart by these images.")
    if not solution.converged:
        most = int(np.argmax(np.abs(solution.last)))
        one, end = numbers[most], float(solution.at[most])
        before, after = one.value(end - float(solution.last[most])), one.value(end)
        notes.append(
            f"The search did not converge in {len(solution.steps) - 1} steps: the last moved "
            f"{one.label} from {before:.4g} to {after:.4g}."
        )
    return errors, notes


# --------------------------------------------------------------------- arguments


def _wanted(parameters: str | Sequence[str] | Mapping[str, Any]) -> dict[str, Any]:
    """The parameters with their starts; None: what the scene holds."""
    if isinstance(parameters, Mapping):
        return dict(parameters)
    return dict.fromkeys(listed(parameters))


def _only_place(scene: mi.Scene, medium: str | None) -> Place | None:
    """The medium with a law; None where there is none or several, and none is named."""
    try:
        return Place(scene, medium)
    except ValueError:
        if medium is not None:
            raise
        return None


def _check_apart(own: Sequence[Unknown], place: Place) -> None:
    for one in own:
        if one.key.startswith(f"{place.path}.transmittance."):
            raise ValueError(
                f"{one.label} belongs to the law: give it in laws, as in "
                f"{{{place.key!r}: {{{one.key.rpartition('.')[2]!r}: {one.start:g}}}}}"
            )


def _check_bounds(bounds: Mapping[str, Any], wanted: Mapping[str, Any], *laws: Any) -> None:
    known = sorted({*wanted, *(name for law in laws for name in parameters_of(law))})
    for name, pair in bounds.items():
        if name not in known and "." not in name:
            raise ValueError(
                f"bounds has {name!r}, which is not fitted: it must be one of {', '.join(known)}"
            )
        if len(pair) != 2:
            raise ValueError(f"the bounds of {name} are {pair}: it must be two numbers")


def _part(update: Callable[..., None], number: int, count: int) -> Callable[[float, str], None]:
    """Tell of one of several fits."""
    return lambda share, state: update((number + share) / count, state)
