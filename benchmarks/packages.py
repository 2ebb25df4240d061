"""How large the extension's zips are, and what is in them: `python benchmarks/packages.py`.

Builds the zip of each system, as `make package` does, and opens it. A zip holds wheels for all of Blender's Pythons, of
which Blender installs those of its own: "installed" is what these take on the disk, of the Python that takes more.
Writes packages.csv and .md to benchmarks/results/. Renders nothing.
"""

from __future__ import annotations

import argparse
import io
import sys
import zipfile
from pathlib import Path

import common

from tools.lobe_blender import SetupError
from tools.package import PLATFORMS, build_package

OWN, WHOLE = "Lobe itself", "the whole zip"
WHEELS = "wheels/"


def contents(package: Path, system: str) -> list[dict]:
    """Rows of a zip: of Lobe's own files, of each library, and of the whole."""
    sizes: dict[str, tuple[int, int]] = {}  # bytes in the zip, and installed
    versions: dict[str, list[str]] = {OWN: [], WHOLE: []}
    pythons: dict[str, list[str]] = {OWN: [], WHOLE: []}
    with zipfile.ZipFile(package) as file:
        for entry in file.infolist():
            part, installed = OWN, entry.file_size
            if entry.filename.startswith(WHEELS) and entry.filename.endswith(".whl"):
                part, version, python, *_ = Path(entry.filename).name.split("-")
                versions.setdefault(part, []).append(version)
                pythons.setdefault(part, []).append(python)
                installed = unpacked(file.read(entry))
            packed, before = sizes.get(part, (0, 0))
            grown = before + installed if part == OWN else max(before, installed)
            sizes[part] = packed + entry.compress_size, grown
    sizes[WHOLE] = package.stat().st_size, sum(installed for _, installed in sizes.values())
    return [
        {
            "system": system,
            "part": part,
            "version": ", ".join(sorted(set(versions[part]))),
            "for Python": ", ".join(sorted(pythons[part])),
            "MB in the zip": f"{packed / 1e6:.1f}",
            "MB installed": f"{installed / 1e6:.1f}",
        }
        for part, (packed, installed) in sizes.items()
    ]


def unpacked(wheel: bytes) -> int:
    """Bytes of a wheel's files."""
    with zipfile.ZipFile(io.BytesIO(wheel)) as file:
        return sum(entry.file_size for entry in file.infolist())


def parse(arguments: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, default=common.ROOT / "out", help="of the zips; default: out")
    parser.add_argument("--platform", nargs="+", choices=PLATFORMS, default=list(PLATFORMS))
    common.add_results(parser)
    return parser.parse_args(arguments)


def main() -> int:
    options = parse()
    rows: list[dict] = []
    for system in options.platform:
        print(system, file=sys.stderr)
        try:
            rows += contents(build_package(options.output, system), system)
        except SetupError as error:
            print(f"packages.py: {error}", file=sys.stderr)
            return 2
    print(common.update_table("packages", ("system",), rows, folder=options.results))
    return 0


if __name__ == "__main__":
    sys.exit(main())
