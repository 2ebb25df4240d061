"""Small scenes made by hand, for the tests of both roads.

Each function gives a fresh `engine.Scene` that the caller may change. Nothing here reads a file or knows Blender.
"""

from __future__ import annotations

import numpy as np

from engine.scene import (
    AreaLight,
    Camera,
    Lamp,
    Material,
    Mesh,
    PointLight,
    Scene,
    SpotLight,
    SunLight,
    World,
)


def place(origin=(0.0, 0.0, 0.0), towards=(0.0, 0.0, -1.0), up=(0.0, 0.0, 1.0), scale=(1.0, 1.0, 1.0)) -> np.ndarray:
    """(3, 4) transform at `origin` whose local -z looks along `towards`."""
    z = -np.asarray(towards, np.float64)
    z /= np.linalg.norm(z)
    x = np.cross(up, z)
    if np.linalg.norm(x) < 1e-6:
        x = np.cross((0.0, 1.0, 0.0), z)
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    return np.column_stack([x * scale[0], y * scale[1], z * scale[2], np.asarray(origin, np.float64)])


def camera(origin=(0.0, 0.0, 0.0), towards=(0.0, 1.0, 0.0), half_width: float = 0.5, aspect: float = 1.0) -> Camera:
    """A perspective camera; `half_width` is the tangent of half the horizontal field of view."""
    half_height = half_width / aspect
    return Camera(transform=place(origin, towards), window=(-half_width, half_width, -half_height, half_height))


def sphere_mesh(rings: int = 32, radius: float = 1.0, smooth: bool = False, name: str = "sphere") -> Mesh:
    """A UV sphere about the origin, normals outwards; no degenerate faces at the poles."""
    theta = np.linspace(0, np.pi, rings + 1)[1:-1]
    phi = np.arange(2 * rings) * np.pi / rings
    t, p = np.meshgrid(theta, phi, indexing="ij")
    body = np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], -1).reshape(-1, 3)
    unit = np.vstack([body, [[0, 0, 1], [0, 0, -1]]])
    columns = 2 * rings
    i, j = np.meshgrid(np.arange(rings - 2), np.arange(columns), indexing="ij")
    a, b = (i * columns + j).ravel(), (i * columns + (j + 1) % columns).ravel()
    sides = np.vstack([np.column_stack([a, a + columns, b]), np.column_stack([b, a + columns, b + columns])])
    j = np.arange(columns)
    k = (j + 1) % columns
    last, north, south = (rings - 2) * columns, len(body), len(body) + 1
    caps = np.vstack(
        [np.column_stack([np.full_like(j, north), j, k]), np.column_stack([np.full_like(j, south), last + k, last + j])]
    )
    return Mesh(
        name,
        (unit * radius).astype(np.float32),
        np.vstack([sides, caps]).astype(np.uint32),
        normals=unit.astype(np.float32) if smooth else None,
    )


def quad_mesh(corner, u, v, name: str = "quad") -> Mesh:
    """The parallelogram `corner + s u + t v`; its normal is u x v."""
    corner, u, v = (np.asarray(x, np.float64) for x in (corner, u, v))
    vertices = np.stack([corner, corner + u, corner + u + v, corner + v])
    return Mesh(name, vertices.astype(np.float32), np.array([[0, 1, 2], [0, 2, 3]], np.uint32))


def cube_mesh(half: float = 1.0, name: str = "cube") -> Mesh:
    """An axis-aligned cube about the origin, flat, normals outwards."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32) * half
    quads = np.array([(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])
    triangles = np.vstack([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return Mesh(name, corners, triangles.astype(np.uint32))


def furnace(kd: float = 0.5, emission: float = 0.5, mesh: Mesh | None = None, size: int = 8) -> Scene:
    """The inside of a closed surface that reflects `kd` and emits `emission` everywhere."""
    scene = Scene(camera=camera(origin=(0.1, -0.2, 0.05)), width=size, height=size)
    scene.materials = [Material("wall", kd=(kd,) * 3, emission=(emission,) * 3)]
    scene.add_instance(mesh or sphere_mesh())
    return scene


def lit_sphere(kd: float = 0.5, intensity: float = np.pi, size: int = 8) -> Scene:
    """The unit sphere seen from inside with a point light at its centre; pbrt-v4's integrator test."""
    scene = furnace(kd, 0.0, sphere_mesh(48), size)
    scene.camera.transform[:, 3] = 0
    scene.lights = [PointLight("centre", intensity=(intensity,) * 3)]
    return scene


def plate(material: Material | None = None, towards=(0.0, 0.0, -1.0), size: int = 8) -> Scene:
    """A wide square at z = 0, seen from a distance of 1 along `towards`; a narrow view, so nearly one direction."""
    scene = Scene(width=size, height=size)
    direction = np.asarray(towards, np.float64) / np.linalg.norm(towards)
    scene.camera = camera(origin=-direction, towards=direction, half_width=1e-3)
    scene.materials = [material or Material("white", kd=(1.0, 1.0, 1.0))]
    scene.add_instance(quad_mesh((-10, -10, 0), (20, 0, 0), (0, 20, 0), name="plate"))
    return scene


def lit_plate(lights: list[Lamp], material: Material | None = None, size: int = 8) -> Scene:
    """`plate` seen from above at a slant, under `lights`."""
    scene = plate(material, towards=(0.0, 0.6, -0.8), size=size)
    scene.lights = list(lights)
    return scene


def cornell(size: int = 32) -> Scene:
    """A Cornell box of side 2 about the origin, open towards -y, with an emissive square under its ceiling."""
    scene = Scene(width=size, height=size)
    scene.camera = camera(origin=(0, -4.4, 0), half_width=0.32)
    scene.materials = [
        Material("white", kd=(0.75, 0.75, 0.75)),
        Material("red", kd=(0.6, 0.05, 0.05)),
        Material("green", kd=(0.1, 0.5, 0.1)),
        Material("lamp", emission=(12.0, 10.0, 7.0)),
    ]
    walls = {
        "floor": ((-1, -1, -1), (2, 0, 0), (0, 2, 0), 0),
        "ceiling": ((-1, -1, 1), (0, 2, 0), (2, 0, 0), 0),
        "back": ((-1, 1, -1), (2, 0, 0), (0, 0, 2), 0),
        "left": ((-1, -1, -1), (0, 2, 0), (0, 0, 2), 1),
        "right": ((1, -1, -1), (0, 0, 2), (0, 2, 0), 2),
        "lamp": ((-0.25, -0.25, 0.98), (0, 0.5, 0), (0.5, 0, 0), 3),
    }
    for name, (corner, u, v, material) in walls.items():
        scene.add_instance(quad_mesh(corner, u, v, name), materials=(material,))
    cube = cube_mesh()
    scene.add_instance(cube, _turned((0.35, -0.3, -0.7), 0.3, (0.3, 0.3, 0.3)), name="short block")
    scene.add_instance(cube, _turned((-0.35, 0.35, -0.4), -0.3, (0.28, 0.28, 0.6)), name="tall block")
    return scene


def phong_plates(size: int = 32) -> Scene:
    """Three plates of rising exponent under a small and a large emissive sphere: Phong with MIS at work."""
    scene = Scene(width=size, height=size, camera=camera(origin=(0, -5, 2.5), towards=(0, 5, -2.2), half_width=0.35))
    scene.materials = [
        Material("emitter", emission=(6.0, 6.0, 5.0)),
        Material("floor", kd=(0.4, 0.4, 0.4)),
        *(Material(f"phong {n}", kd=(0.05,) * 3, ks=(0.6,) * 3, exponent=float(n)) for n in (10, 100, 2000)),
    ]
    scene.add_instance(quad_mesh((-6, -6, -0.5), (12, 0, 0), (0, 12, 0), "floor"), materials=(1,))
    for k in range(3):
        tilt = 0.15 + 0.2 * k
        corner = (-1.2, 0.9 * k - 0.9, 0.25 * k)
        depth = (0.0, 0.8 * np.cos(tilt), 0.8 * np.sin(tilt))
        scene.add_instance(quad_mesh(corner, (2.4, 0, 0), depth, f"plate {k}"), materials=(2 + k,))
    ball = sphere_mesh(12, smooth=True, name="ball")
    for x, radius in ((-0.7, 0.08), (0.5, 0.35)):
        transform = np.column_stack([np.eye(3) * radius, (x, 1.6, 2.2)])
        scene.add_instance(ball, transform, materials=(0,), name=f"ball {radius}")
    return scene


def lamp(kind: str) -> Lamp:
    """One lamp of each kind that both roads know, roughly as bright as the others on a plate two metres below."""
    above, slanted = place((0.3, 0.2, 2)), place((0.8, -0.4, 1.8), (-0.4, 0.2, -0.9))
    return {
        "point": PointLight(kind, above, intensity=(4.0, 4.0, 3.0)),
        "sphere": PointLight(kind, above, intensity=(4.0, 4.0, 3.0), radius=0.4),
        "soft": PointLight(kind, above, intensity=(4.0, 4.0, 3.0), radius=0.4, soft_falloff=True),
        "spot": SpotLight(kind, slanted, intensity=(6.0, 5.0, 4.0), half_angle=0.5, blend=0.4),
        "spot_sphere": SpotLight(kind, slanted, intensity=(6.0, 5.0, 4.0), radius=0.2, half_angle=0.5, blend=0.4),
        "spot_soft": SpotLight(
            kind, slanted, intensity=(6.0, 5.0, 4.0), radius=0.2, half_angle=0.5, blend=0.4, soft_falloff=True
        ),
        "area": AreaLight(kind, slanted, radiance=(3.0, 2.0, 2.0), size_x=1.5, size_y=0.6),
        "ellipse": AreaLight(kind, slanted, radiance=(3.0, 2.0, 2.0), size_x=1.5, size_y=0.6, ellipse=True),
        "spread": AreaLight(kind, slanted, radiance=(3.0, 2.0, 2.0), size_x=1.5, size_y=0.6, spread=1.0),
        "sun": SunLight(kind, slanted, irradiance=(2.0, 2.0, 1.5)),
        "wide_sun": SunLight(kind, slanted, irradiance=(2.0, 2.0, 1.5), angle=0.5),
    }[kind]


# Every key of `lamp`.
LAMP_KINDS = (
    "point",
    "sphere",
    "soft",
    "spot",
    "spot_sphere",
    "spot_soft",
    "area",
    "ellipse",
    "spread",
    "sun",
    "wide_sun",
)


def lamp_room(kinds: list[str], size: int = 32, ks: float = 0.3, exponent: float = 30.0) -> Scene:
    """A plate with a ball on it under the lamps named, a little world light: shadows, gloss and visible lamps."""
    scene = Scene(width=size, height=size, camera=camera(origin=(0, -4, 2.2), towards=(0, 4, -1.6), half_width=0.5))
    scene.materials = [
        Material("floor", kd=(0.5, 0.45, 0.4), ks=(ks,) * 3, exponent=exponent),
        Material("ball", kd=(0.2, 0.4, 0.6), ks=(ks,) * 3, exponent=4 * exponent),
    ]
    scene.add_instance(quad_mesh((-4, -4, 0), (8, 0, 0), (0, 8, 0), "floor"))
    ball = sphere_mesh(16, radius=0.5, smooth=True, name="ball")
    scene.add_instance(ball, np.column_stack([np.eye(3), (-0.3, 0.2, 0.5)]), materials=(1,))
    scene.lights = [lamp(kind) for kind in kinds]
    for k, light in enumerate(scene.lights):
        light.transform[:, 3] += (0.04 * k, 0.03 * k, 0.02 * k)  # no two shapes coincide: which is met first?
    scene.world = World(color=(0.05, 0.06, 0.08))
    return scene


def sky_image(height: int = 16, width: int = 32) -> np.ndarray:
    """(height, width, 3) float32: a dim gradient with one bright patch, so that importance sampling matters."""
    v = (np.arange(height) + 0.5)[:, None] / height
    u = (np.arange(width) + 0.5)[None, :] / width
    sky = 0.2 + 0.5 * v + 0.1 * np.cos(2 * np.pi * u)
    patch = 20.0 * ((np.abs(u - 0.3) < 0.05) & (np.abs(v - 0.75) < 0.07))
    return np.stack([sky + patch, sky + 0.9 * patch, 1.2 * sky + 0.7 * patch], -1).astype(np.float32)


def sky_plate(size: int = 32) -> Scene:
    """`lamp_room` without lamps under an equirectangular image."""
    scene = lamp_room([], size)
    angle = 0.7
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1.0]])
    scene.world = World(color=(0.8, 0.8, 0.8), image=sky_image(), rotation=turn)
    return scene


def _turned(origin, angle: float, scale) -> np.ndarray:
    """(3, 4): scale, then a turn about z, then a move."""
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]) * np.asarray(scale)
    return np.column_stack([turn, origin])
