"""When a render is good enough: targets of samples, time and noise, and how far it is."""

from __future__ import annotations

import math
import re
from collections import deque
from dataclasses import dataclass
from numbers import Real
from time import perf_counter

from ..images.moments import Array, Moments, Noise, Replicates

__all__ = ["BLACK", "Progress", "Run", "Targets", "fraction", "is_checked", "seconds"]

BLACK = (
    "the image is black everywhere: no light reaches the camera "
    "(fog without bounds is black, by theory, under a directional light or an environment)"
)

_UNKNOWN = Noise(math.nan, math.nan)
_PATIENCE = 64
"""Passes after which a run to an error alone ends if its image is black, and so has none."""


@dataclass(frozen=True)
class Targets:
    """A render is finished at the first of these that is reached; None asks for nothing."""

    passes: int | None = None
    """number of passes"""
    time: float | None = None
    """seconds spent; no pass is started that would end later"""
    error: float | None = None
    """relative standard error of the image, held with 95 % confidence: :class:`Noise`"""

    def reached(self, done: int, seconds: float, pass_seconds: float, noise: Noise) -> str | None:
        """The target that is reached: spp, error, time, or None."""
        if self.passes is not None and done >= self.passes:
            return "spp"
        if self.error is not None and noise.bound <= self.error:
            return "error"
        if self.time is not None and done and seconds + pass_seconds > self.time:
            return "time"
        return None

    def seconds_left(self, done: int, seconds: float, pass_seconds: float, noise: Noise) -> float:
        """Estimated time until the first is reached; infinite where that is unknown."""
        left = [math.inf]
        if self.passes is not None:
            left.append((self.passes - done) * pass_seconds)
        if self.time is not None:
            left.append(self.time - seconds)
        if self.error is not None and noise.bound > 0:
            left.append(done * ((noise.bound / self.error) ** 2 - 1) * pass_seconds)
        return max(min(left), 0.0)


def is_checked(passes: int) -> bool:
    """Whether noise is looked at after that many passes: each from 8 to 40, then at steps of 5 %.

    The passes at which a run can stop for its error therefore do not depend on the machine, and
    are few: each look is a chance to stop at an image that happens to seem less noisy than it is.
    """
    look = 8
    while look < passes:
        look += max(1, look // 20)
    return look == passes


@dataclass(frozen=True)
class Progress:
    """State of a run after a pass. Passes and time before a resumption count."""

    done: int
    """passes so far"""
    passes: int | None
    """passes in all, None where time or noise decides"""
    seconds: float
    """time spent"""
    pass_spp: int
    """samples per pixel of a pass"""
    pass_seconds: float
    """time that a pass takes at present"""
    noise: Noise
    """how noisy the image is, at the latest look; NaN before the first"""
    left: float
    """estimated seconds until the first target is reached"""

    @property
    def spp(self) -> int:
        """Samples per pixel so far."""
        return self.done * self.pass_spp


class Run:
    """A render in progress, from the ``moments`` and ``seconds`` that it has."""

    def __init__(
        self,
        targets: Targets,
        pass_spp: int,
        moments: Moments | Replicates,
        seconds: float = 0.0,
    ) -> None:
        self.moments: Moments | Replicates = moments
        self.seconds = seconds
        self._targets = targets
        self._pass_spp = pass_spp
        self._now = perf_counter()
        self._recent: deque[float] = deque(maxlen=8)
        self._noise = _UNKNOWN
        self._outdated = is_checked(moments.passes)
        self.stopped = self._reached()
        """target that is reached, or None"""

    def take(self, image: Array) -> None:
        """Add the image of a pass."""
        self.moments = self.moments.plus(image)
        now = perf_counter()
        self._recent.append(now - self._now)
        self.seconds += now - self._now
        self._now = now
        self._outdated |= is_checked(self.moments.passes)
        self.stopped = self._reached()

    def progress(self) -> Progress:
        """Its state now."""
        state = (self.moments.passes, self.seconds, self._pass_seconds(), self._look())
        done, seconds, pass_seconds, noise = state
        left = self._targets.seconds_left(*state)
        return Progress(
            done, self._targets.passes, seconds, self._pass_spp, pass_seconds, noise, left
        )

    def _reached(self) -> str | None:
        noise = self._look() if self._targets.error is not None else _UNKNOWN
        done, targets = self.moments.passes, self._targets
        only_error = targets.passes is None and targets.time is None
        if only_error and done >= _PATIENCE and not self.moments.lit:
            black = not self.moments.mean.any()
            raise ValueError(
                f"error is {targets.error}, which cannot be reached: after {done} passes "
                f"{BLACK if black else 'no pixel is a finite number'}; "
                "add spp or time as a second target to go on"
            )
        return targets.reached(done, self.seconds, self._pass_seconds(), noise)

    def _look(self) -> Noise:
        """Noise at the latest look; computed only on demand, because it takes a while."""
        if self._outdated and is_checked(self.moments.passes):
            self._noise, self._outdated = Noise.of(self.moments), False
        return self._noise

    def _pass_seconds(self) -> float:
        return sum(self._recent) / max(len(self._recent), 1)


# --------------------------------------------------------------------- targets as people write them


def seconds(time: float | str) -> float:
    """A time in seconds, from a number or from text such as 90, 90s, 10m, 2h30m or 1.5d."""
    number = r"\d+(?:\.\d+)?"
    value = float(time) if isinstance(time, Real) else 0.0
    if isinstance(time, str) and re.fullmatch(rf"(?:{number}[dhms])*(?:{number})?", time):
        parts = re.findall(rf"({number})([dhms]|$)", time)
        value = sum(float(n) * {"d": 86400, "h": 3600, "m": 60}.get(unit, 1) for n, unit in parts)
    if not 0 < value < math.inf:
        raise ValueError(
            f"time is {time!r}: it must be a time > 0, as in 90 (seconds), 10m or 2h30m"
        )
    return float(value)


def fraction(error: float | str) -> float:
    """A relative error, from a number such as 0.01 or from text such as 1% or 0.01."""
    value = float(error) if isinstance(error, Real) else 0.0
    if isinstance(error, str) and (match := re.fullmatch(r"(\d*\.?\d+)\s*(%?)", error)):
        value = float(match[1]) / (100 if match[2] else 1)
    if not 0 < value < 1:
        raise ValueError(f"error is {error!r}: it must lie between 0 and 1, as in 0.01 or 1%")
    return value
