"""The scene of a viewport: exported once, and from then on only where it has changed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import bpy

from ...engine import Scene, Settings
from .changes import changes_of, uid_of
from .instances import Placement, shading_of
from .kept import Kept, same, take_over
from .materials.material import MaterialTable
from .notes import Notes
from .settings import export_settings

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
        self._kept = Kept()
        self._table: MaterialTable | None = None  # of the last export of objects, or of materials since
        # `shading_of` the objects, by `uid_of`, whose shading alone had changed when all objects were exported last.
        self._shading: dict[int, tuple] = {}

    def update(self, depsgraph, shown: Callable[[object], bool] | None = None, anew: bool = False) -> Scene:
        """shown: whether the viewport shows an evaluated object. anew: that is another function than before."""
        of = uid_of(depsgraph.scene), depsgraph.view_layer.name
        before, self._scene = self._scene, None  # after an error all is exported anew
        changes = changes_of(depsgraph.updates)
        if before is None or of != self._of:
            self._of, anew = of, True
            self._kept = Kept()
        self._kept.hear(changes)
        before = before or Scene()
        now = replace(before, world=self._kept.world(depsgraph, Notes()))
        shading = {uid: shading_of(object_) for uid, object_ in changes.shaded.items()}
        shaded = shading.items() <= self._shading.items() and self._table is not None and self._table.lasting
        if anew or changes.placed or changes.nodes or (changes.is_shading and not shaded):
            self._place(depsgraph, shown, now)
            self._shading = shading  # whose materials are edited once, are edited again
            take_over(before, now)
        elif changes.materials:
            self._shade(depsgraph, changes.materials, now)
            take_over(before, now)
        self._scene = before if same(before, now) else now
        return self._scene

    def _place(self, depsgraph, shown: Callable[[object], bool] | None, scene: Scene) -> None:
        """Objects, lamps and the materials that objects have, into `scene`."""
        notes = Notes()  # nobody reads them here: the report of a final render does
        table = self._kept.table(depsgraph, notes)
        placement = Placement(depsgraph, table, notes, self._kept.stop, self._kept.meshes, shown)
        self._kept.placed(table)
        self._table = table
        scene.meshes, scene.instances, scene.lights = placement.meshes, placement.instances, placement.lights
        scene.materials = table.materials

    def _shade(self, depsgraph, changed: Mapping[int, bpy.types.Material], scene: Scene) -> None:
        """Materials alone, into `scene`: no object has others than before."""
        assert self._table is not None
        table = self._kept.table(depsgraph, Notes())
        table.again(self._table, changed)
        self._kept.shaded(table)
        self._table, scene.materials = table, table.materials
