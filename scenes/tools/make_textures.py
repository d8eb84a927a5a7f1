#!/usr/bin/env python3
"""Make the procedural textures of the scenes: a stone wall and a wooden floor.

Both images are tileable, and depend on the seed only.

    python scenes/tools/make_textures.py [--size 1024] [--seed 1]
"""

from __future__ import annotations

import argparse
import itertools
from pathlib import Path

import mitsuba as mi
import numpy as np

OUTPUT = Path(__file__).resolve().parents[1] / "textures"


# --- Building blocks: periodic on the unit square, coordinates (u, v), v downwards ----------------


def grid(size: int) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates of the pixel centres."""
    x = (np.arange(size) + 0.5) / size
    u, v = np.meshgrid(x, x)
    return u, v


def value_noise(
    rng: np.random.Generator, u: np.ndarray, v: np.ndarray, nu: int, nv: int
) -> np.ndarray:
    """Smooth noise in [-1, 1] from an nu x nv lattice of random values."""
    lattice = rng.uniform(-1, 1, (nv, nu))
    x, y = u * nu, v * nv
    i, j = np.floor(x).astype(int), np.floor(y).astype(int)
    s, t = x - i, y - j
    s, t = s * s * s * (s * (6 * s - 15) + 10), t * t * t * (t * (6 * t - 15) + 10)
    i0, i1, j0, j1 = i % nu, (i + 1) % nu, j % nv, (j + 1) % nv
    top = (1 - s) * lattice[j0, i0] + s * lattice[j0, i1]
    bottom = (1 - s) * lattice[j1, i0] + s * lattice[j1, i1]
    return (1 - t) * top + t * bottom


def fractal(
    rng: np.random.Generator,
    u: np.ndarray,
    v: np.ndarray,
    nu: int,
    nv: int,
    octaves: int,
    gain: float = 0.55,
) -> np.ndarray:
    """Sum of octaves of value noise, roughly in [-1, 1]."""
    weights = gain ** np.arange(octaves)
    layers = (w * value_noise(rng, u, v, nu << k, nv << k) for k, w in enumerate(weights))
    return np.sum(list(layers), axis=0) / np.sqrt(np.sum(weights**2)) * 1.2


def smoothstep(low: float, high: float, x: np.ndarray) -> np.ndarray:
    t = np.clip((x - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)


def mix(a: np.ndarray, b: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Blend of two colours by a scalar image."""
    return np.asarray(a) * (1 - t[..., None]) + np.asarray(b) * t[..., None]


def relief(height: np.ndarray, strength: float) -> np.ndarray:
    """Shading factor of a height field under soft light from above and slightly from the left."""
    dv = np.roll(height, -1, 0) - np.roll(height, 1, 0)
    du = np.roll(height, -1, 1) - np.roll(height, 1, 1)
    return 1 + np.tanh(strength * (dv + 0.4 * du)) * 0.35


# --- Stone wall: courses of blocks of varying height and width ------------------------------------


def stone_wall(rng: np.random.Generator, size: int) -> np.ndarray:
    u, v = grid(size)

    # Joints wander a little: look the wall up at displaced coordinates.
    amount = 0.011
    x = (u + amount * fractal(rng, u, v, 8, 8, 4)) % 1
    y = (v + amount * fractal(rng, u, v, 8, 8, 4)) % 1

    heights = rng.uniform(0.75, 1.35, 7)
    courses = np.concatenate([[0], np.cumsum(heights) / heights.sum()])
    edge = np.full_like(u, 1.0)  # distance to the nearest joint, with rounded corners
    block = np.zeros_like(u, dtype=int)
    bowl = np.zeros_like(u)  # each block is a bit thicker in its middle
    count = 0
    for low, high in itertools.pairwise(courses):
        widths = rng.uniform(0.7, 1.7, rng.integers(3, 6))
        ends = np.cumsum(widths) / widths.sum()
        shift = rng.uniform()
        inside = (y >= low) & (y < high)
        w = (x - shift) % 1
        for left, right in zip(np.concatenate([[0], ends[:-1]]), ends, strict=True):
            here = inside & (w >= left) & (w < right)
            dx, dy = np.minimum(w - left, right - w), np.minimum(y - low, high - y)
            radius = 0.03
            cx, cy = np.maximum(radius - dx, 0), np.maximum(radius - dy, 0)
            distance = np.minimum(np.minimum(dx, dy), radius - np.hypot(cx, cy))
            edge[here] = distance[here]
            block[here] = count
            bowl[here] = (np.minimum(dx / (right - left), dy / (high - low)) * 2)[here]
            count += 1

    rough = fractal(rng, u, v, 12, 12, 7, 0.62)
    chips = fractal(rng, u, v, 40, 40, 4)
    stone = smoothstep(0.0045, 0.0095, edge + 0.0022 * chips)  # 0 in mortar, 1 on stone

    # Height: for the shading of the picture only.
    height = stone * (0.5 + 0.25 * np.sqrt(np.clip(bowl, 0, 1))) + 0.09 * rough * stone
    height += 0.03 * fractal(rng, u, v, 64, 64, 3) * (1 + stone)
    shade = relief(height, 11.0 * size / 1024)

    # Colour: grey blocks, some warmer, some cooler, some darker; stains, veins and grain.
    value = rng.uniform(0.44, 0.66, count)
    tint = 1 + rng.normal(0, 1, (count, 1)) * [0.022, 0.003, -0.026]
    base = (value[:, None] * tint)[block]
    stains = fractal(rng, u, v, 3, 3, 6, 0.6)
    base = base * (1 + 0.10 * rough + 0.12 * stains)[..., None]
    veins = 1 - smoothstep(0.0, 0.05, np.abs(fractal(rng, x, y, 5, 5, 6, 0.6)))
    base = base * (1 - 0.10 * veins * (rng.uniform(size=count) < 0.4)[block])[..., None]
    dirt = smoothstep(0.45, 1.1, stains + 0.3 * rough)
    base = mix(base, base * [0.86, 0.86, 0.80], 0.8 * dirt)
    mortar = (0.52 + 0.05 * chips + 0.04 * rough)[..., None] * np.array([1.0, 0.97, 0.92])
    colour = mix(mortar, base, stone)
    contact = smoothstep(-0.004, 0.022, edge)  # dirt and shadow along the joints
    colour *= (shade * (0.70 + 0.30 * contact))[..., None]
    colour *= (1 + 0.045 * rng.normal(size=u.shape))[..., None]
    return colour


# --- Wooden floor: planks along u, each cut out of its own trunk ----------------------------------


def wood_floor(rng: np.random.Generator, size: int) -> np.ndarray:
    u, v = grid(size)
    rows, colour = 8, np.zeros((*u.shape, 3))
    dark, light = np.array([0.235, 0.118, 0.052]), np.array([0.66, 0.42, 0.23])
    for row in range(rows):
        across = v * rows - row  # 0..1 over the width of the plank
        cuts = np.sort((rng.uniform() + np.array([0, rng.uniform(0.38, 0.62)])) % 1)
        for left, right in ((cuts[0], cuts[1]), (cuts[1], cuts[0] + 1)):
            along = (u - left) % 1
            here = (across >= 0) & (across < 1) & (along < right - left)
            s, t = along[here], across[here]
            colour[here] = plank(rng, s, t, right - left, 1 / rows, dark, light)
    return colour


def plank(
    rng: np.random.Generator,
    s: np.ndarray,
    t: np.ndarray,
    length: float,
    width: float,
    dark: np.ndarray,
    light: np.ndarray,
) -> np.ndarray:
    """Colour of one plank at s (along) in texture units and t (across) in 0..1."""
    y = t * width

    # Annual rings: distance to the pith of a trunk that bends, cut by the plank; knots push them
    # aside.  The lattices of noise are long and narrow, as the fibres are.
    pith, depth = rng.uniform(-0.5, 1.5) * width, rng.uniform(0.03, 0.09)
    bend = value_noise(rng, s, y, 3, 4) * 0.02 + value_noise(rng, s, y, 9, 16) * 0.004
    slope = rng.uniform(-0.25, 0.25)
    z = depth + slope * (s - length / 2) * 0.5
    radius = np.hypot(y - pith + bend, z)
    knots = np.zeros_like(s)
    for _ in range(rng.choice([0, 0, 0, 1, 1, 2])):
        cs, ct = rng.uniform(0.08, 0.92) * length, rng.uniform(0.2, 0.8) * width
        size = rng.uniform(0.006, 0.012)
        d = np.hypot((s - cs) / 1.7, y - ct) * (1 + 0.2 * value_noise(rng, s, y, 40, 60))
        radius += 0.030 * np.exp(-((d / (2.2 * size)) ** 2)) * np.sign(ct - pith + 1e-9)
        knots = np.maximum(knots, 1 - smoothstep(0.45 * size, 1.25 * size, d))
    wobble = 0.0015 * fractal(rng, s, y, 6, 90, 3)
    phase = (radius + wobble) / rng.uniform(0.0075, 0.012) + rng.uniform()
    ring = phase % 1
    latewood = smoothstep(0.25, 0.92, ring) * (1 - smoothstep(0.94, 1.0, ring))

    fibres = fractal(rng, s, y, 14, 500, 2) + 0.5 * fractal(rng, s, y, 30, 250, 2)
    pores = smoothstep(0.62, 0.95, value_noise(rng, s, y, 34, 480))
    tone = 0.64 + 0.08 * rng.normal() + 0.10 * fractal(rng, s, y, 3, 10, 3)
    tone = tone - 0.30 * latewood + 0.085 * fibres - 0.20 * pores
    colour = mix(dark, light, np.clip(tone, 0, 1.15))
    colour = colour * (1 + rng.normal(0, 0.03, 3) * [1, 0.3, 0.6]) * rng.uniform(0.82, 1.12)
    rim = 0.65 + 0.35 * smoothstep(0.0, 0.5, np.abs(knots - 0.5) * 2)
    colour = mix(colour, np.array([0.15, 0.07, 0.03]), 0.85 * knots * rim)

    # Dark gaps with a worn, slightly lighter bevel.
    gap = np.minimum(np.minimum(y, width - y), np.minimum(s, length - s))
    colour = colour * (1 + 0.10 * np.exp(-(((gap - 0.0032) / 0.0014) ** 2)))[..., None]
    return colour * (0.12 + 0.88 * smoothstep(0.0006, 0.0024, gap))[..., None]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--size", type=int, default=1024, help="edge length in pixels")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--output", type=Path, default=OUTPUT, metavar="FOLDER")
    args = parser.parse_args()

    mi.set_variant("scalar_rgb")
    args.output.mkdir(parents=True, exist_ok=True)
    for texture in (stone_wall, wood_floor):
        image = texture(np.random.default_rng(args.seed), args.size)
        pixels = np.uint8(np.clip(image, 0, 1) * 255 + 0.5)  # colours above are sRGB values
        path = args.output / f"{texture.__name__}.png"
        mi.Bitmap(pixels).write(str(path))
        print(f"{path}: {args.size} x {args.size}, {path.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
