"""The table of a validation as a page, and its picture."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..system.version import __version__
from .run import STUDIES, agrees, limit, summary, titles
from .study import Row

__all__ = ["cells", "figure", "number", "page", "sentence", "write"]

Rows = Mapping[str, Sequence[Row]]
"""Rows by study."""


HEAD = """\
# Published numbers

Numbers of others beside those of `nonexp_volpath`, and of quadrature where no random numbers are
needed.

```sh
nonexp validate                 # all of this table: about ten minutes on two idle cores
nonexp validate --error 0.1%    # twice as precise, in four times as long
nonexp validate --quick         # a part of it, less precisely: a minute
nonexp validate --list          # what is compared with what
```

![Differences of all numbers in standard errors, by study](images/validation.png)

The difference of a row is in standard errors of both sides together. The numbers, their errors and
where they stand are in `nonexp/validation/`, a folder for each study.
"""


def number(value: float, error: float) -> str:
    """A value with as many decimals as its error has two digits of."""
    if not error or not math.isfinite(error):
        return f"{value:.7g}"
    decimals = max(0, 1 - math.floor(math.log10(error)))
    return f"{value:.{min(decimals, 8)}f}"


def cells(row: Row, rows: int) -> tuple[str, str, str, str, str]:
    """Quantity, published with its error, ours, difference, verdict."""
    quantity, shown = row.quantity, f"{number(row.ours, row.error)}"
    known = quantity.error > 2e-6 * abs(quantity.value)
    published = f"{quantity.value:.7g}" + f" ± {quantity.error:.1g}" * known
    ours = f"{shown} ± {row.error:.1g}" if row.error else f"{shown}"
    verdict = "agrees" if agrees(row, rows) else "DEVIATES"
    return quantity.name, published, ours, f"{row.deviation:+.1f}", verdict


def sentence(rows: Sequence[Row]) -> str:
    """A study in one line."""
    found = summary(rows)
    return (
        f"{found.rows} numbers, mean squared deviation {found.chi2:.2f}, mean relative difference "
        f"{found.relative:+.3%} ± {found.error:.3%}"
    )


def page(found: Rows) -> str:
    """The page docs/validation.md, from what stands above its tables in the repository."""
    total = sum(map(len, found.values()))
    deviating = sum(not agrees(row, total) for rows in found.values() for row in rows)
    beyond = f"{deviating or 'none'} beyond the limit of {limit(total):.1f} standard errors"
    lines = [
        HEAD,
        f"{total} numbers, {beyond}, which one of so many exceeds by chance in 1 of 1000 runs.",
        "",
        f"Written by `nonexp validate --out docs` (nonexp {__version__}).",
    ]
    for study, rows in found.items():
        title, source = titles(study)
        lines += ["", f"## {title[0].upper()}{title[1:]}", "", _manual(study), ""]
        lines += [f"Source: {source}. {sentence(rows)}.", ""]
        lines += ["| quantity | published | ours | difference | |", "|---|---|---|---|---|"]
        for row in rows:
            lines.append("| " + " | ".join(cells(row, total)) + " |")
    return "\n".join(lines) + "\n"


def _manual(study: str) -> str:
    """The docstring of a study, without its first line."""
    text = STUDIES[study].__doc__ or ""
    body = text.strip().partition("\n")[2].strip()
    return body.replace("``", "`").replace(":mod:`..adams_1989_jqsrt`", "the study above")


def figure(found: Rows) -> Any:
    """Deviations in standard errors, a line for each study, over the band of the limit."""
    from matplotlib.figure import Figure

    total = sum(map(len, found.values()))
    drawn = Figure(figsize=(9, 0.6 * len(found) + 1), layout="constrained")
    axes = drawn.subplots()
    bound = limit(total)
    axes.axvspan(-bound, bound, color="0.93", zorder=0)
    axes.axvspan(-1, 1, color="0.85", zorder=0)
    for place, rows in enumerate(found.values()):
        spread = [0.5 * ((i + 0.5) / len(rows) - 0.5) for i in range(len(rows))]
        good = [agrees(row, total) for row in rows]
        colours = ["C0" if one else "C3" for one in good]
        axes.scatter([row.deviation for row in rows], [place + y for y in spread], 9, colours)
    names = ["\n".join(textwrap.wrap(titles(study)[0], 36)) for study in found]
    axes.set_yticks(range(len(found)), names)
    axes.invert_yaxis()
    axes.set_xlabel("difference in standard errors; bands: 1 and the limit")
    return drawn


def write(found: Rows, folder: Path) -> list[Path]:
    """Write validation.md and images/validation.png; returns their paths."""
    from ..system.files import replacing

    text, picture = folder / "validation.md", folder / "images" / "validation.png"
    picture.parent.mkdir(parents=True, exist_ok=True)
    with replacing(text, picture) as (page_file, picture_file):
        page_file.write_text(page(found), encoding="utf-8")
        figure(found).savefig(picture_file, format="png", dpi=120)
    return [text, picture]
