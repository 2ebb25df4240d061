"""How much brighter or darker than in Cycles surfaces are that Lobe draws with the nearest thing it has.

    python benchmarks/materials.py

A ball that fills the picture, and a floor that is seen from nearly along it to steeply from above, each under a white
world alone and under one area lamp alone: so there is no light but what the lamp or the world sends to the surface.
Both engines render several seeds with the settings that make a comparison fair. "mean" is that of the ball or the
floor, with its 95 % interval; "blocks" the smallest and the largest of 8 x 8 pixels that lie on it, but for those that
are next to black in Cycles. As noise alone sets blocks apart, there are more and more seeds until the standard error of
each block is below a tenth of their range, or below half of the last digit that is told. Writes materials.csv and .md
to benchmarks/results/, and a shorter table into docs/materials.md.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import common
import numpy as np
import scale_scenes
from common import br
from tqdm import tqdm

from benchmarks.convergence.tables import quote
from tools import metrics
from tools.render import resolution, whole_number

BLOCK = 8  # pixels a side
NOISE_OF_RANGE, LEAST_NOISE = 0.1, 0.005  # of a block, against the range of blocks, and what rounding hides
DARK = 0.01  # of the brightest block in Cycles: darker ones have no ratio that says anything
GREY = 0.8, 0.8, 0.8, 1.0
WORLD, LAMP = LIGHTS = "white world", "area lamp"
LAMP_AT = {"ball": (-2.0, -3.0, 3.0), "floor": (0.0, 2.0, 3.0)}  # beside the camera; where the floor mirrors it
PRINCIPLED, GLOSSY = "ShaderNodeBsdfPrincipled", "ShaderNodeBsdfAnisotropic"
PAGE = common.ROOT / "docs" / "materials.md"
MARKS = "<!-- the table of materials.py -->\n", "<!-- its end -->\n"


class Case(NamedTuple):
    """node: of the shader, None for an object without a material; roughness: of the node."""

    shape: str
    surface: str
    node: str | None
    roughness: float | None = None
    metallic: float = 0.0


CASES = (
    *(Case("ball", "Glossy BSDF", GLOSSY, roughness) for roughness in (0.1, 0.3, 0.6)),
    *(Case("ball", "Principled BSDF, metallic", PRINCIPLED, roughness, 1.0) for roughness in (0.1, 0.3, 0.6)),
    *(Case(shape, "Principled BSDF", PRINCIPLED, r) for shape in ("ball", "floor") for r in (0.2, 0.5)),
    *(Case(shape, "no material", None) for shape in ("ball", "floor")),
)


# --- scenes ---------------------------------------------------------------------------------------------------


def build(case: Case, light: str):
    """The scene, in an empty file."""
    import bpy

    scale_scenes.empty_file()
    scene = bpy.context.scene
    add_world(scene, float(light == WORLD))
    if light == LAMP:
        add_lamp(scene, LAMP_AT[case.shape])
    if case.shape == "ball":
        bpy.ops.mesh.primitive_uv_sphere_add(segments=128, ring_count=64)
        bpy.context.object.data.shade_smooth()
    else:
        bpy.ops.mesh.primitive_plane_add(size=200)
    if case.node:
        bpy.context.object.data.materials.append(material(case))
    add_camera(scene, case.shape)
    return scene


def add_camera(scene, shape: str) -> None:
    """Of the ball a parallel view that it touches on all sides; the floor from 2 m above, 10 to 70 degrees down."""
    import bpy

    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location = (0, -4, 0 if shape == "ball" else 2)
    camera.rotation_euler.x = math.radians(90 if shape == "ball" else 50)
    if shape == "ball":
        camera.data.type, camera.data.ortho_scale = "ORTHO", 2.0
    camera.data.angle = math.radians(60)
    scene.collection.objects.link(camera)
    scene.camera = camera


def add_lamp(scene, place: tuple[float, float, float]) -> None:
    """One metre wide, shining at the origin."""
    import bpy
    from mathutils import Vector

    lamp = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "AREA"))
    lamp.data.size, lamp.data.energy = 1.0, 100.0
    lamp.location = place
    lamp.rotation_euler = (-Vector(place)).to_track_quat("-Z", "Y").to_euler()
    scene.collection.objects.link(lamp)


def add_world(scene, radiance: float) -> None:
    import bpy

    scene.world = bpy.data.worlds.new("World")
    nodes = empty_tree(scene.world)
    background, output = nodes.new("ShaderNodeBackground"), nodes.new("ShaderNodeOutputWorld")
    background.inputs["Color"].default_value = (radiance, radiance, radiance, 1.0)
    scene.world.node_tree.links.new(background.outputs[0], output.inputs["Surface"])


def material(case: Case):
    import bpy

    made = bpy.data.materials.new(case.surface)
    nodes = empty_tree(made)
    shader, output = nodes.new(case.node), nodes.new("ShaderNodeOutputMaterial")
    shader.inputs["Color" if case.node == GLOSSY else "Base Color"].default_value = GREY
    shader.inputs["Roughness"].default_value = case.roughness
    if case.metallic:
        shader.inputs["Metallic"].default_value = case.metallic
    made.node_tree.links.new(shader.outputs[0], output.inputs["Surface"])
    return made


def empty_tree(data):
    """The nodes of a material or world, of which there are none."""
    import bpy

    if bpy.app.version < (5, 0):  # from then on they always have some
        data.use_nodes = True
    data.node_tree.nodes.clear()
    return data.node_tree.nodes


def inside(shape: str, size: tuple[int, int]) -> np.ndarray:
    """(h, w): the pixels that show the ball or the floor and nothing else."""
    x, y = (2 * np.arange(n + 1) / n - 1 for n in size)
    corners = np.hypot(x[None, :], y[:, None]) < 0.999 if shape == "ball" else np.ones((size[1] + 1, size[0] + 1), bool)
    return corners[:-1, :-1] & corners[1:, :-1] & corners[:-1, 1:] & corners[1:, 1:]


# --- figures --------------------------------------------------------------------------------------------------


class Brighter(NamedTuple):
    """Than in Cycles, relative: the mean with the half width of its interval, the smallest and the largest block, and
    the largest standard error of any block."""

    mean: float
    half_width: float
    low: float
    high: float
    noise: float

    @property
    def settled(self) -> bool:
        """Whether `low` and `high` are the surface's own, rather than noise's."""
        return self.noise <= max(LEAST_NOISE, NOISE_OF_RANGE * (self.high - self.low))


def brighter(lobe: np.ndarray, cycles: np.ndarray, where: np.ndarray) -> Brighter:
    """lobe, cycles: (seeds, h, w, 3); where: (h, w)."""
    mean, half_width = metrics.mean_difference(lobe[:, where], cycles[:, where])
    whole = metrics.block_means(where[None, ..., None].astype(float), BLOCK)[0, ..., 0] == 1.0
    seeds = [metrics.block_means(each, BLOCK).mean(axis=3)[:, whole] for each in (lobe, cycles)]
    theirs = seeds[1].mean(axis=0)
    lit = theirs > DARK * theirs.max()
    ours, theirs = (each.mean(axis=0)[lit] for each in seeds)
    ours_noise, theirs_noise = (each.std(axis=0, ddof=1)[lit] / np.sqrt(len(each)) for each in seeds)
    ratio = ours / theirs
    noise = np.hypot(ours_noise, ratio * theirs_noise) / theirs  # of a quotient of independent means
    return Brighter(mean, half_width, float(ratio.min() - 1), float(ratio.max() - 1), float(noise.max()))


def measure(case: Case, light: str, options: argparse.Namespace) -> dict:
    """A row."""
    scene = build(case, light)
    br.set_resolution(scene, *options.resolution)
    br.set_threads(scene, options.threads)
    scene.lobe.pixel_filter = "BOX"
    common.leave_out(scene)
    where = inside(case.shape, options.resolution)
    pictures: dict[str, list[np.ndarray]] = {"LOBE": [], "CYCLES": []}
    seeds = options.seeds
    while True:
        for engine, first in (("LOBE", 1), ("CYCLES", 1001)):
            for n in range(len(pictures[engine]), seeds):
                pictures[engine].append(common.render(scene, engine, options.samples, first + n)[0])
        found = brighter(*map(np.stack, pictures.values()), where)
        if found.settled or seeds >= options.most_seeds:
            return row(case, light, found, seeds, options)
        seeds = min(2 * seeds, options.most_seeds)


def row(case: Case, light: str, found: Brighter, seeds: int, options: argparse.Namespace) -> dict:
    return {
        "shape": case.shape,
        "surface": case.surface,
        "roughness": "" if case.roughness is None else case.roughness,
        "light": light,
        "resolution": "{}x{}".format(*options.resolution),
        "samples": options.samples,
        "seeds": seeds,
        "mean": f"{found.mean:+.1%} ± {found.half_width:.1%}",
        "blocks": f"{found.low:+.0%} to {found.high:+.0%}" + ("" if found.settled else f", each ± {found.noise:.0%}"),
        "noise of a block": f"{found.noise:.1%}",
    }


def short(rows: Sequence[Mapping[str, str]]) -> str:
    """What docs/materials.md quotes: both lights in one row, means, and blocks in brackets."""
    table: dict[tuple[str, ...], dict[str, str]] = {}
    for one in rows:
        key = one["shape"], one["surface"], one["roughness"]
        line = table.setdefault(key, dict(zip(("shape", "surface", "roughness"), key, strict=True)))
        line[one["light"]] = f"{one['mean'].split()[0]} ({one['blocks']})"
    return common.markdown(list(table.values())) if table else ""


# --- command line ---------------------------------------------------------------------------------------------


def parse(arguments: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--resolution", type=resolution, default=(64, 64), metavar="WxH", help="default: 64x64")
    parser.add_argument("--samples", type=whole_number(1, 1 << 24), default=256, metavar="N", help="default: 256")
    parser.add_argument("--seeds", type=whole_number(2, 1000), default=4, metavar="N",
                        help="to begin with, doubled while blocks are noisy; default: 4")  # fmt: skip
    parser.add_argument("--most-seeds", type=whole_number(2, 1000), default=64, metavar="N", help="default: 64")
    parser.add_argument("--threads", type=whole_number(1, 1024), default=2, metavar="N", help="default: 2")
    common.add_results(parser)
    return parser.parse_args(arguments)


def main() -> int:
    return common.run(work, parse())


def work(options: argparse.Namespace, say: Callable[[str], None]) -> None:
    pairs = [(case, light) for case in CASES for light in LIGHTS]
    rows = [measure(case, light, options) for case, light in tqdm(pairs, file=sys.stderr)]
    say(common.update_table("materials", ("shape",), rows, folder=options.results))
    if options.results == common.RESULTS:
        quote(PAGE, short(common.read_table("materials", common.RESULTS)), MARKS)


if __name__ == "__main__":
    sys.exit(main())
