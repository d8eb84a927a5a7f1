"""Measure the transmittance of a packing of equal, opaque spheres: media/packing.csv.

Spheres are dropped at random into a periodic cube and kept where they overlap no other (random
sequential addition), up to a quarter of the volume. Along a straight line the gaps between
spheres are what a ray can cross: over a distance t from a random point of a gap it gets through
with the probability T(t) = sum of (gap - t)+ / sum of gaps, which is convex as it should be.
Distances are scaled so that the mean extinction is 1.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

RADIUS = 0.04
SHARE = 0.25
LINES = 40_000


def packing(rng: np.random.Generator) -> np.ndarray:
    """Centres of spheres in the unit cube."""
    wanted = round(SHARE / (4 / 3 * np.pi * RADIUS**3))
    centres = np.empty((0, 3))
    while len(centres) < wanted:
        candidate = rng.random(3)
        offset = centres - candidate
        offset -= np.round(offset)  # the nearest periodic image
        if np.all(np.sum(offset**2, axis=1) >= 4 * RADIUS**2):
            centres = np.vstack([centres, candidate])
    return centres


def gaps(centres: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Lengths of the free stretches of periodic lines along the three axes."""
    found = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        for foot in rng.random((LINES // 3, 2)):
            across = centres[:, [u, v]] - foot
            across -= np.round(across)
            half = RADIUS**2 - np.sum(across**2, axis=1)
            hit = half > 0
            if np.count_nonzero(hit) < 2:
                continue
            middle, half = centres[hit, axis], np.sqrt(half[hit])
            order = np.argsort(middle)
            middle, half = middle[order], half[order]
            ahead = np.append(middle[1:], middle[0] + 1) - np.append(half[1:], half[0])
            found.append(ahead - (middle + half))
    lengths = np.concatenate(found)
    assert np.all(lengths >= 0)
    return lengths


def main() -> None:
    rng = np.random.default_rng(1)
    lengths = gaps(packing(rng), rng)
    lengths /= lengths.mean()  # the mean flight from a particle is 1/sigma_bar
    tau = np.concatenate([np.linspace(0, 2, 21), np.linspace(2.25, 5, 12)])
    ff = [np.sum(np.maximum(lengths - t, 0)) / np.sum(lengths) for t in tau]
    path = Path(__file__).parent.parent / "media" / "packing.csv"
    rows = [f"{t:.4g}, {f:.10f}" for t, f in zip(tau, ff, strict=True)]
    head = "# Transmittance of a packing of equal spheres, scenes/tools/make_packing.py"
    path.write_text("\n".join([head, "tau, ff", *rows]) + "\n", encoding="utf-8")
    print(f"{path}: {len(lengths)} gaps")


if __name__ == "__main__":
    main()
