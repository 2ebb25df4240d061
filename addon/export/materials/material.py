"""One material: its node tree's active output to `engine.Material`, and the table of all materials of a scene."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import bpy
import numpy as np

from ....engine import DEFAULT_MATERIAL, Material, SceneError
from ..changes import uid_of
from ..faults import naming
from ..images import MISSING, Images
from ..notes import WARNING, Note, Notes
from ..sky import mean_sky
from ..stop import Stop
from ..unsupported import note_material
from .light_path import IN_MATERIALS
from .surface import Walk, merge_lobes
from .tree import Slot, find_input, shader_output, source
from .values import Evaluator, node_label

# W/(m2 sr), of any channel. The sun's disk shines with 1e7; far above the limit, sums of float32 are infinite.
BRIGHTEST = float(np.float32(1e30))


class Exported(NamedTuple):
    """A material, and what was said of it."""

    material: Material
    notes: list[Note]


class MaterialTable:
    """Materials in the order they were first asked for; index 0 is the default of objects without any.

    exported  by `uid_of`, those that are the same in the next frame if nothing has changed
    lasting   whether those are all of them
    kept      `exported` of an export before
    """

    def __init__(
        self, notes: Notes, images: Images, override=None, stop: Stop | None = None,
        kept: Mapping[int, Exported] | None = None,
    ) -> None:  # fmt: skip
        self.materials: list[Material] = [DEFAULT_MATERIAL]
        self.exported: dict[int, Exported] = {}
        self.lasting = True
        self._notes = notes
        self._images = images
        self._override = override  # The view layer's material override, which replaces all others.
        self._stop = stop or Stop()
        self._known: dict[tuple[int, bool], int] = {(0, False): 0}
        self._kept = kept or {}

    def draws_default(self, holdout: bool) -> bool:
        """Whether surfaces without a material of their own, on a holdout or not, show the default one."""
        return self._override is None and not holdout

    def index(self, material, holdout: bool = False) -> int:
        """Of a bpy material, None for none, on an object that may be a holdout."""
        material = self._override or material
        key = uid_of(material), holdout
        if key not in self._known:
            if holdout:
                exported = replace(self.materials[self.index(material)], holdout=True)
            else:
                exported = replace(self._export(key[0], material), pass_index=material.pass_index)
            self._known[key] = len(self.materials)
            self.materials.append(exported)
        return self._known[key]

    def again(self, before: MaterialTable, changed: Mapping[int, bpy.types.Material]) -> None:
        """Fill this new table as `before`, which was `lasting`, with those that have `changed`, by `uid_of`, exported
        anew."""
        for (uid, holdout), place in before._known.items():
            if uid in changed:
                self.index(changed[uid], holdout)
            elif place:
                self._known[uid, holdout] = len(self.materials)
                self.materials.append(before.materials[place])
                if uid in before.exported:  # all but the default of objects without any
                    self.exported[uid] = before.exported[uid]

    def _export(self, uid: int, material) -> Material:
        if uid in self._kept:
            self._notes.again(self._kept[uid].notes)
            self.exported[uid] = self._kept[uid]
            return self._kept[uid].material
        self._images.lasting()
        with self._notes.recorded() as notes, naming("material", material.name_full):
            exported = export_material(material, notes, self._images, self._stop)
        if self._images.lasting():
            self.exported[uid] = Exported(exported, notes.all)
        else:
            self.lasting = False
        return exported


def export_material(material, notes: Notes, images: Images, stop: Stop) -> Material:
    name = material.name_full  # With the library's name where it is linked: names may then be equal.
    if not uses_nodes(material):
        note_material(material, False, notes)
        return Material(name, kd=tuple(material.diffuse_color[:3]))

    def note(sentence: str, level: str = WARNING) -> None:
        notes.add(level, "material", name, sentence)

    output = shader_output(material.node_tree, "ShaderNodeOutputMaterial")
    if output is None:
        note("it has no output node, drawn black")
        return Material(name)
    if output.target == "EEVEE":
        note("its output is for EEVEE only: drawn here, black in Cycles")
    has_volume = _is_linked(output, "Volume")
    if has_volume:
        note("volumes are not supported and left out")
    if _is_linked(output, "Displacement"):
        note("displacement is not supported, the surface stays as it is")

    if has_volume and not _is_linked(output, "Surface"):  # Without a volume Cycles draws it black.
        note_material(material, False, notes)
        return Material(name, transparency=(1.0, 1.0, 1.0))
    if is_hole(output):
        note_material(material, False, notes)
        return Material(name, holdout=True)

    def texture(_evaluator, slot: Slot) -> np.ndarray:
        if slot.node.bl_idname == "ShaderNodeTexSky":
            note(f"{node_label(slot.node)} is drawn in its average colour: textures are not supported yet")
            return mean_sky(slot.node)
        return average_color(slot, images, note)

    walk = Walk(Evaluator(note, texture, IN_MATERIALS, stop.check))
    surface = walk.surface(Slot(find_input(output, "Surface")))
    ks, exponent = merge_lobes(surface.lobes, note)
    note_material(material, bool(surface.transparency.max() > 0.0), notes)
    if surface.transparency.max() > 1.0 + 1e-6:
        note("it lets through more light than there is, limited to all of it")
    if surface.emission.max() > BRIGHTEST:
        raise SceneError(f"material {name!r}: its emission is {surface.emission.max():.3g}; set it to 1e30 or less")
    return Material(
        name,
        kd=rgb(surface.diffuse),
        ks=rgb(ks),
        exponent=exponent,
        emission=rgb(surface.emission),
        transparency=rgb(np.minimum(surface.transparency, 1.0)),
    )


def is_hole(output) -> bool:
    """Whether the whole surface is the Holdout shader, which is black for all but the camera."""
    shader = source(Slot(find_input(output, "Surface"))).socket
    return shader.is_output and shader.node.bl_idname == "ShaderNodeHoldout"


def always_uses_nodes(datablock) -> bool:
    """Materials and worlds from Blender 5.0 on, lamps from 5.1 on: `use_nodes` then only warns."""
    return bpy.app.version >= ((5, 1) if isinstance(datablock, bpy.types.Light) else (5, 0))


def uses_nodes(datablock) -> bool:
    return datablock.node_tree is not None and (always_uses_nodes(datablock) or datablock.use_nodes)


def average_color(slot: Slot, images: Images, note) -> np.ndarray:
    """(3,) or, for the Alpha output, (1,): the mean of the image that the slot's texture node shows."""
    image = slot.node.image
    mean = images.average(slot.node)
    if mean is None:
        why = images.problem(slot.node) if image else f"{node_label(slot.node)} has no image"
        note(f"{why}, drawn magenta")
        mean = np.array([*MISSING, 1.0])
    else:
        note(f"image {image.name!r} is drawn in its average colour: textures are not supported yet")
    color, alpha = mean[:3], mean[3:]
    if mean[3] < 1.0 and image.alpha_mode == "NONE":
        alpha = np.ones(1)
    elif mean[3] < 1.0 and darkened_by_alpha(slot.node):
        color = color * alpha
        note(f"image {image.name!r} has alpha that is not linked: its colour is drawn times its average alpha")
    return alpha if slot.socket.identifier == "Alpha" else color


def darkened_by_alpha(node) -> bool:
    """Whether Cycles leaves an image's colour multiplied with its alpha: nobody asks for the alpha by itself."""
    image = node.image
    if node.bl_idname != "ShaderNodeTexImage" or node.outputs["Alpha"].is_linked:
        return False
    if image.alpha_mode not in ("STRAIGHT", "PREMUL") or image.colorspace_settings.is_data:
        return False
    from_file = image.source in ("FILE", "SEQUENCE", "TILED") and not image.packed_files
    return from_file or not image.is_float  # Blender holds floats multiplied already.


def _is_linked(output, name: str) -> bool:
    """Whether a node feeds that input of the output node; what ends at a muted node or a reroute doesn't."""
    socket = find_input(output, name)
    return socket is not None and source(Slot(socket)).socket.is_output


def rgb(color: np.ndarray) -> tuple[float, float, float]:
    return float(color[0]), float(color[1]), float(color[2])
