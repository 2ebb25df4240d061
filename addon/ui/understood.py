"""What Lobe makes of materials, for the panels: the export of one, kept until it may have changed.

Panels are drawn on every move of the mouse, and to average an image takes seconds where it is large: that is left to a
thread, and kept until the image changes. What bpy knows of the image is asked for before, on Blender's own thread.
"""

from __future__ import annotations

import threading
from types import SimpleNamespace

import bpy
import numpy as np

from .. import scene_report
from ..export.changes import uid_of
from ..export.images import Images, file_problem, image_path, mean_color, read_file
from ..export.materials.material import export_material
from ..export.notes import Notes
from ..export.stop import Stop

INTERVAL = 0.1  # seconds between looks at the thread
PLAYING = 0.5  # while an animation plays, which reading would hold up


class NotRead(Exception):
    """The image of `node` has yet to be averaged."""

    def __init__(self, node) -> None:
        super().__init__()
        self.node = node


class Reading(threading.Thread):
    """Averages the file of an image. `mean` stays None where OpenImageIO can't read it."""

    def __init__(self, images: KeptAverages, key: tuple, image, path: str) -> None:
        super().__init__(daemon=True)
        self.images, self.key, self.path, self.mean = images, key, path, None
        colors = SimpleNamespace(name=image.colorspace_settings.name, is_data=image.colorspace_settings.is_data)
        self.image = SimpleNamespace(name=image.name, alpha_mode=image.alpha_mode, colorspace_settings=colors)
        self.start()

    def run(self) -> None:
        self.mean = self.images.mean_of_file(self.image, self.path)


class KeptAverages(Images):
    """Averages that stay until their image changes."""

    def __init__(self) -> None:
        super().__init__(Notes(), Stop())
        self.may_read = False
        self._reading: Reading | None = None
        self._by_blender: set[tuple] = set()  # keys of what the thread couldn't read

    def average(self, node):
        if not self.may_read and node.image is not None and self._key(node) not in self._averages:
            raise NotRead(node)
        return super().average(node)

    def forget(self, uid: int) -> None:
        self._averages = {key: mean for key, mean in self._averages.items() if key[0] != uid}
        if self._reading is not None and self._reading.key[0] == uid:
            self._reading = None

    def is_reading(self) -> bool:
        """Keeps what the thread has found, once it has."""
        done = self._reading
        if done is None or done.is_alive():
            return done is not None
        if done.mean is None:
            self._by_blender.add(done.key)
        else:
            self._averages[done.key] = done.mean
        self._reading = None
        return False

    def read(self, node) -> None:
        """Begin with a plain file, else be done with it at once: only Blender can read the others, and only here."""
        image, key = node.image, self._key(node)
        plain = image.type == "IMAGE" and image.source in ("FILE", "SEQUENCE", "TILED") and not image.packed_files
        path = image_path(image, node.image_user) if plain and key not in self._by_blender else ""
        if path and not file_problem(path):
            self._reading = Reading(self, key, image, path)
        else:
            super().average(node)

    def mean_of_file(self, image, path: str) -> np.ndarray | None:
        """On any thread: `image` has but the properties that tell how to take the file's pixels."""
        pixels = read_file(path)
        return None if pixels is None else mean_color(self._converted(image, pixels, multiplied=False))

    def wait(self) -> None:
        if self._reading is not None:
            self._reading.join()


class Understood:
    def __init__(self) -> None:
        self._known: dict[int, tuple] = {}
        self._images = KeptAverages()
        self._waiting: set[int] = set()  # session numbers of materials whose images have yet to be read

    def of(self, material) -> tuple:
        """(engine.Material or None, the sentences that go with it)"""
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
                texts = [note.what for note in notes.all]
            except LobeError as error:
                drawn, texts = None, [str(error)]
            self._known[key] = drawn, texts
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
    understood.forget()


def register() -> None:
    bpy.app.handlers.depsgraph_update_post.append(_changed)
    bpy.app.handlers.frame_change_post.append(_frame_changed)
    bpy.app.handlers.load_pre.append(_forget)


def unregister() -> None:
    if bpy.app.timers.is_registered(_read):
        bpy.app.timers.unregister(_read)
    bpy.app.handlers.load_pre.remove(_forget)
    bpy.app.handlers.frame_change_post.remove(_frame_changed)
    bpy.app.handlers.depsgraph_update_post.remove(_changed)
    understood.wait()
    understood.forget()
