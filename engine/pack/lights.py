"""All emitters to light tables: suns and the world are packed here, the rest in `lamps` and `emitters`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..accel import SphereGeometry, TriangleGeometry
from ..features import (
    CONSTANT_WORLD,
    DARK_WORLD,
    EMITTER_TREE,
    IMAGE_WORLD,
    LISTED_LAMPS,
    NO_EMITTER,
    ONE_EMITTER,
    TRACED_LAMPS,
)
from ..kernels import tables as t
from ..kernels.geom.vec import LUMINANCE
from ..kernels.light.environment import EnvironmentTable, build_environment, environment_irradiance
from ..memory import OF_NEW_TEXEL, foresee, need_of_environment
from ..scene import BLACK, AreaLight, Camera, Lamp, PointLight, Scene, SunLight, Visibility, World
from ..validate import SMALLEST_SIZE
from .emitters import SCATTERED_RAYS, choice_tree, join_emitters, lamp_emitters, mesh_emitters
from .geometry import PackedGeometry, fresh
from .lamps import RAYS_THAT_SEE, lamp_shapes, lamps_that_rays_meet, pack_area, pack_points, unit
from .middle import surface_bounds

NO_IMAGE = np.zeros((1, 1, 3), np.float32)
# Of a sun or the world, in W/m2: sums stay finite.
LARGEST_IMPORTANCE = 1e30


@dataclass
class PackedLights:
    """`shapes` are the lamps' Embree geometries, with the kind and the base of each; `reach` is the largest coordinate
    that they suit, 0 where it doesn't matter."""

    tables: t.Lights
    tree: tuple
    environment: EnvironmentTable
    shapes: list[TriangleGeometry | SphereGeometry]
    shape_kind: list[int]
    shape_base: list[int]
    reach: float
    features: dict[str, int]


def pack_lights(
    scene: Scene, geometry: PackedGeometry, environment: EnvironmentTable | None = None, room: float = 1.0
) -> PackedLights:
    """Everything that shines. `geometry` is the same scene's.

    environment  of the world's image, where it is there already
    room         how much farther than the scene the lamps' shapes are to reach
    """
    lit = [light for light in scene.lights if _shines(light)]
    local: list[Lamp] = [light for light in lit if isinstance(light, PointLight | AreaLight)]
    suns = [light for light in lit if isinstance(light, SunLight)]
    reach = room * lamp_reach(scene)
    rows, kinds = _pack_local(local, reach)
    emitter_triangle, rectangles, triangle_emitter, of_meshes = mesh_emitters(geometry, len(local))
    emitter_mask = geometry.visibility[emitter_triangle]
    masks = rows[:, t.LAMP_MASK].astype(np.int64)
    listed, traced = lamps_that_rays_meet(kinds, rows, masks)
    shapes, shape_kind, shape_base, of_quad, of_sphere = lamp_shapes(traced, kinds, rows, masks)
    emitters = join_emitters(lamp_emitters(local, kinds, rows), of_meshes)
    count = len(emitters.power)
    world_kind = _world_kind(scene.world)
    if environment is None:
        if world_kind == IMAGE_WORLD:
            foresee(need_of_environment(scene.world, OF_NEW_TEXEL))
        environment = build_environment(_world_image(scene.world, world_kind))
    groups = int(count > 0) + int(bool(suns)) + int(world_kind == IMAGE_WORLD)
    tables = t.Lights(
        lamps=rows,
        lamp_kind=kinds,
        listed_lamps=listed,
        lamp_of_quad=of_quad,
        lamp_of_sphere=of_sphere,
        emitter_triangle=emitter_triangle,
        triangle_emitter=triangle_emitter,
        emitter_mask=emitter_mask,
        emitter_rectangle=rectangles,
        suns=np.array([_pack_sun(sun) for sun in suns], np.float32).reshape(-1, t.SUN_WORDS),
        world=_pack_world(scene.world, environment),
        world_rotation=fresh(scene.world.rotation, np.float32),
    )
    features = {
        "mesh_emitters": int(len(emitter_triangle) > 0),
        "rectangle_emitters": int(len(rectangles) > 0),
        "lamp_kinds": int(np.bitwise_or.reduce(kinds)) if len(kinds) else 0,
        "lamp_shapes": LISTED_LAMPS * bool(len(listed)) | TRACED_LAMPS * bool(len(traced)),
        "unshadowed": int(any(not light.cast_shadow for light in lit)),
        "emitter_choice": NO_EMITTER if count == 0 else ONE_EMITTER if count == groups == 1 else EMITTER_TREE,
        "ray_kinds": int(_kinds_differ(scene)),
        "suns": int(bool(suns)),
        "sun_disks": int(any(sun.angle >= SMALLEST_SIZE for sun in suns)),
        "world": world_kind,
    }
    return PackedLights(
        tables=tables,
        tree=choice_tree(emitters, groups),
        environment=environment,
        shapes=shapes,
        shape_kind=shape_kind,
        shape_base=shape_base,
        reach=reach,
        features=features,
    )


def _pack_local(local: list[Lamp], reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Rows and kinds of the lamps that stand somewhere. reach: see `pack_area`."""
    rows, kinds = np.zeros((len(local), t.LAMP_WORDS), np.float32), np.zeros(len(local), np.int32)
    points = [i for i, light in enumerate(local) if isinstance(light, PointLight)]
    rows[points], kinds[points] = pack_points([light for light in local if isinstance(light, PointLight)])
    for i, light in enumerate(local):
        if isinstance(light, AreaLight):
            kinds[i] = pack_area(rows[i], light, reach)
    rows[:, t.UNSHADOWED] = [not light.cast_shadow for light in local]
    rows[:, t.LAMP_MASK] = [int(light.visibility) & int(RAYS_THAT_SEE) for light in local]
    return rows, kinds


def lamp_reach(scene: Scene) -> float:
    """The largest coordinate of its surfaces and of the camera; 0 without lamps whose shapes have to suit it."""
    if not any(isinstance(light, AreaLight) and _shines(light) for light in scene.lights):
        return 0.0
    bounds = surface_bounds(scene)
    assert scene.camera is not None
    return max(camera_reach(scene.camera), 0.0 if bounds is None else float(np.abs(bounds).max()))


def camera_reach(camera: Camera) -> float:
    """The largest coordinate of the camera."""
    return float(np.abs(camera.transform[:, 3]).max())


def _kinds_differ(scene: Scene) -> bool:
    """Whether diffuse and glossy rays have to be told apart, as something is hidden from either."""
    both = int(Visibility.DIFFUSE | Visibility.GLOSSY)
    placed = np.unique(scene.instances.visibility)
    masks = {int(light.visibility) for light in scene.lights} | {int(scene.world.visibility), *placed[placed > 0]}
    return any(mask & both != both for mask in masks)


def _shines(light: Lamp) -> bool:
    """Whether any ray can find light there. What cannot is left out: it would be drawn for nothing."""
    color = BLACK
    if isinstance(light, AreaLight):
        color = light.radiance
    elif isinstance(light, SunLight):
        color = light.irradiance
    elif isinstance(light, PointLight):
        color = light.intensity
    return any(color) and int(light.visibility) & int(RAYS_THAT_SEE) != 0


def _world_kind(world: World) -> int:
    if not any(world.color):
        return DARK_WORLD
    return CONSTANT_WORLD if world.image is None else IMAGE_WORLD


def _world_image(world: World, kind: int) -> np.ndarray:
    """Not copied if it is as `fresh` would make it: such an image may be large."""
    if kind != IMAGE_WORLD or world.image is None:
        return NO_IMAGE
    return np.require(world.image, np.float32, ["C", "A", "W", "E"])


def _pack_sun(light: SunLight) -> np.ndarray:
    row = np.zeros(t.SUN_WORDS, np.float32)
    row[t.SUN_AXIS : t.SUN_AXIS + 3] = unit(np.asarray(light.transform, np.float64)[:, 2])
    row[t.SUN_UNSHADOWED] = float(not light.cast_shadow)
    row[t.SUN_MASK] = float(int(light.visibility & RAYS_THAT_SEE))
    irradiance = np.asarray(light.irradiance, np.float64)
    if light.visibility & SCATTERED_RAYS:
        row[t.SUN_IRRADIANCE] = min(irradiance @ LUMINANCE, LARGEST_IMPORTANCE)
    row[t.SUN_COS] = 1
    half = light.angle / 2
    if light.angle >= SMALLEST_SIZE:
        row[t.SUN_RADIANCE : t.SUN_RADIANCE + 3] = irradiance / (np.pi * np.sin(half) ** 2)
        row[t.SUN_ONE_MINUS_COS] = 2 * np.sin(half / 2) ** 2
        row[t.SUN_COS], row[t.SUN_SIN] = np.cos(half), np.sin(half)
    else:
        row[t.SUN_RADIANCE : t.SUN_RADIANCE + 3] = irradiance
    return row


def _pack_world(world: World, environment: EnvironmentTable) -> np.ndarray:
    row = np.zeros(t.WORLD_WORDS, np.float32)
    row[t.WORLD_COLOR : t.WORLD_COLOR + 3] = world.color
    row[t.WORLD_MASK] = float(int(world.visibility))
    if world.visibility & SCATTERED_RAYS:
        irradiance = environment_irradiance(environment) * (np.asarray(world.color) @ LUMINANCE)
        irradiance[1:] = irradiance[1:] @ np.asarray(world.rotation, np.float64)
        row[t.WORLD_IRRADIANCE : t.WORLD_IRRADIANCE + 4] = np.clip(irradiance, -LARGEST_IMPORTANCE, LARGEST_IMPORTANCE)
    return row
