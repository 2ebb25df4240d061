"""The Cornell box: the measured geometry of Cornell University, every surface diffuse, light from one quad.

https://www.graphics.cornell.edu/online/box/data.html, 1 unit there (a millimetre) is a centimetre here. The colours
are the usual linear Rec. 709 values for the measured spectra. The lamp fills a hole in the ceiling, so nothing of it
is wasted on the ceiling's back.
"""

from __future__ import annotations

import common as c

WHITE, RED, GREEN = (0.725, 0.71, 0.68), (0.63, 0.065, 0.05), (0.14, 0.45, 0.091)
LAMP_RADIANCE, LAMP_REFLECTANCE = (17.0, 12.0, 4.0), (0.78, 0.78, 0.78)

# Cornell's coordinates: x to the left, y up, z into the box. Floor and ceiling, front to back.
FLOOR = [(552.8, 0, 0), (0, 0, 0), (0, 0, 559.2), (549.6, 0, 559.2)]
CEILING = [(556, 548.8, 0), (0, 548.8, 0), (0, 548.8, 559.2), (556, 548.8, 559.2)]
LAMP = [(343, 548.8, 227), (213, 548.8, 227), (213, 548.8, 332), (343, 548.8, 332)]
SHORT_BLOCK = [(130, 165, 65), (82, 165, 225), (240, 165, 272), (290, 165, 114)]
TALL_BLOCK = [(423, 330, 247), (265, 330, 296), (314, 330, 456), (472, 330, 406)]


def to_blender(points):
    """x to the right with its zero in the middle, y into the box, z up; metres."""
    return [((278 - x) / 100, z / 100, y / 100) for x, y, z in points]


def add_block(name: str, top, material) -> None:
    """Four sides and a top; the bottom would lie in the floor."""
    vertices = to_blender(top + [(x, 0, z) for x, _, z in top])
    sides = [(i, (i + 1) % 4, (i + 1) % 4 + 4, i + 4) for i in range(4)]
    c.add_object(name, c.mesh(name, vertices, [(3, 2, 1, 0), *sides], [material]))


def build() -> None:
    scene = c.new_file(512, 512, samples=64)
    white, red, green = c.diffuse("White", WHITE), c.diffuse("Red", RED), c.diffuse("Green", GREEN)

    vertices = to_blender(FLOOR + CEILING + LAMP)
    ring = [(4 + i, 4 + (i + 1) % 4, 8 + (i + 1) % 4, 8 + i) for i in range(4)]  # the ceiling around the lamp
    faces = [(0, 1, 2, 3), *ring, (3, 2, 6, 7), (0, 3, 7, 4), (2, 1, 5, 6)]
    box = c.mesh("Box", vertices, faces, [white, red, green], [0, 0, 0, 0, 0, 0, 1, 2])
    c.add_object("Box", box)
    lamp = c.mesh("Lamp", to_blender(LAMP), [(0, 1, 2, 3)], [c.emission("Lamp", LAMP_RADIANCE, LAMP_REFLECTANCE)])
    c.add_object("Lamp", lamp)
    add_block("Short block", SHORT_BLOCK, white)
    add_block("Tall block", TALL_BLOCK, white)

    (eye,), (target,) = to_blender([(278, 273, -800)]), to_blender([(278, 273, 0)])
    c.camera(scene, eye, target, lens=35, sensor=25)


if __name__ == "__main__":
    build()
    c.save("cornell_diffuse")
