"""The page of a comparison: one HTML file that needs nothing else, with a slider between the two pictures. No bpy."""

from __future__ import annotations

import base64
import math
from html import escape

from . import pictures
from .headline import AGREED, headline_of, times
from .run import ENGINES, Outcome

SMALL = 640  # pixels: a picture that is narrower shows its pixels when it is scaled up

STYLE = """
:root { color-scheme: light dark; --ink: #1d1f21; --dim: #63676c; --line: #d9dbdd; --ground: #fff; --card: #f4f5f6;
  --accent: #b4531a }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e6e7e8; --dim: #9a9ea3; --line: #3a3d40; --ground: #191b1d; --card: #232629; --accent: #f0955a } }
* { box-sizing: border-box }
body { font: 15px/1.55 system-ui, sans-serif; color: var(--ink); background: var(--ground); max-width: 64rem;
  margin: 2.5rem auto; padding: 0 1.25rem; overflow-wrap: anywhere }
h1 { font-size: 1.6rem; line-height: 1.25; margin: 0 } h2 { font-size: 1.1rem; margin: 2.5rem 0 .6rem }
p { max-width: 46rem } .dim, figcaption, th { color: var(--dim) } .dim { margin: .3rem 0 1.5rem }
.headline { font-size: 1.15rem; font-weight: 600; margin: 0 0 1.2rem; max-width: none }
.slider { position: relative; background: #000; border-radius: 6px; overflow: hidden; --at: 50% }
.slider img { display: block; width: 100%; user-select: none }
.slider img + img { position: absolute; inset: 0; clip-path: inset(0 0 0 var(--at)) }
.slider input { position: absolute; inset: 0; width: 100%; height: 100%; margin: 0; opacity: 0; cursor: ew-resize }
.slider i { position: absolute; top: 0; bottom: 0; left: var(--at); width: 2px; margin-left: -1px; background: #fff;
  box-shadow: 0 0 4px #000; pointer-events: none }
.slider i::after { content: "\\2194"; position: absolute; top: 50%; left: 1px; transform: translate(-50%, -50%);
  width: 2rem; line-height: 2rem; text-align: center; font-style: normal; color: #222; background: #fff;
  border-radius: 50%; box-shadow: 0 0 4px #0008 }
.slider:focus-within { outline: 2px solid var(--accent); outline-offset: 2px }
.slider b { position: absolute; top: .6rem; padding: .1rem .6rem; border-radius: 4px; background: #000a; color: #fff;
  font-weight: 600; font-size: 13px; pointer-events: none }
.slider b.left { left: .6rem } .slider b.right { right: .6rem }
.small img { image-rendering: pixelated }
.cards { display: grid; grid-template-columns: repeat(auto-fit, minmax(12rem, 1fr)); gap: .8rem; margin: 1rem 0 }
.cards div { background: var(--card); border-radius: 6px; padding: .7rem 1rem; font-size: 13px; color: var(--dim) }
.cards strong { display: block; font-size: 1.5rem; line-height: 1.3; color: var(--ink); font-weight: 600 }
table { border-collapse: collapse; width: 100%; font-size: 14px; table-layout: fixed; margin-bottom: 1.2rem }
th:first-child { width: 50% }
td, th { border-bottom: 1px solid var(--line); padding: .35rem .8rem .35rem 0; text-align: left; font-weight: 400;
  vertical-align: top } td + td, th + th { font-variant-numeric: tabular-nums }
.maps { display: grid; grid-template-columns: repeat(auto-fit, minmax(18rem, 1fr)); gap: 1rem } figure { margin: 0 }
.maps img { width: 100%; display: block; border-radius: 6px } figcaption { font-size: 13px; margin-top: .4rem }
.bar { display: inline-block; width: 8rem; height: .7em; margin: 0 .5em; border-radius: 2px; vertical-align: baseline }
"""
SCRIPT = """
for (const box of document.querySelectorAll(".slider")) {
  const range = box.querySelector("input");
  const move = () => box.style.setProperty("--at", range.value + "%");
  range.addEventListener("input", move);
  move();
}
"""
HOW = f"""
Each engine has rendered the scene twice, with two seeds; the times are those of the quicker of the two. Half the mean
squared difference of two seeds is the noise of one picture. The product of two differences between the engines, each of
other seeds, is free of noise: what it leaves is the true difference; the map of it shows the mean of both seeds. All of
these are relative squared errors (relMSE), divided by the squared brightness + 0.01 that the mean of all four renders
has around each pixel. Noise falls like 1 / samples, so to the noise of Lobe's picture Cycles would need noise(Cycles) /
noise(Lobe) times the sampling time that it took here: that, with its preparation, over Lobe's time is the speed-up at
equal error. Its standard error comes from the noise, by its spread over the pixels, which a few bright specks make
large, and from how far the sampling times of an engine's two renders are apart. Two may happen to be close: trust no ±
of renders that take less than a second or so, whose times wander. No speed-up is said where it would mean nothing:
where the pictures differ in earnest, where noise may hide a difference of more than {AGREED:.0%}, where the engines
were not asked for the same, and where its standard error is half as large as itself or larger. FLIP (Andersson et al.
2020) says how different the two pictures look to someone who flips between them on a screen: 0 alike, 1 as different as
can be. It is taken of the pictures as shown, noise included.
"""
OF_ERRORS = (
    "± is one standard error; that of the means is the 95 % interval (Welch's t), which is wide as it comes from two "
    "renders of each engine alone."
)


def html(outcome: Outcome) -> str:
    """The whole file."""
    title = f"{outcome.scene}: Lobe beside Cycles"
    body = "\n".join(
        [
            f"<h1>{escape(title)}</h1>",
            f'<p class="dim">{escape(subtitle(outcome))}</p>',
            f'<p class="headline">{escape(headline_of(outcome).text)}</p>',
            _slider(outcome),
            _cards(outcome),
            "<h2>Figures</h2>",
            _table([("", "Lobe", "Cycles"), *engine_rows(outcome)]),
            _table([("", "Lobe against Cycles"), *difference_rows(outcome)]),
            f'<p class="dim">{escape(OF_ERRORS)}</p>',
            _maps(outcome),
            "<h2>Not Matched</h2>",
            _unmatched(outcome),
            "<h2>Settings that were changed for the comparison</h2>",
            _table([("Setting", "In the file", "Here"), *outcome.changed]) if outcome.changed else "<p>None.</p>",
            f"<h2>How it is measured</h2><p>{HOW.strip()}</p>",
        ]
    )
    head = (
        '<meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{STYLE}</style>"
    )
    return (
        f'<!doctype html>\n<html lang="en"><head>{head}</head>\n<body>\n{body}\n<script>{SCRIPT}</script>\n'
        "</body></html>\n"
    )


def subtitle(outcome: Outcome) -> str:
    width, height = outcome.size
    what = f"{outcome.seconds:g} seconds of sampling each" if outcome.seconds else "equal samples"
    return f"{width} x {height} pixels, {what}, {outcome.threads} threads"


# --- figures as text: the panel and the command line show the same ---------------------------------------------


def engine_rows(outcome: Outcome) -> list[tuple[str, str, str]]:
    """(what, Lobe's, Cycles')."""
    noise = {"LOBE": outcome.figures.noise_lobe, "CYCLES": outcome.figures.noise_cycles}
    rows = {
        "Samples": [_samples(outcome, engine) for engine in ENGINES],
        "Time, from F12 to the picture": [f"{outcome.times[engine].total:.2f} s" for engine in ENGINES],
        "of it sampling": [f"{outcome.times[engine].sampling:.2f} s" for engine in ENGINES],
        "Noise (relMSE)": [number(noise[engine], ".1e") for engine in ENGINES],
    }
    return [(what, *values) for what, values in rows.items()]


def _samples(outcome: Outcome, engine: str) -> str:
    samples = f"{outcome.samples[engine]:.5g}"
    if engine == "LOBE" or not outcome.seconds:
        return samples
    return f"at least {samples}" if outcome.samples[engine] else "not told"


def difference_rows(outcome: Outcome) -> list[tuple[str, str]]:
    """(what, the figure); those of the speed-up only where they mean something."""
    found = outcome.figures
    rows = []
    if headline_of(outcome).speedup:
        rows = [
            ("Speed-up at equal error", f"{times(found.speedup, found.ratio_error)} x"),
            ("the same, sampling alone", f"{times(found.speedup_sampling, found.ratio_error)} x"),
        ]
    return [
        *rows,
        ("Difference of means", f"{found.mean_difference:+.2%} ± {found.mean_difference_margin:.2%}"),
        ("relMSE between the pictures", number(found.rel_mse, ".1e")),
        ("of it without the noise of both", f"{found.difference:.1e} ± {found.difference_error:.0e}"),
        ("FLIP", number(found.flip, ".4f")),
    ]


def number(value: float, form: str) -> str:
    return format(value, form) if math.isfinite(value) else "not known"


# --- parts of the page -----------------------------------------------------------------------------------------


def _image(content: bytes, text: str) -> str:
    return f'<img alt="{escape(text)}" src="data:image/png;base64,{base64.b64encode(content).decode()}">'


def _small(outcome: Outcome) -> str:
    return " small" if outcome.size[0] < SMALL else ""


def _slider(outcome: Outcome) -> str:
    width, height = outcome.size
    whole = f"max-width: calc(85vh * {width} / {height})"  # an upright picture fits into the window
    return (
        f'<div class="slider{_small(outcome)}" style="{whole}">{_image(outcome.pictures["lobe"], "Rendered with Lobe")}'
        f"{_image(outcome.pictures['cycles'], 'Rendered with Cycles')}"
        '<b class="left">Lobe</b><b class="right">Cycles</b><i></i>'
        '<input type="range" min="0" max="100" step="0.1" value="50" aria-label="Lobe left, Cycles right">'
        "</div>"
    )


def _cards(outcome: Outcome) -> str:
    found = outcome.figures
    speed = f"{times(found.speedup, found.ratio_error)} x" if headline_of(outcome).speedup else ""
    cards = (
        (speed, "speed-up at equal error: Cycles' time over Lobe's"),
        (f"{found.mean_difference:+.2%}", "difference of the pictures' means, Lobe against Cycles"),
        (number(found.rel_mse, ".2g"), "relMSE between the pictures, noise of both included"),
        (number(found.flip, ".3f"), "FLIP: how different they look, 0 to 1"),
    )
    return '<div class="cards">' + "".join(f"<div><strong>{a}</strong>{b}</div>" for a, b in cards if a) + "</div>"


def _table(rows: list[tuple[str, ...]]) -> str:
    head, *body = rows
    lines = ["".join(f"<th>{escape(cell)}</th>" for cell in head)]
    lines += ["".join(f"<td>{escape(cell)}</td>" for cell in row) for row in body]
    return "<table>" + "".join(f"<tr>{line}</tr>" for line in lines) + "</table>"


def _maps(outcome: Outcome) -> str:
    end = f"{outcome.difference_range:.0%}"
    maps = (
        ("difference", f"Cycles brighter, {end}{_bar(pictures.SIGNS)}{end}, Lobe brighter"),
        ("flip", f"FLIP of the pictures above: 0{_bar(pictures.MAGMA)}1"),
    )
    figures = "".join(
        f"<figure>{_image(outcome.pictures[name], name.capitalize() + ' map')}<figcaption>{text}</figcaption></figure>"
        for name, text in maps
    )
    return f'<h2>Where they differ</h2><div class="maps{_small(outcome)}">{figures}</div>'


def _bar(stops: tuple[str, ...]) -> str:
    return f'<span class="bar" style="background: linear-gradient(to right, {", ".join(stops)})"></span>'


def _unmatched(outcome: Outcome) -> str:
    if not outcome.unmatched:
        return "<p>Nothing that is known of: both engines were asked for the same picture.</p>"
    first = "<p>There the pictures may differ, or take longer, for another reason than the engines' speed:</p>"
    return first + "<ul>" + "".join(f"<li>{escape(line)}</li>" for line in outcome.unmatched) + "</ul>"
