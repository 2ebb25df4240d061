"""Lamps, suns, emissive triangles and the world to light tables, and the tree that chooses among them."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from ..accel import SphereGeometry, TriangleGeometry
from ..features import (
    CONSTANT_WORLD,
    DARK_WORLD,
    DISK,
    ELLIPSE,
    EMITTER_TREE,
    IMAGE_WORLD,
    NO_EMITTER,
    ONE_EMITTER,
    POINT,
    RECTANGLE,
    SPHERE,
    SPOT,
)
from ..kernels import tables as t
from ..kernels.geom.vec import LUMINANCE
from ..kernels.light.environment import EnvironmentTable, build_environment, environment_irradiance
from ..lighttree import build_light_tree
from ..scene import BLACK, AreaLight, Lamp, PointLight, Scene, SpotLight, SunLight, Visibility, World
from ..validate import SMALLEST_SIZE
from .geometry import VERTEX_PADDING, PackedGeometry, own

NO_IMAGE = np.zeros((1, 1, 3), np.float32)
SCATTERED_RAYS = Visibility.DIFFUSE | Visibility.GLOSSY
RAYS_THAT_SEE = Visibility.CAMERA | SCATTERED_RAYS
# Below this half spread, 1 / (tan h - h) cancels in float64: its series is 3 / h^3. Its cube must fit float32.
SMALL_SPREAD, SMALLEST_SPREAD = 1e-3, 1e-10
# Of a sun or the world, in W/m2: sums stay finite.
LARGEST_IMPORTANCE = 1e30
# Lamps coincide if their shapes do up to this power of two of their largest coordinate.
COINCIDENT_BITS = 18
# How far, in parts of its size, two triangles may be off a rectangle and still be sampled as one.
RECTANGLE_TOLERANCE = 1e-5


@dataclass
class PackedLights:
    """`shapes` are the lamps' Embree geometries, with the kind and the base of each."""

    tables: t.Lights
    tree: tuple
    environment: tuple
    shapes: list[TriangleGeometry | SphereGeometry]
    shape_kind: list[int]
    shape_base: list[int]
    features: dict[str, int]


@dataclass
class Emitters:
    """What the light tree is built from; the meaning of each array is in engine/lighttree.py."""

    bounds: np.ndarray
    axis: np.ndarray
    theta_o: np.ndarray
    theta_e: np.ndarray
    power: np.ndarray
    two_sided: np.ndarray


def pack_lights(scene: Scene, geometry: PackedGeometry) -> PackedLights:
    """Adds the quads of area lamps to the geometry's vertex and triangle buffers, as Embree shares them."""
    lit = [light for light in scene.lights if _shines(light)]
    local: list[Lamp] = [light for light in lit if isinstance(light, PointLight | AreaLight)]
    suns = [light for light in lit if isinstance(light, SunLight)]
    rows = np.zeros((len(local), t.LAMP_WORDS), np.float32)
    kinds = np.zeros(len(local), np.int32)
    for i, light in enumerate(local):
        if isinstance(light, PointLight):
            kinds[i] = _pack_point(rows[i], light)
        elif isinstance(light, AreaLight):
            kinds[i] = _pack_area(rows[i], light)
        rows[i, t.UNSHADOWED] = float(not light.cast_shadow)
        rows[i, t.LAMP_MASK] = float(int(light.visibility & RAYS_THAT_SEE))

    emitter_triangle, rectangles, triangle_emitter, mesh_emitters = _mesh_emitters(geometry, len(local))
    emitter_mask = geometry.visibility[emitter_triangle]
    twin, is_first, masks = _coincident(local, kinds, rows)
    shapes, shape_kind, shape_base, of_quad, of_sphere = _lamp_shapes(kinds, rows, np.where(is_first, masks, 0))
    emitters = _join_emitters(_lamp_emitters(local, kinds, rows), mesh_emitters)
    count = len(emitters.power)
    world_kind = _world_kind(scene.world)
    environment = build_environment(_world_image(scene.world, world_kind))
    groups = int(count > 0) + int(bool(suns)) + int(world_kind == IMAGE_WORLD)
    tables = t.Lights(
        lamps=rows,
        lamp_kind=kinds,
        lamp_of_quad=of_quad,
        lamp_of_sphere=of_sphere,
        lamp_twin=twin,
        emitter_triangle=emitter_triangle,
        triangle_emitter=triangle_emitter,
        emitter_mask=emitter_mask,
        emitter_rectangle=rectangles,
        suns=np.array([_pack_sun(sun) for sun in suns], np.float32).reshape(-1, t.SUN_WORDS),
        world=_pack_world(scene.world, environment),
        world_rotation=own(scene.world.rotation, np.float32),
    )
    features = {
        "mesh_emitters": int(len(emitter_triangle) > 0),
        "rectangle_emitters": int(len(rectangles) > 0),
        "lamp_kinds": int(np.bitwise_or.reduce(kinds)) if len(kinds) else 0,
        "lamp_shapes": int(bool(shapes)),
        "unshadowed": int(any(not light.cast_shadow for light in lit)),
        "emitter_choice": NO_EMITTER if count == 0 else ONE_EMITTER if count == groups == 1 else EMITTER_TREE,
        "ray_kinds": int(_kinds_differ(scene)),
        "suns": int(bool(suns)),
        "sun_disks": int(any(sun.angle >= SMALLEST_SIZE for sun in suns)),
        "world": world_kind,
    }
    return PackedLights(
        tables=tables,
        tree=_tree(emitters, groups),
        environment=environment,
        shapes=shapes,
        shape_kind=shape_kind,
        shape_base=shape_base,
        features=features,
    )


def _kinds_differ(scene: Scene) -> bool:
    """Whether diffuse and glossy rays have to be told apart, as something is hidden from either."""
    both = Visibility.DIFFUSE | Visibility.GLOSSY
    placed = np.unique(scene.instances.visibility)
    masks = [light.visibility for light in scene.lights] + [scene.world.visibility] + [int(v) for v in placed if v]
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
    return any(color) and bool(light.visibility & RAYS_THAT_SEE)


def _world_kind(world: World) -> int:
    if not any(world.color):
        return DARK_WORLD
    return CONSTANT_WORLD if world.image is None else IMAGE_WORLD


def _world_image(world: World, kind: int) -> np.ndarray:
    """Not copied if it is as `own` would make it: such an image may be large."""
    if kind != IMAGE_WORLD or world.image is None:
        return NO_IMAGE
    return np.require(world.image, np.float32, ["C", "A", "W", "E"])


def _unit(v: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(v)
    return v / length if length > 0 else np.array([0.0, 0.0, 1.0])


def _pack_point(row: np.ndarray, light: PointLight) -> int:
    """Point, sphere, disk and spot lamps. Returns the kind."""
    matrix = np.asarray(light.transform, np.float64)
    row[t.POSITION : t.POSITION + 3] = matrix[:, 3]
    row[t.AXIS : t.AXIS + 3] = -_unit(matrix[:, 2])
    radius = light.radius if light.radius >= SMALLEST_SIZE else 0.0
    row[t.SIZE : t.SIZE + 2] = radius
    intensity = np.asarray(light.intensity, np.float64)
    if radius > 0:
        kind = DISK if light.soft_falloff else SPHERE
        row[t.RADIANCE : t.RADIANCE + 3] = intensity / (np.pi * radius**2)
    else:
        kind = POINT
        row[t.RADIANCE : t.RADIANCE + 3] = intensity
    if isinstance(light, SpotLight):
        kind |= SPOT
        cos_half = np.cos(light.half_angle)
        row[t.SPOT_COS] = cos_half
        # smoothstep clamps, so a huge finite factor is the hard edge that blend = 0 asks for.
        row[t.SPOT_SCALE] = min(1 / max((1 - cos_half) * light.blend, 1e-12), 1e12)
        row[t.TO_LOCAL : t.TO_LOCAL + 9] = np.linalg.pinv(matrix[:, :3]).ravel()
    return kind


def _pack_area(row: np.ndarray, light: AreaLight) -> int:
    """Rectangle and ellipse lamps. Returns the kind.

    The lamp is the image of the square or disk under its matrix, shear and all: it lies in the plane of the two axes
    and shines to the side where the local -z points. Cycles takes the axes likewise, but the -z column itself for the
    normal, which under a shear is none.
    """
    matrix = np.asarray(light.transform, np.float64)
    x, y = matrix[:, 0] * light.size_x, matrix[:, 1] * light.size_y
    row[t.POSITION : t.POSITION + 3] = matrix[:, 3]
    row[t.AXIS_X : t.AXIS_X + 3] = _unit(x)
    row[t.AXIS_Y : t.AXIS_Y + 3] = _unit(y)
    across = np.cross(x, y)
    row[t.AXIS : t.AXIS + 3] = _unit(-across if across @ matrix[:, 2] >= 0 else across)
    row[t.AREA] = np.linalg.norm(across) * (np.pi / 4 if light.ellipse else 1)
    row[t.TO_LOCAL : t.TO_LOCAL + 6] = np.linalg.pinv(np.column_stack([x / 2, y / 2])).ravel()
    row[t.RADIANCE : t.RADIANCE + 3] = light.radiance
    row[t.SIZE], row[t.SIZE + 1] = np.linalg.norm(x) / 2, np.linalg.norm(y) / 2
    half = light.spread / 2
    if half < np.pi / 2 - 1e-6:
        row[t.TAN_SPREAD] = np.tan(half)
        row[t.SPREAD_NORM] = 1 / (np.tan(half) - half) if half > SMALL_SPREAD else 3 / max(half, SMALLEST_SPREAD) ** 3
    return ELLIPSE if light.ellipse else RECTANGLE


def _pack_sun(light: SunLight) -> np.ndarray:
    row = np.zeros(t.SUN_WORDS, np.float32)
    row[t.SUN_AXIS : t.SUN_AXIS + 3] = _unit(np.asarray(light.transform, np.float64)[:, 2])
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


def _coincident(local: list[Lamp], kinds: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lamps with the same shape at the same place, as copies of a lamp or two back to back: a ray meets only one.

    Returns (the next such lamp of each, -1: none; whether it is the first; the visibility of all of them).
    """
    twin, is_first = np.full(len(local), -1, np.int32), np.ones(len(local), np.bool_)
    masks = np.array([int(light.visibility & RAYS_THAT_SEE) for light in local], np.int64)
    last: dict[tuple, tuple[int, int]] = {}
    for i, row in enumerate(rows):
        if kinds[i] & POINT:
            continue
        place = _place(kinds[i], row)
        first, previous = last.get(place, (i, -1))
        if previous >= 0:
            twin[previous], is_first[i] = i, False
            masks[first] |= masks[i]
        last[place] = first, i
    return twin, is_first, masks


def _place(kind: int, row: np.ndarray) -> tuple:
    """The lamp's shape, the same for lamps that only rounding tells apart."""
    flat = bool(kind & (RECTANGLE | ELLIPSE))
    points = _corners(row) if flat else np.array([[*row[t.POSITION : t.POSITION + 3], row[t.SIZE]]], np.float64)
    # A power of two: so round numbers lie in the middle of what is rounded to them.
    step = 2.0 ** np.floor(np.log2(max(np.abs(points).max() * 1.001, 1e-30)) - COINCIDENT_BITS)
    return flat, step, *sorted(tuple(p) for p in np.round(points / step).astype(np.int64).tolist())


def _lamp_shapes(kinds: np.ndarray, rows: np.ndarray, masks: np.ndarray):
    """Embree geometries of the lamps that some ray can meet, by visibility (0: no ray meets it).

    Returns (shapes, kind of each, base of each, lamp of each quad, lamp of each sphere).
    """
    shapes: list[TriangleGeometry | SphereGeometry] = []
    shape_kind: list[int] = []
    shape_base: list[int] = []
    of_quad: list[int] = []
    of_sphere: list[int] = []
    for mask in np.unique(masks[masks > 0]):
        quads = np.flatnonzero((masks == mask) & ((kinds & (RECTANGLE | ELLIPSE)) != 0))
        quads = quads[np.all(rows[quads, t.SIZE : t.SIZE + 2] > 0, axis=1)]
        if len(quads):
            shapes.append(_quads(np.array([_corners(rows[i]) for i in quads]), int(mask) << t.LAMP_SHIFT))
            shape_kind.append(t.LAMP_QUADS)
            shape_base.append(len(of_quad))
            of_quad.extend(quads)
        spheres = np.flatnonzero((masks == mask) & ((kinds & (SPHERE | DISK)) != 0))
        if len(spheres):
            points = np.ascontiguousarray(rows[spheres][:, [t.POSITION, t.POSITION + 1, t.POSITION + 2, t.SIZE]])
            shapes.append(SphereGeometry(points, int(mask) << t.LAMP_SHIFT))
            shape_kind.append(t.LAMP_SPHERES)
            shape_base.append(len(of_sphere))
            of_sphere.extend(spheres)
    return shapes, shape_kind, shape_base, np.array(of_quad, np.int32), np.array(of_sphere, np.int32)


def _corners(row: np.ndarray) -> np.ndarray:
    center = row[t.POSITION : t.POSITION + 3].astype(np.float64)
    x = row[t.AXIS_X : t.AXIS_X + 3] * float(row[t.SIZE])
    y = row[t.AXIS_Y : t.AXIS_Y + 3] * float(row[t.SIZE + 1])
    return np.array([center - x - y, center + x - y, center + x + y, center - x + y])


def _quads(corners: np.ndarray, mask: int) -> TriangleGeometry:
    """corners (Q, 4, 3): two triangles each."""
    vertices = np.zeros((4 * len(corners) + VERTEX_PADDING, 3), np.float32)
    vertices[:-VERTEX_PADDING] = corners.reshape(-1, 3)
    first = 4 * np.arange(len(corners))[:, None, None]
    return TriangleGeometry(vertices, (first + [[0, 1, 2], [0, 2, 3]]).reshape(-1, 3).astype(np.uint32), mask)


def _mesh_emitters(packed: PackedGeometry, lamp_count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, Emitters]:
    """Emissive surfaces with an area: the triangle of each emitter, its rectangle, the emitter of every triangle, and
    what the tree needs. Two triangles that make a rectangle are one emitter."""
    geometry = packed.tables
    glows = np.any(geometry.materials[:, t.EMISSION : t.EMISSION + 3] > 0, axis=1)
    lit = (
        np.flatnonzero(glows[geometry.triangle_slot[: packed.baked_count]]) if np.any(glows) else np.zeros(0, np.int64)
    )
    corners = geometry.vertices[geometry.triangles[lit]].astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    double_area = np.linalg.norm(normals, axis=1)
    keep = double_area > 0
    lit, corners, normals, double_area = lit[keep], corners[keep], normals[keep], double_area[keep]

    first, rectangles = _rectangles(geometry, lit)
    second = first + 1
    alone = np.ones(len(lit), bool)
    alone[second] = False
    emitter = np.cumsum(alone) - 1
    of_triangle = np.zeros(0, np.int32)
    if len(lit):
        of_triangle = np.full(len(geometry.triangles), -1, np.int32)
        of_triangle[lit] = lamp_count + emitter
    low, high = corners.min(axis=1), corners.max(axis=1)
    low[first], high[first] = np.minimum(low[first], low[second]), np.maximum(high[first], high[second])
    power = geometry.materials[geometry.triangle_slot[lit], t.EMISSION : t.EMISSION + 3] @ LUMINANCE * double_area / 2
    power[first] += power[second]
    power[(packed.visibility[lit] & int(SCATTERED_RAYS)) == 0] = 0  # only the camera sees it
    shape = np.zeros((int(alone.sum()), 9), np.float32)
    shape[emitter[first]] = rectangles
    emitters = Emitters(
        bounds=np.concatenate([low, high], axis=1)[alone].reshape(-1, 6),
        axis=(normals / double_area[:, None])[alone].reshape(-1, 3),
        theta_o=np.zeros(len(shape)),
        theta_e=np.full(len(shape), np.pi / 2),
        power=power[alone],
        two_sided=np.ones(len(shape), np.bool_),
    )
    return lit[alone].astype(np.uint32), shape if len(first) else shape[:0], of_triangle, emitters


def _rectangles(geometry: t.Geometry, lit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Neighbours in `lit` that make a rectangle: (places of the first of each two, (R, 9) corner and two edges)."""
    one, two = geometry.triangles[lit[:-1]].astype(np.int64), geometry.triangles[lit[1:]].astype(np.int64)
    shared = (one[:, :, None] == two[:, None, :]).any(axis=2)  # corners of the first that the second has too
    candidates = (
        (lit[1:] == lit[:-1] + 1)
        & (geometry.triangle_slot[lit[1:]] == geometry.triangle_slot[lit[:-1]])
        & (shared.sum(axis=1) == 2)
    )
    row = np.arange(len(one))
    apex = np.argmin(shared, axis=1)
    corner = geometry.vertices[one[row, apex]].astype(np.float64)
    edge_x = geometry.vertices[one[row, (apex + 1) % 3]] - corner
    edge_y = geometry.vertices[one[row, (apex + 2) % 3]] - corner
    opposite = np.argmin((two[:, :, None] == one[:, None, :]).any(axis=2), axis=1)
    far = geometry.vertices[two[row, opposite]] - corner
    size = np.linalg.norm(edge_x, axis=1) + np.linalg.norm(edge_y, axis=1)
    candidates &= np.linalg.norm(edge_x + edge_y - far, axis=1) < RECTANGLE_TOLERANCE * size
    candidates &= np.abs(np.sum(edge_x * edge_y, axis=1)) < RECTANGLE_TOLERANCE * size**2
    first: list[int] = []
    for place in np.flatnonzero(candidates):
        if not first or place > first[-1] + 1:
            first.append(int(place))
    chosen = np.array(first, np.int64)
    return chosen, np.concatenate([corner, edge_x, edge_y], axis=1)[chosen].astype(np.float32).reshape(-1, 9)


def _lamp_emitters(local: list[Lamp], kinds: np.ndarray, rows: np.ndarray) -> Emitters:
    """Bounds, orientation and power of the lamps. Power in the unit of the emissive triangles': radiance x area."""
    count = len(local)
    zero = np.zeros(count)
    out = Emitters(
        np.zeros((count, 6)), np.zeros((count, 3)), zero.copy(), zero.copy(), zero.copy(), np.zeros(count, np.bool_)
    )
    for i, (light, row) in enumerate(zip(local, rows, strict=True)):
        center = row[t.POSITION : t.POSITION + 3].astype(np.float64)
        radiance = float(row[t.RADIANCE : t.RADIANCE + 3] @ LUMINANCE)
        out.axis[i] = row[t.AXIS : t.AXIS + 3]
        if kinds[i] & (RECTANGLE | ELLIPSE):
            corners = _corners(row)
            low, high = corners.min(axis=0), corners.max(axis=0)
            out.theta_e[i] = light.spread / 2 if isinstance(light, AreaLight) else np.pi / 2
            out.power[i] = radiance * float(row[t.AREA]) * max(float(row[t.TAN_SPREAD] * row[t.SPREAD_NORM]), 1.0)
        else:
            radius = float(row[t.SIZE])
            low, high = center - radius, center + radius
            out.theta_o[i] = 0 if isinstance(light, SpotLight) else np.pi
            # Seen from the side of a wide lamp the cone's rim shines beyond its angle: keep it conservative.
            out.theta_e[i] = _spot_reach(light) if isinstance(light, SpotLight) else np.pi / 2
            out.power[i] = radiance * (np.pi * radius**2 if radius > 0 else 1)
        if not light.visibility & SCATTERED_RAYS:
            out.power[i] = 0  # only the camera sees it
        out.bounds[i] = [*low, *high]
    return out


def _spot_reach(light: SpotLight) -> float:
    """No less than the widest angle off the axis at which the cone shines, in world space, where scale and shear may
    have bent it.

    A direction of the cone's rim is M (z + e tan(half angle)) with a unit e across z: its part across the axis is at
    most the largest singular value of M's x and y columns without their parts along the axis, times the tangent; its
    part along the axis is the length of M z, less at most those parts.
    """
    matrix = np.asarray(light.transform, np.float64)[:, :3]
    if np.linalg.matrix_rank(matrix) < 3:
        return np.pi
    length = float(np.linalg.norm(matrix[:, 2]))
    axis, across = matrix[:, 2] / length, matrix[:, :2]
    along = axis @ across
    widest = np.linalg.norm(across - axis[:, None] * along, 2)
    tangent = np.tan(min(light.half_angle, np.pi / 2 - 1e-6))
    least = length - tangent * float(np.linalg.norm(along))
    return float(np.arctan(tangent * widest / least)) if least > 0 else np.pi


def _tree(e: Emitters, groups: int) -> tuple:
    """A single emitter needs no tree where there is nothing else to choose; an empty one has the same type."""
    used = slice(None) if len(e.power) > 1 or groups > 1 else slice(0, 0)
    return build_light_tree(
        e.bounds[used], e.axis[used], e.theta_o[used], e.theta_e[used], e.power[used], e.two_sided[used]
    )


def _join_emitters(a: Emitters, b: Emitters) -> Emitters:
    return Emitters(*(np.concatenate([getattr(a, f.name), getattr(b, f.name)]) for f in fields(Emitters)))
