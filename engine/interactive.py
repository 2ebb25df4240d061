"""Rendering a scene that changes while one looks: a thread that always works on what was asked for last.

Only the handing over is here; what is kept from one state of the scene to the next, and the passes over the picture,
are in `live`. A viewport calls `show` whenever something has changed, and draws `picture` whenever it likes.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from .errors import LobeError, told_of_memory
from .result import Picture
from .scene import Scene
from .settings import Settings


class _Job(NamedTuple):
    scene: Scene
    settings: Settings

    def only_samples_differ(self, other: _Job) -> bool:
        return self.scene is other.scene and replace(self.settings, samples=other.settings.samples) == other.settings


class Interactive:
    """Renders what `show` was given last: first a coarse picture within some hundredths of a second, then finer ones,
    up to the settings' samples; then it waits. No method but `close` ever waits for anything.

    picture  the newest one; None before the first
    message  what is being done when it isn't rendering: "building", "compiling: 3 of 250 functions, ..."; else empty
    error    why what was shown last can't be rendered; None where it can
    waiting  whether a pause keeps it from what is to be rendered

    Of a scene only what was replaced is looked at: parts that are the same objects as before are taken for unchanged.
    Always by the compiled road, and without adaptive sampling, time limit and passes.
    """

    def __init__(self, changed: Callable[[], None]):
        """changed: called on the own thread when there is something new to see."""
        self.picture: Picture | None = None
        self.message = ""
        self.error: Exception | None = None
        self._changed = changed
        self._news = threading.Condition()
        self._wanted: _Job | None = None
        self._job: _Job | None = None  # that is worked on
        self._seen = False  # a picture of it: from then on it may be interrupted
        self._closed = self._paused = False
        self._halt_pass, self._halt_build = np.zeros(1, np.uint8), np.zeros(1, np.uint8)
        # A daemon: when the program ends it waits for no picture, only for a compilation in this process.
        self._thread = threading.Thread(target=self._run, name="Lobe viewport", daemon=True)
        self._thread.start()

    def show(self, scene: Scene, settings: Settings) -> None:
        """Render this from now on. What was shown before gets its first picture in any case: while changes come
        faster than pictures, there still are pictures."""
        with self._news:
            self._wanted = _Job(scene, settings)
            if self._seen and not (self._job and self._wanted.only_samples_differ(self._job)):
                self._halt_pass[0] = 1
            self._news.notify()

    def pause(self) -> None:
        """Trace nothing from the next picture on, until `resume`: that goes on where it was."""
        with self._news:
            self._paused = True

    def resume(self) -> None:
        with self._news:
            self._paused = False
            self._news.notify()

    @property
    def waiting(self) -> bool:
        with self._news:
            return self._paused and self._wanted is not None

    def close(self, patience: float = 0.5) -> bool:
        """End the threads. Waits for them so many seconds, which only a compilation in this process takes; True if they
        have ended. `changed` may call it too, on the own thread: that can't be waited for there."""
        with self._news:
            self._closed = True
            self._halt_pass[0] = self._halt_build[0] = 1
            self._news.notify()
        if threading.current_thread() is not self._thread:
            self._thread.join(patience)
        return not self._thread.is_alive()

    def _run(self) -> None:
        live = None
        while (job := self._next()) is not None:
            try:
                if live is None:
                    live = _start(self._halt_pass, self._halt_build, self._say)
                with told_of_memory():
                    for picture in live.pictures(job.scene, job.settings):
                        if self._publish(picture):
                            break
            except Exception as error:  # for the caller's thread, which can tell the user
                if not self._closed:
                    self.error = error
                    self._say("")
        if live is not None:
            live.close()

    def _next(self) -> _Job | None:
        """Wait for something to do; None once it is over."""
        with self._news:
            while (self._wanted is None or self._paused) and not self._closed:
                self._news.wait()
            if self._closed:
                return None
            self._job, self._wanted, self._seen = self._wanted, None, False
            self._halt_pass[0] = 0
            return self._job

    def _publish(self, picture: Picture) -> bool:
        """Whether something else is wanted by now."""
        self.picture, self.message, self.error = picture, "", None
        with self._news:
            self._seen = True
            if self._paused and self._wanted is None and picture.samples < picture.total:
                self._wanted = self._job
            is_over = self._wanted is not None or self._closed
        self._changed()  # by now `waiting` is true, where it will be
        return is_over

    def _say(self, message: str) -> None:
        self.message = message
        self._changed()


def _start(halt_pass: np.ndarray, halt_build: np.ndarray, say: Callable[[str], None]):
    """A `Live`. Loading Numba takes a second: it happens here, on the thread that has the time."""
    from . import numba_problem

    if problem := numba_problem():
        raise LobeError(f"Numba cannot be used ({problem}), and without it only final renders work, slowly")
    from .live import Live

    return Live(halt_pass, halt_build, say)
