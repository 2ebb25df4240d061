"""Writes addon/export/skies.npz: Blender's Sky Texture by direction, and the light of the sun's disk, by Cycles.

For each type of sky and some elevations of the sun: a panorama without the disk, read at some directions, and what the
disk adds. All other settings are the texture's defaults. addon/export/sky.py reads the file and says what is in it.

    .venv/bin/python tools/skies.py
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

from tools import blender_render as br  # noqa: E402
from tools.lobe_blender import enable_lobe  # noqa: E402

TABLE = ROOT / "addon" / "export" / "skies.npz"
WITH_DISK = ("SINGLE_SCATTERING", "MULTIPLE_SCATTERING")
WITHOUT_DISK = ("PREETHAM", "HOSEK_WILKIE")

# Degrees, closest together where the sun rises, and where the sky meets the ground.
ELEVATIONS = (-12, -9, -6, -4.5, -3, -2, -1, 0, 1, 2, 3, 5.5, 9, 13, 19, 26, 35, 45, 52, 59, 66, 77, 90)
BELOW = -90.0 * np.linspace(1.0, 0.0, 10, endpoint=False) ** 2
HEIGHTS = np.concatenate([BELOW, 90.0 * np.linspace(0.0, 1.0, 27) ** 1.7])
AZIMUTHS = 180.0 * np.linspace(0.0, 1.0, 16) ** 1.25

ROWS = 360  # of the panorama, half its columns
ACROSS = 96  # pixels of a square view of the disk


def stage(kind: str):
    """A world of this sky alone and a camera; gives back the sky's node."""
    import bpy

    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)  # unlike factory settings keeps the add-on
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.use_adaptive_sampling = scene.cycles.use_denoising = False
    scene.cycles.pixel_filter_type = "BOX"
    scene.render.use_persistent_data = True  # what Cycles has made of the sky is kept while the camera turns
    world = scene.world = bpy.data.worlds.new("World")
    world.cycles.sampling_method = "NONE"  # it lights nothing, and a map of it takes longer than the picture
    nodes, links = world.node_tree.nodes, world.node_tree.links
    nodes.clear()
    sky, background = nodes.new("ShaderNodeTexSky"), nodes.new("ShaderNodeBackground")
    links.new(sky.outputs[0], background.inputs[0])
    links.new(background.outputs[0], nodes.new("ShaderNodeOutputWorld").inputs[0])
    sky.sky_type = kind
    scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(scene.camera)
    return sky


def render(width: int, height: int, samples: int) -> np.ndarray:
    """(height, width, 3) scene-linear, row 0 at the bottom."""
    import bpy

    scene = bpy.context.scene
    scene.cycles.samples = samples
    br.set_resolution(scene, width, height)
    br.render(scene)
    return br.picture(scene)[::-1, :, :3].astype(np.float64)


def measure(sky, degrees: float) -> tuple[np.ndarray, np.ndarray]:
    """(HEIGHTS, AZIMUTHS, 3) W/(m2 sr) without the disk, and (3,) W/m2 of the disk on a surface that faces it."""
    import bpy

    elevation = math.radians(degrees)
    sky.sun_elevation, sky.sun_rotation, sky.sun_disc = elevation, 0.0, False
    sky.sun_direction = (0.0, math.cos(elevation), math.sin(elevation))
    camera = bpy.context.scene.camera
    camera.data.type, camera.data.panorama_type = "PANO", "EQUIRECTANGULAR"
    camera.rotation_euler = (math.pi / 2.0, 0.0, 0.0)  # towards +y, where the sun is
    radiance = at_directions(render(2 * ROWS, ROWS, 2))
    if sky.sky_type in WITHOUT_DISK or degrees < 0.0:
        return radiance, np.zeros(3)
    camera.data.type, camera.data.angle = "PERSP", 2.0 * sky.sun_size
    camera.rotation_euler = (math.pi / 2.0 + elevation, 0.0, 0.0)
    beside = render(ACROSS, ACROSS, 16)
    sky.sun_disc = True
    disk = np.maximum(render(ACROSS, ACROSS, 16) - beside, 0.0)
    if degrees > 0.0 and not disk[ACROSS // 2, ACROSS // 2].any():
        raise SystemExit(f"{sky.sky_type}: the sun at {degrees:g} degrees is not where it should be")
    pixel = (2.0 * math.tan(sky.sun_size) / ACROSS) ** 2  # sr, all but the same over the view
    return radiance, disk.sum(axis=(0, 1)) * pixel


def at_directions(panorama: np.ndarray) -> np.ndarray:
    """(HEIGHTS, AZIMUTHS, 3), interpolated, of the mean of both sides of the sun."""
    half = (panorama[:, ROWS:] + panorama[:, ROWS - 1 :: -1]) / 2.0
    heights, azimuths = (np.arange(ROWS) + 0.5) * 180.0 / ROWS - 90.0, (np.arange(ROWS) + 0.5) * 180.0 / ROWS
    rows = np.apply_along_axis(lambda column: np.interp(HEIGHTS, heights, column), 0, half)
    return np.apply_along_axis(lambda row: np.interp(AZIMUTHS, azimuths, row), 1, rows)


def main() -> None:
    enable_lobe()  # whose code reads the pictures
    arrays = {"elevations": np.array(ELEVATIONS), "heights": HEIGHTS, "azimuths": AZIMUTHS}
    for kind in WITHOUT_DISK + WITH_DISK:
        sky = stage(kind)
        measured = [measure(sky, degrees) for degrees in ELEVATIONS]
        arrays[kind] = np.array([radiance for radiance, _ in measured], np.float16)
        arrays[f"{kind} disk"] = np.array([disk for _, disk in measured], np.float32)
    np.savez_compressed(TABLE, **arrays)
    print(f"Wrote {TABLE} ({TABLE.stat().st_size / 1e3:.0f} kB)")


if __name__ == "__main__":
    main()
