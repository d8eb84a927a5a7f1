"""What the integrator found in a scene, and what it therefore leaves out: for people to read."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from nonexp.plugins.spectra import visible

from .media import Entry, Media, OneMedium, scene_media
from .needs import SceneNeeds, forgotten_media
from .rays import separate


@dataclass(frozen=True)
class Finding:
    """One question about a scene, its answer, and what follows for the kernel."""

    question: str
    answer: str
    consequence: str


def findings(scene: mi.Scene) -> list[Finding]:
    """All that shapes the kernel of ``nonexp_volpath`` on this scene, from its first sensor."""
    sensors = scene.sensors()
    start = sensors[0].get_medium() if sensors else None
    wanted = getattr(scene.integrator(), "refractive_nee", "auto")
    hides = getattr(scene.integrator(), "hide_emitters", False)
    expected = getattr(scene.integrator(), "expected_emission", "auto")
    needs = SceneNeeds.of(scene, start, wanted, hides, expected)
    media = scene_media(needs.media, needs.sealed, needs.shell is not None, expected=needs.expected)
    spheres = [sphere.shape for sphere in separate(scene, needs.shell)[0]]
    emitters = Counter(emitter.class_name() for emitter in scene.emitters())
    return [
        *_media(needs, media),
        _cameras(scene),
        _null(needs, media, spheres),
        _coincident(needs),
        _spheres(scene, spheres),
        Finding(
            "emitters",
            ", ".join(f"{n} {name}" if n > 1 else name for name, n in emitters.items()) or "none",
            _emitters(needs),
        ),
        _connections(needs, media),
        _glass(scene, needs, wanted),
    ]


def _media(needs: SceneNeeds, media: Media | None) -> list[Finding]:
    empty = len(needs.media) - (len(media.entries) if media else 0)
    vacuum = f" (and {empty} in which nothing collides)" if empty else ""
    if media is None:
        return [Finding("media", f"none{vacuum}", "skipped: flights, phase functions, albedo")]
    if isinstance(media, OneMedium):
        how = "called directly; a ray carries a mask, no index"
    else:
        how = "one indirect call each, only these media traced"
    rows = [Finding("media", f"{len(media.entries)}{vacuum}", how)]
    for number, entry in enumerate(media.entries, 1):
        rows.append(Finding(f"medium {number}", _describe(entry), _medium_effect(entry)))
    if media.chromatic:
        colour = "one hero channel per path, weighted over all channels"
        rows.append(Finding("extinction", "differs between channels", colour))
    else:
        rows.append(Finding("extinction", "the same in all channels", "skipped: spectral weights"))
    return [*rows, *_varying(media), _memory(media), _emission(media), *_expected(media)]


def _varying(media: Media) -> list[Finding]:
    """How flights pass media whose density varies in space."""
    if not media.any("varies"):
        return [
            Finding("heterogeneous media", "none", "skipped: walks through grids, null collisions")
        ]
    rows = []
    for entry in media.entries:
        if entry.varies:
            choice = getattr(entry.pointer, "choice", None)
            why = choice.reason if choice else "as Mitsuba's own"
            how = (
                "null collisions (delta tracking)" if entry.tracked else "a walk from cell to cell"
            )
            rows.append(Finding(f"flights in {_medium_name(entry)}", how, why))
    return rows


def _some(media: Media, fact: str, question: str, skipped: str, effect: str) -> Finding:
    """The media for which a fact holds."""
    names = [_medium_name(entry) for entry in media.entries if getattr(entry, fact)]
    if not names:
        return Finding(question, "none", f"skipped: {skipped}")
    return Finding(question, ", ".join(names), effect)


def _memory(media: Media) -> Finding:
    skipped, effect = "the material that a path is in", "paths carry their material"
    return _some(media, "remembers", "media with memory", skipped, effect)


def _emission(media: Media) -> Finding:
    skipped, effect = "emission at collisions", "added at every collision"
    return _some(media, "emits", "media that emit", skipped, effect)


def _expected(media: Media) -> list[Finding]:
    """Where expected values take the place of draws."""
    far = [entry.far for entry in media.entries if entry.expects]
    ahead = "" if not far or max(far) == dr.inf else f", up to {max(far):g} mean free paths ahead"
    rule = "fewer are kept, and count more"
    return [
        _some(media, "expects", "emission met in media", "expected values", f"expected{ahead}"),
        _some(media, "refuses", "collisions in dark media", "a rule for them", rule),
    ]


def _medium_name(entry: Entry) -> str:
    return entry.pointer.id() or type(entry.pointer).__name__


def _describe(entry: Entry) -> str:
    name = _medium_name(entry)
    if entry.tracked and not hasattr(entry.pointer, "model"):
        return f"{name}: exponential, heterogeneous"
    if entry.remembers:
        return f"{name}: {_materials(entry.pointer)}"
    texture = getattr(entry.pointer, "transmittance", None)
    law = texture.to_string().removeprefix("transmittance_") if texture else "exponential"
    mei = visible()
    mei.wi = mi.Vector3f(0, 0, 1)
    extinction = getattr(entry.pointer, "extinction", entry.extinction)
    shown = _range(extinction(mei))
    density = getattr(entry.pointer, "density", None)
    if density is not None:
        size = "x".join(map(str, density.voxels))
        shown += f" times a grid of {size} up to {entry.pointer.most:.3g}"
    phase = entry.pointer.phase_function().class_name()
    return f"{name}: {law}, sigma_t {shown}, {phase}"


def _range(extinction: Any) -> str:
    sigma_t = np.unique(np.round(np.array(dr.detach(extinction)), 6))
    return f"{sigma_t[0]:g}" if len(sigma_t) == 1 else f"{sigma_t[0]:g} to {sigma_t[-1]:g}"


def _materials(medium: Any) -> str:
    """The two materials of a medium with memory."""
    sigma_t = " and ".join(map(_range, medium.extinctions(visible())))
    chords = " and ".join(f"{float(dr.detach(chord)[0]):g}" for chord in medium.chord)
    phases = " and ".join(phase.class_name() for phase in medium.phases)
    return f"two materials with memory, sigma_t {sigma_t}, chords {chords}, {phases}"


def _medium_effect(entry: Entry) -> str:
    if entry.sealed:
        return "closed, no emitter within: no straight connections from inside"
    if not entry.connects:
        return "sample_emitters is off: no connections from collisions"
    return "collisions connect to emitters"


def _cameras(scene: mi.Scene) -> Finding:
    found = [f"{_name(camera)} in {medium.id()}" for camera, medium in forgotten_media(scene)]
    question = "sensors in a medium that they do not refer to"
    if not found:
        return Finding(question, "none", "")
    return Finding(question, ", ".join(found), "warning: their rays start in vacuum")


def _null(needs: SceneNeeds, media: Media | None, spheres: list[mi.Shape]) -> Finding:
    if needs.null_ball in spheres and not (media and media.any("varies")):
        answer, effect = "one sphere", "skipped: walks; flights go on behind it"
    elif needs.shell is not None and not needs.null_surfaces:
        answer, effect = f"only {_name(needs.shell)}", "left out: its grid says where the medium is"
    elif needs.null_surfaces:
        answer, effect = "some", "shadow rays walk through them; flights go on behind them"
    else:
        answer, effect = "none", "skipped: walks; a shadow ray is one occlusion test"
    return Finding("surfaces that let rays straight through", answer, effect)


def _coincident(needs: SceneNeeds) -> Finding:
    question = "boundaries that coincide with other surfaces"
    pairs = [" and ".join(sorted(map(_name, pair))) for pair in needs.coincident.pairs]
    pairs += [f"faces of {_name(mesh)}" for mesh, _ in needs.coincident.doubled]
    if not pairs:
        return Finding(question, "none", "skipped: looks for all surfaces in one place")
    shown = ", ".join(pairs[:4]) + (f" and {len(pairs) - 4} more" if len(pairs) > 4 else "")
    return Finding(question, shown, "rays look for all surfaces in one place")


def _name(thing: Any) -> str:
    return str(thing.id() or thing.class_name())


def _spheres(scene: mi.Scene, spheres: list[mi.Shape]) -> Finding:
    count = sum(shape.class_name() == "Sphere" for shape in scene.shapes())
    if spheres:
        answer = f"{len(spheres)} of {len(scene.shapes())} shapes"
        return Finding("spheres", answer, "intersected analytically, before all other shapes")
    return Finding("spheres", f"{count}" if count else "none", "skipped: analytic spheres")


def _emitters(needs: SceneNeeds) -> str:
    skipped = []
    if not needs.emitters:
        return "skipped: connections, emission"
    if not needs.hittable_emitters:
        skipped.append("emission hit by rays")
    if not needs.delta_emitters:
        skipped.append("points and directions")
    if not needs.infinite_emitters:
        skipped.append("light from infinity")
    return f"skipped: {', '.join(skipped)}" if skipped else "all kinds"


def _connections(needs: SceneNeeds, media: Media | None) -> Finding:
    ends = []
    if needs.smooth_surfaces:
        ends.append("surfaces")
    if media and media.connects:
        ends.append("collisions")
    if not (needs.emitters and ends):
        return Finding("connections to emitters", "none", "skipped: shadow rays, two-way weights")
    return Finding(
        "connections to emitters",
        f"from {' and '.join(ends)}",
        "skipped: media on shadow rays" if media and media.all("sealed") else "shadow rays",
    )


def _glass(scene: mi.Scene, needs: SceneNeeds, wanted: str) -> Finding:
    question = "connections through smooth glass"
    if needs.lobes:
        names = ", ".join(_name(shape) for shape in needs.lobes)
        return Finding(question, f"out of {names}", "a search for the way, media on it")
    skipped = "skipped: the search for a way through the surface"
    if wanted == "off":
        return Finding(question, "refractive_nee is off", skipped)
    if SceneNeeds.of(scene, refractive="on").lobes:
        return Finding(question, "nothing would gain by them", skipped)
    return Finding(question, "no such surface", skipped)
