"""Everything that is placed in the scene: meshes as instances of shared geometry, and the lamps.

One pass over `depsgraph.object_instances`, which holds originals, duplicates, particles, geometry-nodes instances and
the meshes of curves, text, surfaces and metaballs alike. What equal items have in common (mesh, materials, visibility)
is found once, at the first of them; the rest of the pass is one dictionary lookup each.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from itertools import chain
from operator import attrgetter
from typing import NamedTuple

import bpy
import numpy as np

from ...engine import Instances, Lamp, Mesh, Visibility
from .changes import uid_of
from .faults import naming
from .kept_meshes import KeptMeshes
from .lights import PlacedLamp, export_lamps, lit
from .materials import MaterialTable
from .meshes import export_mesh
from .notes import Notes
from .stop import ITEMS_A_CHECK, Stop
from .unsupported import CYCLES_FLAGS, OBJECT_FLAGS, cycles_settings, note_object

UNSUPPORTED_TYPES = {
    "CURVES": "hair curves",
    "POINTCLOUD": "point clouds",
    "VOLUME": "volumes",
}

VISIBILITY = (
    ("visible_camera", Visibility.CAMERA),
    ("visible_diffuse", Visibility.DIFFUSE),
    ("visible_glossy", Visibility.GLOSSY),
    ("visible_shadow", Visibility.SHADOW),
)


# Of an object, beside its materials. Where instances stand on faces, their size may be driven too.
SHADING = (
    *(name for name, _ in VISIBILITY), "is_holdout", "pass_index", "hide_viewport", "hide_render",
    "show_instancer_for_viewport", "show_instancer_for_render", "instance_type", "use_instance_vertices_rotation",
    "use_instance_faces_scale", "instance_faces_scale",
)  # fmt: skip


# All that `seen_by` asks an object and Cycles' settings of it for, each in one call.
flags_of = attrgetter(
    "type", *(name for name, _ in VISIBILITY), "is_shadow_catcher", "light_linking.receiver_collection",
    "light_linking.blocker_collection", *OBJECT_FLAGS,
)  # fmt: skip
cycles_flags_of = attrgetter(*CYCLES_FLAGS)


class Kind(NamedTuple):
    """What equal items of `object_instances` have in common; mesh -1 places no mesh, lamp -1 no lamp."""

    mesh: int = -1
    first_slot: int = 0
    slot_count: int = 1
    visibility: int = 0
    object: int = 0
    lamp: int = -1


NOTHING = Kind()
MESH, LAMP = Kind._fields.index("mesh"), Kind._fields.index("lamp")

# Cycles' default surface (src/scene/shader.cpp, ShaderManager::add_default) is a Principled BSDF from Blender 5.0 on,
# and in 4.2 and 4.5 a Diffuse BSDF of 0.8, as here: its picture is that of a material with this node, to the bit.
CYCLES_SHINES = bpy.app.version >= (5, 0, 0)
NO_MATERIAL = (
    "without a material it is drawn as a diffuse surface, in Cycles with a Principled BSDF, which has a gloss: give it "
    "a material"
)


class Placement:
    """Collects the meshes, instances and lamps of one dependency graph. Of `lights` are those that give light; `lamps`
    are all, for `export_lamps`.

    kept   meshes of an export before
    shown  whether to draw an evaluated object; None: all
    with_uvs  for the pass
    """

    def __init__(
        self, depsgraph, materials: MaterialTable, notes: Notes, stop: Stop, kept: KeptMeshes | None = None,
        shown: Callable[[object], bool] | None = None, with_uvs: bool = False,
    ) -> None:  # fmt: skip
        self.meshes: list[Mesh] = []
        self.lamps: list[PlacedLamp] = []
        self._lamp_objects: list[tuple[str, int, int]] = []  # as the first members of a `PlacedLamp`
        self._lights: dict[int, bpy.types.Light] = {}  # by `uid_of`, evaluated
        self._materials = materials
        self._notes = notes
        self._stop = stop
        self._kept = kept or KeptMeshes()
        self._with_uvs = with_uvs
        self._shown = shown or (lambda _object: True)
        self._view_layer = depsgraph.view_layer
        self._viewport = depsgraph.mode == "VIEWPORT"
        self._layer_flags = uses_layer_flags(depsgraph.view_layer.layer_collection)
        self._seen_by: dict = {}  # for `Notes.alike`
        self._mesh_index: dict = {}
        self._slot_index: dict[tuple[int, ...], int] = {}
        self._slot_table: list[int] = []
        self._object_names: list[str] = []
        self._pass_index: list[int] = []  # of each of those objects
        self.instances = self._collect(depsgraph.object_instances)
        self.lights: list[Lamp] = lit(self.lamps)

    def _collect(self, items) -> Instances:
        known: dict = {}
        kinds: list[Kind] = [NOTHING]
        of_item: list[int] = []  # index into `kinds`
        for number, item in enumerate(items):
            if number % ITEMS_A_CHECK == 0:
                self._stop.check()
            object_ = item.object
            # A duplicate's `object` is a stand-in, at one address for all: the datablocks tell them apart.
            key = (object_.data, item.instance_object, item.parent) if item.is_instance else object_
            kind = known.get(key)
            if kind is None:
                known[key] = kind = len(kinds)
                with naming("object", object_.name_full):
                    kinds.append(self._kind(item, object_))
            of_item.append(kind)

        read = matrices_at_once if bpy.app.version >= (5, 0, 0) else matrices_one_by_one
        matrices = read(items, len(of_item), self._stop)
        # Of a list of named tuples numpy makes an array in ten times as long.
        numbers = np.fromiter(chain.from_iterable(kinds), np.int32, len(kinds) * len(NOTHING))
        table, rows = numbers.reshape(len(kinds), -1), np.array(of_item, np.intp)
        self._place_lamps(table[rows, LAMP], matrices)
        return self._gather(table, rows, matrices)

    def _gather(self, table: np.ndarray, of_item: np.ndarray, matrices: np.ndarray) -> Instances:
        """The structure of arrays: looks each item's properties up in its kind, a row of `table`."""
        drawn = np.flatnonzero(table[of_item, MESH] >= 0)
        mesh, first_slot, slot_count, visibility, object_, _ = np.ascontiguousarray(table[of_item[drawn]].T)
        return Instances(
            mesh=mesh,
            transforms=matrices[drawn].astype(np.float64),
            material_offset=first_slot,
            slot_count=slot_count,
            material_table=np.array(self._slot_table, np.int32),
            visibility=visibility.astype(np.uint8),
            object=object_,
            object_names=self._object_names,
            pass_index=np.array(self._pass_index, np.int32),
        )

    def _place_lamps(self, kinds: np.ndarray, matrices: np.ndarray) -> None:
        """kinds (items,): of each the lamp, or -1; matrices (items, 3, 4) float32."""
        placed = np.flatnonzero(kinds >= 0)
        places = zip(kinds[placed].tolist(), matrices[placed].astype(np.float64, order="C"), strict=True)
        lamps = (PlacedLamp(*self._lamp_objects[kind], matrix) for kind, matrix in places)
        self.lamps = export_lamps(lamps, self._lights, self._notes, self._stop)

    def _kind(self, item, object_) -> Kind:
        if item.show_particles and len(object_.particle_systems):
            self._note_hair(object_)
        if not item.show_self or not self._shown(object_):
            return NOTHING
        if object_.type == "LIGHT":
            return self._lamp(item, object_)
        if object_.type != "MESH":
            if object_.type in UNSUPPORTED_TYPES:
                what = UNSUPPORTED_TYPES[object_.type]
                self._notes.warn("object", object_.name_full, f"{what} are not supported and left out")
            if object_.type == "LIGHT_PROBE":
                self._notes.skip("object", object_.name_full, "light probes are for EEVEE only")
            return NOTHING  # Curves, text and metaballs come again, as instanced meshes.
        if not self._view_layer.use_solid:
            self._notes.skip("object", object_.name_full, "the view layer includes no surfaces")
            return NOTHING
        visibility = self._visibility(item, object_)
        if not visibility:
            self._notes.skip("object", object_.name_full, "it is hidden from every ray")
            return NOTHING
        if subdivides_adaptively(object_):
            what = "adaptive subdivision is not supported, subdivided as often as its modifier says"
            self._notes.warn("object", object_.name_full, what)
        mesh = self._mesh(item.instance_object or object_, object_.data, item.parent if item.is_instance else None)
        if mesh < 0:
            return NOTHING
        first_slot, slot_count = self._slots(object_, self._is_holdout(item, object_), self.meshes[mesh])
        self._object_names.append(object_.name_full)
        self._pass_index.append(object_.pass_index)
        return Kind(mesh, first_slot, slot_count, visibility, len(self._object_names) - 1)

    def _lamp(self, item, object_) -> Kind:
        light = uid_of(object_.data)
        self._lights[light] = object_.data
        self._lamp_objects.append((object_.name_full, light, self._visibility(item, object_)))
        return Kind(lamp=len(self._lamp_objects) - 1)

    def _mesh(self, owner, data, parent) -> int:
        """Index of the exported mesh of an evaluated datablock, -1 for one without faces."""
        if data not in self._mesh_index:
            self._stop.check()
            mesh = self._kept.get(data, owner, parent, self._with_uvs, lambda: self._export_mesh(owner, data))
            if mesh is None:
                self._notes.skip("object", owner.name_full, "it has no faces")
            else:
                self.meshes.append(mesh)
            self._mesh_index[data] = -1 if mesh is None else len(self.meshes) - 1
        return self._mesh_index[data]

    def _export_mesh(self, owner, data) -> Mesh | None:
        """In the viewport a mesh in edit mode is no arrays yet, and a subdivision may be left to the graphics card:
        both become a mesh on demand only."""
        if not self._viewport or owner.data != data or not is_deferred(owner, data):
            return export_mesh(data, data.name_full, self._stop, self._with_uvs)
        try:
            return export_mesh(owner.to_mesh(), data.name_full, self._stop, self._with_uvs)
        finally:
            owner.to_mesh_clear()

    def _slots(self, object_, holdout: bool, mesh: Mesh) -> tuple[int, int]:
        """Where the object's materials begin in the table, and their number. Equal lists are stored once."""
        materials = [slot.material for slot in object_.material_slots] or list(object_.data.materials) or [None]
        is_drawn = CYCLES_SHINES and self._materials.draws_default(holdout)
        if is_drawn and None in materials and shows_none(mesh, materials):
            self._notes.approximate("object", object_.name_full, NO_MATERIAL)
        slots = tuple(self._materials.index(material, holdout) for material in materials)
        if slots not in self._slot_index:
            self._slot_index[slots] = len(self._slot_table)
            self._slot_table.extend(slots)
        return self._slot_index[slots], len(slots)

    def _visibility(self, item, object_) -> int:
        """The rays that see the object and, for a duplicate, its instancer too (as in Cycles, blender/object.cpp).
        Bits of `Visibility`, whose own arithmetic takes ten times as long."""
        visibility = int(Visibility.ALL)
        owners = [object_, item.parent] if item.is_instance and item.parent else [object_]
        for owner in owners:
            cycles = cycles_settings(owner)
            key = flags_of(owner), cycles and cycles_flags_of(cycles)
            visibility &= self._notes.alike(self._seen_by, key, owner.name_full, partial(seen_by, owner, cycles))
        if self._is_indirect_only(item, object_):
            visibility &= ~int(Visibility.CAMERA)
        return visibility

    def _is_indirect_only(self, item, object_) -> bool:
        """By its collection in this view layer, which a holdout outranks."""
        if not self._layer_flags or self._is_holdout(item, object_):
            return False
        return instancer_of(item, object_).original.indirect_only_get(view_layer=self._view_layer)

    def _is_holdout(self, item, object_) -> bool:
        """By itself, or by its collection in this view layer. Of a duplicate its instancer counts alone, as in Cycles,
        blender/object.cpp."""
        owner = instancer_of(item, object_)
        return owner.is_holdout or (self._layer_flags and owner.original.holdout_get(view_layer=self._view_layer))

    def _note_hair(self, object_) -> None:
        for system in object_.particle_systems:
            settings = system.settings
            if settings.type == "HAIR" and settings.render_type == "PATH":
                what = f"hair of particle system {system.name!r} is not supported and left out"
                self._notes.warn("object", object_.name_full, what)


def seen_by(object_, cycles, notes: Notes) -> int:
    """The rays that see an object by its own flags, bits of `Visibility`; notes what these ask for that isn't drawn."""
    visibility, name = Visibility.ALL, object_.name_full
    for flag, bit in VISIBILITY:
        if not getattr(object_, flag):
            visibility &= ~bit
    if object_.is_shadow_catcher and object_.type == "MESH":  # Lamps have this flag set by default.
        notes.warn("object", name, "shadow catchers are not supported, drawn as it is")
    if links_light(object_):
        notes.warn("object", name, "light linking is not supported, every lamp lights everything")
    note_object(object_, cycles, notes)
    return int(visibility)


def shading_of(object_) -> tuple:
    """Of an evaluated object, what a `Placement` depends on and `Changes.shaded` doesn't tell apart, to be compared."""
    flags = [getattr(object_, name) for name in SHADING]
    materials = [slot.material for slot in object_.material_slots] or getattr(object_.data, "materials", None) or []
    return (*flags, uid_of(object_.data), *map(uid_of, materials))


def shows_none(mesh: Mesh, materials: list) -> bool:
    """Whether a face has an empty slot. materials: of the slots; numbers beyond them stand for the last."""
    if mesh.material_slots is None:
        return materials[0] is None
    used = np.unique(np.clip(mesh.material_slots, 0, len(materials) - 1))
    return any(materials[slot] is None for slot in used)


def shown_objects(depsgraph, objects: Iterable) -> tuple:
    """What a `Placement` depends on and Blender says of its scene alone, to be compared: which objects are shown, and
    what is set in the view layer. objects: all of `Depsgraph.objects`."""
    layer = depsgraph.view_layer
    uids = tuple(map(attrgetter("original.session_uid"), objects))
    return uids, layer.use_solid, uid_of(layer.material_override), layer_flags(layer.layer_collection)


def instancer_of(item, object_):
    """What places an item: the object itself where it is no duplicate."""
    return item.parent if item.is_instance and item.parent else object_


def matrices_at_once(items, count: int, stop: Stop) -> np.ndarray:
    """(count, 3, 4) float32, in one call. `len(items)` would walk through them once more. They come transposed."""
    matrices = np.empty((count, 4, 4), np.float32)
    items.foreach_get("matrix_world", matrices.reshape(-1))
    return matrices.transpose(0, 2, 1)[:, :3, :]


def matrices_one_by_one(items, count: int, stop: Stop) -> np.ndarray:
    """The same for Blender 4, whose `foreach_get` keeps 221 bytes of each item for good (measured in 4.2 and 4.5).
    Without a step of Python's for each."""
    matrices = np.empty(count * 16, np.float32)
    rows = chain.from_iterable(map(attrgetter("matrix_world"), items))
    numbers = chain.from_iterable(rows)
    for first in range(0, len(matrices), 16 * ITEMS_A_CHECK):
        stop.check()
        part = matrices[first : first + 16 * ITEMS_A_CHECK]
        part[:] = np.fromiter(numbers, np.float32, len(part))
    return matrices.reshape(count, 4, 4)[:, :3, :]


def is_deferred(owner, data) -> bool:
    return "position" not in data.attributes or any(modifier.type == "SUBSURF" for modifier in owner.modifiers)


def subdivides_adaptively(object_) -> bool:
    """Ticked in the modifier from Blender 5.0 on. Before that in Cycles' properties of the object, which are read as
    plain data: asking for the group makes one on an evaluated object, and nobody frees it."""
    modifiers = [modifier for modifier in object_.modifiers if modifier.type == "SUBSURF" and modifier.show_render]
    if not modifiers:
        return False
    of_object = bool((object_.get("cycles") or {}).get("use_adaptive_subdivision", False))
    return any(getattr(modifier, "use_adaptive_subdivision", of_object) for modifier in modifiers)


def links_light(object_) -> bool:
    linking = object_.light_linking
    return linking is not None and (linking.receiver_collection is not None or linking.blocker_collection is not None)


def uses_layer_flags(layer_collection) -> bool:
    """Whether a view layer makes any collection indirect-only or a holdout."""
    if layer_collection.indirect_only or layer_collection.holdout:
        return True
    return any(uses_layer_flags(child) for child in layer_collection.children)


def layer_flags(layer_collection) -> tuple:
    """Of a collection in a view layer, and of all below it, to be compared."""
    return layer_collection.indirect_only, layer_collection.holdout, *map(layer_flags, layer_collection.children)
