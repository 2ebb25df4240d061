"""Builds the extension with Blender's own tool: for every platform a zip that Blender installs by itself.

    tools/package.py [-o FOLDER] [--platform linux-x64 ...] [--python 3.11 ...]

Each holds the product files and the wheels that they need, for all of Blender's Pythons: Blender takes those of its
own. Wheels are downloaded once into a cache, in the versions that requirements.txt pins, and go into the manifest of
the package alone: the one in the repository stays as it is. numpy is part of Blender and never packed.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parent.parent
if str(REPOSITORY) not in sys.path:
    sys.path.insert(0, str(REPOSITORY))

from tools.lobe_blender import (  # noqa: E402
    PRODUCT,
    SetupError,
    build,
    check_folder,
    make_folder,
    private_folder,
    validate,
)

PACKED = ("embreex", "llvmlite", "numba", "OpenImageIO")
PYTHONS = ("3.11", "3.13")  # of Blender 4.2 to 5.0, and from 5.1 on (Debian's 4.3 has the newer one, too)
# Instead of the pinned ones: Blender 5.2's colour spaces need a newer OpenImageIO, which in turn needs numpy 2.
BY_PYTHON = {"3.13": {"OpenImageIO": "3.1.19.0"}}

# Blender's name of a platform -> the tags of the wheels that run there, the oldest system that Blender supports last.
PLATFORMS = {
    "linux-x64": [f"manylinux_2_{minor}_x86_64" for minor in range(28, 16, -1)] + ["manylinux2014_x86_64"],
    "windows-x64": ["win_amd64"],
    "macos-arm64": [f"macosx_{major}_0_arm64" for major in range(14, 10, -1)],
}


def pins(python: str) -> list[str]:
    """The packed requirements with their exact versions for one Python, from requirements.txt and `BY_PYTHON`."""
    lines = (REPOSITORY / "requirements.txt").read_text().splitlines()
    found = dict(line.split("==") for line in lines if "==" in line) | BY_PYTHON.get(python, {})
    return [f"{name}=={found[name]}" for name in PACKED]


def download(target: str, python: str, folder: Path) -> list[Path]:
    """The wheels for one platform and one Python, from the cache in `folder` where they are there already."""
    key = hashlib.sha256("\n".join([target, python, *pins(python)]).encode()).hexdigest()[:12]
    place = folder / f"{target}-{python}-{key}"
    if not place.is_dir():
        with tempfile.TemporaryDirectory(dir=folder) as unfinished:
            tags = [part for tag in PLATFORMS[target] for part in ("--platform", tag)]
            command = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps",
                       "--only-binary=:all:", "--python-version", python, "--implementation", "cp", *tags,
                       "--dest", unfinished, *pins(python)]  # fmt: skip
            if subprocess.run(command).returncode:
                raise SystemExit(f"no wheels for {target} and Python {python}: pip's message is above")
            os.chmod(unfinished, 0o755)
            shutil.copytree(unfinished, place)
    return sorted(place.glob("*.whl"))


def build_package(output: Path, target: str, pythons: Sequence[str] = PYTHONS, wheels: Path | None = None) -> Path:
    """Build the zip of a platform, validate it, and give back its path.

    wheels  folder that keeps what was downloaded; None: one of this user's, for all packages.
    """
    make_folder(output)
    wheels = wheels or private_folder("wheels")
    wheels.mkdir(parents=True, exist_ok=True)
    found = {wheel.name: wheel for python in pythons for wheel in download(target, python, wheels)}
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "lobe"
        source.mkdir()
        for name in (*PRODUCT, "LICENSE"):
            path = REPOSITORY / name
            if path.is_dir():
                shutil.copytree(path, source / name, ignore=shutil.ignore_patterns("__pycache__", ".*"))
            elif path.is_file():
                shutil.copy(path, source / name)
        (source / "wheels").mkdir()
        for wheel in found.values():
            shutil.copy(wheel, source / "wheels")
        manifest = source / "blender_manifest.toml"
        manifest.write_text(with_wheels(manifest.read_text(), sorted(found), [target]))
        package = output.resolve() / f"lobe-{version(manifest)}-{target.replace('-', '_')}.zip"
        build(package, source)
    validate(package)
    return package


def with_wheels(manifest: str, wheels: list[str], targets: list[str]) -> str:
    """The manifest with its lists of wheels and platforms, which have to stand before the first table."""
    lists = {"platforms": targets, "wheels": [f"./wheels/{name}" for name in wheels]}
    text = "".join(f"{key} = {json.dumps(values, indent=4)}\n" for key, values in lists.items())
    head, table, rest = manifest.partition("[build]")
    return f"{head}{text}\n{table}{rest}"


def version(manifest: Path) -> str:
    match = re.search(r'^version = "(.+)"$', manifest.read_text(), re.MULTILINE)
    assert match, f"{manifest} has no version"
    return match.group(1)


def this_platform() -> str:
    system = {"Linux": "linux", "Darwin": "macos", "Windows": "windows"}[platform.system()]
    return f"{system}-{'arm64' if platform.machine() in ('arm64', 'aarch64') else 'x64'}"


def main() -> None:
    parser = argparse.ArgumentParser(description="Build the extension with its wheels, a zip for each platform.")
    parser.add_argument("-o", "--output", type=Path, default=Path("out"), help="folder of the zips (default: out)")
    parser.add_argument("--platform", nargs="+", choices=PLATFORMS, default=list(PLATFORMS), help="default: all")
    parser.add_argument("--python", nargs="+", default=PYTHONS, help=f"default: {' '.join(PYTHONS)}")
    parser.add_argument("--wheels", type=Path, help="folder that keeps downloaded wheels")
    arguments = parser.parse_args()
    try:
        check_folder(arguments.output)
        pack(arguments)
    except SetupError as error:
        raise SystemExit(f"package.py: {error}") from error


def pack(arguments: argparse.Namespace) -> None:
    for target in arguments.platform:
        print(f"{target}: fetching its wheels where they are not kept yet, then packing them", flush=True)
        package = build_package(arguments.output, target, arguments.python, arguments.wheels)
        print(f"Wrote {package} ({package.stat().st_size / 1e6:.0f} MB, valid)", flush=True)


if __name__ == "__main__":
    main()
