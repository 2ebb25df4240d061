"""The world: what its Background node shines with, a colour or an equirectangular image, and how that is turned.

Colour nodes between the image and the background are applied to the pixels. A Sky Texture is such an image too, and its
sun, which is too small for pixels, becomes a sun lamp.
"""

from __future__ import annotations

from collections.abc import Callable
from math import pi, sin
from typing import NamedTuple

import numpy as np
from mathutils import Vector

from ...engine import SunLight, Visibility, World
from .images import MISSING, Images
from .materials import MaterialTable  # noqa: F401  (fills the registries of node converters)
from .materials.light_path import IN_WORLDS
from .materials.material import uses_nodes
from .materials.nodes_math import euler_matrix, turn_of
from .materials.surface import Walk
from .materials.tree import Slot, find_input, shader_output, source
from .materials.values import Evaluator, as_color, node_label
from .notes import APPROXIMATED, WARNING, Notes
from .sky import BY_DIRECTION, Sun, not_in_table, sky_radiance, sun_of
from .unsupported import note_world

SKY_SHAPE = (256, 512)  # rows and columns of a world that shows nothing but a sky
ROWS = 64  # of an image, that many at a time


class ExportedWorld(NamedTuple):
    """suns: those of its Sky Textures, which the world's image doesn't show."""

    world: World
    suns: list[SunLight]


def export_world(world, notes: Notes, images: Images, film_transparent: bool) -> ExportedWorld:
    """Of a bpy world, evaluated; None gives a black one."""
    if world is None:
        return ExportedWorld(World(), [])
    note_world(world, notes)
    visibility = world_visibility(world)
    if not uses_nodes(world):
        return ExportedWorld(World(color=tuple(world.color), visibility=visibility), [])
    output = shader_output(world.node_tree, "ShaderNodeOutputWorld")
    if output is None:
        return ExportedWorld(World(visibility=visibility), [])

    def note(sentence: str, level: str = WARNING) -> None:
        notes.add(level, "world", world.name_full, sentence)

    def shining(texture: Callable) -> np.ndarray:
        return Walk(Evaluator(note, texture, IN_WORLDS)).surface(surface).emission

    environment, surface = Environment(images, note), Slot(find_input(output, "Surface"))
    if source(Slot(find_input(output, "Volume"))).socket.is_output:
        note("volumes are not supported and left out")
    light = shining(environment.texture)
    if light.ndim == 1:
        return ExportedWorld(World(color=tuple(float(c) for c in light), visibility=visibility), [])
    rotation, seen = environment.rotation, visibility & ~Visibility.CAMERA if film_transparent else visibility
    suns = [sun_lamp(sun, shining(environment.at_sun(key)), seen) for key, sun in environment.suns.items()]
    shown = World(color=(1.0, 1.0, 1.0), image=clean(light, note), rotation=rotation, visibility=visibility)
    return ExportedWorld(shown, [sun for sun in suns if any(sun.irradiance)])


def sun_lamp(sun: Sun, light: np.ndarray, visibility: Visibility) -> SunLight:
    """light: what the world shines with at the sun, (1, 2, 3): beside the disk and on it; or without one, (3,)."""
    disk = np.zeros(3) if light.ndim == 1 else np.maximum(light[0, 1] - light[0, 0], 0.0)
    place = np.zeros((3, 4))
    place[:, :3] = Vector(sun.direction).to_track_quat("Z", "Y").to_matrix()
    irradiance = tuple((disk * solid_angle(sun)).tolist())
    return SunLight("sun of the world", place, visibility, irradiance=irradiance, angle=sun.angle)


def solid_angle(sun: Sun) -> float:
    """Of the disk, each part times its cosine to the middle."""
    return pi * sin(sun.angle / 2.0) ** 2


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


class Environment:
    """Converter for the texture nodes of a world. The first image that comes up is the world's; further ones of
    another size or rotation count with their average colour. A sky fits any.

    suns  of Sky Textures, by `Slot.key`
    """

    def __init__(self, images: Images, note) -> None:
        self.rotation: np.ndarray = np.eye(3)
        self.suns: dict[tuple, Sun] = {}
        self._drawn: dict[tuple, np.ndarray] = {}  # the same, what nodes are drawn as
        self._images = images
        self._note = note
        self._shape: tuple[int, int] | None = None

    def texture(self, evaluator: Evaluator, slot: Slot) -> np.ndarray:
        """(H, W, 3), or (3,) for an average."""
        draw = self._sky if slot.node.bl_idname == "ShaderNodeTexSky" else self._image
        if is_moved(slot.node.texture_mapping):
            label = node_label(slot.node)
            self._note(f"the texture mapping of {label} is not supported, left out: use a Mapping node")
        self._drawn[slot.key] = light = draw(evaluator, slot)
        return light

    def at_sun(self, key: tuple) -> Callable:
        """A converter as `texture`, of the same nodes, at one of the suns: beside its disk and on it, (1, 2, 3)."""
        sun = self.suns[key]
        disk = sun.irradiance / solid_angle(sun)

        def texture(_evaluator, slot: Slot) -> np.ndarray:
            light = self._drawn[slot.key]
            if light.ndim == 1:
                return light
            beside = light[pixel_of(self.rotation @ sun.direction, light.shape)]
            return np.array([[beside, beside + disk if slot.key == key else beside]])

        return texture

    def _sky(self, evaluator: Evaluator, slot: Slot) -> np.ndarray:
        node = slot.node
        if others := not_in_table(node):
            self._note(f"{node_label(node)} is drawn with its default {' and '.join(others)}")
        if sun := sun_of(node):
            self.suns[slot.key] = sun
        self._shape = height, width = self._shape or SKY_SHAPE
        turn = self.rotation
        if node.sky_type in BY_DIRECTION:  # the others look where the ray goes, whatever comes in
            turn = turn @ self._rotation(evaluator, slot).T
        sky = np.empty((height, width, 3), np.float32)
        for start in range(0, height, ROWS):
            rows = slice(start, start + ROWS)
            sky[rows] = sky_radiance(node, directions(rows, height, width) @ turn)
        return sky

    def _image(self, evaluator: Evaluator, slot: Slot) -> np.ndarray:
        node = slot.node
        is_whole = node.bl_idname == "ShaderNodeTexEnvironment" and node.projection == "EQUIRECTANGULAR"
        light = self._images.environment(node) if is_whole else self._images.environment_average(node)
        if light is None:
            why = self._images.problem(node) if node.image else f"{node_label(node)} has no image"
            self._note(f"{why}, drawn magenta")
            return np.array(MISSING)
        if not is_whole:
            return self._average(node, light, "is not an equirectangular environment")
        if node.interpolation != "Linear":
            kind = f"interpolation '{node.interpolation}' of image {node.image.name!r}"
            self._note(f"{kind} is not supported, drawn as 'Linear'", APPROXIMATED)
        rotation, shape = self._rotation(evaluator, slot), light.shape[:2]
        if self._shape is None:
            self._shape, self.rotation = shape, rotation
        elif self._shape != shape or not np.allclose(rotation, self.rotation):
            mean = np.nan_to_num(light, posinf=0.0, neginf=0.0).mean(axis=(0, 1), dtype=np.float64)
            return self._average(node, mean, "is a second environment of another size or rotation")
        return light

    def _average(self, node, mean: np.ndarray, why: str) -> np.ndarray:
        self._note(f"image {node.image.name!r} {why}, its average colour is drawn")
        return mean

    def _rotation(self, evaluator: Evaluator, slot: Slot) -> np.ndarray:
        """(3, 3) from a world direction to the one that is looked up, through any number of nodes that turn it."""
        turns = {"ShaderNodeMapping": self._mapping, "ShaderNodeVectorRotate": self._turn}
        matrix = np.eye(3)
        vector = source(slot.input("Vector"))
        while vector.socket.is_output and vector.node.bl_idname in turns:
            matrix = matrix @ turns[vector.node.bl_idname](evaluator, vector)
            vector = source(vector.input("Vector"))
        if vector.socket.is_output and not is_direction(vector):
            self._note(f"{node_label(vector.node)} is not supported as the direction of an environment, left out")
        return matrix

    def _turn(self, evaluator: Evaluator, slot: Slot) -> np.ndarray:
        if np.abs(evaluator.vector(slot.input("Center"))).max() > 1e-6:
            self._note("Vector Rotate's center is not supported for an environment, left out")
        return turn_of(evaluator, slot)

    def _mapping(self, evaluator: Evaluator, slot: Slot) -> np.ndarray:
        rotation = euler_matrix(evaluator.mean_vector(slot.input("Rotation")))
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


def directions(rows: slice, height: int, width: int) -> np.ndarray:
    """(rows, W, 3) unit, of the pixels of a world's image in its own space; see engine.World."""
    azimuth = pi - (np.arange(width) + 0.5) / width * 2.0 * pi
    down = ((np.arange(height) + 0.5) / height * pi)[rows, None]
    ring = np.sin(down)
    return np.stack([ring * np.cos(azimuth), ring * np.sin(azimuth), -np.cos(down) + 0.0 * azimuth], axis=-1)


def pixel_of(direction: np.ndarray, shape: tuple[int, ...]) -> tuple[int, int]:
    """Row and column of the pixel of an image of that shape that shows a unit vector in the image's own space."""
    x, y, z = direction
    row = int(np.arccos(np.clip(-z, -1.0, 1.0)) / pi * shape[0])
    return min(row, shape[0] - 1), int((1.0 - np.arctan2(y, x) / pi) / 2.0 * shape[1]) % shape[1]


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
