"""The world: what its Background node shines with, a colour or an equirectangular image, and how that is turned.

Colour nodes between the image and the background are applied to the pixels. A procedural sky has no counterpart: it
becomes a constant and is named.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...engine import Visibility, World
from .images import MISSING, Images
from .materials import MaterialTable  # noqa: F401  (fills the registries of node converters)
from .materials.light_path import IN_WORLDS
from .materials.material import uses_nodes
from .materials.nodes_math import euler_matrix
from .materials.surface import Walk
from .materials.tree import Slot, find_input, shader_output, source
from .materials.values import Evaluator, as_color, node_label, value_node
from .notes import APPROXIMATED, WARNING, Notes
from .unsupported import note_world

# Mean radiance over the whole sphere of each kind of sky texture with its default settings, rendered with Cycles 5.0.
SKIES = {
    "PREETHAM": (0.60, 0.68, 1.00),
    "HOSEK_WILKIE": (0.083, 0.155, 0.219),
    "NISHITA": (2.07, 2.07, 2.01),  # of Blender 4; called single scattering from 5.0 on
    "SINGLE_SCATTERING": (2.07, 2.07, 2.01),
    "MULTIPLE_SCATTERING": (1.89, 2.55, 3.47),
}


def export_world(world, notes: Notes, images: Images) -> World:
    """Of a bpy world, evaluated; None gives a black one."""
    if world is None:
        return World()
    note_world(world, notes)
    visibility = world_visibility(world)
    if not uses_nodes(world):
        return World(color=tuple(world.color), visibility=visibility)
    output = shader_output(world.node_tree, "ShaderNodeOutputWorld")
    if output is None:
        return World(visibility=visibility)

    def note(sentence: str, level: str = WARNING) -> None:
        notes.add(level, "world", world.name, sentence)

    environment = Environment(images, note)
    walk = Walk(Evaluator(note, environment.texture, IN_WORLDS))
    if source(Slot(find_input(output, "Volume"))).socket.is_output:
        note("volumes are not supported and left out")
    light = walk.surface(Slot(find_input(output, "Surface"))).emission
    if light.ndim == 1:
        return World(color=tuple(float(c) for c in light), visibility=visibility)
    return World(
        color=(1.0, 1.0, 1.0),
        image=clean(light, note),
        rotation=environment.rotation,
        visibility=visibility,
    )


def clean(image: np.ndarray, note: Callable[[str], None]) -> np.ndarray:
    """(H, W, 3) float32; pixels that are not finite become black, as in Cycles (scene/image.cpp), and so do negative
    channels, which compression leaves behind and which cannot light anything."""
    image = image.astype(np.float32)
    bad = ~(np.isfinite(image) & (image >= 0))
    if count := int(np.count_nonzero(bad.any(axis=2))):
        note(f"{count} pixels of its image are negative or not finite, drawn as black")
        image[bad] = 0.0
    return np.ascontiguousarray(image)


def world_visibility(world) -> Visibility:
    """Cycles' ray visibility, where that add-on is enabled; else every ray sees the world."""
    flags = getattr(world, "cycles_visibility", None)
    visibility = Visibility.ALL
    for name, bit in (("camera", Visibility.CAMERA), ("diffuse", Visibility.DIFFUSE), ("glossy", Visibility.GLOSSY)):
        if not getattr(flags, name, True):
            visibility &= ~bit
    return visibility


@value_node("ShaderNodeTexSky")
def sky(evaluator: Evaluator, slot: Slot) -> np.ndarray:
    evaluator.note("Sky Texture is not supported: its average colour is drawn, without a sun and its shadows")
    return np.array(SKIES.get(slot.node.sky_type, SKIES["PREETHAM"]))


class Environment:
    """Converter for the texture nodes of a world. The first image that comes up is the world's; further ones of
    another size or rotation count with their average colour."""

    def __init__(self, images: Images, note) -> None:
        self.rotation: np.ndarray = np.eye(3)
        self._images = images
        self._note = note
        self._shape: tuple | None = None

    def texture(self, evaluator: Evaluator, slot: Slot) -> np.ndarray | None:
        node = slot.node
        is_whole = node.bl_idname == "ShaderNodeTexEnvironment" and node.projection == "EQUIRECTANGULAR"
        light = self._images.environment(node) if is_whole else self._images.environment_average(node)
        if light is None:
            why = self._images.problem(node) if node.image else f"{node_label(node)} has no image"
            self._note(f"{why}, drawn magenta")
            return np.array(MISSING)
        if is_moved(node.texture_mapping):
            self._note(f"the texture mapping of {node_label(node)} is not supported, left out: use a Mapping node")
        if not is_whole:
            return self._average(node, light, "is not an equirectangular environment")
        if node.interpolation != "Linear":
            kind = f"interpolation '{node.interpolation}' of image {node.image.name!r}"
            self._note(f"{kind} is not supported, drawn as 'Linear'", APPROXIMATED)
        rotation = self._rotation(evaluator, slot)
        if self._shape is None:
            self._shape, self.rotation = light.shape, rotation
        elif self._shape != light.shape or not np.allclose(rotation, self.rotation):
            mean = np.nan_to_num(light, posinf=0.0, neginf=0.0).mean(axis=(0, 1), dtype=np.float64)
            return self._average(node, mean, "is a second environment of another size or rotation")
        return light

    def _average(self, node, mean: np.ndarray, why: str) -> np.ndarray:
        self._note(f"image {node.image.name!r} {why}, its average colour is drawn")
        return mean

    def _rotation(self, evaluator: Evaluator, slot: Slot) -> np.ndarray:
        """(3, 3) from a world direction to the one that is looked up, through any number of Mapping nodes."""
        matrix = np.eye(3)
        vector = source(slot.input("Vector"))
        while vector.socket.is_output and vector.node.bl_idname == "ShaderNodeMapping":
            matrix = matrix @ self._mapping(evaluator, vector)
            vector = source(vector.input("Vector"))
        if vector.socket.is_output and not is_direction(vector):
            self._note(f"{node_label(vector.node)} is not supported as the direction of an environment, left out")
        return matrix

    def _mapping(self, evaluator: Evaluator, slot: Slot) -> np.ndarray:
        rotation = euler_matrix(evaluator.vector(slot.input("Rotation")))
        scale = as_color(evaluator.value(slot.input("Scale")))
        kind = slot.node.vector_type
        size = np.abs(scale).max()
        if kind in ("POINT", "TEXTURE") and np.abs(evaluator.vector(slot.input("Location"))).max() > 1e-6:
            self._note("Mapping's location is not supported for an environment, left out")
        if size == 0.0 or not np.allclose(np.abs(scale), size, rtol=1e-4):
            self._note("Mapping's uneven scale is not supported for an environment, left out")
            scale = np.ones(3)
        signs = np.diag(np.sign(scale))
        return signs @ rotation.T if kind == "TEXTURE" else rotation @ signs


def is_moved(mapping) -> bool:
    """Whether a texture node's own mapping, which files of old Blenders have, changes anything."""
    axes = (mapping.mapping_x, mapping.mapping_y, mapping.mapping_z)
    plain = axes == ("X", "Y", "Z") and not (mapping.use_min or mapping.use_max)
    return not plain or any(mapping.translation) or any(mapping.rotation) or tuple(mapping.scale) != (1.0, 1.0, 1.0)


def is_direction(slot: Slot) -> bool:
    """Outputs that are the ray's direction in a world."""
    node = slot.node
    if node.bl_idname == "ShaderNodeTexCoord":
        return slot.socket.identifier in ("Generated", "Object") and node.object is None
    return node.bl_idname == "ShaderNodeNewGeometry" and slot.socket.identifier == "Position"
