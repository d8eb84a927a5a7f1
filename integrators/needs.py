"""What a scene makes the integrator do: looked up once, before anything is traced.

The integrator's kernel holds only the parts that these answers ask for.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from nonexp.plugins.spectra import visible
from nonexp.scene import walk
from nonexp.system import insides

from .coincident import Coincident, coincident, scatters
from .jit import Remembered, recording
from .media import Expected, entry_of
from .rays import Offset, detachable, place, state

_SMOOTH = ("Sphere", "Cylinder", "Disk", "Rectangle")

# Classes of Mitsuba 3.9 that implement eval_null_transmission.
_TELLING = (
    "Null",
    "MaskBSDF",
    "BlendBSDF",
    "ThinDielectric",
    "TwoSidedBRDF",
    "LinearPolarizer",
    "LinearRetarder",
    "CircularPolarizer",
)

_WORTH = 3.0
"""Worth of a collision over its albedo, that of a surface being 1: squared errors are least at 1.5,
relative ones, which count dark surfaces, at 5."""

_BRIGHT = 0.8
"""Albedo above which expected emission gains next to nothing: other noise is larger."""

_FAR = 2.0
"""Mean free paths that rays look ahead in bright media: to trace them farther takes more time than
it saves."""

_known = Remembered(64)


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
    coincident: Coincident = field(default_factory=Coincident)
    """Shapes of which parts lie in one place, boundaries among them."""
    silent: tuple[Any, ...] = ()
    """BSDFs that let rays straight through, but do not tell shadow rays how many."""
    shell: Any = None
    """The invisible boundary of the only medium, around all of its grid: rays can do without."""
    expected: tuple[Expected, ...] = ()
    """Media in which expected values take the place of draws."""

    @staticmethod
    def of(
        scene: mi.Scene,
        start: Any = None,
        refractive: str = "auto",
        hides: bool = False,
        expected: str = "auto",
    ) -> SceneNeeds:
        """Look at ``scene``; ``start`` is the medium in which the rays begin, if any.

        ``refractive`` says whether connections bend: ``auto`` (where that helps), ``on`` (wherever
        they can) or ``off``. ``hides``: rays pass emitters that are hidden. ``expected`` says
        whether expected values take the place of draws, likewise.
        """
        shapes, media = walk.shapes(scene), walk.media(scene)
        if start is not None and start not in media:
            media.insert(0, start)
        sealed = tuple(m for m in media if m != start and _sealed(scene, shapes, m))
        shell = None if hides else _shell(scene, shapes, media)
        bounds = shapes
        shapes = [shape for shape in shapes if shape != shell]
        direct = [shape for shape in scene.shapes() if shape != shell]
        together = coincident(direct, Offset(scene).extent)
        touching = [shape for group in together.groups for shape in group]
        emitter_flags = [emitter.flags() for emitter in scene.emitters()]
        lobes = _lobes(scene, shapes, refractive) if emitter_flags else ()
        delta, infinite = mi.EmitterFlags.Delta, mi.EmitterFlags.Infinite
        return SceneNeeds(
            media=tuple(media),
            sealed=sealed,
            smooth_surfaces=any(scatters(shape, mi.BSDFFlags.Smooth) for shape in shapes),
            smooth_boundaries=any(
                shape.is_medium_transition() and scatters(shape, mi.BSDFFlags.Smooth)
                for shape in shapes
            ),
            null_surfaces=any(scatters(shape, mi.BSDFFlags.Null) for shape in shapes),
            emitters=bool(emitter_flags),
            hittable_emitters=any(not mi.has_flag(flags, delta) for flags in emitter_flags),
            delta_emitters=any(mi.has_flag(flags, delta) for flags in emitter_flags),
            infinite_emitters=any(mi.has_flag(flags, infinite) for flags in emitter_flags),
            near_emitters=any(
                mi.has_flag(flags, delta) and not mi.has_flag(flags, infinite)
                for flags in emitter_flags
            ),
            null_ball=None if together.groups else _null_ball(shapes, media),
            lobes=tuple(lobe for lobe in lobes if lobe not in touching),
            coincident=together,
            silent=_silent(shapes),
            shell=shell,
            expected=_expected(scene, bounds, media, start, shell, expected),
        )


def forgotten_media(scene: mi.Scene) -> list[tuple[Any, Any]]:
    """Sensors, and a closed medium that each stands in without referring to it.

    Their rays start in vacuum. Only surfaces without gaps are looked at: spheres and meshes.
    """
    found = []
    for sensor in scene.sensors():
        transform = mi.traverse(sensor).get("to_world")
        if sensor.get_medium() is not None or transform is None:
            continue
        origin = np.array(transform.matrix, dtype=float).reshape(4, 4)[:3, 3]
        shapes = (shape for shape in scene.shapes() if shape.interior_medium() is not None)
        inside = next((shape for shape in shapes if _holds(shape, origin)), None)
        if inside is not None:
            found.append((sensor, inside.interior_medium()))
    return found


def _holds(shape: Any, point: Any) -> bool:
    """Whether a closed shape has a point inside; no for shapes that are not surely closed."""
    box = shape.bbox()
    if not (np.all(point > box.min) and np.all(point < box.max) and _encloses(shape)):
        return False
    if not shape.is_mesh():
        where = place(shape)
        centre, radius = (np.array(value, dtype=float).ravel() for value in where or ([0], [0]))
        return bool(np.linalg.norm(point - centre) < radius)
    corners = np.array(insides.vertex_positions(shape), dtype=float).reshape(-1, 3) - point
    a, b, c = (corners[k] for k in np.array(insides.faces(shape)).reshape(-1, 3).T)
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    # Solid angles of the faces (Van Oosterom and Strackee 1983) add up to 4 pi from inside, else 0.
    dots = la * lb * lc + _dot(a, b) * lc + _dot(b, c) * la + _dot(c, a) * lb
    angles = 2 * np.arctan2(_dot(a, np.cross(b, c)), dots)
    return bool(angles.sum() > 2 * np.pi)


def _dot(a: Any, b: Any) -> Any:
    return np.einsum("ij,ij->i", a, b)


def _shell(scene: mi.Scene, shapes: list[Any], media: list[Any]) -> Any:
    """The shape that only says where the only medium is, which its grid says too.

    Density is zero outside of the grid, and a flight that enters it begins as one that enters the
    shape does.
    """
    bounds = [shape for shape in shapes if shape.is_medium_transition()]
    density = getattr(media[0], "density", None) if len(media) == 1 else None
    if len(bounds) != 1 or density is None or recording() or "llvm" not in mi.variant():
        return None
    shell, direct = bounds[0], scene.shapes()
    rest = [shape for shape in direct if shape != shell]
    plain = shell.bsdf().class_name() == "Null" and not shell.is_emitter()
    inside = shell.interior_medium() == media[0] and shell.exterior_medium() is None
    if not (plain and inside and shell in direct and len(shapes) == len(direct)):
        return None
    if not (detachable(rest) and _contains(shell, density.corners_of_box)):
        return None
    return None if forgotten_media(scene) else shell


def _contains(shape: Any, points: Any) -> bool:
    """Whether a closed shape surely has some points, and all between them, inside or on it."""
    if not _encloses(shape):
        return False
    slack = 1e-5 * float(np.max(np.ptp(points, axis=0)))
    if not shape.is_mesh():
        where = place(shape)
        if where is None:
            return False
        centre, radius = (np.array(value, dtype=float).ravel() for value in where)
        return bool(np.all(np.linalg.norm(points - centre, axis=1) <= radius + slack))
    if shape.face_count() > 4096:
        return False
    vertices = np.array(insides.vertex_positions(shape), dtype=float).reshape(-1, 3)
    a, b, c = (vertices[k] for k in np.array(insides.faces(shape)).reshape(-1, 3).T)
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    # What lies behind the planes of all faces can see every one of them from inside.
    return bool(np.all(points @ normals.T <= _dot(a, normals) + slack))


def _null_ball(shapes: list[Any], media: list[Any]) -> Any:
    """The only shape that lets anything straight through, if it is a plain sphere of the medium."""
    null = [shape for shape in shapes if scatters(shape, mi.BSDFFlags.Null)]
    bounds = [shape for shape in shapes if shape.is_medium_transition()]
    if len(null) != 1 or bounds != null or len(media) != 1:
        return None
    ball = null[0]
    plain = ball.shape_type() == mi.ShapeType.Sphere and not insides.flips_normals(ball)
    plain = plain and ball.bsdf().class_name() == "Null" and not ball.is_emitter()
    inside = ball.interior_medium() == media[0] and ball.exterior_medium() is None
    return ball if plain and inside else None


def _silent(shapes: list[Any]) -> tuple[Any, ...]:
    """BSDFs of which some part passes rays on, but does not implement ``eval_null_transmission``.

    Mitsuba's ``normalmap`` and ``bumpmap`` are such, around whatever lets rays through.
    """
    found: list[Any] = []
    passing = (shape.bsdf() for shape in shapes if scatters(shape, mi.BSDFFlags.Null))
    for bsdf in (bsdf for bsdf in passing if bsdf.class_name() != "Null"):
        parts = [node for node in mi.traverse(bsdf).hierarchy if isinstance(node, mi.BSDF)]
        let_through = (part for part in parts if mi.has_flag(part.flags(), mi.BSDFFlags.Null))
        if bsdf not in found and not all(map(_tells, let_through)):
            found.append(bsdf)
    return tuple(found)


def _tells(bsdf: Any) -> bool:
    own = type(bsdf) is not mi.BSDF and "eval_null_transmission" in vars(type(bsdf))
    return own or bsdf.class_name() in _TELLING


def _sealed(scene: mi.Scene, shapes: list[Any], medium: Any) -> bool:
    """Whether ``medium`` fills closed shapes that let nothing straight through and hold no
    emitter. A cautious answer."""
    shells = (shape for shape in shapes if shape.interior_medium() == medium)
    open_ = any(scatters(shell, mi.BSDFFlags.Null) for shell in shells)
    return not open_ and _closed(scene, shapes, medium)


def _closed(scene: mi.Scene, shapes: list[Any], medium: Any) -> bool:
    """Whether ``medium`` fills closed shapes that hold no emitter.

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
            if not _encloses(shape):
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


# --------------------------------------------------------------------- expected values


def _expected(
    scene: mi.Scene, shapes: list[Any], media: list[Any], start: Any, shell: Any, wanted: str
) -> tuple[Expected, ...]:
    """In which media expected values take the place of draws.

    The rule for collisions pays in dark media. So does expected emission, also through grids; in
    brighter ones rays must not look much farther than they fly, and hardly any noise is theirs.
    """
    # Frozen functions draw everything: nothing can be read of what they see.
    if wanted == "off" or recording():
        return ()
    emitters = any(not mi.has_flag(e.flags(), mi.EmitterFlags.Delta) for e in scene.emitters())
    found = []
    for medium in media:
        albedo = _largest_albedo(medium)
        keep = _WORTH * albedo
        dark = keep < 1 and not getattr(medium, "emits", False)
        unlit = medium != start and shell is None and _closed(scene, shapes, medium)
        sees = emitters and not unlit
        if wanted == "auto" and not dark:
            plain = getattr(medium, "density", None) is None
            plain &= not getattr(medium, "remembers", False)
            sees &= plain and albedo <= _BRIGHT
        if sees or dark:
            far = dr.inf if dark or wanted == "on" else _FAR
            found.append(Expected(medium, sees, far, keep if dark else None))
    return tuple(found)


def _largest_albedo(medium: Any) -> float:
    """The largest albedo in a medium; 1 if that is not known."""
    known = getattr(medium, "largest_albedo", None)
    if known is not None:
        return float(known)
    parameters = mi.traverse(medium)
    if "albedo.data" in parameters:
        return float(np.max(np.array(dr.detach(parameters["albedo.data"]))))
    if not medium.is_homogeneous():
        return 1.0
    sigma_s, _, sigma_t = medium.get_scattering_coefficients(visible())
    sigma_s, sigma_t = np.array(dr.detach(sigma_s)), np.array(dr.detach(sigma_t))
    # Extinction that depends on the direction is 0 here: then the ratio is not known.
    return float(np.max(sigma_s / sigma_t)) if np.all(sigma_t > 0) else 1.0


# --------------------------------------------------------------------- glass


def _lobes(scene: mi.Scene, shapes: list[Any], wanted: str) -> tuple[Any, ...]:
    """Shapes with a smooth dielectric surface: those of use (``auto``), all (``on``), none."""
    if wanted == "off" or (wanted == "auto" and not _finds_light(scene)):
        return ()
    present = set(map(id, scene.shapes()))  # not those that exist as instances alone
    found = [shape for shape in shapes if id(shape) in present and _bends(shape)]
    if wanted == "auto":
        found = [shape for shape in found if _holds_something(shape, shapes)]
    return tuple(found)


def _bends(shape: Any) -> bool:
    """Whether connections can bend through a shape: its normals turn smoothly, and are known."""
    bsdf = shape.bsdf()
    if bsdf is None or bsdf.class_name() != "SmoothDielectric" or insides.flips_normals(shape):
        return False
    if shape.is_mesh():
        return bool(insides.has_vertex_normals(shape) and not shape.has_face_normals())
    return shape.class_name() in _SMOOTH


def _finds_light(scene: mi.Scene) -> bool:
    """Light comes from some direction rather than from everywhere, where any ray finds it."""
    return any(emitter.class_name() != "ConstantBackgroundEmitter" for emitter in scene.emitters())


def _holds_something(lobe: Any, shapes: list[Any]) -> bool:
    """Connections may begin behind the surface: in a medium, or on something within."""
    medium = lobe.interior_medium()
    if medium is not None:
        entry = entry_of(medium, sealed=True)
        if entry is not None and entry.samples:
            return True
    return _encloses(lobe) and any(
        shape.bsdf() is not None
        and mi.has_flag(shape.bsdf().flags(), mi.BSDFFlags.Smooth)
        and lobe.bbox().contains(shape.bbox())
        for shape in shapes
    )


# --------------------------------------------------------------------- closed shapes


def _encloses(shape: mi.Shape) -> bool:
    """Whether the side that ``shape``'s normals turn away from is a closed volume.

    Certain for spheres and meshes; False for all other shapes.
    """
    if insides.flips_normals(shape):
        return False
    if shape.is_mesh():
        return _watertight(shape)
    return bool(shape.shape_type() == mi.ShapeType.Sphere)


def _watertight(mesh: Any) -> bool:
    """Every edge belongs to two faces that run through it in opposite directions, and the faces
    turn outwards. Vertices count as one where they coincide. Cached per state of the mesh."""
    arrays, numbers = state(mesh)
    return bool(_known.get(numbers, arrays, lambda: _is_watertight(*map(np.array, arrays))))


def _is_watertight(positions: Any, faces: Any) -> bool:
    points = positions.reshape(-1, 3)
    _, same = np.unique(points, axis=0, return_inverse=True)
    corners = same.reshape(-1)[faces.reshape(-1, 3)].astype(np.int64)
    proper = np.all(corners != np.roll(corners, 1, axis=1), axis=1)  # no area, no hole either
    corners, triangles = corners[proper], points[faces.reshape(-1, 3)][proper].astype(float)
    if not len(corners):
        return False
    ahead = np.concatenate([corners[:, [i, (i + 1) % 3]] for i in range(3)])
    count = corners.max() + 1
    forth = np.sort(ahead[:, 0] * count + ahead[:, 1])
    back = np.sort(ahead[:, 1] * count + ahead[:, 0])
    if np.any(forth[1:] == forth[:-1]) or np.any(forth != back):
        return False
    a, b, c = np.moveaxis(triangles - triangles.mean(axis=(0, 1)), 1, 0)
    return bool(np.sum(a * np.cross(b, c)) > 0)
