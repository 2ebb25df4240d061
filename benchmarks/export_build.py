"""How long a large scene takes until its first sample: Lobe's export and build against Cycles' own preparation.

    python benchmarks/export_build.py --runs 3

Renders one picture of 4 x 4 pixels and one sample, so that all of the time is preparation: the dependency graph (the
same for both), reading the scene, building the ray acceleration structure, and the engine's fixed costs. Measured from
outside, pressing F12 to the end, the engines in turn. "evaluation" is a render of the same file by an engine that
does nothing: it is what neither can avoid. Scenes: one mesh of a million triangles, and sample_blends/instances.blend.
Results go to benchmarks/results/export_build.csv and .md.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable

import common
import numpy as np
from common import br

from tools import metrics
from tools.render import whole_number

MESH = "one mesh"


def million_triangles():
    """A wavy smooth grid of 708 x 708 quads, 1.0 million triangles, under a sun. Gives back the scene."""
    import bpy

    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    n = 709
    axis = np.linspace(-1, 1, n, dtype=np.float32)
    x, y = np.meshgrid(axis, axis)
    vertices = np.stack([x, y, 0.05 * np.sin(20 * x) * np.cos(17 * y)], axis=-1).reshape(-1, 3)
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).reshape(-1, 1)
    faces = (corner + [0, 1, n + 1, n]).astype(np.int32)
    mesh = bpy.data.meshes.new("Grid")
    mesh.vertices.add(len(vertices))
    mesh.vertices.foreach_set("co", vertices.ravel())
    mesh.loops.add(faces.size)
    mesh.loops.foreach_set("vertex_index", faces.ravel())
    mesh.polygons.add(len(faces))
    mesh.polygons.foreach_set("loop_start", np.arange(len(faces), dtype=np.int32) * 4)
    mesh.update()
    mesh.shade_smooth()
    sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location = (0, 0, 4)
    for obj in (bpy.data.objects.new("Grid", mesh), sun, camera):
        scene.collection.objects.link(obj)
    scene.camera = camera
    return scene


def add_idle_engine() -> None:
    """The engine IDLE: takes part in everything that Blender does for a render, and traces nothing."""
    import bpy

    class IdleEngine(bpy.types.RenderEngine):
        bl_idname, bl_label = "IDLE", "Idle"

        def render(self, depsgraph):
            self.end_result(self.begin_result(0, 0, self.resolution_x, self.resolution_y))

    bpy.utils.register_class(IdleEngine)


def prepare(name: str, threads: int):
    scene = million_triangles() if name == MESH else br.open_blend(common.scene_path(name))
    br.set_resolution(scene, 4, 4)
    br.set_threads(scene, threads)
    scene.lobe.samples = 1
    return scene


def measure(name: str, options: argparse.Namespace) -> dict:
    scene = prepare(name, options.threads)
    seconds: dict[str, list[float]] = {"IDLE": [], "LOBE": [], "CYCLES": []}
    reports = []
    for run in range(options.runs + 1):
        for engine in seconds:
            br.set_engine(scene, engine)
            report = br.render(scene)
            if run:  # the first round warms up
                seconds[engine].append(report["seconds"]["total"])
                if engine == "LOBE":
                    reports.append(report)
            print(f"\r{engine} {run}/{options.runs}  ", end="", file=sys.stderr, flush=True)
    idle, lobe, cycles = (np.array(seconds[e]) for e in seconds)
    whole, whole_low, whole_high = metrics.median_ratio(lobe, cycles)
    own, _, _ = metrics.median_ratio(np.maximum(lobe - idle, 1e-6), np.maximum(cycles - idle, 1e-6))
    phase = {p: np.median([r["seconds"][p] for r in reports]) for p in ("export", "build")}
    return {
        "scene": name,
        "runs": options.runs,
        "threads": options.threads,
        "evaluation, s": f"{np.median(idle):.3f}",
        "Lobe, s": f"{np.median(lobe):.3f}",
        "Lobe: export, s": f"{phase['export']:.3f}",
        "Lobe: build, s": f"{phase['build']:.3f}",
        "Cycles, s": f"{np.median(cycles):.3f}",
        "Lobe / Cycles": f"{whole:.2f} ({whole_low:.2f} to {whole_high:.2f})",
        "Lobe / Cycles, without evaluation": f"{own:.2f}",
    }


def parse(arguments: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("scenes", nargs="*", default=[MESH, "instances"], metavar="SCENE")
    parser.add_argument("--runs", type=whole_number(1, 100), default=3)
    parser.add_argument("--threads", type=whole_number(0, 1024), default=2)
    common.add_results(parser)
    return parser.parse_args(arguments)


def main() -> int:
    return common.run(work, parse())


def work(options: argparse.Namespace, say: Callable[[str], None]) -> None:
    add_idle_engine()
    rows = [measure(name, options) for name in options.scenes]
    say(common.update_table("export_build", ("scene", "threads"), rows, folder=options.results))


if __name__ == "__main__":
    sys.exit(main())
