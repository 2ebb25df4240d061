"""The scene of a viewport: exported once, and from then on only where it has changed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace

import numpy as np

from ...engine import Instances, Lamp, Material, Scene, Settings, World
from .changes import Changes, changes_of, uid_of
from .images import Images
from .instances import Placement
from .kept import KeptMeshes
from .materials import MaterialTable
from .notes import Notes
from .settings import export_settings
from .stop import Stop
from .world import export_world

# What a viewport does without: it is left alone when these change.
FINAL_ONLY = ("use_adaptive_sampling", "adaptive_threshold", "time_limit", "road")


def export_viewport_settings(scene) -> Settings:
    """The settings of a Blender scene as a viewport has them."""
    defaults = Settings()
    properties = getattr(scene, "lobe", None)
    samples = getattr(properties, "viewport_samples", defaults.samples)
    return replace(export_settings(scene), samples=samples, **{key: getattr(defaults, key) for key in FINAL_ONLY})


class LiveExport:
    """`update` gives the scene as it is now, without camera and film settings. Its parts are the same objects as before
    where they are equal, and so is the scene where nothing has changed."""

    def __init__(self) -> None:
        self._scene: Scene | None = None
        self._of: tuple = ()  # the scene and the view layer that it was exported from
        self._meshes = KeptMeshes()
        self._materials: dict[int, Material] = {}  # by `uid_of`
        self._world_uid = 0
        self._stop = Stop()
        self._images = Images(Notes(), self._stop)

    def update(self, depsgraph, shown: Callable[[object], bool] | None = None, anew: bool = False) -> Scene:
        """shown: whether the viewport shows an evaluated object. anew: that is another function than before."""
        of = uid_of(depsgraph.scene), depsgraph.view_layer.name
        changes = changes_of(depsgraph.updates)
        if self._scene is None or of != self._of:
            self._of, anew = of, True
            self._meshes.forget_all()
            changes = Changes(nodes=True, images=True)
        changes.placed |= anew
        self._forget(changes)
        before, self._scene = self._scene or Scene(), None  # after an error all is exported anew
        now = replace(before, world=self._world(depsgraph, changes, before.world))
        if changes.placed or changes.nodes:
            self._place(depsgraph, shown, now)
        self._scene = before if _same(before, now) else now
        return self._scene

    def _forget(self, changes: Changes) -> None:
        self._meshes.forget(changes.geometry)
        if changes.images:
            self._images = Images(Notes(), self._stop)
        for uid in list(self._materials) if changes.nodes else changes.materials:
            self._materials.pop(uid, None)

    def _world(self, depsgraph, changes: Changes, before: World) -> World:
        layer = depsgraph.view_layer_eval
        world = getattr(layer, "world_override", None) or depsgraph.scene_eval.world
        uid = uid_of(world)
        if uid == self._world_uid and not (changes.world or changes.nodes):
            return before
        self._world_uid = uid
        return export_world(world, Notes(), self._images)

    def _place(self, depsgraph, shown: Callable[[object], bool] | None, scene: Scene) -> None:
        """Objects, lamps and the materials that objects have, into `scene`."""
        notes = Notes()  # nobody reads them here: the report of a final render does
        override = depsgraph.view_layer_eval.material_override
        table = MaterialTable(notes, self._images, override, self._stop, self._materials)
        placement = Placement(depsgraph, table, notes, self._stop, self._meshes, shown)
        self._meshes.finish()
        self._materials = dict(zip(table.uids, table.materials, strict=True))
        if not _alike(scene.meshes, placement.meshes):
            scene.meshes = placement.meshes
        if not _equal(scene.instances, placement.instances):
            scene.instances = placement.instances
        if len(scene.lights) != len(placement.lights) or not all(map(_equal, scene.lights, placement.lights)):
            scene.lights = placement.lights
        if scene.materials != table.materials:
            scene.materials = table.materials


def _same(a: Scene, b: Scene) -> bool:
    """Whether all of it is the same objects."""
    return all(getattr(a, field.name) is getattr(b, field.name) for field in fields(Scene))


def _alike(a: list, b: list) -> bool:
    """Whether two lists hold the same objects."""
    return len(a) == len(b) and all(x is y for x, y in zip(a, b, strict=True))


def _equal(a: Instances | Lamp, b: Instances | Lamp) -> bool:
    """Whether two records hold equal arrays and values."""
    return type(a) is type(b) and all(
        np.array_equal(getattr(a, field.name), getattr(b, field.name)) for field in fields(a)
    )
