"""The Scene Report: what Lobe does not draw as asked, counted, with a button that selects the objects that have it."""

from __future__ import annotations

import bpy

from .. import scene_report
from ..check import LOBE_OT_check_scene
from ..export.notes import APPROXIMATED, ERROR, SKIPPED, WARNING, Group
from .objects_of import may_have_objects, objects_of
from .panel import LobePanel
from .text import draw_text, is_narrower

ICONS = {
    "": "SCENE_DATA",
    "view layer": "RENDERLAYERS",
    "camera": "CAMERA_DATA",
    "world": "WORLD",
    "light": "LIGHT",
    "object": "OBJECT_DATA",
    "material": "MATERIAL",
    "image": "IMAGE_DATA",
    "library": "LIBRARY_DATA_BROKEN",
}
LEVEL_ICONS = {ERROR: "CANCEL", APPROXIMATED: "INFO"}
SHOWN = 60  # rows; the text and the command line have no limit
BUTTON_WIDTH = 52  # pixels at resolution scale 1, of the button beside a text
NARROW = 270  # of a region in which the buttons go below the texts
TOOLTIP_NAMES = 12
NOTHING = (
    "Nothing in this view layer has or places it: it is in the background scene, or has gone since the list was made. "
    "Check the scene again"
)
TEXT = "Scene Report"
OWN = "lobe_report"  # a property of the texts that Lobe has made: the name they had then


class LOBE_OT_select_reported(bpy.types.Operator):
    bl_idname = "lobe.select_reported"
    bl_label = "Select Objects"
    bl_options = {"REGISTER", "UNDO"}

    report_number: bpy.props.IntProperty(options={"HIDDEN", "SKIP_SAVE"})
    index: bpy.props.IntProperty(options={"HIDDEN", "SKIP_SAVE"})

    @classmethod
    def description(cls, context, properties) -> str:
        group = _group(context.scene, properties)
        if group is None:
            return "Check the scene again"
        names = ", ".join(group.names[:TOOLTIP_NAMES])
        more = len(group.names) - TOOLTIP_NAMES
        what = f"Select the objects of {names}" if group.kind in ("material", "image") else f"Select {names}"
        return what + (f" and {more} more" if more > 0 else "")

    @classmethod
    def poll(cls, context) -> bool:
        return context.scene is not None and context.view_layer is not None

    def execute(self, context):
        group = _group(context.scene, self)
        if group is None:
            self.report({"WARNING"}, "The list is a new one: press again")
            return {"CANCELLED"}
        (objects,) = objects_of(context.view_layer, context.evaluated_depsgraph_get(), [group])
        if not objects:
            self.report({"WARNING"}, NOTHING)
            return {"CANCELLED"}
        if context.mode != "OBJECT":
            bpy.ops.object.mode_set(mode="OBJECT")
        for other in context.view_layer.objects:
            other.select_set(False)
        for found in objects:
            found.select_set(True)
        context.view_layer.objects.active = objects[0]
        _show_slot(objects[0], group)
        hidden = sum(not found.visible_get() for found in objects)
        if hidden:
            of = "It is" if len(objects) == 1 else f"{hidden} of {len(objects)} are"
            self.report({"INFO"}, f"{of} hidden in the viewport, which can't show the selection")
        return {"FINISHED"}


def _group(scene, button) -> Group | None:
    """What a button was drawn beside. None where a render has made a newer report since: a panel on the screen shows
    the old one until it is drawn again."""
    report = scene_report.report_of(scene)
    if report is None or report.number != button.report_number or not 0 <= button.index < len(report.groups):
        return None
    return report.groups[button.index]


def _show_slot(object_, group: Group) -> None:
    """Make the material in question the one that the Material tab shows."""
    for number, slot in enumerate(object_.material_slots):
        if group.kind == "material" and slot.material is not None and slot.material.name_full in group.names:
            object_.active_material_index = number
            return


class LOBE_OT_report_as_text(bpy.types.Operator):
    """Write the whole report, with all names, into a text 'Scene Report', which the Text Editor shows"""

    bl_idname = "lobe.report_as_text"
    bl_label = "Report as Text"

    @classmethod
    def poll(cls, context) -> bool:
        return context.scene is not None and scene_report.report_of(context.scene) is not None

    def execute(self, context):
        text = _text()
        lines = scene_report.lines(scene_report.report_of(context.scene), names_a_line=None)
        text.from_string("\n".join([f"Scene '{context.scene.name}'", *lines, ""]))
        for area in context.screen.areas if context.screen is not None else ():
            if area.type == "TEXT_EDITOR":
                area.spaces.active.text = text
        self.report({"INFO"}, f"Lobe: the report is in the text '{text.name}', see the Text Editor")
        return {"FINISHED"}


def _text() -> bpy.types.Text:
    """The text of a report before, else a new one. One that the user has written, renamed or copied is theirs."""
    for text in bpy.data.texts:
        if text.library is None and text.get(OWN) == text.name:
            return text
    text = bpy.data.texts.new(TEXT)
    text[OWN] = text.name
    return text


class _Buttons:
    """Which groups of a report have a button: looked up once, panels are drawn often."""

    def __init__(self) -> None:
        self._report: scene_report.Report | None = None
        self._has: list[bool] = []

    def has(self, report: scene_report.Report, group: Group) -> bool:
        if self._report is not report:
            self._report, self._has = report, [may_have_objects(each) for each in report.groups]
        return self._has[report.groups.index(group)]


_buttons = _Buttons()


class LOBE_RENDER_PT_scene_report(LobePanel, bpy.types.Panel):
    bl_label = "Scene Report"
    bl_context = "render"
    bl_options = {"DEFAULT_CLOSED"}

    def draw_header_preset(self, context):
        report = scene_report.report_of(context.scene)
        if report is not None:
            number = len(report.of_level(ERROR, WARNING))
            otherwise = "CHECKMARK" if scene_report.is_honoured(report) else "INFO"
            self.layout.label(text=str(number or ""), icon="ERROR" if number else otherwise)

    def draw(self, context):
        layout = self.layout
        report = scene_report.report_of(context.scene)
        row = layout.row(align=True)
        row.operator(LOBE_OT_check_scene.bl_idname, icon="VIEWZOOM")
        if report is not None:
            row.operator(LOBE_OT_report_as_text.bl_idname, text="", icon="TEXT")
        if report is None:
            draw_text(layout, context, "What Lobe would not draw as asked is listed here after a check or a render")
            return
        if scene_report.is_honoured(report):
            layout.label(text=scene_report.HONOURED, icon="CHECKMARK")
            return
        for level in scene_report.NOT_HONOURED:
            if groups := report.of_level(level):
                draw_text(layout, context, f"{scene_report.HEADINGS[level]}, as of the last {report.source}:")
                _draw_groups(layout, context, report, groups)


class LOBE_RENDER_PT_scene_report_skipped(LobePanel, bpy.types.Panel):
    bl_label = "Without Effect"
    bl_parent_id = "LOBE_RENDER_PT_scene_report"
    bl_context = "render"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context) -> bool:
        if not super().poll(context):
            return False
        report = scene_report.report_of(context.scene)
        return report is not None and bool(report.of_level(SKIPPED))

    def draw(self, context):
        report = scene_report.report_of(context.scene)
        _draw_groups(self.layout, context, report, report.of_level(SKIPPED))


def _draw_groups(layout, context, report: scene_report.Report, groups: list[Group]) -> None:
    column = layout.box().column()
    narrow = is_narrower(context, NARROW)
    for group in groups[:SHOWN]:
        has_button = _buttons.has(report, group)
        row = column.column() if narrow else column.row()
        icon = LEVEL_ICONS.get(group.level) or ICONS[group.kind]
        text = group.what[:1].upper() + group.what[1:]
        if len(group.names) == 1 or group.kind in ("view layer", "world", "library"):
            text = f"{', '.join(group.names)}: {group.what}"
        draw_text(row, context, text, icon, BUTTON_WIDTH if has_button and not narrow else 0)
        if has_button:
            button = row.row()
            button.alignment = "RIGHT"
            select = button.operator(
                LOBE_OT_select_reported.bl_idname, text=str(len(group.names)), icon="RESTRICT_SELECT_OFF"
            )
            select.report_number = report.number
            select.index = report.groups.index(group)
    if len(groups) > SHOWN:
        column.label(text=f"and {len(groups) - SHOWN} more, see Report as Text above")


CLASSES = (
    LOBE_OT_select_reported,
    LOBE_OT_report_as_text,
    LOBE_RENDER_PT_scene_report,
    LOBE_RENDER_PT_scene_report_skipped,
)
