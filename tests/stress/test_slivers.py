"""A surface cut into slivers shows the picture of the same surface in two triangles, also where nothing is aligned.

Needles have one short side; caps have a corner next to the middle of a side, so that no product of two sides gives
their normal in float32.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import scenes
from sample_scenes import SCENES, sample_scene
from stress import moves, surfaces

from engine import Camera, PointLight, Settings, render
from engine.scene import Instances, Mesh, Scene, World

TURN = np.linalg.qr(np.random.default_rng(4).normal(size=(3, 3)))[0]


def diced(shape: str, rows: int, half: float = 4.0) -> Mesh:
    """The square about the origin in so many rows of slivers, as many times as long as wide."""
    y, k = np.linspace(-half, half, rows + 1), np.arange(rows)
    vertices = np.zeros((rows + 1, 3, 3))
    vertices[:, :, 0], vertices[:, :, 1] = (-half, 0, half), y[:, None]
    # Of the two edges of a row, caps stand on the even one, which has no middle: `base` that, `top` the other.
    base, top = (k + k % 2) * 3, (k + 1 - k % 2) * 3
    if shape == "cap":
        faces = [(base, base + 2, top + 1), (base, top + 1, top), (base + 2, top + 2, top + 1)]
    else:
        faces = [(base, base + 2, top + 2), (base, top + 2, top)]
    triangles = np.vstack([np.column_stack(face) for face in faces])
    return Mesh("diced", vertices.reshape(-1, 3).astype(np.float32), triangles.astype(np.uint32))


def room(floor: Mesh | None = None) -> Scene:
    scene = scenes.lamp_room(["sphere", "area"], 24)
    if floor is not None:
        scene.meshes[0] = floor
    return moves.turned(scene, TURN)


@cache
def unstressed() -> np.ndarray:
    return moves.render(room())


def check(stressed: np.ndarray, slack: float = moves.ROUNDING) -> None:
    found = moves.difference(stressed, unstressed())
    print(found)
    assert found.half_width.max() < 4e-3, f"tells nothing: {found}"
    assert found.holds(slack), f"differs by {found}"


@pytest.mark.parametrize("rows", [100, 1000, 10_000])
@pytest.mark.parametrize("shape", ["needle", "cap"])
def test_a_floor_of_slivers(shape, rows):
    check(moves.render(room(diced(shape, rows))))


@pytest.mark.long
@pytest.mark.parametrize("shape", ["needle", "cap"])
def test_a_floor_of_slivers_of_aspect_1e5(shape):
    """Embree misjudges the distance of such caps by many times their width, so that their neighbours, too, throw
    shadows on rays that start beside them. The slack is what that comes to where all is made of them."""
    check(moves.render(room(diced(shape, 100_000))), slack=5e-3 if shape == "cap" else moves.ROUNDING)


def strip(width: float, quads: int, length: float = 10.0) -> Mesh:
    """Along x from the origin, in so many quads."""
    x = np.linspace(0, length, quads + 1)
    vertices = np.stack([(a, y, 0) for a in x for y in (-width / 2, width / 2)])
    first = 2 * np.arange(quads)
    triangles = np.vstack([[first, first + 2, first + 3], [first, first + 3, first + 1]]).reshape(2, 3, -1)
    return Mesh("strip", vertices.astype(np.float32), np.hstack(triangles).T.astype(np.uint32))


def lit_end(mesh: Mesh) -> np.ndarray:
    """(16,) the first 8 cm of a strip, with a lamp 2 cm above its end."""
    scene = Scene(width=16, height=1)
    scene.materials = [replace(scene.materials[0], kd=(1.0,) * 3)]
    scene.add_instance(mesh)
    scene.lights = [PointLight("end", scenes.place((0, 0, 0.02)), intensity=(1e-3,) * 3)]
    narrow = 0.45 * float(np.ptp(mesh.vertices[:, 1]))
    scene.camera = Camera(
        transform=scenes.place((0.04, 0, 1), (0, 0, -1)), window=(-0.04, 0.04, -narrow, narrow), orthographic=True,
        clip_start=0.01,
    )  # fmt: skip
    settings = Settings(samples=64, pixel_filter="BOX", threads=1, max_bounces=0)
    return render(scene, settings).pixels[0, :, 0]


@pytest.mark.parametrize("width", [0.001, 0.01])
def test_points_stay_where_they_are_along_a_strip(width):
    """They are kept off the edges of their triangles, which must not move them along those of slivers."""
    assert np.allclose(lit_end(strip(width, 1)), lit_end(strip(width, 2000)), rtol=1e-2)


@pytest.mark.parametrize("shape, most", [("needle", 0.0), ("cap", 1e-3)])
def test_a_closed_room_of_slivers_is_tight(shape, most):
    """Six walls of aspect 1e4 in a bright world. Caps next to a corner may be misjudged so far that rays pass them;
    with steps no longer than a cap is wide 34 in 10,000 paths got out, now 2."""
    scene = scenes.furnace(size=8)
    scene.meshes.clear()
    scene.instances = Instances()
    wall = diced(shape, 10_000, half=1.0)
    for axis in range(3):
        for side in (-1.0, 1.0):
            frame = np.roll(np.eye(3), axis, axis=0)
            scene.add_instance(wall, np.column_stack([frame, side * frame[:, 2]]))
    scene = moves.turned(scene, TURN)
    closed = moves.render(scene, max_bounces=2)
    scene.world = World(color=(1.0, 1.0, 1.0))
    assert (moves.render(scene, max_bounces=2) - closed).mean() <= most


def test_a_floor_that_loses_light_is_caught():
    """Half a percent, as caps of aspect 1e4 did with steps no longer than they are wide."""
    scene = room(diced("cap", 1000))
    floor = scene.materials[0]
    dark = replace(floor, kd=tuple(0.995 * x for x in floor.kd), ks=tuple(0.995 * x for x in floor.ks))
    scene.materials[0] = dark
    with pytest.raises(AssertionError, match="differs"):
        check(moves.render(scene))


def aspect_and_area(scene: Scene) -> tuple[float, float]:
    """Of the most slender triangle that has an area, length by height; and of all together, m2, in object space."""
    corners = np.concatenate([mesh.vertices[mesh.triangles] for mesh in scene.meshes]).astype(np.float64)
    sides = np.roll(corners, 1, axis=1) - corners
    longest, area = (
        np.linalg.norm(sides, axis=2).max(axis=1),
        np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1),
    )
    some = area > 0
    return float((longest[some] ** 2 / area[some]).max()), float(area.sum() / 2)


@pytest.mark.parametrize("name", SCENES)
def test_slivers_of_sample_scenes_are_slivers(name):
    """Some 1e8 times as long as high, as far as float32 has such; of the same surface. `CHANGES` renders them."""
    aspect, area = aspect_and_area(surfaces.slivers(sample_scene(name)))
    assert aspect > 8e7
    np.testing.assert_allclose(area, aspect_and_area(sample_scene(name))[1], rtol=1e-6)
