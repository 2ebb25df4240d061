"""Compare with Cycles: the button, what a comparison is at, and what came of the newest one."""

from __future__ import annotations

import bpy

from ..compare import difference_rows, engine_rows, headline_of
from ..compare.operators import (
    PLACES,
    LOBE_OT_compare_with_cycles,
    LOBE_OT_open_comparison,
    LOBE_OT_save_comparison,
    outcome_of,
    running,
)
from .panel import LobePanel
from .text import draw_text

# Of the rows that the page and the log have in full: the panel is narrow.
SHORT = {
    "Time, from F12 to the picture": "Time",
    "of it sampling": "Sampling",
    "Noise (relMSE)": "Noise",
    "Speed-up at equal error": "Speed-up",
    "the same, sampling alone": "Sampling",
    "Difference of means": "Means",
    "relMSE between the pictures": "relMSE",
    "of it without the noise of both": "Noise off",
}


class LOBE_RENDER_PT_compare(LobePanel, bpy.types.Panel):
    bl_label = "Compare"
    bl_context = "render"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        settings = context.window_manager.lobe_compare
        column = self.column()
        column.row().prop(settings, "mode", expand=True)
        if settings.mode == "TIME":
            column.prop(settings, "seconds")
        button = self.layout.operator(LOBE_OT_compare_with_cycles.bl_idname, icon="IMAGE_RGB")
        button.mode, button.seconds = settings.mode, settings.seconds
        if running():
            draw_text(self.layout, context, f"{running()}. Escape stops it", "TIME")
            return
        outcome = outcome_of(context.scene)
        if outcome is None:
            draw_text(self.layout, context, "Four renders: two of each engine. Your settings stay as they are")
            return
        headline = headline_of(outcome)
        draw_text(self.layout, context, headline.text, "CHECKMARK" if headline.speedup else "ERROR")
        draw_text(
            self.layout, context, f"Done. {PLACES}. The page goes when another file is opened, unless you save it"
        )
        row = self.layout.row(align=True)
        row.operator(LOBE_OT_open_comparison.bl_idname, icon="URL")
        row.operator(LOBE_OT_save_comparison.bl_idname, icon="FILE_TICK")
        _draw_rows(self.layout.box(), [("", "Lobe", "Cycles"), *engine_rows(outcome)])
        _draw_rows(self.layout.box(), difference_rows(outcome))


class LOBE_RENDER_PT_compare_unmatched(LobePanel, bpy.types.Panel):
    bl_label = "Not Matched"
    bl_parent_id = "LOBE_RENDER_PT_compare"
    bl_context = "render"

    @classmethod
    def poll(cls, context) -> bool:
        outcome = outcome_of(context.scene) if super().poll(context) else None
        return outcome is not None and bool(outcome.unmatched)

    def draw(self, context):
        for line in outcome_of(context.scene).unmatched:
            draw_text(self.layout, context, line, "DOT")


def _draw_rows(layout, rows) -> None:
    split = layout.split(factor=0.36)
    columns = [split.column(align=True)]
    values = split.row()
    columns += [values.column(align=True) for _ in rows[0][1:]]
    for what, *texts in rows:
        for column, text in zip(columns, [SHORT.get(what, what), *texts], strict=True):
            column.label(text=text)


CLASSES = (LOBE_RENDER_PT_compare, LOBE_RENDER_PT_compare_unmatched)
