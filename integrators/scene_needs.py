"""What a scene makes the integrator do: looked up once, before anything is traced.

The integrator's kernel holds only the parts that these answers ask for.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import mitsuba as mi


@dataclass(frozen=True)
class SceneNeeds:
    """Facts about a scene that shape the kernel."""

    media: tuple[Any, ...]
    """Every medium on a shape, a sensor or an emitter, and the one the rays start in."""
    null_surfaces: bool
    """A ray can pass straight through some surface."""
    emitters: bool
    """There is something to connect to."""
    hittable_emitters: bool
    """A ray can run into an emitter: not all of them are points or directions."""
    infinite_emitters: bool
    """Light arrives from infinity (environment, directional)."""

    @staticmethod
    def of(scene: mi.Scene, start: Any = None) -> SceneNeeds:
        """Look at ``scene``; ``start`` is the medium in which the rays begin, if any."""
        media: list[Any] = []
        for medium in (start, *_media(scene)):
            if medium is not None and medium not in media:
                media.append(medium)
        emitter_flags = [emitter.flags() for emitter in scene.emitters()]
        delta = mi.EmitterFlags.Delta
        return SceneNeeds(
            media=tuple(media),
            null_surfaces=any(
                mi.has_flag(shape.bsdf().flags(), mi.BSDFFlags.Null)
                for shape in scene.shapes()
                if shape.bsdf() is not None
            ),
            emitters=bool(emitter_flags),
            hittable_emitters=any(not mi.has_flag(flags, delta) for flags in emitter_flags),
            infinite_emitters=any(
                mi.has_flag(flags, mi.EmitterFlags.Infinite) for flags in emitter_flags
            ),
        )


def _media(scene: mi.Scene) -> Iterator[Any]:
    for shape in scene.shapes():
        yield shape.interior_medium()
        yield shape.exterior_medium()
    for endpoint in (*scene.sensors(), *scene.emitters()):
        yield endpoint.get_medium()
