"""The button "Compare with Cycles", and what is kept of its results: for each scene, until another file is opened."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

import bpy
from bpy.props import EnumProperty, FloatProperty, PointerProperty, StringProperty

from ..check import is_rendering, may_render
from ..faults import blender_message
from ..scene_report import redraw_properties
from . import pictures
from .headline import headline_of
from .page import difference_rows, engine_rows, html
from .run import CompareError, Comparison, Outcome, Step, Stopped

IMAGE = "Lobe | Cycles | difference"
PLACES = f"The pictures are in the render slots Lobe and Cycles, side by side in the image {IMAGE!r}"
LOOK = 0.1  # seconds between two looks at a render that runs beside the window

_MODE = {
    "name": "Equal",
    "items": [
        ("SAMPLES", "Samples", "Both engines take the samples of Lobe's settings. Four renders, two of each engine"),
        ("TIME", "Time", "Both engines sample for some seconds. Four renders, two of each engine"),
    ],
    "description": "What is the same for both engines",
    "default": "SAMPLES",
}
_SECONDS = {
    "name": "Time",
    "description": "Seconds that each of the four renders may sample for; preparing the scene comes on top",
    "unit": "TIME_ABSOLUTE",
    "default": 10.0,
    "min": 0.1,
    "max": 1e6,
    "soft_max": 600.0,
    "step": 100,
}

_outcomes: dict[int, Outcome] = {}
_running = ""  # what the comparison beside the window is at


class LobeCompareSettings(bpy.types.PropertyGroup):
    """Of the window manager: they are no part of the file."""

    mode: EnumProperty(**_MODE)
    seconds: FloatProperty(**_SECONDS)


def outcome_of(scene) -> Outcome | None:
    """None for a scene that wasn't compared since its file was opened."""
    return _outcomes.get(scene.session_uid)


def running() -> str:
    """Which render of a comparison runs beside the window, or nothing."""
    return _running


def render_now(step: Step, how: str = "EXEC_DEFAULT") -> set[str]:
    """Raises CompareError with what Blender says."""
    layer = {"layer": step.layer} if step.layer else {}
    try:
        return bpy.ops.render.render(how, scene=step.scene, **layer)
    except RuntimeError as error:
        raise CompareError(blender_message(error)) from error


class LOBE_OT_compare_with_cycles(bpy.types.Operator):
    """Render this scene with Lobe and with Cycles, twice each, with settings as equal as they come, and measure what \
differs and who is the faster at equal error. Takes four renders' time. The pictures go to two render slots, your \
settings stay as they are"""

    bl_idname = "lobe.compare_with_cycles"
    bl_label = "Compare with Cycles"

    mode: EnumProperty(**_MODE)
    seconds: FloatProperty(**_SECONDS)

    @classmethod
    def poll(cls, context) -> bool:
        return may_render(cls, context)

    def execute(self, context):
        """Blender waits until it is done."""
        return self._until_the_end(context, self._begin(context))

    def _until_the_end(self, context, comparison: Comparison):
        try:
            with contextlib.closing(comparison.steps()) as steps:
                for step in steps:
                    render_now(step)
        except (CompareError, Stopped) as error:
            return self._failed(error)
        return self._finished(context, comparison)

    def invoke(self, context, event):
        """Renders run beside the window, which stays alive; Escape ends them."""
        if bpy.app.background or context.window is None:
            return self.execute(context)
        self._comparison = self._begin(context)
        self._steps = self._comparison.steps()
        self._timer = context.window_manager.event_timer_add(LOOK, window=context.window)
        context.window_manager.modal_handler_add(self)
        return self._next(context)

    def modal(self, context, event):
        """Nothing but its own timer reaches Blender's other operators: they could undo what is being compared."""
        if event.type == "TIMER":
            _hold_windows(context)
            if not is_rendering():
                return self._next(context)
        return {"RUNNING_MODAL"}

    def cancel(self, context) -> None:
        """Blender ends the operator: another file is being opened, or the window closed."""
        self._tidy(context)

    def _begin(self, context) -> Comparison:
        return Comparison(context.scene, context.view_layer, self.seconds if self.mode == "TIME" else 0.0)

    def _next(self, context):
        """The next render, or the end."""
        try:
            step = next(self._steps)
            _tell(context, f"Comparing: {step.text}")
            redraw_properties()
            if "CANCELLED" in render_now(step, "INVOKE_DEFAULT"):
                raise CompareError("Blender did not begin the render")
        except StopIteration:
            self._tidy(context)
            return self._finished(context, self._comparison)
        except (CompareError, Stopped) as error:
            self._tidy(context)
            return self._failed(error)
        except BaseException:
            self._tidy(context)
            raise
        return {"RUNNING_MODAL"}

    def _tidy(self, context) -> None:
        self._steps.close()
        context.window_manager.event_timer_remove(self._timer)
        _tell(context, "")

    def _failed(self, error: Exception):
        redraw_properties()
        if isinstance(error, Stopped):
            self.report({"INFO"}, "Lobe: the comparison was stopped, your settings are as before")
        else:
            self.report({"ERROR"}, f"Lobe can't compare: {error}")
        return {"CANCELLED"}

    def _finished(self, context, comparison: Comparison):
        outcome = comparison.outcome
        _outcomes[comparison.scene.session_uid] = outcome
        _show(context, comparison.strip)
        page = _write_page(outcome)
        redraw_properties()
        for what, lobe, cycles in engine_rows(outcome):
            self.report({"INFO"}, f"{what}: Lobe {lobe}, Cycles {cycles}")
        for line in outcome.unmatched:
            self.report({"INFO"}, f"Not matched: {line}")
        rows = ", ".join(f"{what} {value}" for what, value in difference_rows(outcome))
        self.report({"INFO"}, f"Lobe against Cycles: {rows}")
        self.report({"INFO"}, f"{PLACES}; the page is {str(page)!r}")
        # Last, where the status bar shows it.
        self.report({"INFO"}, f"Compared. {headline_of(outcome).text}. See Render properties > Compare")
        return {"FINISHED"}


class LOBE_OT_hold_window(bpy.types.Operator):
    """Part of a comparison: until it is over, nothing that is done in this window reaches Blender's other operators"""

    bl_idname = "lobe.hold_window"
    bl_label = "Hold Window"
    bl_options = {"INTERNAL"}

    def invoke(self, context, event):
        # So that it ends with the comparison: Blender's autosave waits for every operator that listens.
        self._timer = context.window_manager.event_timer_add(LOOK, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        if running():
            return {"RUNNING_MODAL"}
        self.cancel(context)
        return {"FINISHED", "PASS_THROUGH"}

    def cancel(self, context) -> None:
        context.window_manager.event_timer_remove(self._timer)


def _hold_windows(context) -> None:
    """Also one that Blender has opened for a render. A step that is done or undone there would have to do with settings
    that aren't the user's."""
    holding = {"LOBE_OT_compare_with_cycles", "LOBE_OT_hold_window"}
    for window in context.window_manager.windows:
        if holding.isdisjoint(operator.bl_idname for operator in window.modal_operators):
            with context.temp_override(window=window):
                bpy.ops.lobe.hold_window("INVOKE_DEFAULT")


def _tell(context, text: str) -> None:
    """In the status bar, and in the panel."""
    global _running
    _running = text
    if context.workspace is not None:
        context.workspace.status_text_set(f"{text}  |  Escape: stop" if text else None)


def _write_page(outcome: Outcome) -> Path:
    """Into Blender's temporary folder, which is gone with it."""
    path = Path(bpy.app.tempdir, "lobe_comparison.html")
    path.write_text(html(outcome), encoding="utf-8")
    return path


def _show(context, strip) -> None:
    """The three pictures side by side, as an image of Blender's, in an image editor where there is a window.

    It is packed: the file that it is read from lies in Blender's temporary folder, and is gone with it. (An image that
    was never read from a file makes Blender ask at its end whether to save it.)
    """
    path = os.path.join(bpy.app.tempdir, "lobe_comparison.png")
    Path(path).write_bytes(pictures.png(strip))
    image = bpy.data.images.get(IMAGE)
    if image is None:
        image = bpy.data.images.load(path)
        image.name = IMAGE
    else:  # which may be of another session of Blender's, with another folder
        image.filepath = path
        image.reload()
    image.pack()
    if bpy.app.background or context.window is None:
        return
    window, area = _image_editor(context)
    area.spaces.active.image = image
    region = next(region for region in area.regions if region.type == "WINDOW")
    with context.temp_override(window=window, area=area, region=region):
        bpy.ops.image.view_all(fit_view=True)


def _image_editor(context):
    """Window and area of one that shows a render, or the comparison before; else a window of its own."""
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            image = area.spaces.active.image if area.type == "IMAGE_EDITOR" else None
            if image is not None and (image.type == "RENDER_RESULT" or image.name == IMAGE):
                return window, area
    bpy.ops.wm.window_new()
    window = context.window_manager.windows[-1]
    window.screen.areas[0].type = "IMAGE_EDITOR"
    return window, window.screen.areas[0]


class LOBE_OT_open_comparison(bpy.types.Operator):
    """Show the newest comparison of this scene in your web browser: a slider between the pictures, the maps, all \
figures and settings"""

    bl_idname = "lobe.open_comparison"
    bl_label = "Open Page"

    @classmethod
    def poll(cls, context) -> bool:
        return context.scene is not None and outcome_of(context.scene) is not None

    def execute(self, context):
        page = _write_page(outcome_of(context.scene))
        bpy.ops.wm.url_open(url=page.as_uri())
        return {"FINISHED"}


class LOBE_OT_save_comparison(bpy.types.Operator):
    """Save the page of the newest comparison of this scene: one HTML file with the pictures in it"""

    bl_idname = "lobe.save_comparison"
    bl_label = "Save Page"

    filepath: StringProperty(subtype="FILE_PATH")
    filter_glob: StringProperty(default="*.html", options={"HIDDEN"})
    check_existing: bpy.props.BoolProperty(default=True, options={"HIDDEN"})

    @classmethod
    def poll(cls, context) -> bool:
        return LOBE_OT_open_comparison.poll(context)

    def invoke(self, context, event):
        if not self.filepath:
            self.filepath = f"{Path(bpy.data.filepath).stem or 'untitled'}-comparison.html"
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context):
        path = Path(bpy.path.ensure_ext(bpy.path.abspath(self.filepath), ".html"))
        try:
            path.write_text(html(outcome_of(context.scene)), encoding="utf-8")
        except OSError as error:
            self.report({"ERROR"}, f"{str(path)!r} cannot be written: {error.strerror}")
            return {"CANCELLED"}
        self.report({"INFO"}, f"Saved {path.name}")
        return {"FINISHED"}


@bpy.app.handlers.persistent
def _forget(*_) -> None:
    """Another file is open: not earlier, for one that can't be opened leaves this one open."""
    _outcomes.clear()


_CLASSES = (
    LobeCompareSettings,
    LOBE_OT_compare_with_cycles,
    LOBE_OT_hold_window,
    LOBE_OT_open_comparison,
    LOBE_OT_save_comparison,
)


def register() -> None:
    for cls in _CLASSES:
        bpy.utils.register_class(cls)
    bpy.types.WindowManager.lobe_compare = PointerProperty(type=LobeCompareSettings)
    bpy.app.handlers.load_post.append(_forget)


def unregister() -> None:
    bpy.app.handlers.load_post.remove(_forget)
    _outcomes.clear()
    del bpy.types.WindowManager.lobe_compare
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
