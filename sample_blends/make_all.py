"""Make every sample scene again: `python sample_blends/make_all.py [NAME]...`

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
        subprocess.run([sys.executable, str(folder / f"{name}.py")], check=True, stdout=subprocess.DEVNULL)
        print(f"{name}.blend  {(folder / f'{name}.blend').stat().st_size / 1024:.0f} kB")


if __name__ == "__main__":
    main(sys.argv[1:])
