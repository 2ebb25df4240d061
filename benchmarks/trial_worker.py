"""Renders with the engine in the folder that it is started in, for `trials.py`: a line of JSON in, seconds out.

{"load": true} reads the file `scene`; {"settings": {...}} renders it into `picture.npy`. Both are in the folder that
the argument names.
"""

from __future__ import annotations

import json
import pickle
import sys
from pathlib import Path

sys.path[0] = str(Path.cwd())

import numpy as np  # noqa: E402

from engine import Settings, render  # noqa: E402


def main() -> None:
    scene, folder = None, Path(sys.argv[1])
    for line in sys.stdin:
        question, seconds = json.loads(line), 0.0
        if "load" in question:
            scene = pickle.loads((folder / "scene").read_bytes())
        else:
            result = render(scene, Settings(**question["settings"]))
            np.save(folder / "picture.npy", result.pixels)
            seconds = result.seconds["render"]
        print(seconds, flush=True)


if __name__ == "__main__":
    main()
