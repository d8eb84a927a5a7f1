"""Compare a render in passes with checkpoints to one call of ``mitsuba.render`` (8 minutes).

.venv/bin/python tools/overhead.py [scene.xml] [spp] [pairs]

Pairs of renders, in alternating order. Their times differ by what passes and checkpoints cost and
by the noise of the machine, which is often the larger part. What they cost apart from rendering is
therefore shown too: the time outside of Dr.Jit's kernels.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from time import perf_counter
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

import nonexp
from nonexp.scene.load import load
from nonexp.system import machine

ROOT = Path(__file__).resolve().parent.parent


def main(
    path: Path = ROOT / "scenes" / "dragon.xml", spp: int | str = 128, pairs: int | str = 8
) -> None:
    """Measure, and print a table."""
    spp, pairs = int(spp), int(pairs)
    mi.set_variant(machine.check_variant(None))
    mi.set_log_level(mi.LogLevel.Error)
    scene = load(Path(path), {}, None).scene
    with tempfile.TemporaryDirectory() as folder, dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        checkpoint = Path(folder) / "checkpoint"

        def once(seed: int) -> Any:
            return np.array(mi.render(scene, spp=spp, seed=seed))

        def passes(seed: int) -> Any:
            return nonexp.render(scene, spp=spp, seed=seed, checkpoint=checkpoint, resume=False)

        print(f"{nonexp.rendering.planned(scene, spp)}, checkpoint every 60 s and at the end")
        mi.render(scene, spp=1).numpy()
        nonexp.render(scene, spp=1)
        rows: dict[Any, list[tuple[float, float]]] = {once: [], passes: []}
        for seed in range(pairs):
            for render in (once, passes) if seed % 2 else (passes, once):
                rows[render].append(_timed(lambda r=render, s=seed: r(s)))
            one, many = rows[once][-1], rows[passes][-1]
            print(f"once {one[0]:.2f} s, in passes {many[0]:.2f} s", flush=True)
    one, many = np.array(rows[once]), np.array(rows[passes])
    ratios = many[:, 0] / one[:, 0]
    error = ratios.std(ddof=1) / np.sqrt(pairs) if pairs > 1 else np.nan
    print(f"ratio: mean {ratios.mean():.3f} +- {error:.3f}, median {np.median(ratios):.3f}")
    share = 100 * np.median(many[:, 1] / many[:, 0])
    before = 100 * np.median(one[:, 1] / one[:, 0])
    print(f"outside of kernels: {share:.2f} % of the time, once {before:.2f} %")


def _timed(render: Any) -> tuple[float, float]:
    """Seconds that a render takes, and those of them outside kernels."""
    dr.kernel_history_clear()
    start = perf_counter()
    render()
    seconds = perf_counter() - start
    return seconds, seconds - sum(k["execution_time"] for k in dr.kernel_history()) / 1e3


if __name__ == "__main__":
    main(*sys.argv[1:])
