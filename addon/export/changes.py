"""What a dependency graph says has changed, in the terms of an export.

An evaluated datablock has no `session_uid` of its own: it is that of its original which stays the same.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import bpy

# Objects that nothing in a picture is made of. What they carry or deform is listed by itself.
UNSEEN = {"CAMERA", "SPEAKER", "LIGHT_PROBE", "ARMATURE", "LATTICE"}


def uid_of(datablock) -> int:
    """Of an original or evaluated datablock, or None: a number that no other has while Blender runs. 0 for None, and
    for what has no original: the meshes that geometry nodes make."""
    return 0 if datablock is None else datablock.original.session_uid


@dataclass
class Changes:
    """What has to be exported again.

    placed     where objects stand, and which there are
    scene      something of the scene or of its view layers: maybe which objects are shown, of which nothing else may be
               said, and maybe only how the picture is exposed
    shaded     by `uid_of`, evaluated objects of which Blender says that their shading alone has changed. That is so of
               all that have a material that was edited, and of what other rays see; but it is also all that is said of
               one that a driver hides (what keys change is said by the action, which is listed too). And lamp objects
               that haven't moved
    lights     these, evaluated, by `uid_of`
    geometry   `uid_of` objects and of their data whose surfaces were evaluated again
    materials  these, evaluated, by `uid_of`
    nodes      node groups or images, which any material, lamp and world may use
    images     the pixels of some image
    world      the world
    """

    placed: bool = False
    scene: bool = False
    shaded: dict[int, bpy.types.Object] = field(default_factory=dict)
    lights: dict[int, bpy.types.Light] = field(default_factory=dict)
    geometry: set[int] = field(default_factory=set)
    materials: dict[int, bpy.types.Material] = field(default_factory=dict)
    nodes: bool = False
    images: bool = False
    world: bool = False

    @property
    def is_shading(self) -> bool:
        """Whether surfaces may look otherwise."""
        return bool(self.materials or self.shaded)


def changes_of(updates) -> Changes:
    """Of a bpy `Depsgraph.updates`. What isn't known here may change where things are placed."""
    changes = Changes()
    for update in updates:
        _add(changes, update)
    # A tree that belongs to a material is mostly listed beside it, but alone when an image was put into it.
    owners = (bpy.types.Material, bpy.types.World, bpy.types.Light)
    with_owner = {u.id.node_tree.as_pointer() for u in updates if isinstance(u.id, owners) and u.id.node_tree}
    trees = {u.id.as_pointer() for u in updates if isinstance(u.id, bpy.types.ShaderNodeTree)}
    changes.nodes |= not trees <= with_owner
    return changes


def _add(changes: Changes, update) -> None:
    match update.id:
        case bpy.types.Object() as object_ if object_.type in UNSEEN:
            pass
        case bpy.types.Camera() | bpy.types.ShaderNodeTree():
            pass  # the view is looked at whenever it is drawn, and the trees by `changes_of`
        case bpy.types.CompositorNodeTree():
            pass  # Blender draws it over the picture
        case bpy.types.Material() as material:
            changes.materials[uid_of(material)] = material
        case bpy.types.World():
            changes.world = True
        case bpy.types.Image() | bpy.types.Texture() | bpy.types.MovieClip():
            changes.nodes = changes.images = True
        case bpy.types.Light() as light:
            changes.lights[uid_of(light)] = light
        case bpy.types.Scene() if not (update.is_updated_transform or update.is_updated_geometry):
            changes.scene = True
        case bpy.types.Object() as object_ if _is_shaded_alone(update) or _is_lamp_in_its_place(update):
            changes.shaded[uid_of(object_)] = object_
        case bpy.types.Mesh() | bpy.types.Curve() | bpy.types.MetaBall() if _is_shaded_alone(update):
            pass  # what of theirs has a material that was edited; another material counts as geometry
        case datablock:
            changes.placed = True
            if update.is_updated_geometry:
                changes.geometry.add(uid_of(datablock))


def _is_shaded_alone(update) -> bool:
    return update.is_updated_shading and not (update.is_updated_transform or update.is_updated_geometry)


def _is_lamp_in_its_place(update) -> bool:
    """The geometry of a lamp object, which has none, is listed when its datablock is edited."""
    return update.id.type == "LIGHT" and update.is_updated_shading and not update.is_updated_transform
