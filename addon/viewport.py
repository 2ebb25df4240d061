"""The viewport in Rendered mode: one `Viewport` for each 3D viewport.

Blender's side is here: what has changed is exported when Blender says so, and the newest picture is drawn. The tracing
is the engine's, on threads of its own, which never touch bpy but to ask for a redraw.
"""

from __future__ import annotations

import contextlib
import traceback
import weakref
from dataclasses import replace
from typing import NamedTuple

import bpy

from .. import engine as lobe
from . import draw
from .export import LiveExport, View, export_view, export_viewport_settings, film_exposure
from .faults import is_defect, message_of

_PROPERTIES = bpy.types.SpaceView3D.bl_rna.properties.keys()
OBJECT_TYPES = tuple(name for name in _PROPERTIES if name.startswith("show_object_viewport_"))


class _Shown(NamedTuple):
    """What the renderer was given, and what it was made of."""

    exported: lobe.Scene
    view: View
    film: dict
    settings: lobe.Settings
    scene: lobe.Scene


class Choice(NamedTuple):
    """Of the objects that a viewport shows.

    is_local      only those of its local view, or of collections of its own: Blender doesn't say which come and go
    hidden_types  of Object Types Visibility, the properties' names
    """

    is_local: bool
    hidden_types: frozenset[str]


def choice_of(space) -> Choice:
    """Of a bpy `SpaceView3D`."""
    is_local = bool(space.local_view or space.use_local_collections)
    return Choice(is_local, frozenset(name for name in OBJECT_TYPES if not getattr(space, name)))


class Viewport:
    """Made by the first callback of a `RenderEngine`; closed when Blender drops that engine, at the latest.

    is_closed  it has neither threads nor a scene any more, and gets none
    """

    def __init__(self, engine: bpy.types.RenderEngine):
        self._export = LiveExport()
        self._scene: lobe.Scene | None = None  # as exported, without a camera
        self._choice: Choice | None = None  # of objects, with which it was exported
        self._shown: _Shown | None = None  # what the renderer was given last
        self._problem = ""  # why the scene could not be exported
        self._told = ""  # of the newest defect, so that the console has it once
        self._drawing = draw.Drawing()
        self._redraw = _redraw(engine)
        self._renderer = lobe.Interactive(self._redraw)
        self.is_closed = False

    def update(self, context, depsgraph) -> None:
        """Blender has evaluated something anew."""
        space = context.space_data
        choice = choice_of(space)
        shown = (lambda object_: object_.visible_in_viewport_get(space)) if any(choice) else None
        try:
            self._scene = self._export.update(depsgraph, shown, anew=choice.is_local or choice != self._choice)
            self._problem = ""
        except Exception as error:
            self._problem = self._in_words(error)
        self._choice = choice

    def draw(self, context, depsgraph) -> tuple[str, str]:
        """The newest picture, and the next one asked for if the view is another. Returns Blender's two status texts."""
        try:
            return self._draw(context, depsgraph)
        except Exception as error:
            draw.message(context.region, self._in_words(error))
            return "", ""

    def _draw(self, context, depsgraph) -> tuple[str, str]:
        space, region = context.space_data, context.region
        if choice_of(space) != self._choice or (self._scene is None and not self._problem):
            self.update(context, depsgraph)
        view = export_view(depsgraph, space, region, context.region_data)
        # Read at every draw, and of the original: scripts change these without that Blender evaluates anything.
        scene = depsgraph.scene
        film = {"exposure": film_exposure(scene), "transparent_film": scene.render.film_transparent}
        self._show(view, film, export_viewport_settings(scene))
        picture, problem = self._renderer.picture, self._problem or self._failure()
        if problem:
            draw.message(region, problem)
            return "", ""
        if picture is not None and not view.is_empty:
            self._drawing.draw(picture, view)
        return self._status(picture, view)

    def pause(self) -> None:
        self._renderer.pause()
        self._redraw()

    def resume(self) -> None:
        self._renderer.resume()
        self._redraw()

    def close(self) -> None:
        """On any thread. Where Blender goes on showing it, it is to be drawn again, which another one will do."""
        self.is_closed = True
        self._renderer.close()
        self._drawing.close()
        self._redraw()
        self._scene = None
        self._shown = None
        self._export = LiveExport()

    def _show(self, view: View, film: dict, settings: lobe.Settings) -> None:
        """Ask for another picture, where anything has changed since the last one was asked for."""
        if self._scene is None or self._problem or view.is_empty:
            return
        before = self._shown
        same = before is not None and before.exported is self._scene and before.film == film and view.same(before.view)
        if before is not None and same and before.settings == settings:
            return
        if before is not None and same:
            scene = before.scene
        else:
            camera, width, height, region = view
            scene = replace(self._scene, camera=camera, width=width, height=height, region=region, **film)
        self._shown = _Shown(self._scene, view, film, settings, scene)
        self._renderer.show(scene, settings)

    def _failure(self) -> str:
        """What the renderer can't do, in words."""
        error = self._renderer.error
        return "" if error is None else self._in_words(error)

    def _in_words(self, error: Exception) -> str:
        """For the middle of the viewport: Blender shows nobody what is reported here. A defect goes to the console too,
        once for all draws and edits that come upon it."""
        message = message_of(error)
        if is_defect(error) and message != self._told:
            self._told = message
            traceback.print_exception(error)
        return message

    def _status(self, picture: lobe.Picture | None, view: View) -> tuple[str, str]:
        message = "waiting for the render" if self._renderer.waiting else self._renderer.message
        if message or picture is None:
            return "", f"{message[:1].upper()}{message[1:]}" or "Preparing"
        return "", f"Sample {picture.samples}/{picture.total}"


def _redraw(engine: bpy.types.RenderEngine):
    """A function that asks Blender to draw the viewport again. It keeps the engine no longer than Blender does."""
    reference = weakref.ref(engine)

    def redraw() -> None:
        alive = reference()
        if alive is not None:
            with contextlib.suppress(ReferenceError):  # Blender has just dropped it
                alive.tag_redraw()

    return redraw
