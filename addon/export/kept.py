"""What the exports of a scene that changes have in common: those of a viewport, and those of an animation's frames.

Blender says what it has evaluated again (see `changes`); all else is taken over.
"""

from __future__ import annotations

from dataclasses import fields
from typing import NamedTuple

import bpy
import numpy as np

from ...engine import Instances, Lamp, Prepared, Scene
from .changes import Changes, changes_of, uid_of
from .faults import naming
from .images import PAINTED, Images, version
from .kept_meshes import KeptMeshes
from .materials.material import Exported, MaterialTable
from .notes import Note, Notes
from .stop import Stop
from .world import ExportedWorld, export_world


class _KeptWorld(NamedTuple):
    """of: its `uid_of`, and whether the film is transparent."""

    of: tuple[int, bool]
    exported: ExportedWorld
    notes: list[Note]


class Kept:
    """Of one view layer of one scene. New, it holds nothing."""

    def __init__(self) -> None:
        self.stop = Stop()
        self.meshes = KeptMeshes()
        self.materials: dict[int, Exported] = {}  # by `uid_of`
        self._image_notes = Notes()
        self.images = Images(self._image_notes, self.stop)
        self._world: _KeptWorld | None = None
        self._scene: Scene | None = None
        self.prepared = Prepared()  # of the last export, by whoever rendered it

    def hear(self, changes: Changes) -> None:
        """Forget what has been evaluated again."""
        self.meshes.forget(changes.geometry)
        if changes.images:
            self._image_notes = Notes()
            self.images = Images(self._image_notes, self.stop)
        for uid in list(self.materials) if changes.nodes else changes.materials:
            self.materials.pop(uid, None)
        if changes.world or changes.nodes:
            self._world = None

    def world(self, depsgraph, notes: Notes) -> ExportedWorld:
        """Of the view layer."""
        layer = depsgraph.view_layer_eval
        shown = getattr(layer, "world_override", None) or depsgraph.scene_eval.world
        shown = shown if layer.use_sky or depsgraph.mode == "VIEWPORT" else None
        film_transparent = depsgraph.scene.render.film_transparent
        of = uid_of(shown), film_transparent
        if self._world is not None and self._world.of == of:
            notes.again(self._world.notes)
            return self._world.exported
        self.images.lasting()
        with notes.recorded() as own, naming("world", shown.name_full if shown else ""):
            exported = export_world(shown, own, self.images, film_transparent)
        self._world = _KeptWorld(of, exported, own.all) if self.images.lasting() else None
        self.images.forget_unused()
        return exported

    def table(self, depsgraph, notes: Notes) -> MaterialTable:
        override = depsgraph.view_layer_eval.material_override
        return MaterialTable(notes, self.images, override, self.stop, self.materials)

    def placed(self, table: MaterialTable) -> None:
        """All objects have been exported: what they didn't ask for is gone from the scene."""
        self.meshes.finish()
        self.materials = table.exported

    def shaded(self, table: MaterialTable) -> None:
        """Materials alone have been exported."""
        self.materials = table.exported

    def finish(self, scene: Scene, notes: Notes) -> None:
        """All has been exported, into `scene`, which gets the parts of the last one where they are equal."""
        notes.again(self._image_notes.all)
        if self._scene is not None:
            take_over(self._scene, scene)
        self._scene = scene
        self.stop.ask = None


class KeptLayers:
    """Of a renderer that is kept from frame to frame: `Kept` of each view layer."""

    def __init__(self) -> None:
        self._layers: dict[tuple[int, str], Kept] = {}
        self._images: dict[int, tuple] = {}  # by `uid_of`, the `version` of each

    def of(self, depsgraph) -> Kept:
        """Of the one that is about to be exported: a new one unless its last export came to its end."""
        scene = depsgraph.scene
        there = {(uid_of(scene), layer.name) for layer in scene.view_layers}
        self._layers = {key: kept for key, kept in self._layers.items() if key in there}
        shown = (image for image in bpy.data.images if image.source != "VIEWER")  # nodes don't show Blender's renders
        images, self._images = self._images, {uid_of(image): version(image) for image in shown}
        if self._layers:
            changes = changes_of(depsgraph.updates)
            changes.nodes |= images != self._images or PAINTED in images.values()
            for kept in self._layers.values():  # Blender has one graph for all of them, and says each change once
                kept.hear(changes)
                kept.images.forget_painted()
        return self._layers.pop((uid_of(scene), depsgraph.view_layer.name), None) or Kept()

    def keep(self, depsgraph, kept: Kept) -> None:
        """Its export has come to its end."""
        self._layers[uid_of(depsgraph.scene), depsgraph.view_layer.name] = kept


def take_over(before: Scene, now: Scene) -> None:
    """Replace parts of `now` by those of `before` that are equal, for who takes the same objects for unchanged."""
    if _alike(before.meshes, now.meshes):
        now.meshes = before.meshes
    if _equal(before.instances, now.instances):
        now.instances = before.instances
    if len(before.lights) == len(now.lights) and all(map(_equal, before.lights, now.lights)):
        now.lights = before.lights
    if before.materials == now.materials:
        now.materials = before.materials


def same(a: Scene, b: Scene) -> bool:
    """Whether all of it is the same objects."""
    return all(getattr(a, field.name) is getattr(b, field.name) for field in fields(Scene))


def _alike(a: list, b: list) -> bool:
    """Whether two lists hold the same objects."""
    return len(a) == len(b) and all(x is y for x, y in zip(a, b, strict=True))


def _equal(a: Instances | Lamp, b: Instances | Lamp) -> bool:
    """Whether two records hold equal arrays and values."""
    if a is b:
        return True
    return type(a) is type(b) and all(_same_value(x, getattr(b, name)) for name, x in vars(a).items())


def _same_value(x, y) -> bool:
    if isinstance(x, np.ndarray) or isinstance(y, np.ndarray):
        return np.array_equal(x, y)
    return x == y
