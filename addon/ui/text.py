"""Sentences in a panel: Blender's labels don't break lines."""

from __future__ import annotations

import blf

MARGIN = 56  # pixels at resolution scale 1, of a panel, a box, and what a label keeps free
ICON = 22
FALLBACK_WIDTH = 300


def draw_text(layout, context, text: str, icon: str = "NONE", beside: float = 0.0) -> None:
    """As many labels below each other as the text needs; `beside` pixels of the row are for something else."""
    scale = context.preferences.system.ui_scale
    width = _region_width(context) - scale * (MARGIN + beside + ICON * (icon != "NONE"))
    column = layout.column(align=True)
    for number, line in enumerate(broken(text, width, _measure(context, scale))):
        shown = icon if number == 0 else ("BLANK1" if icon != "NONE" else "NONE")
        column.label(text=line, icon=shown)


def broken(text: str, width: float, measure) -> list[str]:
    """`text` in lines of at most `width`, broken between words; a word that is longer stays whole."""
    lines: list[str] = []
    for word in text.split():
        longer = f"{lines[-1]} {word}" if lines else word
        if lines and measure(longer) <= width:
            lines[-1] = longer
        else:
            lines.append(word)
    return lines


def is_narrower(context, width: float) -> bool:
    """Than so many pixels at resolution scale 1."""
    return _region_width(context) < width * context.preferences.system.ui_scale


def _region_width(context) -> float:
    return context.region.width if context.region is not None else FALLBACK_WIDTH


def _measure(context, scale: float):
    """A function that tells the width in pixels of a text in the interface's font."""
    points = context.preferences.ui_styles[0].widget.points
    blf.size(0, points * scale)
    return lambda text: blf.dimensions(0, text)[0]
