"""Scenes whose radiance a formula gives, for every bounce limit: the table that test_known_answers.py renders.

All is seen through so narrow a camera that the formula's one point is what the picture shows, or is the same
everywhere. A lamp's name in the table says what stands beside it; the formulas are those of radiometry's textbooks.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import scenes
from reference import slab
from reference.irradiance import above_horizon, polygon_irradiance, smoothstep, spread_disk, spread_rectangle
from reference.slab import Slab
from sample_scenes import sample_scene

from engine.scene import AreaLight, Camera, Lamp, Material, Mesh, PointLight, Scene, SpotLight, SunLight, World

SIZE = 4  # pixels a side
NARROW = 1e-6  # half width of a view that is one ray
FLOAT32 = 2e-5  # relative: what single precision may lose along a path
NOISY = 16384  # samples where 4096 would need too many seeds
DEEP = 1000
EVERY = (*range(9), DEEP)
ENDS = (0, 8)  # for pictures without a second surface: no limit may change them
LIMITS = ("max_bounces", "diffuse_bounces", "glossy_bounces")
ONE = (1.0, 1.0, 1.0)
WHITE = Material("white", kd=ONE)
ALBEDO_TABLE = Path(__file__).resolve().parents[1] / "kernels" / "phong_albedo.json"


@dataclass(frozen=True)
class Case:
    """expected  radiance (a number or RGB) at a bounce limit
    source    where that comes from
    limits    rendered with as many samples as the interval wants
    others    more limits, with few samples
    slack     relative, for what is no noise: float32, or a mesh that only comes near to a sphere
    samples   of a pixel and seed
    bounds    the settings that a limit stands for, each with its multiple of it; what isn't named is DEEP
    settings  any other settings
    """

    name: str
    scene: Callable[[], Scene]
    expected: Callable[[int], np.ndarray | float]
    source: str
    limits: tuple[int, ...] = ENDS
    slack: float = FLOAT32
    samples: int = 4096
    others: tuple[int, ...] = ()
    bounds: dict[str, int] = field(default_factory=lambda: dict.fromkeys(LIMITS, 1))
    settings: dict[str, str] = field(default_factory=dict)

    def bounces(self, limit: int) -> dict[str, int]:
        """The three settings at a limit, in the order of LIMITS."""
        return {name: min(self.bounds[name] * limit, DEEP) if name in self.bounds else DEEP for name in LIMITS}


def always(value) -> Callable[[int], np.ndarray | float]:
    return lambda bounces: value


def without(limits: tuple[int, ...]) -> tuple[int, ...]:
    """All limits but these."""
    return tuple(limit for limit in EVERY if limit not in limits)


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
    expected = series([1 - kd for kd in KD], KD, more=1)
    source = "Le sum(kd^i, i = 0 .. bounces + 1)"
    for name, mesh in FURNACES.items():
        limits = EVERY if name == "cube" else (0, 2, DEEP)
        case = Case(f"furnace, {name}", partial(furnace, mesh), expected, source, limits, samples=NOISY)
        yield replace(case, others=without(limits))
    cube = partial(furnace, FURNACES["cube"])
    for setting in ("max_bounces", "diffuse_bounces"):
        name = f"furnace, cube, {setting} alone"
        yield Case(name, cube, expected, source, (), samples=NOISY, others=EVERY, bounds={setting: 1})


# Plates without end, with both lobes

SLABS = (
    Slab(0.0, 0.9, 10, 60), Slab(0.3, 0.6, 10, 60), Slab(0.3, 0.6, 100, 80), Slab(0.1, 0.8, 1, 30),
    Slab(0.0, 0.9, 1000, 45),
)  # fmt: skip
DIFFUSE_SLAB, BOTH = Slab(0.5, 0.0, 0, 60), SLABS[1]
UNEQUAL = {
    "glossy_bounces alone": {"glossy_bounces": 1},
    "diffuse_bounces alone": {"diffuse_bounces": 1},
    "glossy_bounces twice diffuse_bounces": {"diffuse_bounces": 1, "glossy_bounces": 2},
    "diffuse_bounces twice glossy_bounces": {"diffuse_bounces": 2, "glossy_bounces": 1},
}
CHOICES = (
    {"lobe_selection": "CLASSIC"}, {"hemisphere_sampling": "UNIFORM"}, {"hemisphere_sampling": "REJECTION"},
)  # fmt: skip


def plates(walls: Slab, name: str = "", limits: tuple[int, ...] = (), **rest) -> Case:
    def expected(limit: int) -> float:
        return slab.radiance(walls, *case.bounces(limit).values())

    case = Case(f"plates, {walls}{name}", partial(slab.scene, walls, SIZE), expected, "matrix of the angles", limits,
                others=without(limits), **rest)  # fmt: skip
    return case


def slabs() -> Iterator[Case]:
    for each in SLABS:
        yield plates(each, limits=(1, 4))
    yield plates(DIFFUSE_SLAB)
    for name, bounds in UNEQUAL.items():
        yield plates(BOTH, f", {name}", bounds=bounds)
    for settings in CHOICES:
        yield plates(BOTH, f", {next(iter(settings.values()))}", settings=settings)


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


def turned_off(angle: float) -> np.ndarray:
    """(3,) from SLANT past the origin by so many radians."""
    side = np.cross(SLANT, (0, 0, 1)) / np.linalg.norm(SLANT[:2])
    return -SLANT / DISTANCE * np.cos(angle) + side * np.sin(angle)


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
    for spread, towards, x, y in (
        (0.1, -SLANT, 0.4, 0.1), (1.0, (-0.3, -0.3, -1), 1.5, 0.8), (1.0, (-0.6, -0.3, -2), 0.1, 0.1),
        (2.5, (-0.5, 0, -1), 1.5, 0.8),
    ):  # fmt: skip
        name = f"area, {x} x {y}, spread {spread}"
        window = AreaLight(name, scenes.place(SLANT, towards), radiance=RGB, size_x=x, size_y=y, spread=spread)
        shown = spread_rectangle(area_corners(window), -window.transform[:, 2], spread) / np.pi
        yield window, COLOUR * shown, "L int int f cos cos / d^2 r dr dphi"
    low = AreaLight("area, cut by the horizon", scenes.place((1.2, 0.3, 0.2), (-1, -0.2, 0.3)), radiance=RGB,
                    size_x=0.8, size_y=1.2)  # fmt: skip
    yield low, COLOUR * polygon_irradiance(above_horizon(area_corners(low))) / np.pi, "Lambert's polygon, clipped"
    for angle in (0.0, 0.0092, 0.6):
        sun = SunLight(f"sun, angle {angle}", AT_PLATE, irradiance=RGB, angle=angle)
        yield sun, COLOUR * COSINE / np.pi, "E cos"


def plate_under_mesh(mesh: Mesh) -> Scene:
    scene = plate()
    scene.materials.append(Material("lamp", emission=RGB))
    scene.add_instance(mesh, materials=(1,))
    return scene


POLYGONS = {
    "heptagon": [(np.cos(a), np.sin(a) - 0.3, 1.6 + 0.5 * np.cos(a + 1)) for a in np.arange(7) / 7 * 2 * np.pi],
    # Of the shape of an L; all of it is seen from its inner corner, the first.
    "hexagon with a dent": [(0.5 + 0.4 * x, 0.3 * y - 0.2, 1.2 + 0.2 * x - 0.3 * y)
                            for x, y in ((1, 1), (1, 2), (0, 2), (0, 0), (2, 0), (2, 1))],
    "pentagon cut by the horizon": [(1.0, -0.6, -0.5), (1.4, 0.3, -0.4), (1.6, 0.8, 0.4), (1.2, 0.0, 1.2),
                                    (0.8, -0.8, 0.6)],
}  # fmt: skip


def flat_polygon(corners) -> np.ndarray:
    """(k, 3) moved along z into the plane of the first three: float32 then has it, or nearly so."""
    v = np.array(corners, np.float64)
    normal = np.cross(v[1] - v[0], v[2] - v[0])
    v[:, 2] -= (v - v[0]) @ normal / normal[2]
    return v


def polygon_mesh(corners: np.ndarray, name: str) -> Mesh:
    """As a fan about the first corner."""
    k = np.arange(1, len(corners) - 1, dtype=np.uint32)
    return Mesh(name, corners.astype(np.float32), np.column_stack([0 * k, k, k + 1]).astype(np.uint32))


def mesh_polygons() -> Iterator[Case]:
    for name, rough in POLYGONS.items():
        mesh = polygon_mesh(flat_polygon(rough), name)
        shown = COLOUR * polygon_irradiance(above_horizon(mesh.vertices)) / np.pi
        source = "Lambert's polygon, clipped" if "horizon" in name else "Lambert's polygon"
        yield Case(f"mesh, {name}", partial(plate_under_mesh, mesh), always(shown), source)


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
    yield from mesh_polygons()


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


CASES = [*furnaces(), *slabs(), *lit_spheres(), *form_factors(), *lit_plates(), *skies(), *cornell(), *phong_albedos()]
