"""Check Scene: the export of a scene as a render would see it, without the render.

Only a render evaluates what a render shows: modifiers and subdivision at their render settings, objects that are
hidden in the viewport. So the check is a render too, of a short-lived copy of the scene (which shares all its objects)
by an engine that exports and draws nothing. Blender waits for it, and sees no Escape meanwhile. The Render Result
stays as it is, in all of its slots.
"""

from __future__ import annotations

import contextlib
import traceback
from collections.abc import Iterator
from dataclasses import replace

import bpy

from ..engine import left_out
from . import scene_report
from .export import Note, Notes, export_scene, export_settings
from .export.camera import NO_CAMERA
from .export.notes import ERROR, WARNING
from .export.scene import note_scene
from .faults import blender_message, is_defect, message_of
from .passes import wanted_passes
from .render_slots import in_newest_slot
from .report import nothing_to_see

NO_VIEW_LAYER = "no view layer is rendered: tick Use for Rendering in View Layer properties > View Layer"


class _CheckEngine(bpy.types.RenderEngine):
    """Registered while a check runs, and never otherwise: Blender would offer it to the user."""

    bl_idname = "LOBE_CHECK"
    bl_label = "Lobe Check"
    bl_use_shading_nodes_custom = False

    found: dict[Note, None] = {}

    def update(self, data, depsgraph) -> None:
        notes = Notes()
        try:
            scene = export_scene(depsgraph, notes=notes)
            settings = replace(export_settings(depsgraph.scene_eval), passes=wanted_passes(depsgraph.view_layer))
            for sentence in nothing_to_see(scene, depsgraph) + left_out(settings):
                notes.warn_scene(sentence)
            settings.validate()
            scene.validate()
        except Exception as error:
            if is_defect(error):
                traceback.print_exc()
            self.found[scene_report.note_from_sentence(ERROR, message_of(error))] = None
        self.found.update(dict.fromkeys(notes.all))

    def render(self, depsgraph) -> None:
        """Nothing."""


def nothing_to_begin_with(scene) -> str:
    """What a scene lacks, so that Blender would begin no render, or begin and end one without asking the engine."""
    if scene.camera is None:
        return NO_CAMERA
    is_shown_anyway = scene.render.use_single_layer and not bpy.app.background  # which Blender has in windows only
    if not (is_shown_anyway or any(layer.use for layer in scene.view_layers)):
        return NO_VIEW_LAYER
    return ""


def check(scene) -> list[Note]:
    """What `scene` holds that Lobe does not honour, over all of its view layers."""
    if missing := nothing_to_begin_with(scene):
        return [Note(ERROR, "", "", missing)]
    notes = Notes()
    note_scene(scene, notes)
    twin = scene.copy()
    try:
        _leave_no_trace(twin.render)
        with _engine() as engine, _no_handlers(), in_newest_slot():
            twin.render.engine = engine.bl_idname
            try:
                bpy.ops.render.render(scene=twin.name)
            except RuntimeError as error:  # Blender refused to begin
                return [Note(ERROR, "", "", blender_message(error))]
            return list(dict.fromkeys([*notes.all, *engine.found]))
    finally:
        bpy.data.scenes.remove(twin)


def _leave_no_trace(render) -> None:
    """The compositor writes files, the sequencer would render its own strips, and Freestyle would draw its lines."""
    render.use_compositing = render.use_sequencer = render.use_freestyle = False
    render.use_persistent_data = False


@contextlib.contextmanager
def _no_handlers() -> Iterator[None]:
    """Other add-ons' are about renders: they play a sound at the end, send a mail, switch the computer off."""
    lists = [getattr(bpy.app.handlers, name) for name in dir(bpy.app.handlers) if name.startswith("render_")]
    kept = [list(handlers) for handlers in lists]
    for handlers in lists:
        handlers.clear()
    try:
        yield
    finally:
        for handlers, functions in zip(lists, kept, strict=True):
            handlers[:] = functions


@contextlib.contextmanager
def _engine() -> Iterator[type[_CheckEngine]]:
    _CheckEngine.found = {}
    bpy.utils.register_class(_CheckEngine)
    try:
        yield _CheckEngine
    finally:
        bpy.utils.unregister_class(_CheckEngine)
        _CheckEngine.found = {}


@contextlib.contextmanager
def _waiting(window) -> Iterator[None]:
    """Shows the mouse as a clock; there is no window in the background."""
    if window is None or bpy.app.background:
        yield
        return
    window.cursor_modal_set("WAIT")
    try:
        yield
    finally:
        window.cursor_modal_restore()


def is_rendering() -> bool:
    """Whether no operator may begin a render. Blender begins one by waiting for its previews. From Python it keeps
    Python's lock while it waits, which an engine that draws a preview needs to come to its end: neither would go on."""
    return bpy.app.is_job_running("RENDER") or bpy.app.is_job_running("RENDER_PREVIEW")


def may_render(operator, context) -> bool:
    """The `poll` of an operator that renders."""
    if is_rendering():
        operator.poll_message_set("Blender is rendering a picture or a preview: a moment, please")
        return False
    return context.scene is not None


class LOBE_OT_check_scene(bpy.types.Operator):
    """List what this scene holds that Lobe does not draw as asked. It renders nothing, and takes as long as exporting \
the scene does: a moment, some seconds for millions of faces. It can't be stopped"""

    bl_idname = "lobe.check_scene"
    bl_label = "Check Scene"

    @classmethod
    def poll(cls, context) -> bool:
        return may_render(cls, context)

    def execute(self, context):
        with _waiting(context.window):
            notes = check(context.scene)
        report = scene_report.keep(scene_report.key(context.scene), "check", notes)
        self.report({"INFO"}, f"Lobe: {_said(report)}, see Scene Report")
        return {"FINISHED"}


def _said(report: scene_report.Report) -> str:
    number = len(report.of_level(ERROR, WARNING))
    if number:
        return f"{number} things are not drawn as asked" if number > 1 else "one thing is not drawn as asked"
    return "all is drawn as asked" + ("" if scene_report.is_honoured(report) else ", or nearly so")


def register() -> None:
    bpy.utils.register_class(LOBE_OT_check_scene)


def unregister() -> None:
    bpy.utils.unregister_class(LOBE_OT_check_scene)
