"""What skipping saves: each feature that a scene may lack, and what it costs to have it in the kernel all the same.

A sample scene that lacks a feature, by choice one with much of what the feature would burden, is rendered by its own
kernel and by the same one with the feature forced on, in turn; tables are filled up as that kernel needs them. Kernels
are compiled in processes of their own, each with an empty cache. `tools/bench.py --features` prints the table.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from tqdm import tqdm

from benchmarks import common
from benchmarks.common import br
from engine import render, schedule
from engine.features import EMITTER_TREE, EVERYTHING, Features
from engine.kernels.batch import new_batch
from engine.kernels.embree import build_monitor
from engine.loading import load_kernel
from engine.pack import pack
from engine.prepared import Prepared
from engine.scene import Camera, Scene
from engine.settings import Settings
from engine.tiles import tile_kernel
from tools import metrics
from tools.forcing import forced

SAMPLES = 16
COMPILATIONS = 3

# What a scene without the feature goes without.
LEFT_OUT = {
    "phong": "the lobe's code, the choice between lobes",
    "smooth": "three normals for each triangle and their interpolation",
    "instances": "a matrix for each instance, points and normals to the world",
    "transparency": "rays that go on, shadow rays that look for what dims them",
    "mesh_emitters": "emission where rays meet surfaces, an emitter's number for each triangle",
    "rectangle_emitters": "a rectangle for each pair of triangles, sampling by its solid angle",
    "lamp_kinds": "sampling points, balls, disks, rectangles, ellipses, spots",
    "lamp_shapes": "asking a few lamps one after the other where rays go, noting many where Embree meets them",
    "unshadowed": "light that is let through everything",
    "ray_kinds": "which kind of ray sees what, and goes how far",
    "emitter_choice": "the light tree",
    "suns": "sampling suns",
    "sun_disks": "suns that rays meet",
    "world": "the image and its tables, sampling it",
    "lens": "a point of the lens",
    "clamp": "limits of contributions",
    "holdout": "surfaces that are holes in the picture",
    "transparent_film": "how much of the background shows; with it, the background isn't drawn",
    "light_passes": "sums of the parts of the light; with it, the passes Emission and Environment",
}
FORCED = EVERYTHING | {"holdout": 1, "transparent_film": 1, "light_passes": 1}

PASSES = "EMISSION", "ENVIRONMENT"

# Fields of Features without a row: in each of their values the kernel does as much.
CHOICES = {
    "orthographic": "one camera or the other",
    "hemisphere": "one way or another to sample a cosine",
    "lobe_selection": "one way or another to choose between lobes",
    "shared_light": "light found in both ways counts by MIS, or each way has its own; see kernels/mis.py",
}


# Where there is most to lose: a scene with much of what the feature adds work or memory to.
TELLING = {
    "smooth": "many_lights",  # triangles
    "transparency": "many_lights",  # shadow rays
    "ray_kinds": "many_lights",
    "holdout": "many_lights",
    "unshadowed": "many_lights",  # lamps
    "suns": "plates_phong",  # emitters of another group, whose share then has to be found
    "world": "plates_phong",
    "sun_disks": "world",  # rays that meet nothing
    "transparent_film": "world",
    "lens": "world",  # camera rays among all rays
}


class Pair(NamedTuple):
    """A scene's own features, and the same with one more."""

    own: Features
    forced: Features


def pair(own: Features, feature: str) -> Pair | None:
    """None where the scene has the feature. One emitter alone lacks the tree that chooses between many."""
    present = own.emitter_choice == EMITTER_TREE if feature == "emitter_choice" else bool(getattr(own, feature))
    return None if present else Pair(own, own._replace(**{feature: FORCED[feature]}))


def asked(settings: Settings, feature: str) -> Settings:
    """Passes have to be asked for as well, so that there is room for them: those that need no colours beside them."""
    return replace(settings, passes=PASSES) if feature == "light_passes" else settings


def measure(scenes: dict[str, Scene], feature: str, threads: int, runs: int) -> dict:
    """A row of the table; no row is left out, since some of the sample scenes lack each feature."""
    settings = Settings(samples=SAMPLES, threads=threads, pixel_filter="BOX")
    pairs = {name: pair(pack(scene, settings).features, feature) for name, scene in scenes.items()}
    lacking = [name for name, both in pairs.items() if both is not None]
    if not lacking:
        raise br.ToolError(f"all of these scenes have {feature!r}: add one that lacks it")
    name = TELLING[feature] if TELLING.get(feature) in lacking else lacking[0]
    scene, both = scenes[name], pairs[name]
    assert both is not None
    compile_time, code = _compiled(both)
    return {
        "feature": feature.replace("_", " "),
        "left out": LEFT_OUT[feature],
        "scene": name,
        "render with it / without": _ratio(scene, settings, feature, runs),
        "tables and threads, kB": f"{more_bytes(scene, settings, feature) / 1e3:+.1f}",
        "machine code, kB": f"{code / 1e3:+.0f}",
        "compile with it / without": f"{compile_time:.2f}",
    }


def _with(feature: str) -> AbstractContextManager[None]:
    return forced(lambda features: features._replace(**{feature: FORCED[feature]}))


def _ratio(scene: Scene, settings: Settings, feature: str, runs: int) -> str:
    """Of the times of the render phase, the median of pairs with its range."""
    seconds: dict[bool, list[float]] = {True: [], False: []}
    for run, on in common.in_turn((False, True), runs + 1):
        with _with(feature) if on else nullcontext():
            taken = render(scene, asked(settings, feature) if on else settings).seconds["render"]
        if run:  # the first compiles
            seconds[on].append(taken)
    return "{:.2f} ({:.2f} to {:.2f})".format(*metrics.median_ratio(seconds[True], seconds[False]))


def more_bytes(scene: Scene, settings: Settings, feature: str) -> int:
    """That the tables and the threads' memory grow by."""
    with _with(feature):
        forced_on = _bytes(scene, asked(settings, feature))
    return forced_on - _bytes(scene, settings)


def _bytes(scene: Scene, settings: Settings) -> int:
    """Of all tables of a scene as a render packs it, and of the threads' memory."""
    packed = schedule.pack_next(Prepared(), scene, settings)
    tables = *packed.geometry, *packed.lights, *packed.environment, *packed.tree
    memory = new_batch(packed.features, packed.lights.shape_count).nbytes * settings.thread_count
    return memory + sum(table.nbytes for table in tables if isinstance(table, np.ndarray))


def _compiled(both: Pair) -> tuple[float, int]:
    """(ratio of the medians of the times that compiling takes, bytes of machine code that are more)."""
    seconds: dict[Features, list[float]] = {both.own: [], both.forced: []}
    size = {}
    for _ in range(COMPILATIONS):
        for features in both:
            taken, size[features] = _compile_alone(features)
            seconds[features].append(taken)
    ratio = float(np.median(seconds[both.forced]) / np.median(seconds[both.own]))
    return ratio, size[both.forced] - size[both.own]


def _compile_alone(features: Features) -> tuple[float, int]:
    """(seconds, bytes of machine code) of this kernel, by a new process with an empty cache."""
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "LOBE_CACHE_DIR": folder, "PYTHONPATH": str(common.ROOT)}
        command = [sys.executable, "-m", "benchmarks.features", json.dumps(features._asdict())]
        done = subprocess.run(command, env=environment, cwd=common.ROOT, capture_output=True, text=True, check=True)
    seconds, size = json.loads(done.stdout)
    return seconds, size


def compile_and_say(features: Features) -> None:
    """What `_compile_alone` runs: prints [seconds, bytes]."""
    build_monitor()
    packed = pack(Scene(camera=Camera()), Settings())
    packed.features = features
    begun = time.perf_counter()
    load_kernel(packed, Settings())
    seconds = time.perf_counter() - begun
    kernel = tile_kernel(features)
    code = kernel.overloads[kernel.signatures[0]].library._get_compiled_object()
    print(json.dumps([seconds, len(code)]))


NOTE = """\
Of the scene that is named, the same render by a kernel that has a feature which the scene lacks. "Tables and threads":
by how much the tables of that scene grow, and the memory of the threads.

"""


def table(names: list[Path], resolution: tuple[int, int], threads: int, runs: int, folder: Path) -> str:
    """Measure each feature on one of these scenes that lacks it, and write features.csv and .md."""
    from tools.exported import exported

    scenes = {}
    for path in names:
        common.prepare(path, resolution, threads)
        scenes[path.stem] = replace(exported(), skipped=[], warnings=[])
    rows = []
    for feature in tqdm(LEFT_OUT, file=sys.stderr):
        rows.append(measure(scenes, feature, threads, runs))
        written = common.update_table("features", ("feature",), rows, folder=folder, note=NOTE)
    return written


if __name__ == "__main__":
    compile_and_say(Features(**json.loads(sys.argv[1])))
