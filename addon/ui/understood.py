"""What Lobe makes of materials, for the panels: the export of one, kept until it may have changed.

Panels are drawn on every move of the mouse, and to average an image takes seconds where it is large: that is left to
`averages`.
"""

from __future__ import annotations

import bpy

from .. import scene_report
from ..export.changes import uid_of
from ..export.materials.material import export_material
from ..export.notes import ERROR, Notes, importance
from ..export.stop import Stop
from .averages import KeptAverages, NotRead

INTERVAL = 0.1  # seconds between looks at the thread
PLAYING = 0.5  # while an animation plays, which reading would hold up


class Understood:
    def __init__(self) -> None:
        self._known: dict[int, tuple] = {}
        self._images = KeptAverages()
        self._waiting: set[int] = set()  # session numbers of materials whose images have yet to be read

    def of(self, material) -> tuple:
        """(engine.Material or None, the notes that go with it, as they matter)"""
        self._images.may_read = True
        try:
            return self._exported(material)
        finally:
            self._images.may_read = False

    def at_hand(self, material) -> tuple | None:
        """The same; None while its images have yet to be read, which `read` does."""
        try:
            return self._exported(material)
        except NotRead:
            self._waiting.add(material.session_uid)
            return None

    def read(self) -> bool:
        """Go on with the images of the materials that wait; whether there is more to do."""
        for material in bpy.data.materials:
            while material.session_uid in self._waiting:
                if self._images.is_reading():
                    return True
                try:
                    self._exported(material)
                    self._waiting.remove(material.session_uid)
                except NotRead as missing:
                    self._images.read(missing.node)
        self._waiting.clear()  # of those that are no more
        return False

    def _exported(self, material) -> tuple:
        from ...engine import LobeError

        key = material.session_uid
        if key not in self._known:
            notes = Notes()
            try:
                drawn = export_material(material, notes, self._images, Stop())
            except LobeError as error:
                drawn = None
                notes.add(ERROR, "material", material.name_full, str(error))
            self._known[key] = drawn, sorted(notes.all, key=importance)
        return self._known[key]

    def changed(self, datablocks) -> None:
        """These may have changed: Blender lists too many rather than too few."""
        for datablock in datablocks:
            if isinstance(datablock, bpy.types.Image):
                self._images.forget(uid_of(datablock))
            if isinstance(datablock, KINDS):
                self.forget_materials()

    def forget_materials(self) -> None:
        self._known.clear()

    def forget(self) -> None:
        self._known.clear()
        self._waiting.clear()
        self._images = KeptAverages()

    def wait(self) -> None:
        self._images.wait()


KINDS = (bpy.types.Material, bpy.types.NodeTree, bpy.types.Image, bpy.types.Scene)
understood = Understood()


def read_soon() -> None:
    """Called by what draws a material that has to wait."""
    if not bpy.app.timers.is_registered(_read):
        bpy.app.timers.register(_read, first_interval=INTERVAL)


def _read() -> float | None:
    if any(window.screen.is_animation_playing for window in bpy.context.window_manager.windows):
        return PLAYING
    if understood.read():
        return INTERVAL
    scene_report.redraw_properties()
    return None


@bpy.app.handlers.persistent
def _changed(scene, depsgraph) -> None:
    understood.changed(update.id for update in depsgraph.updates)


@bpy.app.handlers.persistent
def _frame_changed(*_) -> None:
    """Averages know their frame."""
    understood.forget_materials()


@bpy.app.handlers.persistent
def _forget(*_) -> None:
    """Another file is open: not earlier, for one that can't be opened leaves this one open."""
    understood.forget()


def register() -> None:
    bpy.app.handlers.depsgraph_update_post.append(_changed)
    bpy.app.handlers.frame_change_post.append(_frame_changed)
    bpy.app.handlers.load_post.append(_forget)


def unregister() -> None:
    if bpy.app.timers.is_registered(_read):
        bpy.app.timers.unregister(_read)
    bpy.app.handlers.load_post.remove(_forget)
    bpy.app.handlers.frame_change_post.remove(_frame_changed)
    bpy.app.handlers.depsgraph_update_post.remove(_changed)
    understood.wait()
    understood.forget()
