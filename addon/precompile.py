"""Compiles in processes of their own: holding Python's lock for seconds, as compiling does, would freeze the window.

Such a process is the Python inside Blender, which fills the cache on disk and ends. One is started when Lobe is
enabled, at low priority: it compiles what scenes most often need before anyone waits for it. It ends at once where that
has been done, or has failed, for the same kernels: only with Numba loaded, which Blender is spared, can one tell. For
any other kernel the engine starts one when a scene needs it. Both only where there is a window. This file is also what
they run.
"""

from __future__ import annotations

import contextlib
import os
import re
import sys

CACHE_VARIABLE = "LOBE_CACHE_DIR"  # read by engine/kernels/jit.py
LOOK_INTERVAL = 1.0  # seconds
LOG, FAILED = "precompile.log", "precompile-failed.log"  # in the cache's folder
FAR_AWAY = 1 << 30  # bytes, behind the end of any log
DONE = "{} of {} kinds of scenes are compiled"  # a line of the log
_process = None  # the one that compiles the common kernels
_log = None  # the file that it writes to, open and locked
_said = ""
_own_variable = False


def register() -> None:
    import bpy

    from .. import engine as lobe

    global _own_variable
    # An empty answer means that the user's folder can't be written: the engine then takes the temporary one.
    if CACHE_VARIABLE not in os.environ and (
        folder := bpy.utils.extension_path_user(_root_package(), path="cache", create=True)
    ):
        os.environ[CACHE_VARIABLE] = folder
        _own_variable = True
    if not bpy.app.background and _has_python():
        lobe.compile_elsewhere(_command(), _environment())
        start()


def unregister() -> None:
    from .. import engine as lobe

    global _own_variable
    lobe.compile_elsewhere(())
    stop()
    if _own_variable:
        del os.environ[CACHE_VARIABLE]
        _own_variable = False


def start() -> None:
    """Start the process, unless another Blender has one, or there is nowhere to keep the result."""
    global _process, _log
    folder = os.environ.get(CACHE_VARIABLE)
    if not folder or not _has_python():
        return
    import atexit
    import subprocess

    import bpy

    try:
        os.makedirs(folder, exist_ok=True)
        _log = _locked(os.path.join(folder, LOG))
        if _log is None:
            return
        _process = subprocess.Popen(
            [*_command(), ""],
            env=_environment(),
            stdin=subprocess.DEVNULL,
            stdout=_log,
            stderr=_log,
            creationflags=_windows("CREATE_NO_WINDOW") | _windows("IDLE_PRIORITY_CLASS"),
        )
    except OSError:  # the engine keeps its kernels elsewhere then, and says so
        _close_log()
        return
    atexit.register(_end)
    bpy.app.timers.register(_look, persistent=True)


def _locked(path: str):
    """The file, open and empty; None where another Blender has it, or the process of one that has ended."""
    file = open(path, "ab")  # noqa: SIM115  it stays open as long as the process runs
    try:
        if sys.platform == "win32":
            import msvcrt

            file.seek(FAR_AWAY)  # there nobody else can read or write what is locked
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
            file.seek(0)  # the process goes on from here
        else:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        file.close()
        return None
    except OSError:  # a disk that knows no locks
        pass
    file.truncate(0)
    return file


def _close_log() -> None:
    global _log
    if _log is not None:
        _log.close()
        _log = None


def said() -> str:
    """How far the process is, or why it has ended, for a panel; empty where it compiles nothing."""
    return _said


def _look() -> float | None:
    """Blender's timer: see how far it is, until it has ended."""
    from .scene_report import redraw_properties

    global _said
    code = None if _process is None else _process.poll()
    is_over = _process is None or code is not None
    before, _said = _said, _outcome(code) if is_over else _progress()
    if _said != before:
        redraw_properties()
    if is_over:
        _end()
    return None if is_over else LOOK_INTERVAL


def _progress() -> str:
    counts = []
    with contextlib.suppress(OSError), open(_log.name, errors="replace") as log:  # users may delete it
        counts = re.findall(DONE.format(r"(\d+)", r"(\d+)"), log.read())
    return "Compiling in the background: {} of {}".format(*counts[-1]) if counts else ""


def _outcome(code: int | None) -> str:
    """What to say of a process that has ended. The log of one that failed stays, which `_main` finds."""
    import signal

    if code in (None, 0, -signal.SIGINT, -signal.SIGTERM):  # the last two: as all that runs when the user logs out
        return ""
    path = _log.name
    _close_log()
    kept = os.path.join(os.path.dirname(path), FAILED)
    with contextlib.suppress(OSError):
        os.replace(path, kept)
    return f"Compiling in the background failed, see {kept}"


def stop() -> None:
    import bpy

    global _said
    if bpy.app.timers.is_registered(_look):
        bpy.app.timers.unregister(_look)
    _said = ""
    _end()


def _end() -> None:
    """Also when Blender closes, and is no longer there to be asked."""
    global _process
    _close_log()
    if _process is None:
        return
    import atexit

    atexit.unregister(_end)
    if _process.poll() is None:
        _process.kill()
    _process.wait()
    _process = None


def _windows(flag: str) -> int:
    import subprocess

    return getattr(subprocess, flag, 0)  # other systems don't have them


def _has_python() -> bool:
    """Where Blender comes without one, `sys.executable` may be empty, or Blender itself, which would open once more."""
    executable = sys.executable or ""
    return os.path.basename(executable).lower().startswith("python") and os.access(executable, os.X_OK)


def _command() -> list[str]:
    """To which the name of the kernel is added, or an empty text for the common ones."""
    return [sys.executable, __file__, _root_package(), _root_folder()]


def _environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}


def _root_package() -> str:
    return __package__.rpartition(".")[0]


def _root_folder() -> str:
    return os.path.dirname(os.path.dirname(os.path.abspath(__file__)))


def _main(package: str, folder: str, kernel: str) -> None:
    """In the process: import the engine under the name that it has in Blender, and compile this kernel, or the common
    ones in nobody's way."""
    import importlib
    import types

    if not kernel and hasattr(os, "nice"):
        os.nice(10)
    # Numba's cache remembers module names, and Blender's own packages above the extension don't exist here.
    names = package.split(".")
    for depth in range(1, len(names)):
        parent = types.ModuleType(".".join(names[:depth]))
        parent.__path__ = [os.path.dirname(folder)] if depth == len(names) - 1 else []
        sys.modules[parent.__name__] = parent
    engine = importlib.import_module(f"{package}.engine")
    if kernel or not _failed_before(engine.kernel_folder()):
        engine.precompile(kernel, _tell)


def _failed_before(kernels: str) -> bool:
    """In the process: whether the log of a failure is of these kernels and this Python. If not, the new log says what
    it is of."""
    title = f"Python {sys.version.split()[0]}, {kernels}"
    with contextlib.suppress(OSError), open(os.path.join(os.environ[CACHE_VARIABLE], FAILED), errors="replace") as log:
        if log.readline().strip() == title:
            return True
    print(title, flush=True)
    return False


def _tell(done: int, total: int) -> None:
    """In the process: for Blender, which reads the log."""
    print(DONE.format(done, total), flush=True)


if __name__ == "__main__":
    # Python puts the script's folder first, where `memory`, `report` and others would hide modules of those names.
    sys.path.pop(0)
    _main(*sys.argv[1:])
