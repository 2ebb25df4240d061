"""Compiles the kernels before anyone waits for them.

Compiling holds Python's lock for seconds, which would freeze the window, so it happens in a process of its own: the
Python inside Blender, at low priority, which fills the cache on disk and ends. This file is also what it runs.
It is started once for each version of the kernels, when Lobe is enabled, and only where there is a window.
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

    global _own_variable
    # An empty answer means that the user's folder can't be written: the engine then takes the temporary one.
    if CACHE_VARIABLE not in os.environ and (
        folder := bpy.utils.extension_path_user(_root_package(), path="cache", create=True)
    ):
        os.environ[CACHE_VARIABLE] = folder
        _own_variable = True
    if not bpy.app.background:
        start()


def unregister() -> None:
    global _own_variable
    stop()
    if _own_variable:
        del os.environ[CACHE_VARIABLE]
        _own_variable = False


def start() -> None:
    """Start the process, unless these kernels were compiled before or there is nowhere to keep the result."""
    global _process
    folder = os.environ.get(CACHE_VARIABLE)
    if not folder or not os.access(sys.executable, os.X_OK) or os.path.exists(_stamp(folder)):
        return
    import atexit
    import subprocess

    arguments = [sys.executable, __file__, _root_package(), _root_folder(), _stamp(folder)]
    with open(os.path.join(folder, "precompile.log"), "w") as log:
        _process = subprocess.Popen(
            arguments,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
        )
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


def _main(package: str, folder: str, stamp: str) -> None:
    """In the process: import the engine under the name that it has in Blender, and compile everything."""
    import importlib
    import types

    if hasattr(os, "nice"):
        os.nice(10)
    # Numba's cache remembers module names, and Blender's own packages above the extension don't exist here.
    names = package.split(".")
    for depth in range(1, len(names)):
        parent = types.ModuleType(".".join(names[:depth]))
        parent.__path__ = [os.path.dirname(folder)] if depth == len(names) - 1 else []
        sys.modules[parent.__name__] = parent
    engine = importlib.import_module(f"{package}.engine")
    engine.precompile()
    open(stamp, "w").close()


if __name__ == "__main__":
    # Python puts the script's folder first, where `memory`, `report` and others would hide modules of those names.
    sys.path.pop(0)
    _main(*sys.argv[1:])
