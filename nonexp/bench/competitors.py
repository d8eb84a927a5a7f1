"""The competitors: integrators with their options."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import mitsuba as mi

from .scenes import Case, Filling, Scene

__all__ = ["BASELINES", "COMPETITORS", "Competitor", "competing", "known", "reference_competitor"]


@dataclass(frozen=True)
class Competitor:
    """An integrator, and the scenes in which it takes part.

    ``properties`` are passed to the integrator, together with the depths of the scene. ``medium``
    is None for integrators that render nonexp's media; otherwise the integrator renders Mitsuba's
    own media, with these properties. It takes part in scenes that have all tags ``needs`` and none
    of ``not_with``, and in a quick run only if ``quick``. ``later`` bounces are added to the
    scene's ``rr_depth``. ``module`` is imported first, to register your own plugin. ``tracking`` is
    how flights pass grids; with another than ``auto`` only laws for which there is a choice. Of the
    ``sampler`` each pass takes a sequence of its own, with ``samples`` times the scene's samples.
    """

    name: str
    plugin: str
    properties: Mapping[str, Any] = field(default_factory=dict)
    medium: Mapping[str, Any] | None = None
    needs: frozenset[str] = frozenset()
    not_with: frozenset[str] = frozenset()
    quick: bool = False
    later: int = 0
    module: str = ""
    tracking: str = "auto"
    sampler: str = "independent"
    samples: int = 1

    def takes_part(self, case: Case) -> bool:
        """Whether it competes in the case."""
        tags = case.scene.tags
        return (
            self.needs <= tags
            and not self.not_with & tags
            and (self.medium is None or case.stock)
            and (self.tracking == "auto" or case.mixes)
        )

    def filling(self, case: Case) -> Filling:
        """What fills the scene's media for this competitor."""
        if self.medium is None:
            return Filling(case.law, tracking=self.tracking)
        return Filling(None, self.medium)

    def integrator(self, scene: Scene) -> Any:
        """The plugin. Raises ``RuntimeError`` if it does not know a property."""
        depths = {"max_depth": scene.max_depth, "rr_depth": scene.rr_depth + self.later}
        return mi.load_dict({"type": self.plugin, **depths, **self.properties})


MEDIA = frozenset({"media"})
GLASS = frozenset({"glass"})
CHROMATIC = frozenset({"chromatic"})
CAMERA_INSIDE = frozenset({"camera inside"})
GRID = frozenset({"grid"})
GREY = {"has_spectral_extinction": False}

COMPETITORS = (
    Competitor("nonexp", "nonexp_volpath", quick=True),
    # As nonexp.render does 1024 samples per pixel, in 8 replicates.
    Competitor("nonexp sobol", "nonexp_volpath", quick=True, sampler="nonexp_sobol", samples=4),
    Competitor(
        "nonexp nee=off",
        "nonexp_volpath",
        {"refractive_nee": "off"},
        needs=GLASS,
        quick=True,
    ),
    Competitor("nonexp nee=on", "nonexp_volpath", {"refractive_nee": "on"}, needs=GLASS),
    Competitor("nonexp regular", "nonexp_volpath", needs=GRID, tracking="regular"),
    Competitor("nonexp delta", "nonexp_volpath", needs=GRID, tracking="delta"),
    Competitor("volpath", "volpath", medium={}, quick=True),
    Competitor(
        "volpath tuned",
        "volpath",
        medium={**GREY, "sample_emitters": False},
        needs=GLASS,
    ),
    Competitor("volpath tuned", "volpath", medium=GREY, needs=MEDIA, not_with=GLASS | CHROMATIC),
    Competitor("volpathmis", "volpathmis", medium={}, needs=MEDIA),
    # It ignores the medium that the camera is in.
    Competitor("prbvolpath", "prbvolpath", medium={}, needs=MEDIA, not_with=CAMERA_INSIDE),
    # Its Russian roulette begins one bounce earlier than that of the volumetric integrators.
    Competitor("path", "path", medium={}, not_with=MEDIA, later=1, quick=True),
)
"""Names are unique among those that take part in one case."""

BASELINES = ("volpath", "nonexp nee=off", "nonexp")
"""Efficiencies are given relative to the first of these that takes part."""


def known(competitor: Competitor, scene: Scene) -> bool:
    """Whether the plugin exists and knows all properties."""
    try:
        competitor.integrator(scene)
    except RuntimeError as error:
        if "unreferenced" in str(error) or "not found" in str(error):
            return False
        raise
    return True


def competing(case: Case, quick: bool = False) -> list[Competitor]:
    """The competitors of a case, without those whose options the plugin does not know."""
    return [
        competitor
        for competitor in COMPETITORS
        if competitor.takes_part(case)
        and (competitor.quick or not quick)
        and (not competitor.properties or known(competitor, case.scene))
    ]


def reference_competitor(case: Case) -> Competitor:
    """What renders the reference: Mitsuba if the law allows it, else our simplest configuration."""
    glass = "glass" in case.scene.tags
    grid = "grid" in case.scene.tags
    if case.stock:
        tuned = GREY if "chromatic" not in case.scene.tags else {}
        plain = {"sample_emitters": False} if glass else {}
        return Competitor("volpath", "volpath", medium={**tuned, **plain})
    off = Competitor("nonexp", "nonexp_volpath", {"refractive_nee": "off"})
    if glass and known(off, case.scene):
        return off
    return Competitor("nonexp", "nonexp_volpath", tracking="regular" if grid else "auto")
