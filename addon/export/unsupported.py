"""Names settings of datablocks that have no counterpart in the engine and that nothing else in the export looks at.

One function for each kind of datablock. What any engine would honour, or Cycles does, is a warning; what only EEVEE
does is a note that it was skipped, as Cycles skips it. Nodes are named where they are read, in `materials/`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import bpy

from ..passes import KINDS
from .notes import Notes
from .settings import property_group

CYCLES_BOUNCES = 1024  # Cycles' own limit of a lamp's or world's bounces, and its default: none
CYCLES_TRANSPARENT = 8  # Cycles' default limit of transparent surfaces, below which a file means it
DEFAULT_OFFSET = 0.1  # Cycles' default shadow terminator geometry offset; the engine's is 0
CAUSTICS = "shadow caustics are not supported and left out"
OWN_BOUNCES = "its own limit of bounces is not supported: it lights as far as the scene's bounces go"

# How the notes of what is made beside the picture begin.
AOVS, LIGHT_GROUPS, PASSES_NOT_MADE = "shader AOVs", "light groups", "these passes are not made"

PASSES = ("use_pass_", "pass_", "denoising_store_passes")  # how the boxes of passes are called
# What is no pass but the picture itself, a setting of one, what Blender makes of any engine's picture, and what Lobe
# makes.
WISHES_GRANTED = {
    "use_pass_combined", "use_pass_cryptomatte_accurate", "use_pass_grease_pencil",
    *(kind.box for kind in KINDS.values()),
}  # fmt: skip

EEVEE_LIGHT = {
    "diffuse_factor": "diffuse factor",
    "specular_factor": "specular factor",
    "transmission_factor": "transmission factor",
    "volume_factor": "volume factor",
}


# What `note_object` asks for: the object, and Cycles' settings of it.
TERMINATOR: tuple[str, ...] = ("shadow_terminator_geometry_offset", "shadow_terminator_shading_offset")
CYCLES_TERMINATOR: tuple[str, ...] = ()
if bpy.app.version < (4, 3, 0):
    TERMINATOR, CYCLES_TERMINATOR = (), ("shadow_terminator_geometry_offset", "shadow_terminator_offset")
OBJECT_FLAGS = ("visible_transmission", "visible_volume_scatter", *TERMINATOR)
CYCLES_FLAGS = ("is_caustics_caster", "is_caustics_receiver", *CYCLES_TERMINATOR)


def cycles_settings(datablock) -> Any:
    """Cycles' properties of an object, lamp, world or view layer; None where none was ever set, or without Cycles.

    Of the original: asking an evaluated datablock for a group of properties makes one, which nobody frees.
    """
    original = getattr(datablock, "original", datablock)
    try:
        return original.cycles if original.is_property_set("cycles") else None
    except TypeError:  # there is no such property; to look it up takes twenty times as long
        return None


def note_object(object_, cycles, notes: Notes) -> None:
    """Of a mesh or lamp object, or of what instances it, by `OBJECT_FLAGS` and its `cycles_settings` alone."""
    if not object_.visible_transmission:
        what = "hiding it from transmission rays is not supported: glass is drawn as a clear pane and shows it"
        notes.warn("object", object_.name_full, what)
    if not object_.visible_volume_scatter:
        notes.skip("object", object_.name_full, "it is hidden from volume scatter, which is not drawn")
    if offsets_terminator(object_, cycles):
        notes.warn("object", object_.name_full, "shadow terminator offsets are not supported and left out")
    if cycles is not None and (cycles.is_caustics_caster or cycles.is_caustics_receiver):
        notes.warn("object", object_.name_full, CAUSTICS)


def offsets_terminator(object_, cycles) -> bool:
    """By more or less than Cycles does unless told. Properties of the object from Blender 4.3 on."""
    owner, names = (object_, TERMINATOR) if TERMINATOR else (cycles, CYCLES_TERMINATOR)
    if owner is None:
        return False
    geometry, shading = (getattr(owner, name) for name in names)
    return shading > 0.0 or not (geometry == 0.0 or abs(geometry - DEFAULT_OFFSET) < 1e-6)


def note_light(data, name: str, notes: Notes) -> None:
    """Of a lamp's data; `name` is its object's."""
    cycles = cycles_settings(data)
    if getattr(cycles, "max_bounces", CYCLES_BOUNCES) < CYCLES_BOUNCES:
        notes.warn("light", name, OWN_BOUNCES)
    if getattr(cycles, "is_caustics_light", False):
        notes.warn("light", name, CAUSTICS)
    changed = [label for key, label in EEVEE_LIGHT.items() if getattr(data, key, 1.0) != 1.0]
    changed += ["custom distance"] if getattr(data, "use_custom_distance", False) else []
    changed += ["square cone"] if data.type == "SPOT" and getattr(data, "use_square", False) else []
    if changed:
        notes.skip("light", name, f"{', '.join(changed)}: only EEVEE knows that, Cycles leaves it out too")


def note_world(world, notes: Notes) -> None:
    cycles = cycles_settings(world)
    if getattr(cycles, "max_bounces", CYCLES_BOUNCES) < CYCLES_BOUNCES:
        notes.warn("world", world.name_full, OWN_BOUNCES)
    if getattr(cycles, "is_caustics_light", False):
        notes.warn("world", world.name_full, CAUSTICS)
    visibility = getattr(world, "cycles_visibility", None)
    if not getattr(visibility, "transmission", True):
        what = "hiding it from transmission rays is not supported: glass is drawn as a clear pane and shows it"
        notes.warn("world", world.name_full, what)
    if not getattr(visibility, "scatter", True):
        notes.skip("world", world.name_full, "it is hidden from volume scatter, which is not drawn")


def note_material(material, lets_light_through: bool, notes: Notes) -> None:
    name = material.name_full
    if lets_light_through and not getattr(material, "use_transparent_shadow", True):
        notes.warn("material", name, "opaque shadows of a transparent surface are not supported: light passes through")
    if material.use_backface_culling or getattr(material, "use_backface_culling_shadow", False):
        notes.skip("material", name, "backface culling: only EEVEE knows that, Cycles draws both sides too")


def note_view_layer(view_layer, notes: Notes) -> None:
    name = view_layer.name
    how = getattr(cycles_settings(view_layer.id_data), "use_layer_samples", "USE")
    if view_layer.samples and how != "IGNORE":
        what = f"its own number of samples ({view_layer.samples}) is not supported, it gets the scene's"
        notes.warn("view layer", name, what)
    for what, named in ((AOVS, view_layer.aovs), (LIGHT_GROUPS, view_layer.lightgroups)):
        if names := ", ".join(each.name for each in named):
            mend = "to remove them, choose Cycles for the while"  # with Lobe their panels are hidden
            notes.warn("view layer", name, f"{what} are not supported and left out: {names}; {mend}")
    if passes := ", ".join(box.text for box in passes_not_made(view_layer)):
        notes.warn("view layer", name, f"{PASSES_NOT_MADE}: {passes}; untick them under View Layer > Passes")


def is_beside_the_picture(kind: str, what: str) -> bool:
    """Whether a note is of a wish for pictures beside Combined, which itself is as without the wish."""
    return kind == "view layer" and what.startswith((AOVS, LIGHT_GROUPS, PASSES_NOT_MADE))


class Box(NamedTuple):
    """A property that asks for a pass."""

    owner: Any
    key: str
    text: str


def passes_not_made(view_layer) -> list[Box]:
    """Those that are ticked: Blender's own, and those of Cycles and EEVEE, for which Lobe may have boxes of its own."""
    owners = {"": view_layer, " (Cycles)": cycles_settings(view_layer), " (EEVEE)": getattr(view_layer, "eevee", None)}
    return [
        Box(owner, prop.identifier, prop.name + whose)
        for whose, owner in owners.items()
        for prop in (owner.bl_rna.properties if owner is not None else ())
        if prop.type == "BOOLEAN"
        and prop.identifier.startswith(PASSES)
        and prop.identifier not in WISHES_GRANTED
        and getattr(owner, prop.identifier)
    ]


def note_cycles_scene(scene, notes: Notes) -> None:
    """What Cycles' settings ask for that changes what is drawn. Those of its sampling are no wish of the scene's."""
    cycles = property_group(scene, "cycles")
    if cycles is None:
        return
    if not (cycles.caustics_reflective and cycles.caustics_refractive):
        notes.warn_scene("Cycles' caustics are switched off, which is not supported: light that mirrors throw is drawn")
    if cycles.transparent_max_bounces < CYCLES_TRANSPARENT:
        limit = f"Cycles' limit of {cycles.transparent_max_bounces} transparent bounces"
        notes.warn_scene(f"{limit} is not supported: light passes through more transparent surfaces than that")
    if cycles.use_fast_gi:
        notes.warn_scene("Cycles' Fast Global Illumination is not supported: all bounces are traced")
    if scene.render.film_transparent and cycles.film_transparent_glass:
        notes.warn_scene(
            "Cycles' Transparent Glass is not supported: glass is drawn as a clear pane, with alpha to match"
        )
    if scene.render.use_simplify and (cycles.use_camera_cull or cycles.use_distance_cull):
        notes.warn_scene("culling by the camera or by distance (Simplify) is not supported: every object is drawn")
