"""The zip that `make package` builds, put into clean user folders of several Blenders, renders there.

These are bpy modules, each in a Python that has nothing else of what Lobe needs. The pinned one is always tested; of
the others, which tools/other_blender.py makes, when long tests are asked for, the long-term ones always and those that
need another Python where they are there. A Blender program is in `test_addon_real_blender.py`.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.blender.real_blender import read_picture, this_package
from tools.lobe_blender import MODULE, REPOSITORY, blender_version
from tools.package import PACKED

SCRIPT = Path(__file__).with_name("install_script.py")
SCENE = REPOSITORY / "sample_blends" / "plates_phong.blend"
LONG_TERM = ("4.2.23", "4.5.15")
OTHERS = (*LONG_TERM, "5.1.2", "5.2.3")


def interpreter(version: str) -> Path:
    """The Python that has this version's bpy."""
    if version == blender_version():
        return Path(sys.executable)
    folder = REPOSITORY / ".venv" / f"blender-{version}"
    path = folder / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")
    if not path.is_file():
        missing = f"bpy {version} is not installed: tools/other_blender.py {version} -m pip list does it"
        (pytest.fail if version in LONG_TERM else pytest.skip)(missing)
    return path


def without_packed(python: Path, folder: Path) -> Path:
    """A folder with all packages of an interpreter, except those that the zip brings, and what comes with these."""
    ask = "import sysconfig; print(sysconfig.get_path('purelib'))"
    site = Path(subprocess.run([python, "-c", ask], capture_output=True, text=True, check=True).stdout.strip())
    packed = tuple(name.lower() for name in PACKED)
    folder.mkdir()
    for path in site.iterdir():
        if not path.name.lower().startswith(packed):
            (folder / path.name).symlink_to(path)
    return folder


@pytest.fixture(scope="module")
def package(tmp_path_factory) -> Path:
    return this_package(tmp_path_factory.mktemp("package"))


@pytest.mark.parametrize(
    "version", [blender_version(), *(pytest.param(version, marks=pytest.mark.long) for version in OTHERS)]
)
def test_the_package_installs_and_renders(version, package, tmp_path) -> None:
    python, user, output = interpreter(version), tmp_path / "user", tmp_path / "out.exr"
    user.mkdir()
    environment = {**os.environ, "BLENDER_USER_RESOURCES": str(user)}
    environment.pop("LOBE_CACHE_DIR", None)  # as a user has it
    environment.pop("PYTHONPATH", None)
    packages = without_packed(python, tmp_path / "packages")
    command = [python, "-S", SCRIPT, packages, package, SCENE, output]
    done = subprocess.run(command, env=environment, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert ".".join(map(str, found["version"])) == version
    assert found["engine"] == "LOBE" and MODULE in found["addons"]
    assert [name for name, file in found["files"].items() if not Path(file).is_relative_to(user)] == []
    expected = tmp_path / "expected.exr"
    render_here(expected)
    assert np.allclose(read_picture(output), read_picture(expected), rtol=1e-3, atol=1e-4)


def render_here(path: Path) -> None:
    """The same picture by this checkout."""
    command = [sys.executable, REPOSITORY / "tools" / "render.py", SCENE, "--resolution", "48x32", "--samples", "8"]
    subprocess.run([*command, "-o", path], check=True, capture_output=True)
