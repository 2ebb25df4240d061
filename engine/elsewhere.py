"""Compiling in another process, for programs with a window: it must not freeze while Numba holds Python's lock.

What the other process compiles, this one finds in the cache on the disk and loads in a moment. A marker beside the
compiled code says that it is there, so that no process is started for nothing. Where anything of this fails, the
kernel compiles here, as it does without a window.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

POLL_SECONDS = 0.03
NO_WINDOW = getattr(subprocess, "CREATE_NO_WINDOW", 0)  # on Windows a program of the console opens one unless told

_command: tuple[str, ...] = ()
_environment: dict[str, str] | None = None
_one_at_a_time = threading.Lock()  # the viewport and a render may want the same kernel


class CompilationStopped(Exception):
    """The caller's `stop` said so; the other process has ended."""


def compile_elsewhere(command: Sequence[str], environment: dict[str, str] | None = None) -> None:
    """From now on kernels are compiled by this command in this environment, with a text after it which that process
    hands to `engine.precompile`. No command: by this process."""
    global _command, _environment
    _command, _environment = tuple(command), environment


def compiled(kernel: dict[str, Any], folder: Path | None, stop: Callable[[], bool]) -> None:
    """Have a kernel compiled into the cache, where another process does that and has not yet.

    kernel  names it, in what JSON knows
    folder  the cache; None where nothing can be kept
    Raises CompilationStopped.
    """
    if not _command or folder is None or is_marked(kernel, folder):
        return
    while not _one_at_a_time.acquire(timeout=POLL_SECONDS):
        if stop():
            raise CompilationStopped
    try:
        if not is_marked(kernel, folder):
            _run([*_command, json.dumps(kernel)], stop)
    finally:
        _one_at_a_time.release()


def _run(command: list[str], stop: Callable[[], bool]) -> None:
    nothing = subprocess.DEVNULL
    try:
        process = subprocess.Popen(command, env=_environment, stdin=nothing, stdout=nothing, creationflags=NO_WINDOW)
    except OSError:
        return
    try:
        while process.poll() is None:
            if stop():
                raise CompilationStopped
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(POLL_SECONDS)
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()


def mark(kernel: dict[str, Any], folder: Path | None) -> None:
    """This kernel is in the cache."""
    if folder is not None:
        with contextlib.suppress(OSError):  # a full disk: the next one compiles it again
            _marker(kernel, folder).touch()


def is_marked(kernel: dict[str, Any], folder: Path | None) -> bool:
    """Whether this kernel is in the cache."""
    return folder is not None and _marker(kernel, folder).exists()


def _marker(kernel: dict[str, Any], folder: Path) -> Path:
    """Compiled code is for one version of Python. That of another processor is compiled again without being asked."""
    text = json.dumps([sys.version, kernel], sort_keys=True)
    return folder / f"{hashlib.sha256(text.encode()).hexdigest()[:16]}.compiled"
