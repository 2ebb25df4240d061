"""Every kind of lamp, each in its own bay of a cabinet, and a low sun across all of it.

The balls are half glossy, so each also shows its lamp's mirror image. The signs are text objects: the sun lights them.
"""

from __future__ import annotations

import math

import common as c

BAY = 2.0  # width, height and depth of a bay
BOARD = 0.06
RECESS = 0.01  # of the uprights: two faces in one plane, where boards cross, would shade each other in Cycles
PLINTH = 0.38  # height of what each row stands on, with the signs on its front
COLUMNS, ROWS = 4, 2

# The lamps, left to right, lower row first: sign, kind, height below the bay's ceiling, properties.
LAMPS = [
    ("point", "POINT", 0.5, {"energy": 35, "shadow_soft_size": 0.0}),
    ("sphere", "POINT", 0.5, {"energy": 35, "shadow_soft_size": 0.15, "visible": True}),
    ("spot", "SPOT", 0.15, {"energy": 150, "shadow_soft_size": 0.0, "spot_size": 1.0, "spot_blend": 0.0}),
    ("soft spot", "SPOT", 0.15, {"energy": 150, "shadow_soft_size": 0.1, "spot_size": 1.3, "spot_blend": 0.7}),
    ("square", "AREA", 0.1, {"energy": 25, "shape": "SQUARE", "size": 0.7, "visible": True}),
    ("rectangle, 60°", "AREA", 0.1, {"energy": 25, "shape": "RECTANGLE", "size": 1.4, "size_y": 0.25, "spread": 60}),
    ("disk", "AREA", 0.1, {"energy": 25, "shape": "DISK", "size": 0.8, "visible": True}),
    ("ellipse, 120°", "AREA", 0.1, {"energy": 25, "shape": "ELLIPSE", "size": 1.2, "size_y": 0.5, "spread": 120}),
]
COLORS = [(1, 0.85, 0.7), (1, 0.7, 0.45), (0.75, 0.85, 1), (1, 0.95, 0.8)]


def bay_origin(index: int) -> tuple[float, float]:
    """x of a bay's middle and z of its floor."""
    column, row = index % COLUMNS, index // COLUMNS
    return (column - (COLUMNS - 1) / 2) * BAY, PLINTH + row * (BAY + PLINTH)


def add_cabinet(wood, dark) -> None:
    """Boxes: back, top, uprights and shelves of one wood, and a darker plinth below each row."""
    right, top = COLUMNS * BAY / 2, ROWS * (BAY + PLINTH)
    boards = [((-right, BAY, 0), (right, BAY + BOARD, top)), ((-right, 0, top), (right, BAY, top + BOARD))]
    for column in range(COLUMNS + 1):
        x = -right + column * BAY
        boards.append(((x - BOARD / 2, RECESS, 0), (x + BOARD / 2, BAY, top)))
    for row in range(ROWS):
        bottom = row * (BAY + PLINTH)
        boards.append(((-right, 0, bottom + PLINTH - BOARD), (right, BAY, bottom + PLINTH)))
        add_box(f"Plinth {row}", (-right, -0.02, bottom), (right, BAY, bottom + PLINTH - BOARD), dark)
    for number, (low, high) in enumerate(boards):
        add_box(f"Board {number}", low, high, wood)


def add_box(name: str, low, high, material) -> None:
    c.add_object(name, c.mesh(name, c.box_vertices(low, high), c.BOX_FACES, [material]))


def add_bay(index: int, ball, sign_material) -> None:
    sign, kind, drop, properties = LAMPS[index]
    x, z = bay_origin(index)
    properties = {"color": COLORS[index % len(COLORS)], **properties}
    if "spread" in properties:
        properties["spread"] = math.radians(properties["spread"])
    location = (x, BAY / 2 - 0.1, z + BAY - drop)
    c.lamp(sign.capitalize(), kind, location, (x, BAY / 2, z), **properties)
    c.add_object(f"Ball {index}", ball, (x + 0.2, BAY / 2 + 0.25, z + 0.45))

    text = c.bpy.data.curves.new(sign, "FONT")
    text.body, text.size, text.extrude, text.align_x = sign, 0.3, 0.01, "CENTER"
    text.materials.append(sign_material)
    obj = c.add_object(f"Sign {index}", text, (x, -0.03, z - PLINTH + 0.1))
    obj.rotation_euler = (math.radians(90), 0, 0)


def build() -> None:
    scene = c.new_file(768, 512, samples=128, view_transform="AgX")
    wood, dark = c.diffuse("Wood", (0.55, 0.5, 0.45)), c.diffuse("Plinth", (0.06, 0.05, 0.045))
    sign_material = c.diffuse("Sign", (0.9, 0.88, 0.84))
    ball = c.ico_sphere("Ball", 0.45, 4, c.phong("Ball", (0.25, 0.3, 0.4), (0.5, 0.5, 0.5), 60))
    add_cabinet(wood, dark)
    for index in range(len(LAMPS)):
        add_bay(index, ball, sign_material)
    floor = [(-8, -6, -BOARD / 2), (8, -6, -BOARD / 2), (8, 4, -BOARD / 2), (-8, 4, -BOARD / 2)]
    c.add_object("Floor", c.mesh("Floor", floor, [(0, 1, 2, 3)], [c.diffuse("Floor", (0.3, 0.3, 0.32))]))
    c.lamp("Sun", "SUN", (-6, -8, 6), (0, 0, 1.5), energy=1.2, angle=math.radians(4), color=(1, 0.72, 0.5))
    c.set_background(scene.world, (0.02, 0.03, 0.05))
    c.camera(scene, (0, -11.5, 3.0), (0, 0, 2.25), lens=45)


if __name__ == "__main__":
    build()
    c.save("lamps")
