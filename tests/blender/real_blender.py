"""A Blender program with the packed extension installed, for the tests that need one instead of the bpy module."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

from tools.package import build_package, this_platform

BLENDER = shlex.split(os.environ.get("LOBE_BLENDER", "")) or [path for path in [shutil.which("blender")] if path]
# A program that can open a window: where there is a display it is the same.
WITH_WINDOW = shlex.split(os.environ.get("LOBE_BLENDER_WINDOW", "")) or (BLENDER if os.environ.get("DISPLAY") else [])

Run = Callable[..., str]


def install(make_folder: Callable[[str], Path], command: list[str] = BLENDER) -> Run:
    """A function that runs the command, with the extension installed into a user folder of its own."""
    user = make_folder("user")
    environment = {**os.environ, "BLENDER_USER_RESOURCES": str(user)}
    environment.pop("LOBE_CACHE_DIR", None)  # as a user has it

    def runner(command: list[str]) -> Run:
        def run(*arguments: str | Path, code: int = 0) -> str:
            done = subprocess.run([*command, *map(str, arguments)], env=environment, capture_output=True, text=True)
            assert done.returncode == code, done.stdout + done.stderr
            return done.stdout + done.stderr

        return run

    run = runner(BLENDER or command)
    said = run("-b", "--factory-startup", "--python-expr", "import sys; print('PYTHON %d.%d' % sys.version_info[:2])")
    python = next(line.split()[1] for line in said.splitlines() if line.startswith("PYTHON"))
    wheels = Path(os.environ.get("LOBE_WHEELS", make_folder("wheels")))
    package = build_package(make_folder("package"), [this_platform()], [python], wheels)
    assert "Installed" in run("--command", "extension", "install-file", "-r", "user_default", "-e", package)
    return runner(command)
