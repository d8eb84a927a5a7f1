"""Tables in Markdown, and plots (these need matplotlib, the extra ``plot``)."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scipy import stats

from ..fitting import plot as plotting
from ..system.files import replacing
from .competitors import COMPETITORS
from .results import CaseResult, Results, Row
from .statistics import LEVEL, Estimate

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_Panel = tuple[str, Callable[[Any], None]]

__all__ = [
    "STYLE",
    "colour",
    "efficiency_plot",
    "error_plot",
    "logarithmic",
    "main_plot",
    "markdown",
    "summary",
]

STYLE = {**plotting.STYLE, "font.size": 8.5, "axes.titlesize": 9.5, "lines.linewidth": 1.5}

# Colours of Okabe and Ito, which colour-blind people can distinguish.
_COLOURS = (
    "#D55E00",
    "#E69F00",
    "#B34400",
    "#0072B2",
    "#56B4E9",
    "#009E73",
    "#CC79A7",
    "#666666",
    "#000000",
)
_MARKERS = "o^vsDPX*<"


def colour(name: str) -> tuple[str, str]:
    """Colour and marker of a competitor, the same in all plots."""
    names = list(dict.fromkeys(competitor.name for competitor in COMPETITORS))
    return _style(names.index(name) if name in names else len(names))


def _style(place: int) -> tuple[str, str]:
    return _COLOURS[place % len(_COLOURS)], _MARKERS[place % len(_MARKERS)]


# --------------------------------------------------------------------- tables


def markdown(results: Results) -> str:
    """The whole report: environment, relative efficiencies, and all figures of every case."""
    about = results.environment
    lines = [
        "# Run time against error",
        "",
        (
            f"Written by `nonexp bench{' --quick' if about.get('quick') else ''}` on "
            f"{about.get('date', '')[:10]}, commit {about.get('commit') or 'unknown'}: "
            f"{about.get('processor')}, {about.get('threads')} threads, {about.get('variant')}, "
            f"nonexp {about.get('nonexp')}, Mitsuba {about.get('mitsuba')}, "
            f"Dr.Jit {about.get('drjit')}, LLVM {about.get('llvm')}, Python {about.get('python')}; "
            f"load at the start {_number(about.get('load'))}."
        ),
        "",
        (
            "Efficiency is 1/(MSE of a pass x its median time), relative to the competitor with 1. "
            "Intervals hold 95 %. Errors are corrected for the reference's own variance."
        ),
        "",
        "## Summary",
        "",
        *summary(results),
        "",
    ]
    lines += [f"Left out: {text}." for text in results.skipped]
    for case in results.cases:
        lines += ["", *_case_table(case)]
    return "\n".join(lines).rstrip() + "\n"


def summary(results: Results) -> list[str]:
    """A table of the relative efficiency of every competitor in every case, then biases."""
    names = list(
        dict.fromkeys(
            row.name
            for name in dict.fromkeys(competitor.name for competitor in COMPETITORS)
            for case in results.cases
            for row in case.rows
            if row.name == name
        )
    )
    others = {row.name for case in results.cases for row in case.rows} - {*names}
    names += sorted(others)
    lines = [f"| efficiency | {' | '.join(names)} |", f"|---|{'--:|' * len(names)}"]
    biased, failed = [], []
    for case in results.cases:
        cells = []
        for name in names:
            row = case.row(name)
            cells.append("" if row is None else _relative(case, row))
            if row is not None and row.error is not None:
                failed.append(f"`{row.name}` fails in {case.name}: {row.error}.")
            elif row is not None and row.figures is not None and row.figures.bias.found:
                off = row.figures.bias
                biased.append(
                    f"`{row.name}` is biased in {case.name}: {_percent(off.mean)} of the mean, "
                    f"root mean square over tiles {100 * off.floor:.2f} %."
                )
        lines.append(f"| {case.name} | {' | '.join(cells)} |")
    if biased:
        lines += ["", "(*) " + " ".join(biased)]
    else:
        lines += ["", "No competitor is biased."]
    if failed:
        lines += ["", *failed]
    return [*lines, "", _slopes(results)]


def _slopes(results: Results) -> str:
    """Competitors whose error does not fall as 1/N, corrected for the number of slopes."""
    found = [
        (case, row, row.figures.slope)
        for case in results.cases
        for row in case.rows
        if row.figures is not None and math.isfinite(row.figures.slope.value)
    ]
    off, outside = [], 0
    for case, row, slope in found:
        # Joint intervals of all slopes at 95 % (Bonferroni).
        joint = 0.5 * (1 - LEVEL) / len(found)
        wider = stats.t.isf(joint, row.passes - 1) / stats.t.isf(0.5 * (1 - LEVEL), row.passes - 1)
        distance = abs(slope.value + 1)
        outside += distance > slope.high - slope.value
        if distance > wider * (slope.high - slope.value):
            off.append(f"`{row.name}` in {case.name} ({_interval(slope, 3)})")
    text = f"Of {len(found)} slopes, {outside} miss -1 in their own interval at 95 %"
    if off:
        return f"{text}, and in intervals that hold all of them at 95 %: {', '.join(off)}."
    return f"{text}, and none in intervals that hold all of them at 95 %."


def _case_table(case: CaseResult) -> list[str]:
    width, height = case.size
    noise = case.reference_stderr
    shown = f", standard error of its mean {100 * noise:.3f} %" if noise else ""
    lines = [
        f"## {case.name}",
        "",
        (
            f"{case.text[0].upper()}{case.text[1:]}; {width} x {height} pixels. "
            f"Reference: {case.reference}{shown}."
        ),
        "",
        (
            "| competitor | passes | ms per pass (quartiles) | MSE of a pass | relMSE "
            "| relative efficiency | slope | bias / mean | floor < | operations | compile, s | MB |"
        ),
        "|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|",
    ]
    return lines + [_row(case, row) for row in case.rows]


def _row(case: CaseResult, row: Row) -> str:
    figures = row.figures
    if figures is None:
        return f"| {row.name} | failed: {row.error} |" + " |" * 10
    first, median, third = (1e3 * seconds for seconds in figures.seconds)
    bias = figures.bias
    flag = " (*)" if bias.found else ""
    cells = [
        row.name,
        f"{row.passes} x {row.spp}",
        f"{median:.4g} ({first:.4g} to {third:.4g})",
        f"{figures.variance:.3g}",
        f"{figures.curve[0].relmse:.3g}",
        _relative(case, row),
        _interval(figures.slope, 2) if math.isfinite(figures.slope.value) else "",
        f"{_percent(bias.mean)} ± {100 * bias.stderr:.2f}{flag}",
        f"{100 * bias.floor_high:.2f} %",
        f"{row.operations}",
        f"{row.compile_seconds:.2f}{' cached' if row.compile_cached else ''}",
        f"{row.memory / 1e6:.1f}",
    ]
    return f"| {' | '.join(cells)} |"


def _relative(case: CaseResult, row: Row) -> str:
    ratio = case.relative(row)
    if row.figures and row.figures.variance == 0:
        return "no noise"
    if ratio is None or not math.isfinite(ratio.value):
        return "failed" if row.error else ""
    flag = " (*)" if row.figures and row.figures.bias.found else ""
    return ("1" if row.name == case.baseline else _interval(ratio, 2)) + flag


def _interval(estimate: Estimate, digits: int) -> str:
    value, low, high = (f"{x:.{digits}f}" for x in (estimate.value, estimate.low, estimate.high))
    return f"{value} ({low} to {high})"


def _percent(fraction: float) -> str:
    return f"{100 * fraction:+.2f} %"


def _number(value: Any) -> str:
    return f"{value:.2f}" if isinstance(value, float) else "unknown"


# --------------------------------------------------------------------- plots


def error_plot(results: Results, path: Path) -> bool:
    """Error against time: one panel per case with competitors, and one for all others."""
    panels: list[_Panel] = [
        (case.name, partial(_errors, rows=[(row.name, row) for row in case.rows]))
        for case in results.cases
        if len(case.rows) > 1 and case.baseline
    ]
    alone = [
        (case.name, case.rows[0]) for case in results.cases if len(case.rows) == 1 and case.baseline
    ]
    if alone:
        panels.append(("nonexp alone", partial(_errors, rows=alone)))
    return _draw(panels, path, "MSE against seconds of rendering")


def efficiency_plot(results: Results, path: Path) -> bool:
    """Bars of relative efficiency, one panel per case with competitors."""
    panels: list[_Panel] = [
        (case.name, partial(_bars, case=case))
        for case in results.cases
        if len(case.rows) > 1 and case.baseline
    ]
    return _draw(panels, path, "efficiency 1/(MSE x time)")


def main_plot(results: Results, path: Path) -> bool:
    """Error and efficiency, side by side, of the first case in which Mitsuba's volpath competes."""
    case = next((case for case in results.cases if case.baseline == "volpath"), None)
    if case is None:
        return False
    errors = partial(_errors, rows=[(row.name, row) for row in case.rows])
    panels: list[_Panel] = [("error", errors), ("efficiency", partial(_bars, case=case))]
    return _draw(panels, path, f"{case.name}: {case.text}")


def _draw(panels: list[_Panel], path: Path, title: str) -> bool:
    """Draw the panels; false if there are none."""
    import matplotlib
    from matplotlib.figure import Figure

    if not panels:
        return False
    columns = min(3, len(panels))
    rows = -(-len(panels) // columns)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(4.2 * columns, 3.1 * rows + 0.4), layout="constrained")
        figure.suptitle(title, fontsize=10)
        axes = figure.subplots(rows, columns, squeeze=False)
        for place, (name, draw) in zip(axes.flat, panels, strict=False):
            draw(place)
            place.set_title(name)
        for place in axes.flat[len(panels) :]:
            place.set_axis_off()
        with replacing(path) as (aside,):
            figure.savefig(aside, format=path.suffix[1:], dpi=110)
    return True


def _errors(axes: Axes, rows: list[tuple[str, Row]]) -> None:
    """Lines through the MSE at 1, 2, 4 ... passes, bands from the 16th to the 84th percentile."""
    shared = len({row.name for _, row in rows}) < len(rows)
    for place, (label, row) in enumerate(rows):
        points = [p for p in row.figures.curve if p.mse > 0] if row.figures else []
        if row.figures is None or not points:
            continue
        shade, marker = _style(place) if shared else colour(row.name)
        seconds = [point.seconds for point in points]
        least = min(point.mse for point in points) * 1e-2
        low = [max(point.low, least) for point in points]
        high = [max(point.high, least) for point in points]
        axes.fill_between(seconds, low, high, color=shade, alpha=0.15, linewidth=0)
        label += " (biased)" if row.figures.bias.found else ""
        style: dict[str, Any] = {"color": shade, "marker": marker, "markersize": 4, "label": label}
        axes.plot(seconds, [point.mse for point in points], **style)
    logarithmic(axes)
    axes.set(xlabel="seconds", ylabel="MSE")
    if shared:
        axes.legend(fontsize=7, loc="upper left", bbox_to_anchor=(1, 1))
    else:
        axes.legend(fontsize=7)


def logarithmic(axes: Axes) -> None:
    """Make axes logarithmic: at least a decade in y, and labels at 1, 2 and 5 on short axes."""
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    axes.set(xscale="log", yscale="log")
    bottom, top = axes.get_ylim()
    if top < 10 * bottom:
        middle = math.sqrt(bottom * top)
        axes.set_ylim(middle / math.sqrt(10), middle * math.sqrt(10))
    for axis, (low, high) in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
        axis.set_minor_formatter(NullFormatter())
        if high < 100 * low:
            axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        if 1e-3 < low and high < 1e5:
            axis.set_major_formatter(StrMethodFormatter("{x:g}"))
        elif high < 100 * low:
            axis.set_major_formatter(StrMethodFormatter("{x:.0e}"))


def _bars(axes: Axes, case: CaseResult) -> None:
    rows = [row for row in case.rows if row.figures is not None and case.relative(row)]
    for place, row in enumerate(reversed(rows)):
        ratio = case.relative(row)
        if ratio is None or not math.isfinite(ratio.value):
            continue
        error = [[ratio.value - ratio.low], [ratio.high - ratio.value]]
        axes.barh(place, ratio.value, color=colour(row.name)[0], height=0.7)
        axes.errorbar(ratio.value, place, xerr=error, color="0.2", capsize=2, linewidth=1)
    axes.set_yticks(range(len(rows)), [row.name for row in reversed(rows)])
    axes.set_xlabel(f"relative to {case.baseline}")
    axes.axvline(1, color="0.4", linewidth=0.8)
    axes.set_xlim(left=0)
    axes.grid(axis="y", visible=False)
