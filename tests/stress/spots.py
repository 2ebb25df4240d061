"""Where the sample scenes have a surface to put a lamp on, and an object to put it or the camera into; and lamps there.

The functions that change a scene give a new one, with another picture.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scenes

from engine.scene import RGB, AreaLight, Lamp, Material, PointLight, Scene, Visibility, World

RADIANCE = 2.0
UNSEEN = Visibility.ALL & ~Visibility.CAMERA
LIFT = 1e-4  # of a lamp's size: so far off the surface, it lights the scene as if it touched it


@dataclass(frozen=True)
class Spot:
    """Of one sample scene: a piece of ground in view with room above it, and the inside of a closed object.

    ground, point  a mesh, and where on it (x, y), metres
    size           of lamps there, metres
    object, faces  a mesh whose first so many triangles are closed
    """

    ground: str
    point: tuple[float, float]
    size: float
    object: str
    faces: int | None = None


SPOTS = (  # told by the object
    Spot("Box", (-0.8, 1.0), 0.3, "Short block"),
    Spot("Wall", (0.0, -6.0), 0.5, "Plate 20"),
    Spot("Floor", (0.0, -2.0), 0.5, "Ball"),
    Spot("Ground", (0.4, -2.5), 0.3, "Mirror ball"),
    Spot("Terrain", (0.0, -55.0), 0.5, "Tree 0"),
    Spot("Ground", (0.4, -60.0), 2.0, "Houses", faces=12),
)


def spot(scene: Scene) -> Spot:
    return next(spot for spot in SPOTS if any(mesh.name == spot.object for mesh in scene.meshes))


def ground(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """The spot's point (3,) in float64, exactly in the plane of its triangle, and the normal (3,) upwards."""
    here = spot(scene)
    corners = _world_triangles(scene, here.ground)[0]
    a, u, v = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normals = np.cross(u, v)
    level = np.abs(normals[:, 2]) > 0.5 * np.linalg.norm(normals, axis=1)
    area = np.where(level, normals[:, 2], 1.0)
    d = np.asarray(here.point) - a[:, :2]
    s, t = (d[:, 0] * v[:, 1] - d[:, 1] * v[:, 0]) / area, (u[:, 0] * d[:, 1] - u[:, 1] * d[:, 0]) / area
    points = a + s[:, None] * u + t[:, None] * v
    inside = level & (s >= 0) & (t >= 0) & (s + t <= 1)
    lowest = np.argmin(np.where(inside, points[:, 2], np.inf))
    assert inside[lowest], "the spot is beside its ground"
    return points[lowest], normals[lowest] * np.sign(area[lowest]) / np.linalg.norm(normals[lowest])


def inside(scene: Scene) -> np.ndarray:
    """(3,), within the spot's object."""
    here = spot(scene)
    corners, transform = _world_triangles(scene, here.object)
    corners = corners[: here.faces].reshape(-1, 3)
    if here.object == "Tree 0":  # its cones are closed, but for a hole of 4 mm at their tips
        return transform @ (0.2, 0.0, 0.4, 1.0)
    return (corners.min(axis=0) + corners.max(axis=0)) / 2


def _world_triangles(scene: Scene, name: str) -> tuple[np.ndarray, np.ndarray]:
    """(T, 3, 3) of the first instance of a mesh, and its transform (3, 4)."""
    index = next(k for k, mesh in enumerate(scene.meshes) if mesh.name == name)
    transform = scene.instances.transforms[np.argmax(scene.instances.mesh == index)]
    mesh = scene.meshes[index]
    corners = mesh.vertices[mesh.triangles].astype(np.float64)
    return corners @ transform[:, :3].T + transform[:, 3], transform


# Lamps


def with_lamps(scene: Scene, *lamps: Lamp) -> Scene:
    return replace(scene, lights=[*scene.lights, *lamps])


def ball(centre, radius: float, radiance: float = RADIANCE, **more) -> PointLight:
    intensity = (np.pi * radius**2 * radiance,) * 3
    return PointLight("ball", scenes.place(centre), intensity=intensity, radius=radius, **more)


def square(centre, towards, size: float) -> AreaLight:
    return AreaLight(
        "square", scenes.place(centre, towards), UNSEEN, radiance=(RADIANCE,) * 3, size_x=size, size_y=size
    )


def ball_at(height: float) -> Callable[[Scene], Scene]:
    """So many times its radius above the ground."""

    def change(scene: Scene) -> Scene:
        point, up = ground(scene)
        return with_lamps(scene, ball(point + height * spot(scene).size * up, spot(scene).size))

    return change


def square_at(height: float, towards: int) -> Callable[[Scene], Scene]:
    """So many times its size above the ground, facing up (1) or down (-1)."""

    def change(scene: Scene) -> Scene:
        point, up = ground(scene)
        return with_lamps(scene, square(point + height * spot(scene).size * up, towards * up, spot(scene).size))

    return change


def lamp_inside(scene: Scene) -> Scene:
    """In a closed object, small enough for the thinnest of them."""
    return with_lamps(scene, ball(inside(scene), 0.01, visibility=UNSEEN))


def both_kinds(scene: Scene) -> Scene:
    """Besides its own a ball and a square, so that every scene has both."""
    return square_at(5.0, -1)(ball_at(4.0)(scene))


def with_radius(radius: float) -> Callable[[Scene], Scene]:
    """All lamps that have one, as bright from afar."""

    def change(scene: Scene) -> Scene:
        lamps = both_kinds(scene).lights
        return replace(scene, lights=[replace(x, radius=radius) if isinstance(x, PointLight) else x for x in lamps])

    return change


def with_size(size: float, same_power: bool = True) -> Callable[[Scene], Scene]:
    """All area lights."""

    def change(lamp: Lamp) -> Lamp:
        if not isinstance(lamp, AreaLight):
            return lamp
        factor = lamp.size_x * lamp.size_y / size**2 if same_power else 1.0
        red, green, blue = (x * factor for x in lamp.radiance)
        return replace(lamp, size_x=size, size_y=size, radiance=(red, green, blue))

    return lambda scene: replace(scene, lights=[change(lamp) for lamp in both_kinds(scene).lights])


def without_area_lights(scene: Scene) -> Scene:
    lamps = both_kinds(scene).lights
    return replace(scene, lights=[lamp for lamp in lamps if not isinstance(lamp, AreaLight)])


# The world


def without_lamps(scene: Scene) -> Scene:
    materials = [replace(material, emission=(0.0,) * 3) for material in scene.materials]
    return replace(scene, lights=[], materials=materials)


def with_world(scene: Scene, factor: float) -> Scene:
    """The scene's own world so many times as bright, or one of that radiance where it is black."""
    color: RGB = scene.world.color if max(scene.world.color) > 0 else (1.0, 1.0, 1.0)
    red, green, blue = (x * factor for x in color)
    return replace(scene, world=replace(scene.world, color=(red, green, blue)))


def plain_world(scene: Scene, radiance: float = RADIANCE, seen: bool = True) -> Scene:
    """Lit by nothing but a world of one colour."""
    world = World(color=(radiance,) * 3, visibility=Visibility.ALL if seen else UNSEEN)
    return replace(without_lamps(scene), world=world)


def enclosed(radius: float) -> Callable[[Scene], Scene]:
    """A world of one colour that the camera doesn't see, made by a lamp around everything."""
    return lambda scene: with_lamps(plain_world(scene, 0.0), ball(ground(scene)[0], radius, visibility=UNSEEN))


# Cameras


def camera_at(scene: Scene, place: np.ndarray) -> Scene:
    assert scene.camera is not None
    transform = np.column_stack([scene.camera.transform[:, :3], place])
    return replace(scene, camera=replace(scene.camera, transform=transform, clip_start=0.0))


def camera_inside(scene: Scene) -> Scene:
    return camera_at(scene, inside(scene))


def camera_on_ground(scene: Scene) -> Scene:
    return camera_at(scene, ground(scene)[0])


def camera_inside_lamp(scene: Scene) -> Scene:
    """A ball about the camera; it hides nothing, so that the rest is black."""
    assert scene.camera is not None
    return with_lamps(plain_world(black(scene), 0.0), ball(scene.camera.transform[:, 3], 0.2))


# Materials


def with_materials(scene: Scene, change: Callable[[Material], Material]) -> Scene:
    return replace(scene, materials=[change(material) for material in scene.materials])


def black(scene: Scene) -> Scene:
    """What shines goes on shining."""
    return with_materials(scene, lambda m: replace(m, kd=(0.0,) * 3, ks=(0.0,) * 3))


def white(kd: float, ks: float) -> Callable[[Scene], Scene]:
    return lambda scene: with_materials(scene, lambda m: replace(m, kd=(kd,) * 3, ks=(ks,) * 3, exponent=1e4))


def with_exponent(exponent: float) -> Callable[[Scene], Scene]:
    """Half of each surface's light in the lobe."""

    def change(material: Material) -> Material:
        red, green, blue = (0.5 * (d + s) for d, s in zip(material.kd, material.ks, strict=True))
        return replace(material, kd=(red, green, blue), ks=(red, green, blue), exponent=exponent)

    return lambda scene: with_materials(scene, change)
