"""The scene of a viewport: exported once, and from then on only where it has changed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import bpy

from ...engine import Scene, Settings, SunLight
from .changes import Changes, changes_of, uid_of
from .instances import Placement, shading_of, shown_objects
from .kept import Kept, same, take_over
from .lights import PlacedLamp, export_lamps, lit
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
        # As it was when all objects were exported last.
        self._frame = 0
        self._shown: tuple = ()  # `shown_objects`
        self._shading: dict[int, tuple] = {}  # by `uid_of`, of lamps, and of objects whose shading alone had changed
        self._lamps: list[PlacedLamp] = []  # with what has become of their lights since
        self._suns: list[SunLight] = []  # of the world, as it is now

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
        world, suns = self._kept.world(depsgraph, Notes())
        now = replace(before, world=world)
        lit_before = self._lamps, self._suns
        shading = {uid: shading_of(object_) for uid, object_ in changes.shaded.items()}
        if anew or changes.placed or changes.nodes or not self._stand(depsgraph, changes, shading):
            self._place(depsgraph, shown, now)
            self._shading |= shading  # whose materials are edited once, are edited again
        else:
            if changes.lights:  # they stand where they stood
                self._lamps = export_lamps(self._lamps, changes.lights, Notes(), self._kept.stop)
            if changes.materials:
                self._shade(depsgraph, changes.materials, now)
        self._suns = suns
        if self._lamps is not lit_before[0] or self._suns is not lit_before[1]:
            now.lights = lit(self._lamps) + suns
        take_over(before, now)
        self._scene = before if same(before, now) else now
        return self._scene

    def _stand(self, depsgraph, changes: Changes, shading: Mapping[int, tuple]) -> bool:
        """Whether the objects are those that were exported last, where they were, with the materials that they had. Not
        sure of it is no."""
        assert self._table is not None
        if not self._table.lasting and (changes.is_shading or depsgraph.scene.frame_current != self._frame):
            return False
        if not shading.items() <= self._shading.items():
            return False
        # With objects it lists the scene when it has found out anew what depends on what.
        return not changes.scene or (not shading and shown_objects(depsgraph, depsgraph.objects) == self._shown)

    def _place(self, depsgraph, shown: Callable[[object], bool] | None, scene: Scene) -> None:
        """Objects and the materials that they have, into `scene`, and the lamps."""
        notes = Notes()  # nobody reads them here: the report of a final render does
        table = self._kept.table(depsgraph, notes)
        placement = Placement(depsgraph, table, notes, self._kept.stop, self._kept.meshes, shown)
        self._kept.placed(table)
        self._table, self._lamps = table, placement.lamps
        scene.meshes, scene.instances = placement.meshes, placement.instances
        scene.materials = table.materials
        objects = list(depsgraph.objects)
        self._frame, self._shown = depsgraph.scene.frame_current, shown_objects(depsgraph, objects)
        self._shading = {uid_of(object_): shading_of(object_) for object_ in objects if object_.type == "LIGHT"}

    def _shade(self, depsgraph, changed: Mapping[int, bpy.types.Material], scene: Scene) -> None:
        """Materials alone, into `scene`: no object has others than before."""
        assert self._table is not None
        table = self._kept.table(depsgraph, Notes())
        table.again(self._table, changed)
        self._kept.shaded(table)
        self._table, scene.materials = table, table.materials
