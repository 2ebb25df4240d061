"""Random small scenes for hypothesis: meshes, instances, materials, every lamp, worlds, cameras, visibility.

All valid, none so extreme that its noise hides a difference: what is extreme is the business of `tests/fuzz`. Pictures
are 8 x 8 pixels. Whether the film is transparent and the camera orthographic stays as it is, as each combination
would be a kernel of its own (see `forcing`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scenes
from hypothesis import strategies as st

from engine import Aperture, Camera, Lamp, Material, Mesh, Scene, Visibility, World

SIZE = 8
SEEN_BY_MOST = st.sampled_from([Visibility.ALL] * 4 + [Visibility.ALL & ~bit for bit in Visibility if bit < 15])


def numbers(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high)


def colors(high: float = 1.0) -> st.SearchStrategy:
    return st.tuples(*[numbers(0, high)] * 3)


@st.composite
def rotations(draw) -> np.ndarray:
    """(3, 3), from a quaternion."""
    w, x, y, z = q = np.array([draw(numbers(-1, 1)) for _ in range(3)] + [1.0])
    w, x, y, z = q / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


@st.composite
def transforms(draw) -> np.ndarray:
    """(3, 4): turned, scaled along the axes, perhaps mirrored, moved to somewhere above the floor."""
    scale = [draw(numbers(0.2, 1.5)) * draw(st.sampled_from([1, 1, -1])) for _ in range(3)]
    place = [draw(numbers(-1.2, 1.2)), draw(numbers(-1.2, 1.2)), draw(numbers(0.3, 1.5))]
    return np.column_stack([draw(rotations()) * scale, place])


@st.composite
def materials(draw, index: int) -> Material:
    kd = np.array(draw(colors(0.8)))
    ks = draw(st.one_of(st.just(0.0), numbers(0.1, 0.9))) * (1 - kd)
    return Material(
        f"material {index}",
        kd=tuple(kd.tolist()),
        ks=tuple(ks.tolist()),
        exponent=draw(st.sampled_from([0.0, 1.0, 10.0, 100.0])),
        emission=draw(st.sampled_from([(0.0, 0.0, 0.0)] * 3 + [(1.0, 2.0, 0.5)])),
        transparency=draw(st.sampled_from([(0.0, 0.0, 0.0)] * 3 + [(0.6, 0.3, 0.0), (0.5, 0.5, 0.5)])),
    )


def meshes() -> st.SearchStrategy[Mesh]:
    return st.sampled_from(
        [
            lambda: scenes.quad_mesh((-0.5, -0.5, 0), (1, 0, 0), (0, 1, 0), "quad"),
            lambda: scenes.cube_mesh(0.4),
            lambda: scenes.sphere_mesh(4, 0.5, name="flat ball"),
            lambda: scenes.sphere_mesh(4, 0.5, smooth=True, name="smooth ball"),
        ]
    ).map(lambda make: make())


@st.composite
def lamps(draw) -> Lamp:
    lamp = scenes.lamp(draw(st.sampled_from(scenes.LAMP_KINDS)))
    lamp.transform[:, 3] += [draw(numbers(-0.5, 0.5)), draw(numbers(-0.5, 0.5)), draw(numbers(0, 0.5))]
    return replace(lamp, visibility=draw(SEEN_BY_MOST), cast_shadow=draw(st.sampled_from([True, True, True, False])))


@st.composite
def worlds(draw) -> World:
    kind = draw(st.sampled_from(["dark", "constant", "image"]))
    if kind == "dark":
        return World()
    image = scenes.sky_image(4, 8) if kind == "image" else None
    return World(draw(colors(0.5)), image, rotation=draw(rotations()), visibility=draw(SEEN_BY_MOST))


@st.composite
def cameras(draw) -> Camera:
    camera = scenes.camera(origin=(0, -4, 2.2), towards=(draw(numbers(-0.5, 0.5)), 4, -1.6))
    lens = draw(st.one_of(st.none(), st.builds(Aperture, numbers(0, 0.1), numbers(2, 6), st.sampled_from([0, 3, 6]))))
    return replace(camera, aperture=lens)


@st.composite
def small_scenes(draw) -> Scene:
    scene = Scene(width=SIZE, height=SIZE, camera=draw(cameras()), world=draw(worlds()))
    scene.materials = [Material("floor", kd=(0.5, 0.45, 0.4))]
    scene.materials += [draw(materials(i)) for i in range(draw(st.integers(1, 3)))]
    scene.add_instance(scenes.quad_mesh((-3, -3, 0), (6, 0, 0), (0, 6, 0), "floor"))
    for mesh in draw(st.lists(meshes(), max_size=2)):
        for _ in range(draw(st.integers(1, 2))):
            material = draw(st.integers(0, len(scene.materials) - 1))
            scene.add_instance(mesh, draw(transforms()), (material,), draw(SEEN_BY_MOST))
    scene.lights = draw(st.lists(lamps(), max_size=3))
    return scene
