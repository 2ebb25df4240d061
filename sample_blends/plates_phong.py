"""Veach's plates: four plates of rising Phong exponent mirror four bulbs of falling size and equal power.

After Veach & Guibas, "Optimally Combining Sampling Techniques for Monte Carlo Rendering", 1995, figure 2. Choosing
light directions by the lamp does well where the bulb is small and the plate rough (lower right to upper left in the
picture), choosing them by the lobe does well in the opposite corner, and only the combination does well everywhere.
The second scene of the file is the same set seen at sixteen times the exposure: it shows what the plates' lobes do
far from their peak.
"""

from __future__ import annotations

import common as c
import numpy as np
from mathutils import Vector

EXPONENTS = (20, 200, 2000, 20000)  # the plate nearest to the camera first
PLATE_CENTRES = [(0, -3.57, 0.24), (0, -2.22, 0.56), (0, -0.92, 1.08), (0, 0.14, 1.75)]
PLATE_SIZE = (8.0, 1.0, 0.05)
KD, KS = (0.06, 0.07, 0.09), (0.85, 0.85, 0.85)

BULB_ROW = (0.0, 0.0, 4.15)
BULBS = [  # x, radius, hue; the radiance follows from equal power: L r^2 is the same for all
    (-3.75, 0.0333, (1.0, 0.62, 0.45)),
    (-1.25, 0.1, (1.0, 0.9, 0.6)),
    (1.25, 0.3, (0.6, 1.0, 0.75)),
    (3.75, 0.9, (0.55, 0.75, 1.0)),
]
RADIANCE_TIMES_AREA = 1.3  # L r^2, W/sr / pi

EYE, TARGET = (0, -15, 6.15), (0, -2.2, 2.25)


def add_plate(centre, exponent: float) -> None:
    """A thin slab whose normal halves the angle between camera and bulbs, so that its middle mirrors the row."""
    name = f"Plate {exponent}"
    half = np.array(PLATE_SIZE) / 2
    material = c.phong(name, KD, KS, exponent)
    plate = c.add_object(name, c.mesh(name, c.box_vertices(-half, half), c.BOX_FACES, [material]), centre)
    to_eye, to_bulbs = (Vector(p) - Vector(centre) for p in (EYE, BULB_ROW))
    normal = to_eye.normalized() + to_bulbs.normalized()
    plate.rotation_euler = normal.to_track_quat("Z", "Y").to_euler()


def add_bulb(x: float, radius: float, hue) -> None:
    name = f"Bulb {radius}"
    material = c.emission(name, [h * RADIANCE_TIMES_AREA / radius**2 for h in hue])
    subdivisions = 4 if radius > 0.2 else 3
    c.add_object(name, c.ico_sphere(name, radius, subdivisions, material), (x, *BULB_ROW[1:]))


def build() -> None:
    scene = c.new_file(768, 512, samples=64)
    scene.name = "Plates"
    for centre, exponent in zip(PLATE_CENTRES, EXPONENTS, strict=True):
        add_plate(centre, exponent)
    for bulb in BULBS:
        add_bulb(*bulb)
    wall = c.diffuse("Wall", (0.4, 0.4, 0.4))
    corners = [(-10, -12, 0), (10, -12, 0), (10, 2, 0), (-10, 2, 0), (10, 2, 12), (-10, 2, 12)]
    c.add_object("Wall", c.mesh("Wall", corners, [(0, 1, 2, 3), (3, 2, 4, 5)], [wall]))
    c.lamp("Fill", "AREA", (0, -8, 11), (0, -1, 1), energy=60, shape="SQUARE", size=4)
    c.camera(scene, EYE, TARGET, lens=52, sensor=36)
    add_high_exposure_view(scene)


def add_high_exposure_view(scene) -> None:
    high = c.bpy.data.scenes.new("Plates, high exposure")
    for obj in scene.collection.objects:
        high.collection.objects.link(obj)
    high.camera, high.world = scene.camera, scene.world
    c.prepare_scene(high, 768, 512, 64, "Standard")
    high.view_settings.exposure = 4.0


if __name__ == "__main__":
    build()
    c.save("plates_phong")
