"""Packing a scene that changes: what is as it was is taken over, so that a move of the camera costs next to nothing,
and an edit of a material or a lamp doesn't pack the triangles anew.

Meshes, instances, images, worlds and lists of lamps count as unchanged where they are the same objects: whoever
changes one makes a new one.
"""

from __future__ import annotations

import numpy as np

from ..accel import SphereGeometry, TriangleGeometry
from ..kernels.tables import EMISSION
from ..prepared import Prepared
from ..scene import Scene
from ..settings import Settings
from . import Packed, Parts, assemble, pack
from .geometry import pack_materials
from .lights import PackedLights, camera_reach, lamp_reach, pack_lights

# A camera that has left the reach of the lamps' shapes finds so many times as much room.
ROOM = 2.0


def pack_next(prepared: Prepared, scene: Scene, settings: Settings, halt: np.ndarray | None = None) -> Packed:
    """`pack(scene, settings, halt)` to the bit, with what still holds taken from what is prepared, and prepared in its
    turn. What doesn't hold is freed before: there may be no room for both."""
    before = prepared.take()
    if before is not None and not _same_surfaces(before.parts, scene, pack_materials(scene)):
        before = None
    packed = pack(scene, settings, halt) if before is None else _refit(before, scene, settings, halt, exact=True)
    prepared.put(packed)
    return packed


def pack_again(before: Packed, scene: Scene, settings: Settings, halt: np.ndarray | None = None) -> Packed:
    """`pack(scene, settings, halt)`, with what still holds taken from a former result. Shapes of lamps may reach
    farther than they would if they were packed anew."""
    if not _same_surfaces(before.parts, scene, pack_materials(scene)):
        return pack(scene, settings, halt)
    return _refit(before, scene, settings, halt, exact=False)


def _refit(before: Packed, scene: Scene, settings: Settings, halt: np.ndarray | None, exact: bool) -> Packed:
    """For a scene with the same surfaces. exact: lamps' shapes reach as far as they would if they were packed anew."""
    materials, old = pack_materials(scene), before.parts
    geometry = old.geometry.with_materials(materials)
    parts = Parts(scene, old.move, geometry, old.lights)
    far = 0 < old.lights.reach < _camera_reach(parts)
    room = ROOM if far and not exact else 1.0
    far |= exact and old.lights.reach != lamp_reach(old.move.scene(scene))
    if far or not _same_lights(old, scene, materials):
        environment = old.lights.environment if _same_world(old.scene, scene) else None
        parts = parts._replace(lights=pack_lights(old.move.scene(scene), geometry, environment, room))
    accel = before.accel if _same_shapes(old.lights, parts.lights) else None
    return assemble(parts, settings, halt, accel)


def _camera_reach(parts: Parts) -> float:
    assert parts.scene.camera is not None
    return camera_reach(parts.move.camera(parts.scene.camera))


def same_meshes(a: Scene, b: Scene) -> bool:
    """Whether the same meshes are placed in the same way."""
    return a.instances is b.instances and len(a.meshes) == len(b.meshes) and all(map(_is, a.meshes, b.meshes))


def _is(a: object, b: object) -> bool:
    return a is b


def _same_surfaces(old: Parts, scene: Scene, materials: np.ndarray) -> bool:
    """Nor has another material begun or ceased to emit, which decides what is baked."""
    before = old.geometry.tables.materials
    return (
        same_meshes(old.scene, scene)
        and len(before) == len(materials)
        and np.array_equal(_glows(before), _glows(materials))
    )


def _glows(materials: np.ndarray) -> np.ndarray:
    return np.any(_emission(materials) > 0, axis=1)


def _emission(materials: np.ndarray) -> np.ndarray:
    return materials[:, EMISSION : EMISSION + 3]


def _same_lights(old: Parts, scene: Scene, materials: np.ndarray) -> bool:
    return (
        old.scene.lights is scene.lights
        and old.scene.world is scene.world
        and np.array_equal(_emission(old.geometry.tables.materials), _emission(materials))
    )


def _same_world(old: Scene, new: Scene) -> bool:
    """Whether their environment tables are equal: where the world is black it has none."""
    return old.world.image is new.world.image and any(old.world.color) == any(new.world.color)


def _same_shapes(a: PackedLights, b: PackedLights) -> bool:
    """Whether rays meet the same lamps at the same places."""
    return len(a.shapes) == len(b.shapes) and all(map(_same_shape, a.shapes, b.shapes))


def _same_shape(a: TriangleGeometry | SphereGeometry, b: TriangleGeometry | SphereGeometry) -> bool:
    if a.mask != b.mask:
        return False
    if isinstance(a, SphereGeometry) and isinstance(b, SphereGeometry):
        return np.array_equal(a.centers_radii, b.centers_radii)
    if isinstance(a, TriangleGeometry) and isinstance(b, TriangleGeometry):
        return np.array_equal(a.vertices, b.vertices) and np.array_equal(a.triangles, b.triangles)
    return False
