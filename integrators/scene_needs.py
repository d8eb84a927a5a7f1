"""What a scene makes the integrator do: looked up once, before anything is traced.

The integrator's kernel holds only the parts that these answers ask for.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mitsuba as mi

from nonexp.scene import walk as scenewalk

from .closed import encloses
from .lobes import lobes


@dataclass(frozen=True)
class SceneNeeds:
    """Facts about a scene that shape the kernel."""

    media: tuple[Any, ...]
    """Every medium on a shape, a sensor or an emitter, and the one the rays start in."""
    sealed: tuple[Any, ...]
    """Those media from which no straight line can reach an emitter: nothing to connect to there."""
    smooth_surfaces: bool
    """Some surface scatters smoothly: connections to emitters begin on it."""
    smooth_boundaries: bool
    """Some medium boundary scatters smoothly: connections begin on it, to either side."""
    null_surfaces: bool
    """A ray can pass straight through some surface."""
    emitters: bool
    """There is something to connect to."""
    hittable_emitters: bool
    """A ray can run into an emitter: not all of them are points or directions."""
    delta_emitters: bool
    """Some emitter is a point or a direction: only connections find it."""
    infinite_emitters: bool
    """Light arrives from infinity (environment, directional)."""
    near_emitters: bool = False
    """Some emitter is a point, so that its light depends on where it is seen from."""
    null_ball: Any = None
    """The sphere that is the only null surface, and the only boundary of the only medium."""
    lobes: tuple[Any, ...] = ()
    """Smooth dielectric shapes through which connections from inside bend."""

    @staticmethod
    def of(scene: mi.Scene, start: Any = None, refractive: str = "auto") -> SceneNeeds:
        """Look at ``scene``; ``start`` is the medium in which the rays begin, if any.

        ``refractive`` says whether connections bend: ``auto`` (where that helps), ``on`` (wherever
        they can) or ``off``.
        """
        shapes, media = scenewalk.shapes(scene), scenewalk.media(scene)
        if start is not None and start not in media:
            media.insert(0, start)
        emitter_flags = [emitter.flags() for emitter in scene.emitters()]
        delta, infinite = mi.EmitterFlags.Delta, mi.EmitterFlags.Infinite
        return SceneNeeds(
            media=tuple(media),
            sealed=tuple(m for m in media if m != start and _sealed(scene, shapes, m)),
            smooth_surfaces=any(_scatters(shape, mi.BSDFFlags.Smooth) for shape in shapes),
            smooth_boundaries=any(
                shape.is_medium_transition() and _scatters(shape, mi.BSDFFlags.Smooth)
                for shape in shapes
            ),
            null_surfaces=any(_scatters(shape, mi.BSDFFlags.Null) for shape in shapes),
            emitters=bool(emitter_flags),
            hittable_emitters=any(not mi.has_flag(flags, delta) for flags in emitter_flags),
            delta_emitters=any(mi.has_flag(flags, delta) for flags in emitter_flags),
            infinite_emitters=any(mi.has_flag(flags, infinite) for flags in emitter_flags),
            near_emitters=any(
                mi.has_flag(flags, delta) and not mi.has_flag(flags, infinite)
                for flags in emitter_flags
            ),
            null_ball=_null_ball(shapes, media),
            lobes=lobes(scene, shapes, refractive) if emitter_flags else (),
        )


def _null_ball(shapes: list[Any], media: list[Any]) -> Any:
    """The only shape that lets anything straight through, if it is a plain sphere of the medium."""
    null = [shape for shape in shapes if _scatters(shape, mi.BSDFFlags.Null)]
    bounds = [shape for shape in shapes if shape.is_medium_transition()]
    if len(null) != 1 or bounds != null or len(media) != 1:
        return None
    ball = null[0]
    plain = ball.shape_type() == mi.ShapeType.Sphere and not ball.has_flipped_normals()
    plain = plain and ball.bsdf().class_name() == "Null" and not ball.is_emitter()
    inside = ball.interior_medium() == media[0] and ball.exterior_medium() is None
    return ball if plain and inside else None


def _scatters(shape: mi.Shape, flag: mi.BSDFFlags) -> bool:
    bsdf = shape.bsdf()
    return bsdf is not None and bool(mi.has_flag(bsdf.flags(), flag))


def _sealed(scene: mi.Scene, shapes: list[Any], medium: Any) -> bool:
    """Whether ``medium`` fills closed shapes that let nothing straight through and hold no emitter.

    A cautious answer: no for shapes that are not surely closed, and where boxes cannot tell an
    emitter from the inside of a shape.
    """
    if any(medium == end.get_medium() for end in (*scene.sensors(), *scene.emitters())):
        return False
    shells, inner = [], []
    for shape in shapes:
        if shape.class_name() == "Instance":
            return False
        if shape.interior_medium() == medium:
            if _scatters(shape, mi.BSDFFlags.Null) or not encloses(shape):
                return False
            shells.append(shape.bbox())
        elif shape.exterior_medium() == medium:
            inner.append(shape.bbox())
    outside = (emitter for emitter in scene.emitters() if not _infinite(emitter))
    return all(any(shell.contains(box) for shell in shells) for box in inner) and not any(
        not emitter.bbox().valid() or shell.overlaps(emitter.bbox())
        for emitter in outside
        for shell in shells
    )


def _infinite(emitter: mi.Emitter) -> bool:
    return bool(mi.has_flag(emitter.flags(), mi.EmitterFlags.Infinite))
