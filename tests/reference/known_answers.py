"""Scenes whose radiance a formula gives, for every bounce limit: the table that test_known_answers.py renders.

All is seen through so narrow a camera that the formula's one point is what the picture shows, or is the same
everywhere. A lamp's name in the table says what stands beside it; the formulas are those of radiometry's textbooks.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import scenes
from sample_scenes import sample_scene

from engine.scene import AreaLight, Camera, Lamp, Material, Mesh, PointLight, Scene, SpotLight, SunLight, World

SIZE = 4  # pixels a side
NARROW = 1e-6  # half width of a view that is one ray
FLOAT32 = 2e-5  # relative: what single precision may lose along a path
NOISY = 16384  # samples where 4096 would need too many seeds
DEEP = 1000
EVERY = (*range(9), DEEP)
ENDS = (0, 8)  # for pictures without a second surface: no limit may change them
ONE = (1.0, 1.0, 1.0)
WHITE = Material("white", kd=ONE)
ALBEDO_TABLE = Path(__file__).resolve().parents[1] / "kernels" / "phong_albedo.json"


@dataclass(frozen=True)
class Case:
    """expected  radiance (a number or RGB) at a bounce limit
    source    where that comes from
    slack     relative, for what is no noise: float32, or a mesh that only comes near to a sphere
    samples   of a pixel and seed
    """

    name: str
    scene: Callable[[], Scene]
    expected: Callable[[int], np.ndarray | float]
    source: str
    limits: tuple[int, ...] = ENDS
    slack: float = FLOAT32
    samples: int = 4096


def always(value) -> Callable[[int], np.ndarray | float]:
    return lambda bounces: value


def series(first, kd, more: int) -> Callable[[int], np.ndarray]:
    """first * sum(kd^i, i = 0 .. bounces + more)"""
    first, kd = np.asarray(first, np.float64), np.asarray(kd, np.float64)
    return lambda bounces: first * (1 - kd ** (bounces + more + 1)) / (1 - kd)


# Closed surfaces that emit and reflect the same everywhere


def ragged_mesh() -> Mesh:
    """A closed surface with dents, to be seen from inside: parts of it hide others."""
    ball = scenes.sphere_mesh(12)
    radii = np.random.default_rng(1).uniform(0.5, 1.0, (len(ball.vertices), 1))
    return replace(ball, name="ragged", vertices=(ball.vertices * radii).astype(np.float32))


KD = (0.2, 0.5, 0.8)
FURNACES: dict[str, Callable[[], Mesh]] = {
    "cube": scenes.cube_mesh, "sphere": lambda: scenes.sphere_mesh(16), "ragged": ragged_mesh,
}  # fmt: skip


def furnace(mesh: Callable[[], Mesh]) -> Scene:
    scene = scenes.furnace(mesh=mesh(), size=SIZE)
    scene.materials = [Material("wall", kd=KD, emission=tuple(1 - kd for kd in KD))]
    return scene


def furnaces() -> Iterator[Case]:
    for name, mesh in FURNACES.items():
        limits = EVERY if name == "cube" else (0, 2, DEEP)
        expected = series([1 - kd for kd in KD], KD, more=1)
        source = "Le sum(kd^i, i = 0 .. bounces + 1)"
        yield Case(f"furnace, {name}", partial(furnace, mesh), expected, source, limits, samples=NOISY)


RINGS = 256


@cache
def lit_sphere() -> Scene:
    scene = scenes.furnace(0.5, 0.0, scenes.sphere_mesh(RINGS), SIZE)
    assert scene.camera is not None
    scene.camera.transform[:, 3] = 0
    scene.lights = [PointLight("centre", intensity=(np.pi,) * 3)]
    return scene


def lit_spheres() -> Iterator[Case]:
    """pbrt-v4's integrator test. On a facet whose plane is d from the centre the light's irradiance lies between
    pi d (at a vertex) and pi / d^2 (at the foot), and bounces are averages of it: it bounds the slack."""
    step = np.pi / RINGS
    plane = 1 - step**2 / 4  # of a facet with a right angle between two sides of length `step`, and of any smaller
    slack = max(plane**-2 - 1, 1 - plane) + FLOAT32
    source = "kd sum(kd^i, i = 0 .. bounces), I = pi in the centre"
    yield Case("lit sphere", lit_sphere, series(0.5, 0.5, more=0), source, EVERY, slack, NOISY)


# Form factors of the unit cube

OPPOSITE = 2 / np.pi * (np.log(2 / np.sqrt(3)) + 2 * np.sqrt(2) * np.arctan(np.sqrt(0.5)) - np.pi / 2)
FORM_FACTORS = {"opposite": OPPOSITE, "adjacent": (1 - OPPOSITE) / 4}


def cube_floor(wall: str) -> Scene:
    """An orthographic camera averages the white floor under one emissive wall."""
    scene = Scene(width=SIZE, height=SIZE)
    scene.camera = Camera(
        transform=scenes.place((0, 0, 0.25)), window=(-0.5, 0.5, -0.5, 0.5), orthographic=True, clip_start=0.01
    )
    scene.materials = [WHITE, Material("lamp", emission=ONE)]
    scene.add_instance(scenes.quad_mesh((-0.5, -0.5, 0), (1, 0, 0), (0, 1, 0), "floor"))
    corner, u, v = {
        "opposite": ((-0.5, -0.5, 1), (1, 0, 0), (0, 1, 0)),
        "adjacent": ((-0.5, -0.5, 0), (0, 1, 0), (0, 0, 1)),
    }[wall]
    scene.add_instance(scenes.quad_mesh(corner, u, v, wall), materials=(1,))
    return scene


def form_factors() -> Iterator[Case]:
    for wall, factor in FORM_FACTORS.items():
        source = "parallel squares" if wall == "opposite" else "(1 - opposite) / 4"
        yield Case(f"cube's form factor, {wall}", partial(cube_floor, wall), always(factor), source, samples=NOISY)


# Irradiance E of a white plate at the origin by one lamp: it shows E / pi

SLANT = np.array([0.9, 0.4, 2.0])
DISTANCE = float(np.linalg.norm(SLANT))
COSINE = float(SLANT[2]) / DISTANCE
AT_PLATE = scenes.place(SLANT, -SLANT)  # there, shining at the middle
COLOUR = np.array([3.0, 2.0, 1.0])
RGB = (3.0, 2.0, 1.0)


def plate(material: Material = WHITE, degrees: float = 36.87) -> Scene:
    """`material` seen at so many degrees off the normal."""
    angle = np.radians(degrees)
    scene = scenes.plate(material, towards=(0, np.sin(angle), -np.cos(angle)), size=SIZE)
    assert scene.camera is not None
    scene.camera = replace(scene.camera, window=(-NARROW, NARROW, -NARROW, NARROW))
    return scene


def under(light: Lamp) -> Scene:
    scene = plate()
    scene.lights = [light]
    return scene


def polygon_irradiance(corners, normal=(0.0, 0.0, 1.0)) -> float:
    """Lambert: of radiance 1, from a polygon (k, 3) above the horizon of the origin, W/m2."""
    v = np.asarray(corners, np.float64)
    v = v / np.linalg.norm(v, axis=1)[:, None]
    total = 0.0
    for a, b in zip(v, np.roll(v, -1, axis=0), strict=True):
        across = np.cross(a, b)
        total += np.arccos(a @ b) * (across @ np.asarray(normal)) / np.linalg.norm(across)
    return float(abs(total) / 2)


def smoothstep(angle: float, half: float, blend: float) -> float:
    s = np.clip((np.cos(angle) - np.cos(half)) / ((1 - np.cos(half)) * blend), 0, 1)
    return float(s * s * (3 - 2 * s))


def turned_off(angle: float) -> np.ndarray:
    """(3,) from SLANT past the origin by so many radians."""
    side = np.cross(SLANT, (0, 0, 1)) / np.linalg.norm(SLANT[:2])
    return -SLANT / DISTANCE * np.cos(angle) + side * np.sin(angle)


def spread_disk(radius: float, height: float, spread: float) -> float:
    """E / pi of a coaxial disk of radiance 1 with `spread`: 2 L int (tan h - tan t) sin t cos t dt / (tan h - h)."""
    h = spread / 2
    a = min(h, np.arctan(radius / height))
    return float((np.tan(h) * np.sin(a) ** 2 - a + np.sin(2 * a) / 2) / (np.tan(h) - h))


def area_corners(light: AreaLight) -> np.ndarray:
    x, y = light.transform[:, 0] * light.size_x / 2, light.transform[:, 1] * light.size_y / 2
    return light.transform[:, 3] + np.array([-x - y, x - y, x + y, y - x])


def lamps() -> Iterator[tuple[Lamp, np.ndarray, str]]:
    """Lamp, what the plate shows, formula."""
    like_a_point = COLOUR * COSINE / DISTANCE**2 / np.pi
    yield PointLight("point", AT_PLATE, intensity=RGB), like_a_point, "I cos / d^2"
    for r in (0.01, 0.7):
        ball = PointLight(f"sphere, radius {r}", AT_PLATE, intensity=RGB, radius=r)
        yield ball, like_a_point, "pi L (r / d)^2 cos"
        disk = replace(ball, name=f"disk that faces the point, radius {r}", soft_falloff=True)
        yield disk, COLOUR * COSINE / (DISTANCE**2 + r * r) / np.pi, "pi L r^2 / (r^2 + d^2) cos"
    for kind, off, half, blend in (
        ("spot", 0.3, 0.5, 0.8), ("spot", 0.45, 0.5, 1.0), ("spot", 0.49, 0.5, 0.0), ("narrow spot", 0.04, 0.05, 1.0)
    ):  # fmt: skip
        for r in (0.0, 1e-4):
            name = f"{kind}, {off} off the axis, blend {blend}, radius {r:g}"
            tilted = scenes.place(SLANT, turned_off(off))
            spot = SpotLight(name, tilted, intensity=RGB, radius=r, half_angle=half, blend=blend)
            yield spot, like_a_point * smoothstep(off, half, max(blend, 1e-9)), "I smoothstep cos / d^2"
    for scale in ((1, 1, 1), (1.5, 0.5, 2), (-1, 1, 1)):
        area = AreaLight(f"area, scale {scale}", scenes.place(SLANT, (-0.5, 0, -1), scale=scale), radiance=RGB,
                         size_x=1.5, size_y=0.8)  # fmt: skip
        yield area, COLOUR * polygon_irradiance(area_corners(area)) / np.pi, "Lambert's polygon"
    disk = AreaLight("area, disk", scenes.place((0, 0, 2)), radiance=RGB, size_x=1.4, size_y=1.4, ellipse=True)
    yield disk, COLOUR * 0.49 / (0.49 + 4), "pi L r^2 / (r^2 + d^2)"
    for spread, r in ((0.05, 0.06), (1.0, 0.7), (3.0, 0.7)):
        narrow = replace(disk, name=f"area, disk, spread {spread}", size_x=2 * r, size_y=2 * r, spread=spread)
        yield narrow, COLOUR * spread_disk(r, 2.0, spread), "2 L int f sin cos dt"
    for angle in (0.0, 0.0092, 0.6):
        sun = SunLight(f"sun, angle {angle}", AT_PLATE, irradiance=RGB, angle=angle)
        yield sun, COLOUR * COSINE / np.pi, "E cos"


def plate_under_mesh(mesh: Mesh) -> Scene:
    scene = plate()
    scene.materials.append(Material("lamp", emission=RGB))
    scene.add_instance(mesh, materials=(1,))
    return scene


def mesh_lamps() -> Iterator[Case]:
    quad = scenes.quad_mesh((0.5, -0.3, 1.5), (1.0, 0.2, 0.1), (-0.1, 0.6, 0.5))
    shown = COLOUR * polygon_irradiance(quad.vertices) / np.pi
    yield Case("mesh, quad", lambda: plate_under_mesh(quad), always(shown), "Lambert's polygon")

    ball = scenes.sphere_mesh(8, radius=0.6)
    ball.vertices[:] += np.float32((0.3, 0.4, 1.5))
    corners = ball.vertices[ball.triangles].astype(np.float64)
    out = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facing = corners[np.einsum("ij,ij->i", out, corners[:, 0]) < 0]
    shown = COLOUR * sum(polygon_irradiance(triangle) for triangle in facing) / np.pi
    yield Case("mesh, ball", lambda: plate_under_mesh(ball), always(shown), "Lambert's polygon, each facet")


def lit_plates() -> Iterator[Case]:
    for light, shown, source in lamps():
        yield Case(f"lamp: {light.name}", partial(under, light), always(shown), source)
    yield from mesh_lamps()


# The sample scene's lamp on its own wall

DROPS = (0.05, 0.2, 0.5, 1.0, 2.0)  # metres below the lamp's plane


@cache
def cornell_lamp() -> tuple[np.ndarray, Material]:
    """Its corners (4, 3) in the world, and its material."""
    scene = sample_scene("cornell_diffuse", 16)
    index = scene.instances.object_names.index("Lamp")
    mesh = scene.meshes[scene.instances.mesh[index]]
    matrix = scene.instances.transforms[index]
    material = scene.instances.material_table[scene.instances.material_offset[index]]
    return mesh.vertices @ matrix[:, :3].T + matrix[:, 3], scene.materials[material]


def wall_point(drop: float) -> np.ndarray:
    return np.array([0.3, 5.592, cornell_lamp()[0][0, 2] - drop])


def cornell_wall(drop: float) -> Scene:
    eye = np.array([0.3, 1.0, 2.0])
    scene = sample_scene("cornell_diffuse", 16)
    assert scene.camera is not None
    camera = replace(scene.camera, transform=scenes.place(eye, wall_point(drop) - eye),
                     window=(-NARROW, NARROW, -NARROW, NARROW), aperture=None)  # fmt: skip
    return replace(scene, width=SIZE, height=SIZE, camera=camera)


def cornell_expected(drop: float, bounces: int) -> np.ndarray:
    corners, lamp = cornell_lamp()
    white = next(m for m in sample_scene("cornell_diffuse", 16).materials if m.name == "White")
    e = polygon_irradiance(corners - wall_point(drop), (0, -1, 0))
    return np.array(lamp.emission) * np.array(white.kd) * e / np.pi


def cornell() -> Iterator[Case]:
    """Direct light alone has a formula; the wall sees nothing else that emits."""
    for drop in DROPS:
        name = f"Cornell's wall, {drop} below the lamp"
        yield Case(name, partial(cornell_wall, drop), partial(cornell_expected, drop), "Lambert's polygon", (0,))


# Worlds


def under_world(world: World) -> Scene:
    scene = plate()
    scene.world = world
    return scene


def white_ball() -> Scene:
    """Convex and white under a white sky: it can't be seen."""
    scene = Scene(width=SIZE, height=SIZE, camera=scenes.camera(origin=(0, -3, 0), half_width=0.4))
    scene.materials = [WHITE]
    scene.add_instance(scenes.sphere_mesh(16))
    scene.world = World(color=ONE)
    return scene


def rising_sky(rotation: np.ndarray, height: int = 512) -> World:
    """Radiance z^2 of the direction in environment space: bilinear to (pi / height)^2 / 4."""
    z = -np.cos((np.arange(height) + 0.5) / height * np.pi)
    image = np.broadcast_to((z * z)[:, None, None], (height, 2 * height, 3)).astype(np.float32)
    return World(color=RGB, image=image, rotation=rotation)


def skies() -> Iterator[Case]:
    yield Case("white plate, white sky", lambda: under_world(World(color=RGB)), always(COLOUR), "L")
    yield Case("white ball, white sky", white_ball, always(1.0), "L")
    ones = np.ones((64, 128, 3), np.float32)
    yield Case("white plate, white image", lambda: under_world(World(color=RGB, image=ones)), always(COLOUR), "L")
    upright, lying = np.eye(3), np.roll(np.eye(3), 1, axis=0)
    yield Case(
        "white plate, image of z^2", lambda: under_world(rising_sky(upright)), always(COLOUR / 2), "int z^3 / pi"
    )
    yield Case(
        "white plate, image of x^2", lambda: under_world(rising_sky(lying)), always(COLOUR / 4), "int x^2 z / pi"
    )


# The Phong lobe under a white sky: its directional albedo


def phong_plate(kd: float, ks: float, exponent: float, degrees: float) -> Scene:
    scene = plate(Material("phong", kd=(kd,) * 3, ks=(ks,) * 3, exponent=exponent), degrees)
    scene.world = World(color=ONE)
    return scene


def phong_albedos() -> Iterator[Case]:
    """Every row of the table, at one limit: the plate is all there is. With a diffuse lobe beside, a part of them."""
    for n, degrees, albedo in json.loads(ALBEDO_TABLE.read_text())["rows"]:
        name = f"Phong, n = {n:g}, {degrees:g} degrees"
        yield Case(name, partial(phong_plate, 0.0, 1.0, n, degrees), always(albedo), "albedo by quadrature", (0,))
        if n in (0, 10, 1000) and degrees in (0, 60, 85):
            scene, expected = partial(phong_plate, 0.3, 0.7, n, degrees), always(0.3 + 0.7 * albedo)
            yield Case(f"diffuse and {name}", scene, expected, "kd + ks albedo by quadrature", (0,), samples=NOISY)


CASES = [*furnaces(), *lit_spheres(), *form_factors(), *lit_plates(), *skies(), *cornell(), *phong_albedos()]
