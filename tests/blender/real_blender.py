"""The packed extension, and Blender programs that have it, for tests that need one instead of the bpy module."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

import numpy as np
import pytest

from tools.package import build_package, this_platform

BLENDER = shlex.split(os.environ.get("LOBE_BLENDER", "")) or [path for path in [shutil.which("blender")] if path]
# A program that can open a window: where there is a display it is the same.
WITH_WINDOW = shlex.split(os.environ.get("LOBE_BLENDER_WINDOW", "")) or (BLENDER if os.environ.get("DISPLAY") else [])

NO_WINDOW = "no Blender with a window: set LOBE_BLENDER_WINDOW to a command that opens Blender 4.2 or newer in one"

Run = Callable[..., str]


def named() -> str:
    """The program with a window as LOBE_BLENDER_WINDOW names it; without any it ends Python, and says so."""
    if not WITH_WINDOW:
        raise SystemExit(NO_WINDOW)
    return shlex.join(WITH_WINDOW)


def cannot_look(reason: str) -> NoReturn:
    """Skip the test; where somebody has named a Blender with a window to be looked at, fail it."""
    if os.environ.get("LOBE_BLENDER_WINDOW"):
        pytest.fail(reason)
    pytest.skip(reason)


def this_package(folder: Path) -> Path:
    """The zip for this platform, as `make package` builds it. LOBE_WHEELS names a folder of wheels other than its."""
    wheels = os.environ.get("LOBE_WHEELS")
    return build_package(folder, this_platform(), wheels=Path(wheels) if wheels else None)


def install(make_folder: Callable[[str], Path], command: list[str] = BLENDER) -> Run:
    """A function that runs the command, with the extension installed into a user folder of its own."""
    user = make_folder("user")
    package = this_package(make_folder("package"))
    said = runner(user, BLENDER or command)(
        "--command", "extension", "install-file", "-r", "user_default", "-e", package
    )
    assert "Installed" in said, said
    return runner(user, command)


def runner(user: Path, command: list[str]) -> Run:
    """A function that runs the command with arguments and a user folder, and gives back what it says."""
    environment = {**os.environ, "BLENDER_USER_RESOURCES": str(user)}
    environment.pop("LOBE_CACHE_DIR", None)  # as a user has it

    def run(*arguments: str | Path, code: int = 0) -> str:
        done = subprocess.run([*command, *map(str, arguments)], env=environment, capture_output=True, text=True)
        assert done.returncode == code, done.stdout + done.stderr
        return done.stdout + done.stderr

    return run


def read_picture(path: Path) -> np.ndarray:
    """(h, w, 4) float32, row 0 at the top."""
    import OpenImageIO as oiio

    image = oiio.ImageInput.open(str(path))
    pixels = image.read_image("float")
    image.close()
    return pixels


def read_bytes(path: Path) -> np.ndarray:
    """(h, w, 3) int16 of a PNG, row 0 at the top: 0 to 255 that can be subtracted."""
    import OpenImageIO as oiio

    return oiio.ImageBuf(str(path)).get_pixels(oiio.UINT8)[..., :3].astype(np.int16)
