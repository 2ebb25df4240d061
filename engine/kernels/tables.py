"""The arrays that a path kernel reads, by name. Filled by `engine/pack`; a table that a scene doesn't need has
no rows, and the kernel for that scene never looks at it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


def words(*places: int) -> tuple[np.int64, ...]:
    """Places in a row of a table. Not plain numbers: Numba compiles a function anew for each plain number that it is
    called with."""
    return tuple(np.int64(place) for place in places)


# Rays as bits of Embree's masks: surfaces carry `Visibility`, the shapes of lamps the same bits shifted.
CAMERA_RAY, DIFFUSE_RAY, GLOSSY_RAY, SHADOW_RAY = np.uint32(1), np.uint32(2), np.uint32(4), np.uint32(8)
LAMP_SHIFT = 4

# Kinds of Embree geometries in the top scene.
BAKED_MESH, INSTANCED_MESH, LAMP_QUADS, LAMP_SPHERES = 0, 1, 2, 3

# Words of a material.
KD, KS, EXPONENT, EMISSION, TRANSPARENCY, HOLDOUT, MATERIAL_WORDS = words(0, 3, 6, 7, 10, 13, 16)

# Words of a lamp. RADIANCE holds W/sr where the lamp is a point. SIZE: half the lengths along x and y, or the radius.
# SPOT_DROP: 1 - cos of half the cone's angle. TO_LOCAL: of spots, world to lamp space; of area lamps, two rows that
# give the place from the middle in half lengths.
POSITION, AXIS_X, AXIS_Y, AXIS, RADIANCE, SIZE = words(0, 3, 6, 9, 12, 15)
TAN_SPREAD, SPREAD_NORM, SPOT_DROP, SPOT_SCALE, TO_LOCAL, UNSHADOWED, LAMP_MASK, LAMP_WORDS = words(
    17, 18, 19, 20, 21, 30, 31, 32
)
# Of area lamps: m2, and how far before the lamp the shape lies by which rays meet it, metres.
AREA, SHAPE_STEP = SPOT_DROP, SPOT_SCALE

# Words of a sun. AXIS points from the scene to the sun. ONE_MINUS_COS, COS and SIN of the half angle; 0: a direction.
# IRRADIANCE: the luminance, on a plane that faces it; 0 if only the camera sees it.
SUN_AXIS, SUN_RADIANCE, SUN_ONE_MINUS_COS, SUN_UNSHADOWED, SUN_MASK, SUN_IRRADIANCE, SUN_COS, SUN_SIN, SUN_WORDS = (
    words(0, 3, 6, 7, 8, 9, 10, 11, 12)
)

# Words of the world. IRRADIANCE: the four numbers of `environment_irradiance`, with the normal in world space.
WORLD_COLOR, WORLD_MASK, WORLD_IRRADIANCE, WORLD_WORDS = words(0, 3, 4, 8)

# Numbers of `Surfaces`. MOVE_*: a length is stored times FACTOR, and a place is then off by the vector from X on.
MIST_START, MIST_PER_METRE, MIST_FALLOFF, AO_DISTANCE, MOVE_FACTOR, MOVE_X, LETS_THROUGH, SURFACE_NUMBERS = words(
    0, 1, 2, 3, 4, 5, 8, 9
)


class Geometry(NamedTuple):
    """Surfaces. Triangles of baked meshes come in world space, those of instanced meshes in object space.

    accel            (1,) uint64, address of the Embree scene
    vertices         (V, 3) float32, metres
    triangles        (T, 3) uint32
    triangle_slot    (T,) int32: baked: the material; instanced: the slot
    normals          (N, 3) float32, unit
    normal_triangles (T, 3) uint32, INVALID in flat triangles
    kind, base       (G,) int32 by Embree geometry id: what it is, and its first triangle or lamp
    instance_base    (G,) int32: first row of the instance tables
    transforms       (I, 3, 4) float32, object to world
    slot_offset, slot_count  (I,) int32
    slots            (S,) int32, material of each slot
    materials        (M, 16) float32
    """

    accel: np.ndarray
    vertices: np.ndarray
    triangles: np.ndarray
    triangle_slot: np.ndarray
    normals: np.ndarray
    normal_triangles: np.ndarray
    kind: np.ndarray
    base: np.ndarray
    instance_base: np.ndarray
    transforms: np.ndarray
    slot_offset: np.ndarray
    slot_count: np.ndarray
    slots: np.ndarray
    materials: np.ndarray


class Lights(NamedTuple):
    """Emitters 0..L-1 are the lamps, L.. are the emissive triangles.

    lamps             (L, 32) float32
    lamp_kind         (L,) int32
    listed_lamps      (K,) int32: lamps that rays may meet and Embree doesn't know
    lamp_of_quad, lamp_of_sphere  int32: lamp of each lamp geometry's primitive
    emitter_triangle  (E,) uint32, triangle of emitter L + i
    triangle_emitter  (T,) int32, emitter of a triangle, -1: none
    emitter_mask      (E,) uint8, visibility of emitter L + i
    emitter_rectangle (E, 9) float32, corner and two edges of an emitter that is a rectangle, else zeros; no rows if
                      there is none
    suns              (S, 12) float32
    world             (8,) float32
    world_rotation    (3, 3) float32, world to environment
    """

    lamps: np.ndarray
    lamp_kind: np.ndarray
    listed_lamps: np.ndarray
    lamp_of_quad: np.ndarray
    lamp_of_sphere: np.ndarray
    emitter_triangle: np.ndarray
    triangle_emitter: np.ndarray
    emitter_mask: np.ndarray
    emitter_rectangle: np.ndarray
    suns: np.ndarray
    world: np.ndarray
    world_rotation: np.ndarray

    @property
    def shape_count(self) -> int:
        """How many lamps Embree may meet on a ray's way."""
        return len(self.lamp_of_quad) + len(self.lamp_of_sphere)


class Surfaces(NamedTuple):
    """What only passes show of surfaces. Tables of passes that aren't chosen have no rows.

    triangle_index  (T,) int32, pass index of each baked triangle's object
    instance_index  (I,) int32, of each instance's
    material_index  (M,) int32
    uv_row          (T,) int32, of each triangle in `uvs`; -1: its mesh has none
    uvs             (U, 3, 2) float32, of a triangle's corners
    numbers         (9,) float64, see above. Lengths in the space of the geometry's tables
    """

    triangle_index: np.ndarray
    instance_index: np.ndarray
    material_index: np.ndarray
    uv_row: np.ndarray
    uvs: np.ndarray
    numbers: np.ndarray
