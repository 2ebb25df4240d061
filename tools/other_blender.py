"""Run a script with another version of Blender, as a Python module, than the one of the pinned requirements:

    tools/other_blender.py VERSION SCRIPT.py [ARGUMENT]...
    tools/other_blender.py VERSION -m MODULE [ARGUMENT]...

    tools/other_blender.py 4.2.23 sample_blends/make_all.py
    tools/other_blender.py 4.5.15 -m pytest tests/blender tests/tools
    tools/other_blender.py 4.2.23 tools/render.py FILE.blend -o OUT.png

VERSION is one of the bpy package's. Blender 4.2 to 5.0 need Python 3.11 to run this, 5.1 and 5.2 Python 3.13. The first
use of a version makes .venv/blender-VERSION from the pinned requirements, with the numpy of that Blender.
"""

from __future__ import annotations

import subprocess
import sys
import venv
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parent.parent
if str(REPOSITORY) not in sys.path:
    sys.path.insert(0, str(REPOSITORY))

from tools.package import BY_PYTHON  # noqa: E402

# Version of Blender, from which on -> the versions that go with it, instead of those of the requirements.
NUMPY = {(4, 2): "1.24.3", (4, 4): "1.26.4", (5, 1): "2.3.4"}
FOR_OLD_NUMPY = {"scipy": "1.13.1", "matplotlib": "3.10.8"}  # the newest ones for a numpy before 1.25
PYTHON = {(4, 2): (3, 11), (5, 1): (3, 13)}
TEST_PACKAGES = ("flip-evaluator", "hypothesis", "matplotlib", "pytest", "scipy")


def requirements(version: str, lines: list[str]) -> list[str]:
    """The pinned requirement `lines`, changed to those that go with this version of Blender."""
    numpy, python = since(version, NUMPY), "{}.{}".format(*since(version, PYTHON))
    pins = dict(line.split("==") for line in lines if "==" in line) | BY_PYTHON.get(python, {})
    pins.update(bpy=version, numpy=numpy)
    if numpy < "1.25":
        pins.update((name, pin) for name, pin in FOR_OLD_NUMPY.items() if name in pins)
    return [f"{name}=={pin}" for name, pin in pins.items()]


def since(version: str, table: dict):
    """The table's value for the newest version that isn't newer than `version`."""
    asked = tuple(int(part) for part in version.split(".")[:2])
    return table[max(key for key in table if key <= asked)]


def python_of(version: str) -> Path:
    """The interpreter of the version's environment, made when it is missing or other packages are asked for."""
    folder = REPOSITORY / ".venv" / f"blender-{version}"
    python = folder / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")
    installed = folder / "installed"
    lines = (REPOSITORY / "requirements.txt").read_text().splitlines()
    lines += [line for line in (REPOSITORY / "requirements-dev.txt").read_text().splitlines()
              if line.partition("==")[0] in TEST_PACKAGES]  # fmt: skip
    packages = requirements(version, lines)
    if not installed.is_file() or installed.read_text().split() != packages:
        venv.create(folder, with_pip=True, clear=True)
        pip = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
        if subprocess.run([*pip, *packages]).returncode:
            raise SystemExit(f"bpy {version} could not be installed: pip's message is above")
        installed.write_text("\n".join(packages))
    return python


def main() -> int:
    if len(sys.argv) < 3 or not sys.argv[1].replace(".", "").isdigit() or sys.argv[1].count(".") != 2:
        print(__doc__, file=sys.stderr)
        return 2
    version = sys.argv[1]
    needed = since(version, PYTHON)
    if sys.version_info[:2] != needed:
        print(f"Blender {version} needs Python {needed[0]}.{needed[1]}: run this script with it", file=sys.stderr)
        return 2
    return subprocess.run([str(python_of(version)), *sys.argv[2:]]).returncode


if __name__ == "__main__":
    sys.exit(main())
