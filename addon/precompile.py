"""Compiles in processes of their own: holding Python's lock for seconds, as compiling does, would freeze the window.

Such a process is the Python inside Blender, which fills the cache on disk and ends. One is started when Lobe is
enabled, once for each version of the kernels, at low priority: it compiles what scenes most often need before anyone
waits for it. For any other kernel the engine starts one when a scene needs it. Both only where there is a window.
This file is also what they run.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import sys

CACHE_VARIABLE = "LOBE_CACHE_DIR"  # read by engine/kernels/jit.py
LOOK_INTERVAL = 1.0  # seconds
DONE = "{} of {} kinds of scenes are compiled"  # a line of the log
_process = None  # the one that compiles the common kernels
_log = ""  # the file that it writes to
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
    """Start the process, unless these kernels were compiled before or there is nowhere to keep the result."""
    global _process, _log
    folder = os.environ.get(CACHE_VARIABLE)
    if not folder or not _has_python() or os.path.exists(_stamp(folder)):
        return
    import atexit
    import subprocess

    import bpy

    _log = os.path.join(folder, "precompile.log")
    try:
        os.makedirs(folder, exist_ok=True)
        with open(_log, "w") as log:
            _process = subprocess.Popen(
                [*_command(), "", _stamp(folder)],
                env=_environment(),
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                creationflags=_windows("CREATE_NO_WINDOW") | _windows("IDLE_PRIORITY_CLASS"),
            )
    except OSError:  # the engine keeps its kernels elsewhere then, and says so
        return
    atexit.register(_end)
    bpy.app.timers.register(_look, persistent=True)


def said() -> str:
    """How far the process is, for a panel; empty where there is none."""
    return _said


def _look() -> float | None:
    """Blender's timer: see how far it is, until it has ended."""
    from .scene_report import redraw_properties

    global _said
    before, _said = _said, _progress()
    if _said != before:
        redraw_properties()
    return LOOK_INTERVAL if _said else None


def _progress() -> str:
    if _process is None or _process.poll() is not None:
        return ""
    text = "Compiling in the background"
    counts = []
    with contextlib.suppress(OSError), open(_log, errors="replace") as log:  # users may delete it
        counts = re.findall(DONE.format(r"(\d+)", r"(\d+)"), log.read())
    return f"{text}: {counts[-1][0]} of {counts[-1][1]}" if counts else text


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
    """To which the name of the kernel is added, or nothing and the stamp."""
    return [sys.executable, __file__, _root_package(), _root_folder()]


def _environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}


def _root_package() -> str:
    return __package__.rpartition(".")[0]


def _root_folder() -> str:
    return os.path.dirname(os.path.dirname(os.path.abspath(__file__)))


def _stamp(folder: str) -> str:
    """The file that says that the kernels as they are now have been compiled by this Python."""
    digest = hashlib.sha256(sys.version.encode())
    for path, folders, names in os.walk(os.path.join(_root_folder(), "engine")):
        folders.sort()
        for name in sorted(n for n in names if n.endswith(".py")):
            with open(os.path.join(path, name), "rb") as file:
                digest.update(file.read())
    return os.path.join(folder, f"precompiled-{digest.hexdigest()[:16]}")


def _main(package: str, folder: str, kernel: str, stamp: str = "") -> None:
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
    importlib.import_module(f"{package}.engine").precompile(kernel, _tell)
    if stamp:
        open(stamp, "w").close()


def _tell(done: int, total: int) -> None:
    """In the process: for Blender, which reads the log."""
    print(DONE.format(done, total), flush=True)


if __name__ == "__main__":
    # Python puts the script's folder first, where `memory`, `report` and others would hide modules of those names.
    sys.path.pop(0)
    _main(*sys.argv[1:])
