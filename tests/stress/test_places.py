"""The same scene elsewhere, smaller, larger or through odd matrices shows the same picture.

Compared pixel by pixel with the same random numbers, so that the confidence interval is mostly rounding. The sample
scenes themselves are `long`; here are their like from `tests/scenes.py`.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import scenes
from stress import moves

from engine.pack.geometry import CHUNK
from engine.pack.middle import STAY, surface_bounds
from engine.scene import Instances, Mesh, PointLight, Scene

ALONG = np.array([0.6, -0.7, 0.39])  # direction of all moves
SCENES = {
    "cornell": scenes.cornell,
    "phong": scenes.phong_plates,
    "lamps": lambda size: scenes.lamp_room(list(scenes.LAMP_KINDS), size),
    "sky": scenes.sky_plate,
}
SIZE = 24


@cache
def unstressed(name: str) -> np.ndarray:
    return moves.render(SCENES[name](SIZE))


def check(stressed: Scene, expected: np.ndarray, half_width: float = 0.03) -> None:
    found = moves.difference(moves.render(stressed), expected)
    assert found.half_width.max() < half_width, f"tells nothing: {found}"
    assert found.holds(), f"differs by {found}"


@pytest.mark.parametrize("factor", [2.0**-20, 1e-6, 1e-3, 1e3, 1e6])
@pytest.mark.parametrize("name", SCENES)
def test_scaled(name, factor):
    check(moves.scaled(SCENES[name](SIZE), factor), unstressed(name))


@pytest.mark.parametrize("distance", [1e3, 1e4, 1e5, 1e6])
@pytest.mark.parametrize("name", SCENES)
def test_moved(name, distance):
    check(moves.moved(SCENES[name](SIZE), distance * ALONG), unstressed(name))


@pytest.mark.parametrize("distance", [1e3, 1e5])
@pytest.mark.parametrize("name", ["cornell", "lamps"])
def test_moved_with_its_vertices(name, distance):
    """Which float32 rounds out there: compared with the rounded shapes at the origin."""
    scene = SCENES[name](SIZE)
    expected = moves.render(moves.rounded_at(scene, distance * ALONG))
    check(moves.baked_at(scene, distance * ALONG), expected)


@pytest.mark.parametrize("name", SCENES)
def test_moved_and_scaled(name):
    check(moves.moved(moves.scaled(SCENES[name](SIZE), 1e-3), 10 * ALONG), unstressed(name))


def test_a_picture_that_depends_on_the_place_is_caught(monkeypatch):
    """Far off without the move to the origin, and a scaled scene whose lamps kept their watts."""
    monkeypatch.setattr("engine.pack.move_of", lambda scene: STAY)
    with pytest.raises(AssertionError):
        check(moves.moved(SCENES["lamps"](SIZE), 1e6 * ALONG), unstressed("lamps"))
    scene = moves.scaled(SCENES["lamps"](SIZE), 2.0)
    point = scene.lights[0]
    assert isinstance(point, PointLight)
    scene.lights[0] = replace(point, intensity=tuple(x / 4 for x in point.intensity))
    with pytest.raises(AssertionError, match="differs"):
        check(scene, unstressed("lamps"))


TURN = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
MATRICES = {
    "mirrored": np.diag([-1.0, 1, 1]),
    "point-mirrored": -np.eye(3),
    "flattened": np.diag([1, 1, 2.0**-20]),
    "needle": np.diag([2.0**-10, 2.0**10, 1]),
    "tiny": np.eye(3) * 2.0**-30,
    "huge": np.eye(3) * 2.0**20,
    "sheared": np.array([[1, 4.0, 0], [0, 1, 2], [0, 0, 1]]),
    "flattened askew": TURN @ np.diag([1, 1, 1e-3]) @ TURN.T,
}


def through(scene: Scene, matrix: np.ndarray) -> Scene:
    """Every instance by a transform that ends in `matrix` (3, 3), every mesh by its inverse: the same scene."""
    inverse = np.linalg.inv(matrix)
    out = replace(scene)
    out.meshes = [_through_inverse(mesh, matrix, inverse) for mesh in scene.meshes]
    transforms = scene.instances.transforms.copy()
    transforms[:, :, :3] = transforms[:, :, :3] @ matrix
    out.instances = replace(scene.instances, transforms=transforms)
    return out


def _through_inverse(mesh: Mesh, matrix: np.ndarray, inverse: np.ndarray) -> Mesh:
    normals = mesh.normals
    if normals is not None:
        # The transform's cofactors undo the inverse's, up to a positive length.
        normals = normals @ matrix * np.sign(np.linalg.det(matrix))
        normals = (normals / np.linalg.norm(normals, axis=1)[:, None]).astype(np.float32)
    return replace(mesh, vertices=(mesh.vertices @ inverse.T).astype(np.float32), normals=normals)


@cache
def unstressed_balls() -> np.ndarray:
    return moves.render(two_balls())


def two_balls() -> Scene:
    """Flat blocks and smooth balls, each placed twice."""
    scene = scenes.cornell(SIZE)
    ball = scenes.sphere_mesh(12, radius=0.3, smooth=True, name="ball")
    for x in (-0.5, 0.5):
        scene.add_instance(ball, np.column_stack([np.eye(3), (x, -0.6, 0.4)]))
    return scene


@pytest.mark.parametrize("bake_limit", [0, 1 << 16], ids=["instanced", "baked"])
@pytest.mark.parametrize("matrix", MATRICES)
def test_instances_through_odd_matrices(monkeypatch, matrix, bake_limit):
    monkeypatch.setattr("engine.pack.geometry.BAKE_LIMIT", bake_limit)
    check(through(two_balls(), MATRICES[matrix]), unstressed_balls())


def test_a_wrong_matrix_is_caught():
    scene = through(two_balls(), MATRICES["sheared"])
    scene.instances.transforms[-1, :, :3] *= 1.5
    with pytest.raises(AssertionError):
        check(scene, unstressed_balls())


@pytest.mark.parametrize("matrix", [np.zeros((3, 3)), np.diag([1.0, 1, 0]), np.diag([1.0, 0, 0]), np.ones((3, 3))])
@pytest.mark.parametrize("bake_limit", [0, 1 << 16])
def test_singular_instances_are_drawn(monkeypatch, matrix, bake_limit):
    """As what they are: a disk, a line, a point."""
    monkeypatch.setattr("engine.pack.geometry.BAKE_LIMIT", bake_limit)
    scene = two_balls()
    scene.instances.transforms[-4:, :, :3] = matrix
    moves.render(scene)


def test_bounds_of_more_instances_than_are_taken_at_a_time():
    """The corners of all boxes, in the world."""
    scene, random = two_balls(), np.random.default_rng(1)
    count = 2 * CHUNK + 7
    transforms = random.normal(size=(count, 3, 4))
    transforms[[0, CHUNK, -1], :, 3] *= 100  # the farthest are in different parts
    numbers = random.integers(0, len(scene.meshes), count).astype(np.int32)
    scene.instances = Instances(mesh=numbers, transforms=transforms)
    signs = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    boxes = np.array([mesh.bounds() for mesh in scene.meshes], np.float64)
    corners = boxes[numbers][:, signs, [0, 1, 2]]
    world = np.einsum("nij,nkj->nki", transforms[:, :, :3], corners) + transforms[:, None, :, 3]
    expected = [world.min(axis=(0, 1)), world.max(axis=(0, 1))]
    np.testing.assert_allclose(surface_bounds(scene), expected, rtol=1e-12)
