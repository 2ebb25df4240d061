"""The render engine that Blender knows. It forwards to `session` and reports what goes wrong, nothing else."""

from __future__ import annotations

import contextlib
import threading
import traceback
import weakref
from collections.abc import Iterator

import bpy

from .faults import is_defect, message_of

_viewports: weakref.WeakSet = weakref.WeakSet()  # all that may have threads
_renders = 0  # for which they are paused: those under way
_viewports_lock = threading.Lock()  # of both: renders look at them on a thread of their own


class LobeRenderEngine(bpy.types.RenderEngine):
    bl_idname = "LOBE"
    bl_label = "Lobe"
    bl_use_preview = True
    bl_use_eevee_viewport = True
    bl_use_shading_nodes_custom = False

    # Class attributes and no __init__: Blender calls that twice for one object (measured in 5.0).
    session = None  # made by update() for the render() that follows; None when the export failed
    frame_report = None  # of the view layers rendered so far in this frame
    kept_layers = None  # what is kept for the next frame, where Blender keeps this object for it
    viewport = None  # made by the first callback of a 3D viewport, and by the first one after it was closed
    ends_viewport = None  # its finalizer
    failed = False  # then this frame's other view layers aren't tried: the user has the message

    def update_render_passes(self, scene=None, renderlayer=None) -> None:
        with _reporting(self):
            from .passes import register_passes

            register_passes(self, scene, renderlayer)

    def update(self, data, depsgraph) -> None:
        if self.failed:
            return
        with _reporting(self):
            from .report import start_report
            from .session import Session

            if self.frame_report is None:
                self.frame_report = start_report(self.is_preview)
            self.session = Session(self, depsgraph)

    def render(self, depsgraph) -> None:
        session, self.session = self.session, None
        if session is None:
            return
        with _reporting(self), _viewports_paused(self):
            session.render(self.frame_report)

    def render_frame_finish(self) -> None:
        report, self.frame_report = self.frame_report, None
        failed, self.failed = self.failed, False
        if report is None or failed or self.is_preview:
            return
        with _reporting(self):
            from .memory import give_back
            from .report import publish

            publish(report, self)
            give_back()

    def view_update(self, context, depsgraph) -> None:
        """Blender has evaluated the scene anew, or a viewport has just been switched to Rendered."""
        with _reporting(self):
            self._viewport().update(context, depsgraph)
            self.tag_redraw()

    def view_draw(self, context, depsgraph) -> None:
        with _reporting(self):
            self.update_stats(*self._viewport().draw(context, depsgraph))

    def _viewport(self):
        # Closed, though Blender still shows it, where another file should have been opened and could not be.
        if self.viewport is None or self.viewport.is_closed:
            from .viewport import Viewport

            if self.ends_viewport is not None:
                self.ends_viewport.detach()
            self.viewport = Viewport(self)
            # Not in __del__: there Blender no longer lets one look at the attributes. Also when the program ends.
            self.ends_viewport = weakref.finalize(self, self.viewport.close)
            with _viewports_lock:
                _viewports.add(self.viewport)
                if _renders:
                    self.viewport.pause()
        return self.viewport


class _reporting:
    """Turns every exception into a message for the user.

    Blender swallows what a callback raises. `report` makes `bpy.ops.render.render` raise; `error_set` writes into the
    render's window, and without a window it would only say the same again.
    """

    def __init__(self, engine: bpy.types.RenderEngine):
        self.engine = engine

    def __enter__(self):
        return self

    def __exit__(self, kind, error, trace) -> bool:
        if error is None or not isinstance(error, Exception):
            return False
        if is_defect(error):
            traceback.print_exception(kind, error, trace)
        message = message_of(error)
        self.engine.failed = True
        if not bpy.app.background:
            self.engine.error_set(message)
        self.engine.report({"ERROR"}, message)
        return True


def _open_viewports() -> list:
    with _viewports_lock:
        return list(_viewports)


@contextlib.contextmanager
def _viewports_paused(engine: bpy.types.RenderEngine) -> Iterator[None]:
    """While a render traces, viewports leave it the processor, also those that are opened meanwhile. Icons are quick,
    and made of what a viewport shows."""
    if engine.is_preview:
        yield
        return
    _count_renders(1)
    try:
        yield
    finally:
        _count_renders(-1)


def _count_renders(more: int) -> None:
    global _renders
    with _viewports_lock:
        _renders += more
        for viewport in list(_viewports):
            if _renders:
                viewport.pause()
            else:
                viewport.resume()


@bpy.app.handlers.persistent
def close_viewports(*_) -> None:
    """End their threads: before another file is opened, and when Lobe is disabled."""
    for viewport in _open_viewports():
        viewport.close()


def register() -> None:
    bpy.utils.register_class(LobeRenderEngine)
    bpy.app.handlers.load_pre.append(close_viewports)


def unregister() -> None:
    bpy.app.handlers.load_pre.remove(close_viewports)
    close_viewports()
    bpy.utils.unregister_class(LobeRenderEngine)
