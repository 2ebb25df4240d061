"""Suzanne, half diffuse and half glossy, lit by nothing but an environment image: a blue sky with a small bright sun.

The sun covers a ten-thousandth of the image and sends out most of its light: without importance sampling of the
image this scene is all noise.
"""

from __future__ import annotations

import math
import tempfile
from pathlib import Path

import common as c
import numpy as np
import OpenImageIO as oiio

WIDTH, HEIGHT = 512, 256
SUN_DIRECTION = np.array([-0.55, -0.6, 0.6])
SUN_RADIUS = math.radians(1.6)
SUN_RADIANCE = np.array([1.0, 0.88, 0.7]) * 1300
ZENITH, HORIZON, GROUND = np.array([0.10, 0.24, 0.62]), np.array([0.75, 0.82, 0.9]), np.array([0.16, 0.14, 0.12])


def directions() -> np.ndarray:
    """(HEIGHT, WIDTH, 3) unit vectors of the pixel centres, row 0 at the bottom, in Blender's orientation."""
    phi = (2 * (np.arange(WIDTH) + 0.5) / WIDTH - 1) * math.pi  # u = (atan2(y, -x) / pi + 1) / 2
    theta = (np.arange(HEIGHT) + 0.5) / HEIGHT * math.pi  # v = acos(-z) / pi
    sin_theta, up = np.sin(theta)[:, None], np.broadcast_to(-np.cos(theta)[:, None], (HEIGHT, WIDTH))
    return np.stack([-np.cos(phi) * sin_theta, np.sin(phi) * sin_theta, up], axis=-1)


def sky() -> np.ndarray:
    """(HEIGHT, WIDTH, 3) radiance, row 0 at the bottom."""
    d = directions()
    up = d[..., 2:]
    blend = np.clip(up, 0, 1) ** 0.45
    picture = np.where(up > 0, HORIZON * (1 - blend) + ZENITH * blend, GROUND)
    angle = np.arccos(np.clip(d @ (SUN_DIRECTION / np.linalg.norm(SUN_DIRECTION)), -1, 1))[..., None]
    glow = np.array([1.0, 0.8, 0.5]) * 2.5 * np.exp(-angle / 0.12)
    disk = np.clip((SUN_RADIUS - angle) / math.radians(0.7) + 0.5, 0, 1)  # a rim of one pixel
    return picture + np.where(up > 0, glow, 0) + disk * SUN_RADIANCE


def sky_image():
    """The sky as an image packed into the file."""
    with tempfile.TemporaryDirectory() as folder:
        path = str(Path(folder, "sky.exr"))
        spec = oiio.ImageSpec(WIDTH, HEIGHT, 3, "half")
        spec.attribute("compression", "zip")
        output = oiio.ImageOutput.create(path)
        output.open(path, spec)
        output.write_image(np.ascontiguousarray(sky()[::-1], np.float32))
        output.close()
        image = c.bpy.data.images.load(path)
        image.name = "sky.exr"
        image.pack()
        image.filepath_raw = image.filepath = image.packed_files[0].filepath = "//sky.exr"
        return image


def light_by_image(world, image) -> None:
    c.set_background(world, (0, 0, 0))
    nodes, links = world.node_tree.nodes, world.node_tree.links
    environment = nodes.new("ShaderNodeTexEnvironment")
    environment.location = (-280, 0)
    environment.image = image
    links.new(environment.outputs["Color"], nodes["Background"].inputs["Color"])


def build() -> None:
    scene = c.new_file(768, 512, samples=128, view_transform="AgX")
    light_by_image(scene.world, sky_image())

    c.bpy.ops.mesh.primitive_monkey_add(size=2, location=(0, 0, 0.62), rotation=(math.radians(-35), 0, 0.35))
    suzanne = c.bpy.context.object
    suzanne.data.materials.append(c.phong("Suzanne", (0.5, 0.09, 0.05), (0.4, 0.4, 0.4), 120))
    suzanne.data.shade_smooth()
    subdivision = suzanne.modifiers.new("Subdivision", "SUBSURF")
    subdivision.levels = subdivision.render_levels = 2

    mirror = c.phong("Mirror ball", (0.02, 0.02, 0.02), (0.9, 0.9, 0.9), 5000)
    c.add_object("Mirror ball", c.ico_sphere("Mirror ball", 0.5, 5, mirror), (1.75, -0.3, 0.5))
    matte = c.diffuse("Matte ball", (0.7, 0.7, 0.65))
    c.add_object("Matte ball", c.ico_sphere("Matte ball", 0.5, 4, matte), (-1.8, -0.2, 0.5))
    ground = [(-300, -30, 0), (300, -30, 0), (300, 600, 0), (-300, 600, 0)]
    c.add_object("Ground", c.mesh("Ground", ground, [(0, 1, 2, 3)], [c.diffuse("Ground", (0.3, 0.29, 0.27))]))
    c.camera(scene, (0.4, -7, 1.9), (0, 0, 0.8), lens=50)


if __name__ == "__main__":
    build()
    c.save("world")
