"""A town at night: 10,000 small emitters, 8,000 lit windows (two emissive triangles each) and 2,000 street lamps.

Every point sees hundreds of lamps and most of its light comes from the nearest few: choosing lamps with equal
chances, or by power alone, drowns this scene in noise.
"""

from __future__ import annotations

import common as c
import numpy as np

BLOCKS = 20  # per side
PITCH = 14.0  # from street to street, metres
FOOTPRINT = 9.0
WINDOWS, STREET_LAMPS = 8000, 2000
WINDOW_SIZE = (0.7, 0.9)
COLUMNS, STOREY = 7, 1.5  # windows side by side on a wall; metres from one row to the next
GLOW = [(9.0, 5.2, 2.2), (8.0, 6.2, 3.6), (4.2, 5.4, 7.0), (8.0, 3.0, 1.5)]
LAMP_COLORS = [(1.0, 0.62, 0.28), (0.8, 0.9, 1.0)]
LAMP_HEIGHT = 5.0


def block_centres() -> np.ndarray:
    """(BLOCKS^2, 2) metres."""
    axis = (np.arange(BLOCKS) - (BLOCKS - 1) / 2) * PITCH
    return np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)


def houses(rng):
    """low, high corners (N, 3) of each house: taller towards the town's middle."""
    centres = block_centres()
    size = rng.uniform(0.7, 1.0, (len(centres), 2)) * FOOTPRINT / 2
    distance = np.linalg.norm(centres, axis=1) / (BLOCKS * PITCH / 2)
    tall = 5 + 26 * np.exp(-3 * distance**2) * rng.uniform(0.4, 1.0, len(centres)) + rng.uniform(0, 4, len(centres))
    low = np.column_stack([centres - size, np.zeros(len(centres))])
    return low, np.column_stack([centres + size, tall])


def house_mesh(low, high, material):
    vertices = np.concatenate([c.box_vertices(a, b) for a, b in zip(low, high, strict=True)])
    faces = (np.arange(len(low))[:, None, None] * 8 + c.BOX_FACES).reshape(-1, 4)
    return c.mesh("Houses", vertices, faces, [material])


def window_places(extent) -> np.ndarray:
    """(N, 4) house, wall, column and storey of every place for a window. No two places overlap."""
    storeys = np.maximum((extent[:, 2] - 1.5) // STOREY, 1).astype(int)
    places = [
        np.indices((1, 4, COLUMNS, n)).reshape(4, -1) + [[house], [0], [0], [0]] for house, n in enumerate(storeys)
    ]
    return np.concatenate(places, axis=1).T


def window_quads(rng, low, high) -> np.ndarray:
    """(WINDOWS, 4, 3) corners, one centimetre in front of a wall."""
    extent = high - low
    places = window_places(extent)
    house, side, column, storey = places[rng.choice(len(places), WINDOWS, replace=False)].T
    along = 1 - side // 2  # axis that runs along the wall: y for the walls at low and high x
    across = 1 - along
    outside = np.where(side % 2 == 0, -1.0, 1.0)
    rows = np.arange(WINDOWS)

    middle = np.zeros((WINDOWS, 3))
    inset = WINDOW_SIZE[0]
    span = extent[house, along] - 2 * inset
    middle[rows, along] = low[house, along] + inset + column / (COLUMNS - 1) * span
    middle[rows, across] = np.where(outside < 0, low[house, across], high[house, across]) + outside * 0.01
    middle[:, 2] = 1.5 + storey * STOREY

    u, v = np.zeros((WINDOWS, 3)), np.array([0, 0, WINDOW_SIZE[1] / 2])
    u[rows, along] = WINDOW_SIZE[0] / 2
    return np.stack([middle - u - v, middle + u - v, middle + u + v, middle - u + v], axis=1)


def add_street_lamps(rng) -> None:
    """Point lamps along the streets; many objects, two lamp datablocks.

    Their radius is 0: Cycles tests every ray against every lamp with a size, one after the other, and would spend
    nearly all of its time on that.
    """
    kinds = []
    for number, color in enumerate(LAMP_COLORS):
        data = c.bpy.data.lights.new(f"Street lamp {number}", "POINT")
        data.energy, data.color, data.shadow_soft_size, data.use_soft_falloff = 60, color, 0.0, False
        kinds.append(data)
    street = (rng.integers(0, BLOCKS + 1, STREET_LAMPS) - BLOCKS / 2) * PITCH + rng.choice([-1.6, 1.6], STREET_LAMPS)
    along = rng.uniform(-BLOCKS * PITCH / 2, BLOCKS * PITCH / 2, STREET_LAMPS)
    swap = rng.random(STREET_LAMPS) < 0.5
    x, y = np.where(swap, street, along), np.where(swap, along, street)
    kind = (np.abs(street) < PITCH * 3).astype(int)
    for i in range(STREET_LAMPS):
        c.add_object(f"Street lamp {i}", kinds[kind[i]], (x[i], y[i], LAMP_HEIGHT))


def build() -> None:
    scene = c.new_file(768, 512, samples=128, view_transform="AgX")
    scene.view_settings.exposure = 1.0
    rng = np.random.default_rng(9)
    low, high = houses(rng)
    c.add_object("Houses", house_mesh(low, high, c.diffuse("Plaster", (0.35, 0.33, 0.32))))
    quads = window_quads(rng, low, high)
    glow = [c.emission(f"Window {i}", radiance) for i, radiance in enumerate(GLOW)]
    windows = c.mesh(
        "Windows",
        quads.reshape(-1, 3),
        np.arange(WINDOWS * 4).reshape(-1, 4),
        glow,
        rng.integers(0, len(GLOW), WINDOWS),
    )
    c.add_object("Windows", windows)
    add_street_lamps(rng)
    side = BLOCKS * PITCH
    ground = [(-side, -side, 0), (side, -side, 0), (side, side, 0), (-side, side, 0)]
    c.add_object("Ground", c.mesh("Ground", ground, [(0, 1, 2, 3)], [c.diffuse("Asphalt", (0.12, 0.12, 0.13))]))
    c.set_background(scene.world, (0.012, 0.02, 0.05))
    c.lamp("Moon", "SUN", (-3, -2, 4), (0, 0, 0), energy=0.12, angle=0.01, color=(0.6, 0.75, 1.0))
    c.camera(scene, (24, -128, 42), (0, -30, 4), lens=40).data.clip_end = 2000


if __name__ == "__main__":
    build()
    c.save("many_lights")
