"""Compute the numbers of independent programs that ``nonexp validate`` compares with.

.venv/bin/python tools/validation.py        the numbers.csv of iadpython and PythonicDISORT

Both programs are test dependencies. Their numbers are kept so that ``nonexp validate`` does not
need them; the test suite computes some of them anew. The error is what is left when the number of
their quadrature points doubles.
"""

from __future__ import annotations

import csv
import itertools
import math
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

FOLDER = Path(__file__).resolve().parent.parent / "nonexp" / "validation"

Row = tuple[str, float, float]


def disort(albedo: float, thickness: float, g: float, points: int, mu: float | None) -> Any:
    """Reflected and transmitted share of a beam, or of Lambertian light, by discrete ordinates."""
    from PythonicDISORT import pydisort

    moments = g ** np.arange(max(points, 64))
    source: dict[str, Any] = {"mu0": mu or 0.6, "I0": 1 / mu if mu else 0, "phi0": 0}
    if mu is None:
        source["b_neg"] = 1 / math.pi
    arguments = (np.array([thickness]), np.array([albedo]), points, moments[None])
    _, up, down, *_ = pydisort(*arguments, **source, NLeg=points, only_flux=True)
    diffuse, direct = down(thickness)
    return float(up(0)), float(diffuse) + float(direct)


def doubling(albedo: float, thickness: float, g: float, index: float, points: int) -> Any:
    """Reflected and transmitted share of normal light, then of Lambertian light."""
    from iadpython import Sample

    sample = Sample(a=albedo, b=thickness, g=g, n=index, quad_pts=points)
    reflected, transmitted, reflected_sky, transmitted_sky = sample.rt()
    return reflected, transmitted, reflected_sky, transmitted_sky


ALBEDOS, THICKNESSES, ANISOTROPIES = (0.5, 0.9, 0.99), (0.5, 3.0, math.inf), (0.0, 0.75)


def of_disort() -> Iterator[Row]:
    for albedo, thickness, g in itertools.product(ALBEDOS, THICKNESSES, ANISOTROPIES):
        depth = min(thickness, 400.0)
        for light, mu in (("normal", 1.0), ("oblique", 0.3), ("Lambertian", None)):
            fine, coarse = (disort(albedo, depth, g, n, mu) for n in (64, 32))
            for name, one, other in zip(("reflected", "transmitted"), fine, coarse, strict=True):
                if name == "reflected" or thickness < math.inf:
                    case = f"albedo={albedo:g} thickness={thickness:g} g={g:g}"
                    yield f"{case} {light} {name}", one, abs(one - other)


def of_doubling() -> Iterator[Row]:
    names = ("normal reflected", "normal transmitted", "Lambertian reflected")
    for albedo, thickness, index in itertools.product((0.5, 0.9, 0.99), (0.5, 3.0), (1.33, 1.5)):
        for g in (0.0, 0.75) if albedo == 0.9 else (0.0,):
            fine, coarse = (doubling(albedo, thickness, g, index, n) for n in (64, 32))
            case = f"albedo={albedo:g} thickness={thickness:g} g={g:g} index={index:g}"
            for name, one, other in zip(names, fine, coarse, strict=False):
                yield f"{case} {name}", float(one), abs(float(one - other))


STUDIES: dict[str, tuple[str, Callable[[], Iterator[Row]]]] = {
    "ho_2024_joss": ("PythonicDISORT", of_disort),
    "prahl_2023_pypi": ("iadpython", of_doubling),
}


def main() -> None:
    for folder, (package, rows) in STUDIES.items():
        path = FOLDER / folder / "numbers.csv"
        path.parent.mkdir(exist_ok=True)
        with path.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(("name", "value", "error", "where"))
            where = f"{package} {version(package)}, 64 quadrature points"
            for name, value, error in rows():
                writer.writerow((name, f"{value:.7g}", f"{max(error, 1e-7):.2g}", where))
        print(path)


if __name__ == "__main__":
    main()
