"""One material: its node tree's active output to `engine.Material`, and the table of all materials of a scene."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import bpy
import numpy as np

from ....engine import DEFAULT_MATERIAL, Material, SceneError
from ..changes import uid_of
from ..images import MISSING, Images
from ..notes import Notes
from ..stop import Stop
from ..unsupported import note_material
from .surface import Walk, merge_lobes
from .tree import Slot, find_input, shader_output, source
from .values import Evaluator, node_label

# What stands for values that depend on the ray or the place: the camera looks at the front.
NEAREST = {
    ("ShaderNodeLightPath", "Is Camera Ray"): 1.0,
    ("ShaderNodeLightPath", "Is Shadow Ray"): 0.0,
    ("ShaderNodeLightPath", "Is Diffuse Ray"): 0.0,
    ("ShaderNodeLightPath", "Is Glossy Ray"): 0.0,
    ("ShaderNodeLightPath", "Is Singular Ray"): 0.0,
    ("ShaderNodeLightPath", "Is Reflection Ray"): 0.0,
    ("ShaderNodeLightPath", "Is Transmission Ray"): 0.0,
    ("ShaderNodeLightPath", "Is Volume Scatter Ray"): 0.0,
    ("ShaderNodeNewGeometry", "Backfacing"): 0.0,
}


# W/(m2 sr), of any channel. The sun's disk shines with 1e7; far above the limit, sums of float32 are infinite.
BRIGHTEST = float(np.float32(1e30))


class MaterialTable:
    """Materials in the order they were first asked for; index 0 is the default of objects without any.

    uids  `uid_of` each, 0 of the default
    kept  by their uids, materials that were exported before
    """

    def __init__(
        self, notes: Notes, images: Images, override=None, stop: Stop | None = None,
        kept: Mapping[int, Material] | None = None,
    ) -> None:  # fmt: skip
        self.materials: list[Material] = [DEFAULT_MATERIAL]
        self.uids: list[int] = [0]
        self._notes = notes
        self._images = images
        self._override = override  # The view layer's material override, which replaces all others.
        self._stop = stop or Stop()
        self._known: dict[int, int] = {}
        self._kept = kept or {}

    def index(self, material) -> int:
        """Of a bpy material, None for none."""
        material = self._override or material
        if material is None:
            return 0
        uid = uid_of(material)
        if uid not in self._known:
            self._known[uid] = len(self.materials)
            exported = self._kept.get(uid) or export_material(material, self._notes, self._images, self._stop)
            if exported.pass_index != material.pass_index:
                exported = replace(exported, pass_index=material.pass_index)
            self.materials.append(exported)
            self.uids.append(uid)
        return self._known[uid]


def export_material(material, notes: Notes, images: Images, stop: Stop) -> Material:
    name = material.name_full  # With the library's name where it is linked: names may then be equal.
    if not uses_nodes(material):
        note_material(material, False, notes)
        return Material(name, kd=tuple(material.diffuse_color[:3]))

    def note(sentence: str) -> None:
        notes.warn("material", name, sentence)

    output = shader_output(material.node_tree, "ShaderNodeOutputMaterial")
    if output is None:
        note("it has no output node, drawn black")
        return Material(name)
    if output.target == "EEVEE":
        note("its output is for EEVEE only: drawn here, black in Cycles")
    _note_linked(output, "Volume", "volumes are not supported and left out", note)
    _note_linked(output, "Displacement", "displacement is not supported, the surface stays as it is", note)

    def texture(_evaluator, slot: Slot) -> np.ndarray:
        return average_color(slot, images, note)

    walk = Walk(Evaluator(note, texture, NEAREST, stop.check), notes.warn_scene)
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


def uses_nodes(datablock) -> bool:
    """From Blender 5.0 on materials and worlds always do, and the property only warns."""
    if bpy.app.version >= (5, 0, 0) and not isinstance(datablock, bpy.types.Light):
        return datablock.node_tree is not None
    return datablock.use_nodes and datablock.node_tree is not None


def average_color(slot: Slot, images: Images, note) -> np.ndarray:
    """(3,) or, for the Alpha output, (1,): the mean of the image that the slot's texture node shows."""
    image = slot.node.image
    mean = images.average(slot.node)
    if mean is None:
        why = images.problem(slot.node) if image else f"{node_label(slot.node)} has no image"
        note(f"{why}, drawn magenta")
        mean = np.array([*MISSING, 1.0])
    else:
        note(f"image '{image.name}' is not mapped, its average colour is drawn")
    color, alpha = mean[:3], mean[3:]
    if mean[3] < 1.0 and image.alpha_mode == "NONE":
        alpha = np.ones(1)
    elif mean[3] < 1.0 and darkened_by_alpha(slot.node):
        color = color * alpha
        note(f"image '{image.name}' has alpha that is not linked: its colour is drawn times its average alpha")
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


def _note_linked(output, name: str, sentence: str, note) -> None:
    socket = find_input(output, name)
    if socket is not None and source(Slot(socket)).socket.is_output:
        note(sentence)


def rgb(color: np.ndarray) -> tuple[float, float, float]:
    return float(color[0]), float(color[1]), float(color[2])
