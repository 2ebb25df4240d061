"""The page benchmarks/results/convergence.html: one file, without script, that needs nothing else to be shown.

Each scene's section is kept in the store, so that a run of one scene leaves the others on the page.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Sequence
from html import escape
from pathlib import Path

import numpy as np

from .. import common
from . import pictures, plot, tables
from .campaign import Outcome, Shot, trial_costs
from .pictures import ERROR_RANGE, Z_RANGE
from .plan import REFERENCE_SEEDS

ERRORS, SIGNS = "inferno", "RdBu_r"
STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #222; max-width: 62rem; margin: 2rem auto; padding: 0 1rem }
h2 { margin: 3rem 0 .5rem; border-top: 1px solid #ddd; padding-top: 1.5rem }
table { border-collapse: collapse; font-size: 13px; margin: 1rem 0; display: block; overflow-x: auto }
td, th { border-bottom: 1px solid #e5e5e5; padding: .25rem .7rem; text-align: left; vertical-align: top }
.row { display: grid; grid-template-columns: repeat(3, 1fr); gap: 1rem }
figure { margin: 0 0 .7rem } figcaption { font-size: 13px; color: #555 }
.row img { width: 100%; image-rendering: pixelated; display: block }
.plot { max-width: 100% } .legend { height: .8em; vertical-align: baseline; margin: 0 .4em }
"""
INTRODUCTION = """
<p>Error (relMSE against the mean of long renders of both engines) over the time of the whole render, from the start of
the command to its end, warm. A point is the mean over several seeds, the engines in turn, Cycles with those of its
settings (light tree, guiding, map of the world) that did best in a pilot on the scene. Seconds are of the machine that
this ran on: only the ratios say something about the engines.</p>
"""


def image(content: bytes, style: str = "", text: str = "") -> str:
    data = base64.b64encode(content).decode()
    return f'<img class="{style}" alt="{escape(text)}" src="data:image/png;base64,{data}">'


def figure(pixels: np.ndarray, caption: str) -> str:
    """caption: HTML."""
    return f"<figure>{image(pictures.png(pictures.middle(pixels)))}<figcaption>{caption}</figcaption></figure>"


def table(rows: Sequence[dict[str, str]]) -> str:
    head = "".join(f"<th>{escape(key)}</th>" for key in rows[0])
    body = "".join("<tr>" + "".join(f"<td>{escape(v)}</td>" for v in row.values()) + "</tr>" for row in rows)
    return f"<table><tr>{head}</tr>{body}</table>"


def section(outcome: Outcome, curves: bytes) -> str:
    """One scene: the plot, pictures of about equal time beside the reference, where they differ, and the pilot."""
    settings, reference = outcome.settings, outcome.reference
    found = reference.comparison
    parts = [f'<h2 id="{escape(settings.scene.stem)}">{escape(settings.scene.stem)}</h2>']
    parts.append(f"<p>{settings.seeds} seeds a point.</p>")
    parts.append(image(curves, "plot", f"relMSE over seconds, {settings.scene.stem}"))
    shown = [
        figure(pictures.visible(shot.render.picture, outcome.exposure), caption(shot, outcome))
        for shot in outcome.shots
    ]
    shown.append(
        figure(
            pictures.visible(reference.picture, outcome.exposure),
            f"<b>Reference</b>: {REFERENCE_SEEDS} renders of each engine, {reference.samples} samples each; "
            f"relMSE of its own {reference.noise:.1e}. The engines' pictures: {reference.verdict}, difference of means "
            f"{found.mean_difference:+.2%} ± {found.mean_half_width:.2%}, {found.pass_sidak:.2%} of pixels pass.",
        )
    )
    parts.append(row(shown))
    maps = [
        figure(
            pictures.colored(pictures.error_map(shot.render.picture, reference.picture), *ERROR_RANGE, ERRORS),
            f"{common.engine_label(shot.engine)}: relative error",
        )
        for shot in outcome.shots
    ]
    maps.append(figure(pictures.colored(reference.agreement, *Z_RANGE, SIGNS),
                       "Long renders, Lobe less Cycles, in standard errors: noise when the engines agree"))  # fmt: skip
    parts += [row(maps), legends(), trials(outcome)]
    return "\n".join(parts)


def row(figures: Sequence[str]) -> str:
    return f'<div class="row">{"".join(figures)}</div>'


def caption(shot: Shot, outcome: Outcome) -> str:
    """Samples, the time as a share of that of the picture beside it, error."""
    last = outcome.shots[-1]
    share = f", {shot.render.total / last.render.total:.2f} of {common.engine_label(last.engine)}' time"
    return (
        f"<b>{common.engine_label(shot.engine)}</b>: {shot.samples} samples{'' if shot is last else share}; "
        f"relMSE {shot.error:.4f}"
    )


def legends() -> str:
    errors = image(pictures.legend(ERRORS, *ERROR_RANGE), "legend")
    signs = image(pictures.legend(SIGNS, *Z_RANGE), "legend")
    low, high = (10**end for end in ERROR_RANGE)
    return (
        f"<p><small>relative error {low:.1%}{errors}{high:.0%} &emsp; "
        f"Cycles brighter by {-Z_RANGE[0]:.0f} standard errors{signs}Lobe brighter</small></p>"
    )


def trials(outcome: Outcome) -> str:
    parts = []
    for side_by_side in outcome.trials:
        costs = trial_costs(side_by_side)
        least = min(costs.values()) or math.nan
        rows = [
            {
                "Cycles": str(trial.variant) + (" (chosen)" if trial.variant == outcome.variant else ""),
                "relMSE": f"{trial.error:.2e}",
                "trimmed": f"{trial.trimmed:.2e}",
                "time to the first's": f"{trial.seconds / side_by_side[0].seconds:.2f}",
                "time x error to the best": f"{costs[trial.variant] / least:.2f}",
            }
            for trial in side_by_side
        ]
        parts.append(f"<p>Pilot of Cycles' settings, {side_by_side[0].samples} samples:</p>{table(rows)}")
    return "".join(parts)


def write(path: Path, sections: Path, outcomes: Sequence[Outcome], short: Sequence[dict[str, str]]) -> None:
    """The page of all the scenes in the folder `sections`, which these outcomes' sections go into.

    Beside it each outcome's plot.
    """
    for folder in (path.parent, sections):
        folder.mkdir(parents=True, exist_ok=True)
    for outcome in outcomes:
        name, curves = outcome.settings.scene.stem, plot.convergence(outcome)
        path.with_name(f"{path.stem}_{name}.png").write_bytes(curves)
        (sections / f"{name}.html").write_text(section(outcome, curves), encoding="utf-8")
    order = {name: index for index, name in enumerate(common.SCENES)}
    files = sorted(sections.glob("*.html"), key=lambda file: (order.get(file.stem, len(order)), file.stem))
    summary = table(short) if short else ""
    settings = f"<p>{escape(tables.SETTINGS)} {escape(tables.AGREEMENT)}</p>"
    body = "\n".join([INTRODUCTION, settings, summary, *(file.read_text(encoding="utf-8") for file in files)])
    title = "Error against time: Lobe beside Cycles"
    head = f'<meta charset="utf-8"><title>{title}</title><style>{STYLE}</style>'
    path.write_text(
        f'<!doctype html><html lang="en"><head>{head}</head><body><h1>{title}</h1>{body}</body></html>\n',
        encoding="utf-8",
    )
