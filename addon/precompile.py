"""Compiles in processes of their own: holding Python's lock for seconds, as compiling does, would freeze the window.

Such a process is the Python inside Blender, which fills the cache on disk and ends. One is started when Lobe is
enabled, once for each version of the kernels, at low priority: it compiles what scenes most often need before anyone
waits for it. For any other kernel the engine starts one when a scene needs it. Both only where there is a window.
This file is also what they run.
"""

from __future__ import annotations

import hashlib
import os
import sys

CACHE_VARIABLE = "LOBE_CACHE_DIR"  # read by engine/kernels/jit.py
_process = None
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
    global _process
    folder = os.environ.get(CACHE_VARIABLE)
    if not folder or not _has_python() or os.path.exists(_stamp(folder)):
        return
    import atexit
    import subprocess

    try:
        os.makedirs(folder, exist_ok=True)
        with open(os.path.join(folder, "precompile.log"), "w") as log:
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
    atexit.register(stop)


def stop() -> None:
    global _process
    if _process is None:
        return
    import atexit

    atexit.unregister(stop)
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
    importlib.import_module(f"{package}.engine").precompile(kernel)
    if stamp:
        open(stamp, "w").close()


if __name__ == "__main__":
    # Python puts the script's folder first, where `memory`, `report` and others would hide modules of those names.
    sys.path.pop(0)
    _main(*sys.argv[1:])
