"""Measure the error of every model in single precision, and write docs/accuracy.md (a minute).

.venv/bin/pip install -e '.[test]' && .venv/bin/python tools/accuracy.py
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "tests"), str(ROOT / "tests" / "stability")]

import numpy as np  # noqa: E402
from stability_cases import CASES, KERNELS, case_id  # noqa: E402
from stability_values import BAR, compare  # noqa: E402

from nonexp import models  # noqa: E402

COUNT = 1000

TEXT = """\
# Accuracy in single precision

Largest relative error of each function of each model, divided by 1 + |ln value|, in units of 1e-7
(neighbouring single-precision numbers differ by a relative 0.6e-7 to 1.2e-7), and the parameters
and optical depth where it occurs. The test suite allows at most {bar:g}.

| model | cases | {kernels} |
|---|---|{rules}|
{rows}

Measured by `tools/accuracy.py`: all functions in float32 on Dr.Jit's LLVM backend, on the examples
of each model and on extreme parameters ({cases} cases, `tests/stability/stability_cases.py`), at
{count} optical depths log-spaced from 1e-8 to 1e8, {half} around the mean flight, and the float32
numbers up to 4 steps around every kink (of many kinks, around 12). The exact values are those of
textbook formulas in 60-digit arithmetic (`tests/stability/stability_reference.py`), for the same
float32 parameters and depths, so that their rounding does not count. Values below 1e-30 are left
out. `tabulated` and `custom` are compared with the curve that they make of their data, not with the
data.
"""


def described(position: int) -> str:
    """The parameters of a case."""
    name = case_id(CASES[position]).removeprefix(CASES[position][0]).removeprefix("-")
    return re.sub(r"-(?=[a-z]+=)", ", ", name.replace("stability_cases:", ""))


def rows() -> Iterator[str]:
    """The table: one row per model, with the largest error of each function and where it occurs."""
    for key in models.names():
        mine = [i for i, case in enumerate(CASES) if case[0] == key]
        cells = []
        for kernel in KERNELS:
            worst, where = -1.0, ""
            for position in mine:
                found = compare(position, kernel, COUNT)
                i = int(np.argmax(found.error))
                if found.error[i] > worst:
                    worst = float(found.error[i])
                    where = f"{described(position)} at {found.tau[i]:.3g}".strip()
            cells.append(f"{worst / 1e-7:.1f}" + (f" ({where})" if worst else ""))
            print(f"{key:20} {kernel} {cells[-1]}", flush=True)
        yield f"| `{key}` | {len(mine)} | {' | '.join(cells)} |"


def main() -> None:
    page = TEXT.format(
        bar=BAR / 1e-7,
        kernels=" | ".join(KERNELS),
        rules="|".join("---" for _ in KERNELS),
        rows="\n".join(rows()),
        cases=len(CASES),
        count=COUNT,
        half=COUNT // 2,
    )
    (ROOT / "docs" / "accuracy.md").write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()
