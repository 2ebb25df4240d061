"""The log-log plot of a scene: relMSE over seconds, both engines, with error bars. Off screen, as PNG."""

from __future__ import annotations

import io
import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from ..common import engine_label
from . import analysis, tables
from .analysis import Level
from .campaign import Outcome

COLORS = {"LOBE": "#c2410c", "CYCLES": "#1d4ed8"}
MARKERS = {"LOBE": "o", "CYCLES": "s"}
PANELS = {"whole": "relMSE", "trimmed": "relMSE without the worst 0.1 % of values"}
SIZE, DPI = (9.2, 4.3), 100


def convergence(outcome: Outcome) -> bytes:
    """PNG: one panel with the whole error, one with the trimmed, which a few bright pixels don't decide.

    Full lines: whole time; dashed: sampling alone; numbers: samples. Hollow: within 5 times the reference's noise.
    """
    figure = Figure(figsize=SIZE, dpi=DPI, layout="constrained")  # without pyplot there is no screen to look for
    panels = figure.subplots(1, len(PANELS), sharey=True)
    for axes, (error, label) in zip(panels, PANELS.items(), strict=True):
        for engine, levels in outcome.levels.items():
            draw(axes, engine, [level for level in levels if getattr(level, error).mean() > 0.0], error)
        decorate(axes, outcome)
        axes.set_title(f"{label}\n{statement(outcome, error)}", fontsize=9.5, loc="left")
    panels[0].set_ylabel("relMSE")
    figure.legend(
        *panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False, fontsize=8.5
    )
    content = io.BytesIO()
    figure.savefig(content, format="png", metadata={"Software": None})
    return content.getvalue()


def decorate(axes: Axes, outcome: Outcome) -> None:
    noise = outcome.reference.noise
    axes.axhline(noise, color="0.6", linewidth=0.8, linestyle=":")
    axes.annotate("noise of the reference", (0.01, noise), xycoords=("axes fraction", "data"), xytext=(0, 2),
                  textcoords="offset points", color="0.4", fontsize=8)  # fmt: skip
    axes.set(xscale="log", yscale="log", xlabel="seconds of rendering, on the machine of this run")
    shortest, longest = axes.get_xlim()
    axes.xaxis.set_major_locator(LogLocator(base=10, subs=(1, 2, 5) if longest < 200 * shortest else (1,)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.tick_params(labelsize=8.5)
    axes.grid(True, which="major", color="0.92", linewidth=0.7)
    axes.spines[["top", "right"]].set_visible(False)


def draw(axes: Axes, engine: str, levels: list[Level], error: str) -> None:
    """One engine's two curves, with one standard error up and down, and the samples written at each point."""
    values = [getattr(level, error) for level in levels]
    errors = np.array([value.mean() for value in values])
    up = np.array([analysis.standard_error(value) for value in values])
    down = np.minimum(up, 0.8 * errors)  # the logarithm has no place for zero
    total, sampling = (np.array([np.median(getattr(lv, kind)) for lv in levels]) for kind in ("total", "sampling"))
    color, name = COLORS[engine], engine_label(engine)
    axes.errorbar(total, errors, yerr=(down, up), color=color, linewidth=1.6, capsize=2.5, elinewidth=1.0,
                  label=f"{name}, whole render")  # fmt: skip
    right = engine == "CYCLES"  # of the curve, where Lobe's is to its left
    for level, x, y in zip(levels, total, errors, strict=True):
        axes.plot(x, y, MARKERS[engine], markersize=5, color=color, markerfacecolor="white" if level.marked else color)
        axes.annotate(str(level.samples), (x, y), xytext=(6, 3) if right else (-6, -3), textcoords="offset points",
                      ha="left" if right else "right", va="bottom" if right else "top", fontsize=7.5,
                      color=color)  # fmt: skip
    long = sampling >= (analysis.SHORTEST_SAMPLING if engine == "CYCLES" else 0.0)
    if long.sum() > 1:
        axes.plot(sampling[long], errors[long], color=color, linewidth=1.0, linestyle=(0, (4, 3)), alpha=0.7,
                  label=f"{name}, sampling alone")  # fmt: skip


def statement(outcome: Outcome, error: str) -> str:
    """What the panel shows, in words; empty when there are not two curves that reach the same errors."""
    if set(outcome.levels) != set(COLORS):
        return ""
    lobe, cycles = (outcome.levels[engine] for engine in COLORS)
    ratios, _ = tables.ratios_and_range(lobe, cycles)
    middle, low, high = ratios[tables.RATIO if error == "whole" else tables.TRIMMED_RATIO]
    if not math.isfinite(middle):
        return "too few levels for a ratio of times"
    return f"to equal error Cycles takes {middle:.2f} ({low:.2f} to {high:.2f}) times as long"
