"""`Scene` to flat arrays for the kernels, and the decision which features a scene needs.

This is the only module that knows both sides: the scene description above and the kernels' tables below.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, lru_cache
from typing import NamedTuple

import numpy as np

from ..accel import Accel
from ..errors import SceneError
from ..features import Features
from ..kernels.camera import pack_camera
from ..kernels.film.filter import build_filter_table
from ..kernels.sampler.sobol import build_sobol_table
from ..kernels.tables import Geometry, Lights, Surfaces
from ..passes import has_data_passes, has_light_passes
from ..scene import Scene
from ..settings import CHOICES, Settings
from .geometry import PackedGeometry, pack_geometry
from .lights import PackedLights, pack_lights
from .middle import Move, move_of
from .surfaces import pack_surfaces

# Kernels count places in a table with 31 bits.
MOST_NUMBERS = 1 << 31
COUNTED = {
    "vertices": "vertices", "triangles": "triangles", "normals": "normals", "transforms": "instances", "lamps": "lamps",
}  # fmt: skip

# The same from render to render.
filter_table = lru_cache(4)(build_filter_table)
sobol_table = cache(build_sobol_table)


class Parts(NamedTuple):
    """What was packed, of which scene, for `engine/pack/again.py`."""

    scene: Scene
    move: Move
    geometry: PackedGeometry
    lights: PackedLights


@dataclass
class Packed:
    """All that a path kernel is called with, and what keeps its memory alive."""

    features: Features
    geometry: Geometry
    lights: Lights
    environment: tuple
    tree: tuple
    camera: np.ndarray
    filter_table: np.ndarray
    sampler: np.ndarray
    accel: Accel
    parts: Parts
    surfaces: Surfaces | None = None  # where a pass shows what the camera sees first


def _check_sizes(geometry: Geometry, lights: Lights) -> None:
    """Raises SceneError where a table is too large for the kernels."""
    for name, what in COUNTED.items():
        table = getattr(lights if name == "lamps" else geometry, name)
        if table.size > MOST_NUMBERS:
            most = MOST_NUMBERS * len(table) // table.size
            raise SceneError(
                f"the scene has {len(table):,} {what}, and {most:,} can be rendered: use fewer, for instance with "
                "lower levels of subdivision or with instances of a mesh"
            )


def pack(scene: Scene, settings: Settings, halt: np.ndarray | None = None) -> Packed:
    """Pack and build. The scene must have passed `Scene.validate`. Raises SceneError where it is too large, and
    accel.BuildStopped once `halt` is set."""
    move = move_of(scene)
    placed = move.scene(scene)
    geometry = pack_geometry(placed, settings.passes)
    lights = pack_lights(placed, geometry)
    return assemble(Parts(scene, move, geometry, lights), settings, halt)


def assemble(parts: Parts, settings: Settings, halt: np.ndarray | None = None, accel: Accel | None = None) -> Packed:
    """The parts' tables side by side. accel: of the same shapes, where it is there already."""
    geometry, lights, scene = parts.geometry, parts.lights, parts.scene
    _check_sizes(geometry.tables, lights.tables)
    if scene.world.image is not None and scene.world.image.size > MOST_NUMBERS:
        raise SceneError("the world's image has more than 715 million pixels: use a smaller one")
    accel = accel or Accel([*geometry.shapes, *lights.shapes], halt, settings.thread_count)
    kind = np.concatenate([geometry.tables.kind, lights.shape_kind]).astype(np.int32)
    base = np.concatenate([geometry.tables.base, lights.shape_base]).astype(np.int32)
    assert scene.camera is not None
    camera = parts.move.camera(scene.camera)
    surfaces = None
    if has_data_passes(settings.passes):
        surfaces = pack_surfaces(parts.move.scene(scene), parts.move, geometry.tables.materials, settings.passes)
    return Packed(
        features=_features(parts, settings),
        geometry=geometry.tables._replace(accel=np.array([accel.address], np.uint64), kind=kind, base=base),
        lights=lights.tables,
        environment=lights.environment,
        tree=lights.tree,
        camera=pack_camera(camera, scene.width, scene.height),
        filter_table=filter_table(settings.pixel_filter, settings.filter_width),
        sampler=sobol_table(),
        accel=accel,
        parts=parts,
        surfaces=surfaces,
    )


def _features(parts: Parts, settings: Settings) -> Features:
    geometry, lights, camera = parts.geometry.features, parts.lights.features, parts.scene.camera
    assert camera is not None
    bounces = min(settings.diffuse_bounces, settings.glossy_bounces)
    kinds_end_apart = int(geometry["phong"] and bounces < settings.max_bounces)
    return Features(
        **geometry,
        **{**lights, "ray_kinds": lights["ray_kinds"] | kinds_end_apart},
        orthographic=int(camera.orthographic),
        lens=int(camera.aperture is not None and camera.aperture.radius > 0),
        transparent_film=int(parts.scene.transparent_film),
        hemisphere=CHOICES["hemisphere_sampling"].index(settings.hemisphere_sampling),
        lobe_selection=CHOICES["lobe_selection"].index(settings.lobe_selection),
        light_passes=int(has_light_passes(settings.passes)),
        clamp=int(settings.clamp_direct > 0 or settings.clamp_indirect > 0),
    )
