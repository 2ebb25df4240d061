"""Make every sample scene again: `python tools/other_blender.py 4.2.23 sample_blends/make_all.py [NAME]...`

Blender 4.2 saves them: the file format of 5.0 has a header that 4.4 and older take for "not a blend file", while every
version from 4.2 on opens these, with the same scene in them. Building them works in any of these versions, and
tests/tools/test_sample_blends.py holds each file against what its script builds.

Each scene is made by its own Python process, so none depends on what another left behind.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

SCENES = ("cornell_diffuse", "plates_phong", "lamps", "world", "instances", "many_lights")


def main(names: list[str]) -> None:
    folder = Path(__file__).resolve().parent
    unknown = [name for name in names if name not in SCENES]
    if unknown:
        sys.exit(f"no such scene: {', '.join(unknown)}; there are {', '.join(SCENES)}")
    for name in names or SCENES:
        script = folder / f"{name}.py"
        if code := subprocess.run([sys.executable, str(script)], stdout=subprocess.DEVNULL).returncode:
            sys.exit(code)
        print(f"{name}.blend  {(folder / f'{name}.blend').stat().st_size / 1024:.0f} kB")


if __name__ == "__main__":
    main(sys.argv[1:])
