"""Compiling in another process, for programs with a window: it must not freeze while Numba holds Python's lock.

What the other process compiles, this one finds in the cache on the disk and loads in a moment. A marker beside the
compiled code says that it is there, so that no process is started for nothing. Where no process can be started, or
Python fails in it, the kernel compiles here, as it does without a window. Not where the process crashed, as LLVM makes
it do where it knows no other way: here it would take the program with the user's work along.
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

from .errors import LobeError

POLL_SECONDS = 0.03
NO_WINDOW = getattr(subprocess, "CREATE_NO_WINDOW", 0)  # on Windows a program of the console opens one unless told
# Of a process on Windows that called C's abort, and the first of those that the system ended (NTSTATUS of ntstatus.h).
WINDOWS_ABORT, WINDOWS_ERRORS = 3, 0xC0000000

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
    Raises CompilationStopped, and LobeError where the other process crashed or was killed.
    """
    if not _command or folder is None or is_marked(kernel, folder):
        return
    while not _one_at_a_time.acquire(timeout=POLL_SECONDS):
        if stop():
            raise CompilationStopped
    try:
        if not is_marked(kernel, folder):
            code = _run([*_command, json.dumps(kernel)], stop)
            if was_killed(code):
                raise LobeError(_crash(code))
    finally:
        _one_at_a_time.release()


def was_killed(code: int) -> bool:
    """Whether a process with this exit code didn't end by itself: by a crash, or from outside."""
    if sys.platform == "win32":
        return code == WINDOWS_ABORT or code >= WINDOWS_ERRORS
    return code < 0


def _crash(code: int) -> str:
    from llvmlite import binding  # not at the top: whoever imports the engine need not wait for it

    return (
        f"the compiler crashed on what this scene needs (exit code {code}, processor {binding.get_host_cpu_name()!r}): "
        "please report this to Lobe's developers with the scene and the processor's name. Until it is mended, "
        "Performance > Debug > Implementation: Reference renders the scene, slowly"
    )


def _run(command: list[str], stop: Callable[[], bool]) -> int:
    """The exit code; 0 where the command can't be started."""
    nothing = subprocess.DEVNULL
    try:
        process = subprocess.Popen(command, env=_environment, stdin=nothing, stdout=nothing, creationflags=NO_WINDOW)
    except OSError:
        return 0
    try:
        while process.poll() is None:
            if stop():
                raise CompilationStopped
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(POLL_SECONDS)
        return process.returncode
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
    """Compiled code is for one version of Python. The folder is for one processor."""
    text = json.dumps([sys.version, kernel], sort_keys=True)
    return folder / f"{hashlib.sha256(text.encode()).hexdigest()[:16]}.compiled"
