"""Materials, meshes and cameras at the ends of their ranges: closed forms, or the picture of the tame scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scenes
from stress import moves

from engine.scene import Camera, Material, Mesh, PointLight, Scene, Visibility, World
from engine.schedule import render_compiled
from engine.settings import Settings

DEEP = {"max_bounces": 1000, "diffuse_bounces": 1000, "glossy_bounces": 1000}
ONE = (1.0, 1.0, 1.0)


def check(scene: Scene, expected: float, slack: float = 2e-4, **settings) -> None:
    """The mean radiance is `expected`, within its confidence interval and `slack`, relative."""
    picture = moves.render(scene, **settings).reshape(-1, 3)
    margin = moves.QUANTILE * picture.std(axis=0, ddof=1) / np.sqrt(len(picture)) + slack * expected
    assert np.all(np.abs(picture.mean(axis=0) - expected) <= margin), (
        f"measured {picture.mean(axis=0)} +- {margin}, expected {expected}"
    )


def lobe_albedo(exponent: float, degrees: float, side: int = 1000) -> float:
    """Directional albedo of the Phong lobe by midpoints of its own sampling, float64."""
    u, phi = np.meshgrid((np.arange(side) + 0.5) / side, (np.arange(side) + 0.5) / side * 2 * np.pi)
    t = -np.log(u) / (exponent + 1)
    sine, cosine, angle = np.sqrt(-np.expm1(-2 * t)), np.exp(-t), np.radians(degrees)
    height = cosine * np.cos(angle) + sine * np.cos(phi) * np.sin(angle)
    return float(np.maximum(height, 0).mean() * (exponent + 2) / (exponent + 1))


@pytest.mark.parametrize("degrees", [0, 60, 85])
@pytest.mark.parametrize("exponent", [0.0, 1e-6, 1.0, 1e3, 1e5, 1e7, 1e8, 1e30])
def test_exponents(exponent, degrees):
    angle = np.radians(degrees)
    scene = scenes.plate(Material("phong", ks=ONE, exponent=exponent), towards=(np.sin(angle), 0, -np.cos(angle)))
    scene.camera = replace(scene.camera, window=(-1e-6, 1e-6, -1e-6, 1e-6))
    scene.world = World(color=ONE)
    check(scene, lobe_albedo(exponent, degrees), slack=1e-3, max_bounces=0)


def test_albedo_of_exactly_0():
    check(scenes.furnace(kd=0.0, emission=0.5), 0.5, **DEEP)
    check(scenes.lit_sphere(kd=0.0), 0.0, **DEEP)


def test_albedo_of_exactly_1_with_1000_bounces():
    """Nothing is lost: Le for the first surface and for each bounce, and once more by the last ray."""
    check(scenes.furnace(kd=1.0, emission=0.5, size=4), 0.5 * 1002, samples=4, **DEEP)


def test_white_lobe_with_1000_bounces():
    """The lobe loses energy off the normal, so that there is at most as much light as in the diffuse furnace."""
    scene = scenes.furnace(emission=0.5, size=4)
    scene.materials = [Material("wall", kd=(0.5,) * 3, ks=(0.5,) * 3, exponent=20.0, emission=(0.5,) * 3)]
    mean = moves.render(scene, samples=4, **DEEP).mean()
    assert 1 < mean < 501


def split_cube(widths) -> Mesh:
    """The cube from -1 to 1 whose every side is cut into strips at the coordinates `widths`."""
    cuts = np.array([-1.0, *widths, 1.0])
    corners = np.array([[x, y] for x in cuts for y in (-1.0, 1.0)])
    k = np.arange(len(cuts) - 1) * 2
    faces = np.vstack([np.column_stack([k, k + 2, k + 3]), np.column_stack([k, k + 3, k + 1])])
    vertices, triangles = [], []
    for axis in range(3):
        for end in (-1.0, 1.0):
            triangles.append(faces + len(corners) * len(vertices))
            vertices.append(np.insert(corners, axis, end, axis=1))
    return Mesh("slivers", np.vstack(vertices).astype(np.float32), np.vstack(triangles).astype(np.uint32))


TURN = np.linalg.qr(np.random.default_rng(4).normal(size=(3, 3)))[0]


@pytest.mark.parametrize("turned", [False, True])
def test_slivers_of_aspect_1e8(turned):
    """A closed box stays closed, as a furnace and as a room that no light of the world may enter."""
    mesh = split_cube([-0.5, 0.0, 2e-8, 4e-8, 0.3, np.nextafter(np.float32(0.3), 1)])
    scene = scenes.furnace(mesh=mesh)
    if turned:
        scene.instances.transforms[:, :, :3] = TURN
    scene.world = World(color=(1e6,) * 3)
    check(scene, 0.5 * (1 + 0.5 + 0.25), max_bounces=1, samples=256)


def fan(blades: int) -> Mesh:
    """A square whose triangles all meet in one corner."""
    t = np.linspace(0, 2, blades + 1)
    rim = np.column_stack([np.minimum(t, 1), 1 - np.maximum(t - 1, 0)[:], np.zeros_like(t)])
    vertices = np.vstack([[0, 0, 0], rim]) * 20 - (10, 10, 0)
    k = np.arange(1, blades + 1)
    triangles = np.column_stack([np.zeros_like(k), k + 1, k])
    return Mesh("fan", vertices.astype(np.float32), triangles.astype(np.uint32))


def test_a_fan_of_slivers():
    scene = scenes.lamp_room(["sphere", "area"], 16)
    scene.meshes[0] = scenes.quad_mesh((-10, -10, 0), (20, 0, 0), (0, 20, 0))
    expected = moves.render(scene)
    scene.meshes[0] = fan(100_000)
    found = moves.difference(moves.render(scene), expected)
    assert found.half_width.max() < 0.02 and found.holds(), f"{found}"


def coincident(mesh: Mesh, times: int) -> Mesh:
    return replace(mesh, triangles=np.tile(mesh.triangles, (times, 1)))


def test_a_million_coincident_triangles():
    """No box can tell them apart, so that every ray costs as many tests: a tiny picture."""
    scene = scenes.lamp_room(["sphere", "area"], 4)
    expected = moves.render(scene, samples=2)
    scene.meshes[0] = coincident(scene.meshes[0], 500_000)
    found = moves.difference(moves.render(scene, samples=2), expected)
    assert found.half_width.max() < 0.02 and found.holds(), f"{found}"


def test_coincident_emitters_that_rays_meet():
    """Which of them a ray meets is open, and with it how much light there is; that what it finds is a number isn't."""
    scene = scenes.furnace(mesh=coincident(scenes.cube_mesh(), 100))
    moves.render(scene, samples=4)


def room_with_emitters(times: int, size: int = 4) -> Scene:
    """A triangle that shines, in so many layers; neither the camera nor shadow rays meet it, so that light sampling
    finds the light of all of them."""
    scene = scenes.lamp_room([], size)
    scene.materials.append(Material("lamp", emission=(20.0 / times,) * 3))
    corners = np.array([(0.2, -0.2, 1.5), (0.2, 0.4, 1.5), (0.8, -0.2, 1.9)], np.float32)
    mesh = coincident(Mesh("lamp", corners, np.array([[0, 1, 2]], np.uint32)), times)
    scene.add_instance(mesh, materials=(2,), visibility=Visibility.DIFFUSE | Visibility.GLOSSY)
    return scene


def test_a_million_coincident_emitters():
    """As bright as one of a million times their radiance. No plane parts them, so that the tree halves them."""
    expected = moves.render(room_with_emitters(1), samples=4)
    dark = room_with_emitters(1)
    dark.materials[2] = Material("off")
    assert expected.mean() > 1.1 * moves.render(dark, samples=4).mean(), "they light nothing"
    found = moves.difference(moves.render(room_with_emitters(1_000_000), samples=4), expected)
    assert found.half_width.max() < 0.02 and found.holds(), f"{found}"


def room_with_normals(change) -> Scene:
    """Two smooth balls, one of them far from a unit matrix, whose normals are changed."""
    scene = scenes.lamp_room(["sphere", "area"], 16)
    ball = scene.meshes[1]
    transform = np.column_stack([np.diag([0.5, 1.5, 0.8]), (1.0, 0.3, 0.5)])
    scene.add_instance(ball, transform, materials=(1,))
    changed = replace(ball, normals=change(ball.normals))
    scene.meshes = [changed if mesh is ball else mesh for mesh in scene.meshes]
    return scene


@pytest.mark.parametrize("bake_limit", [0, 1 << 16], ids=["instanced", "baked"])
@pytest.mark.parametrize("length", [1e-30, 1e-6, 0.1, 10, 1e6, 1e30, "any"])
def test_unnormalised_normals(monkeypatch, length, bake_limit):
    monkeypatch.setattr("engine.pack.geometry.BAKE_LIMIT", bake_limit)
    expected = moves.render(room_with_normals(lambda n: n))
    count = len(scenes.sphere_mesh(16).vertices)
    factor = np.float32(length) if length != "any" else 10 ** np.random.default_rng(1).uniform(-5, 5, (count, 1))
    stressed = moves.render(room_with_normals(lambda n: (n * factor).astype(np.float32)))
    found = moves.difference(stressed, expected)
    assert found.half_width.max() < 0.02 and found.holds(), f"{found}"


def test_normals_of_length_zero_are_flat():
    stressed = room_with_normals(np.zeros_like)
    flat = room_with_normals(lambda n: n)
    flat.meshes = [replace(mesh, normals=None) for mesh in flat.meshes]
    found = moves.difference(moves.render(stressed), moves.render(flat))
    assert found.half_width.max() < 0.02 and found.holds(), f"{found}"


def turned_over(mesh: Mesh, faces: bool, normals: bool) -> Mesh:
    """The ball with its faces wound the other way round, its normals reversed, or both."""
    return replace(
        mesh,
        triangles=np.ascontiguousarray(mesh.triangles[:, ::-1]) if faces else mesh.triangles,
        normals=-mesh.normals if normals and mesh.normals is not None else mesh.normals,
    )


def room_turned_over(faces: bool, normals: bool, flat: bool = False) -> Scene:
    scene = room_with_normals(lambda n: n)
    if flat:
        scene.meshes = [replace(mesh, normals=None) for mesh in scene.meshes]
    scene.meshes = [turned_over(mesh, faces, normals) if mesh.name == "ball" else mesh for mesh in scene.meshes]
    return scene


@pytest.mark.parametrize("bake_limit", [0, 1 << 16], ids=["instanced", "baked"])
@pytest.mark.parametrize("flat", [False, True])
def test_surfaces_turned_inside_out_look_alike(monkeypatch, flat, bake_limit):
    """Faces and their normals both reversed: a surface is the same from both of its sides."""
    monkeypatch.setattr("engine.pack.geometry.BAKE_LIMIT", bake_limit)
    expected = moves.render(room_turned_over(faces=False, normals=False, flat=flat))
    found = moves.difference(moves.render(room_turned_over(faces=True, normals=True, flat=flat)), expected)
    assert found.half_width.max() < 0.02 and found.holds(), f"{found}"


def test_reversed_normals_are_as_reversed_faces():
    """Which of the two is the wrong one, nobody can tell."""
    expected = moves.render(room_turned_over(faces=True, normals=False))
    found = moves.difference(moves.render(room_turned_over(faces=False, normals=True)), expected)
    assert found.half_width.max() < 0.02 and found.holds(), f"{found}"


def finely(scene: Scene) -> Scene:
    """With balls whose faces lie within a degree of their normals."""
    fine = scenes.sphere_mesh(90, radius=0.5, smooth=True, name="ball")
    return replace(scene, meshes=[fine if mesh.name == "ball" else mesh for mesh in scene.meshes])


def test_surfaces_against_their_normals_are_black():
    """A direction counts that lies above the face and above the normal: there is next to none. Right way round,
    the balls are some percent of the light."""
    right, black = finely(room_with_normals(lambda n: n)), finely(room_with_normals(lambda n: n))
    black.materials[1] = Material("black")
    against = finely(room_with_normals(lambda n: n))
    against.meshes = [turned_over(m, False, True) if m.name == "ball" else m for m in against.meshes]
    expected = moves.render(black)
    found = moves.difference(moves.render(against), expected)
    assert found.half_width.max() < 2e-3 and found.holds(slack=2e-3), f"{found}"
    assert moves.difference(moves.render(right), expected).mean.min() > 0.02


def test_reversed_normals_look_alike_on_both_roads():
    scene = room_with_normals(np.negative)
    scene.width = scene.height = 12
    pictures = [moves.render(scene, samples=s, road=road, seed=3) for road, s in (("COMPILED", 256), ("REFERENCE", 16))]
    found = moves.difference(*pictures)
    assert found.half_width.max() < 0.2 and found.holds(), f"{found}"


def test_normals_at_random_are_drawn():
    random = np.random.default_rng(1)
    moves.render(room_with_normals(lambda n: random.normal(size=n.shape).astype(np.float32)))


def looking(origin, **more) -> Camera:
    return replace(scenes.camera(origin), clip_start=0.0, **more)


@pytest.mark.parametrize("height", [0.0, 1e-6, -1e-6, 1e-30])
def test_camera_on_a_surface(height):
    """In the ground's plane it sees the ground edge on, above or below: all of it is finite."""
    scene = scenes.lamp_room(list(scenes.LAMP_KINDS), 8)
    scene.camera = looking((0.1, -2.0, height))
    moves.render(scene)


def test_camera_inside_a_block():
    """A closed block keeps the world out."""
    scene = Scene(width=8, height=8, camera=looking((0.2, 0.1, -0.3)), world=World(color=(1e6,) * 3))
    scene.add_instance(scenes.cube_mesh())
    check(scene, 0.0, samples=256)


@pytest.mark.parametrize("radius", [1e-3, 1.0, 1e3])
def test_camera_inside_a_lamp(radius):
    lamp = PointLight("lamp", scenes.place((0, 0, 0)), intensity=ONE, radius=radius)
    scene = Scene(width=8, height=8, camera=looking((0.2 * radius, 0.1 * radius, 0)), lights=[lamp])
    check(scene, 1 / (np.pi * radius**2))


def test_a_value_that_is_no_number_is_caught():
    """Past the border the film counts it, and every check here asks for the count."""
    scene = scenes.plate()
    scene.world = World(color=(float("nan"),) * 3)
    result = render_compiled(scene, Settings(samples=1))
    assert result.rejected > 0 and np.isfinite(result.pixels).all()


def test_a_hole_is_caught():
    """One of the box's 84 triangles is missing."""
    mesh = split_cube([-0.5, 0.0, 2e-8, 4e-8, 0.3, np.nextafter(np.float32(0.3), 1)])
    scene = scenes.furnace(mesh=replace(mesh, triangles=mesh.triangles[1:]))
    scene.world = World(color=(1e6,) * 3)
    with pytest.raises(AssertionError, match="expected"):
        check(scene, 0.5 * (1 + 0.5 + 0.25), max_bounces=1)


def test_lamps_that_send_next_to_nothing():
    """The light tree shares out the smallest numbers that there are: a reciprocal of their sum would be infinite."""
    scene = scenes.lamp_room(["area", "area"], 16)
    scene.lights = [replace(lamp, size_y=1e-45) for lamp in scene.lights]
    result = render_compiled(scene, Settings(samples=64, max_bounces=2, threads=1))
    assert result.rejected == 0
    assert np.isfinite(result.pixels).all()
