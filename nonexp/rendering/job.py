"""What is rendered, how, until when, and where to: one value for a whole render."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import mitsuba as mi

from ..scene.files import SceneFiles, collect
from ..scene.identity import differences, of_scene, versions
from ..scene.load import LoadedScene
from ..system.files import check_writable
from .passes import Plan, plan_for, sensor_number, whole
from .sampling import replicates, sampler_of
from .targets import Targets, fraction, seconds

__all__ = ["RenderJob"]


@dataclass(frozen=True, eq=False)
class RenderJob:
    """A render: made once, by :meth:`of_scene` or :meth:`of_file`, and read by all that work on it.

    It holds no scene in memory, so that it can be sent to a worker.
    """

    plan: Plan
    identity: Mapping[str, Any]
    """what has to be the same for a render to go on: scene, parameters, variant, size, sensor,
    seed, sampler, versions"""
    seed: int
    sensor: int
    spp: int | None
    """samples per pixel asked for; None where time or noise decides"""
    pass_spp: int | None
    """samples per pixel of a pass, where they were chosen"""
    sampler: str | None
    """sampler asked for"""
    replicates: int | None
    """independent replicates to which the passes belong in turn; None: each is independent"""
    time: float | None
    error: float | None
    checkpoint: Path | None
    """file for the state of the render"""
    resume: bool
    interval: float
    """seconds between two checkpoints"""
    files: SceneFiles | None = None
    """the files of the scene, where it comes from files"""
    parameters: Mapping[str, str] = field(default_factory=dict)
    """parameters of the scene file"""
    size: tuple[int, int] | None = None
    """image size, where it is not the scene file's"""
    output: Path | None = None
    """EXR file for the image"""

    @classmethod
    def of_scene(
        cls,
        scene: mi.Scene,
        *,
        spp: int | None = None,
        time: float | str | None = None,
        error: float | str | None = None,
        seed: int = 0,
        sensor: int | str | mi.Sensor = 0,
        pass_spp: int | None = None,
        sampler: str | None = None,
        checkpoint: str | Path | None = None,
        resume: bool = True,
        interval: float = 60,
        identity: Mapping[str, Any] | None = None,
        **origin: Any,
    ) -> RenderJob:
        """The job to render a scene; the arguments are those of :func:`nonexp.render`.

        Raises ``ValueError`` for an argument that is not allowed, ``OSError`` for a checkpoint
        that cannot be written. Without ``identity`` the scene's own is found, if there is a
        checkpoint to need it.
        """
        number = sensor_number(scene, sensor)
        camera = scene.sensors()[number]
        if camera.film().class_name() == "SpecFilm":
            raise ValueError("the film is a specfilm: it must be an hdrfilm, whose image is RGB")
        if not 0 <= interval < math.inf:
            raise ValueError(f"interval is {interval}: it must be a number of seconds >= 0")
        spp = None if spp is None else whole("spp", spp, 1)
        if spp is None and time is None and error is None:
            spp = camera.sampler().sample_count()
        seed = whole("seed", seed, 0)
        plugin = sampler_of(camera, sampler)
        path = None if checkpoint is None else Path(checkpoint)
        if path is not None:
            check_writable(path, name="checkpoint")
            identity = of_scene(scene) if identity is None else identity
        plan = plan_for(camera, spp, pass_spp, plugin)
        return cls(
            plan=plan,
            identity={**_completed(identity or {}, camera, number, seed), "sampler": plugin},
            seed=seed,
            sensor=number,
            spp=spp,
            pass_spp=pass_spp,
            sampler=sampler,
            replicates=replicates(plugin, plan.spp),
            time=None if time is None else seconds(time),
            error=None if error is None else fraction(error),
            checkpoint=path,
            resume=resume,
            interval=interval,
            **origin,
        )

    @classmethod
    def of_file(
        cls,
        loaded: LoadedScene,
        path: Path,
        parameters: Mapping[str, str],
        size: tuple[int, int] | None = None,
        output: Path | None = None,
        **asked: Any,
    ) -> RenderJob:
        """The job to render a scene that was loaded from a file; ``asked`` as for :meth:`of_scene`.

        The files of the scene identify it, beside its parameters.
        """
        files = collect(path, parameters)
        identity = {
            "parameters": dict(parameters),
            "files": files.digests(),
            "integrator": ", ".join(loaded.integrators),
        }
        origin = {"files": files, "parameters": dict(parameters), "size": size, "output": output}
        return cls.of_scene(loaded.scene, **{"identity": identity, **asked, **origin})

    @property
    def targets(self) -> Targets:
        """When it is finished."""
        return Targets(self.plan.passes, self.time, self.error)

    @property
    def variant(self) -> str:
        """The Mitsuba variant that renders it."""
        return str(self.identity["variant"])

    @property
    def state_identity(self) -> dict[str, Any]:
        """What identifies its checkpoints: they have a pass size and replicates too."""
        more = {} if self.replicates is None else {"replicates": self.replicates}
        return {**self.identity, "pass_spp": self.plan.pass_spp, **more}

    def going_on(self, found: Mapping[str, Any]) -> RenderJob:
        """This job with the pass size and replicates of a checkpoint with the identity ``found``.

        Raises ``ValueError`` if that is of another render.
        """
        size = found["pass_spp"]
        job = replace(self, replicates=self.replicates and found.get("replicates"))
        if self.pass_spp is None and size != self.plan.pass_spp:
            job = replace(job, plan=Plan(None, size).for_spp(self.spp))
        if differ := differences(found, job.state_identity):
            raise ValueError(
                f"checkpoint {str(self.checkpoint)!r} is of another render: {'; '.join(differ)} "
                "(undo that to go on, or delete the file to start over)"
            )
        return job


def _completed(identity: Mapping[str, Any], camera: Any, sensor: int, seed: int) -> dict[str, Any]:
    """An identity with what a scene is rendered with."""
    try:
        own = json.loads(json.dumps(identity))  # as it will be read again
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"identity is {identity!r}: it must be what JSON can hold ({error})"
        ) from None
    film = camera.film()
    size, crop, offset = (list(v) for v in (film.size(), film.crop_size(), film.crop_offset()))
    window = {} if crop == size else {"crop": f"{crop[0]}x{crop[1]} at {offset[0]}, {offset[1]}"}
    return {
        **own,
        **window,
        "variant": mi.variant(),
        "size": size,
        "sensor": sensor,
        "seed": seed,
        "versions": versions(),
    }
