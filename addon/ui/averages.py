"""Averages of images for the panels: a thread reads the files, and they are kept until their image changes.

What bpy knows of an image is asked for before, on Blender's own thread.
"""

from __future__ import annotations

import contextlib
import threading
from types import SimpleNamespace

from ..export.images import Images, Unreadable, file_problem, image_path
from ..export.notes import Notes
from ..export.stop import Stop


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
        self.image = SimpleNamespace(name_full=image.name_full, alpha_mode=image.alpha_mode, colorspace_settings=colors)
        self.start()

    def run(self) -> None:
        with contextlib.suppress(Unreadable):
            self.mean = self.images.mean_of_file(self.image, self.path)


class KeptAverages(Images):
    """Averages that stay until their image changes. Those that aren't known raise NotRead, unless they may be read at
    once."""

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
        self._by_blender = {key for key in self._by_blender if key[0] != uid}
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

    def wait(self) -> None:
        if self._reading is not None:
            self._reading.join()
