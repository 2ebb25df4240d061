"""Lamps: one converter for each of Blender's light types, in `LIGHT_CONVERTERS`.

A parent's uneven scale can shear a rotated lamp. The engine takes its shape as that leaves it, and Cycles takes parts
of it as if its axes were still at right angles: such lamps are named.

A lamp is exported with Blender's strength (see units.py) times its colour and, where it has a node tree, times what
that emits. Lamps that give no light are left out and listed in `Scene.skipped`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from math import pi
from typing import NamedTuple

import bpy
import numpy as np

from ...engine import AreaLight, Lamp, PointLight, SpotLight, SunLight, Visibility
from . import units
from .faults import naming
from .materials import MaterialTable  # noqa: F401  (fills the registries of node converters)
from .materials.light_path import IN_LAMPS
from .materials.material import uses_nodes
from .materials.surface import Walk
from .materials.tree import Slot, find_input, shader_output
from .materials.values import Evaluator
from .notes import WARNING, Notes
from .stop import ITEMS_A_CHECK, Stop
from .unsupported import note_light

LIGHTING_RAYS = int(~Visibility.SHADOW)  # whoever is seen by none of them lights nothing
SHEAR = 1e-3  # cosine of the angle between two axes of a lamp from which on it is named


class PlacedLamp(NamedTuple):
    """A lamp object where it stands, with all that is needed to export it again when its datablock has changed.

    light       `uid_of` the datablock
    visibility  bits of `Visibility`
    matrix      (3, 4) float64
    lamp        as it was exported; None where it gives no light
    """

    name: str
    light: int
    visibility: int
    matrix: np.ndarray
    lamp: Lamp | None = None


class LampKind(NamedTuple):
    """What all lamp objects of a datablock that the same rays see have in common.

    place  the lamp from what these differ in and what is named below, or None where it gives no light
    """

    type: str
    visibility: Visibility
    cast_shadow: bool
    place: Callable[[dict, Notes], Lamp | None]


def export_lamps(
    placed: Iterable[PlacedLamp], lights: Mapping[int, bpy.types.Light], notes: Notes, stop: Stop
) -> list[PlacedLamp]:
    """Those whose datablock is one of the evaluated `lights`, by `uid_of`, exported anew; the others as they are."""
    kinds: dict = {}
    exported = []
    for number, lamp in enumerate(placed):
        if number % ITEMS_A_CHECK == 0:
            stop.check()
        name, light, visibility, matrix, _ = lamp
        if light in lights:
            with naming("light", name):
                find = partial(lamp_kind, name, lights[light], visibility)
                kind = notes.alike(kinds, (light, visibility), name, find)
                lamp = PlacedLamp(name, light, visibility, matrix, kind and export_light(kind, name, matrix, notes))
        exported.append(lamp)
    return exported


def lit(placed: Iterable[PlacedLamp]) -> list[Lamp]:
    """Those that give light."""
    return [lamp.lamp for lamp in placed if lamp.lamp is not None]


def lamp_kind(name: str, data: bpy.types.Light, visibility: int, notes: Notes) -> LampKind | None:
    """A lamp object with this data, wherever it stands, or None where it gives no light. name: of one, for notes."""
    if data.type not in LIGHT_CONVERTERS:
        notes.warn("light", name, f"type {data.type.lower()} is not supported and left out")
        return None
    if data.type == "AREA" and getattr(getattr(data, "cycles", None), "is_portal", False):
        notes.skip("light", name, "it is a portal, which only guides Cycles")
        return None
    color = light_color(data, name, notes)
    strength = units.lamp_strength(data.energy, getattr(data, "exposure", 0.0))
    if strength == 0.0 or not color.any():
        notes.skip("light", name, "its strength is zero")
        return None
    if not visibility & LIGHTING_RAYS:
        notes.skip("light", name, "it is hidden from every ray")
        return None
    note_light(data, name, notes)
    place = LIGHT_CONVERTERS[data.type](data, color, strength)
    return LampKind(data.type, Visibility(visibility), bool(data.use_shadow), place)


def export_light(kind: LampKind, name: str, matrix: np.ndarray, notes: Notes) -> Lamp | None:
    """The lamp placed by `matrix` (3, 4) float64, or None where it gives no light there."""
    if kind.type in ("AREA", "SPOT"):
        _note_shape(kind.type, name, matrix[:, :3], notes)
    common = {"name": name, "transform": matrix, "visibility": kind.visibility, "cast_shadow": kind.cast_shadow}
    return kind.place(common, notes)


def _note_shape(kind: str, name: str, axes: np.ndarray, notes: Notes) -> None:
    """Names an area or spot lamp whose axes (columns, (3, 3)) Cycles reads in another way."""
    lengths = np.linalg.norm(axes, axis=0)
    if not lengths.all():
        if kind == "SPOT":  # an area lamp without area is left out
            notes.warn("light", name, "its scale is zero, which leaves no cone to shine through: set it above 0")
        return
    cosines = np.abs((axes / lengths).T @ (axes / lengths) - np.eye(3))
    if cosines.max() > SHEAR:
        notes.warn("light", name, "it is sheared by its parents, which Cycles lights otherwise: apply their scale")


def light_color(data, name: str, notes: Notes) -> np.ndarray:
    """(3,) colour, with the colour temperature of Blender 4.5 and later, times the emission of the node tree."""
    color = np.array(data.color[:3], np.float64)
    if getattr(data, "use_temperature", False):
        color *= np.array(data.temperature_color[:3])
    if not uses_nodes(data):
        return color
    output = shader_output(data.node_tree, "ShaderNodeOutputLight")
    if output is None:
        return np.zeros(3)

    def note(sentence: str, level: str = WARNING) -> None:
        notes.add(level, "light", name, sentence)

    def texture(_evaluator, _slot):
        return None

    walk = Walk(Evaluator(note, texture, IN_LAMPS))
    return color * walk.surface(Slot(find_input(output, "Surface"))).emission


def normalized(data) -> bool:
    """Whether the strength is a power, spread over the lamp's size: always before Blender 4.5."""
    return bool(getattr(data, "normalize", True))


def _rgb(color: np.ndarray, factor: float) -> tuple[float, float, float]:
    return tuple((color * factor).tolist())


def _sphere(data, color, strength: float) -> dict:
    """What point and spot lamps share. Their radius is in world space: the object's scale does not change it."""
    radius = data.shadow_soft_size
    return {
        "intensity": _rgb(color, units.point_intensity(strength, radius, normalized(data))),
        "radius": radius,
        "soft_falloff": bool(getattr(data, "use_soft_falloff", False)),
    }


def _point(data, color, strength: float) -> Callable[[dict, Notes], Lamp]:
    sphere = _sphere(data, color, strength)
    return lambda common, notes: PointLight(**common, **sphere)


def _spot(data, color, strength: float) -> Callable[[dict, Notes], Lamp]:
    sphere = _sphere(data, color, strength)
    cone = {"half_angle": min(data.spot_size / 2.0, pi / 2.0), "blend": data.spot_blend}
    return lambda common, notes: SpotLight(**common, **sphere, **cone)


def _sun(data, color, strength: float) -> Callable[[dict, Notes], Lamp]:
    angle = data.angle
    irradiance = _rgb(color, units.sun_irradiance(strength, angle, normalized(data)))
    return lambda common, notes: SunLight(**common, irradiance=irradiance, angle=angle)


def _area(data, color, strength: float) -> Callable[[dict, Notes], Lamp | None]:
    size_x = data.size
    size_y = data.size_y if data.shape in ("RECTANGLE", "ELLIPSE") else data.size
    ellipse = data.shape in ("DISK", "ELLIPSE")
    spread = getattr(data, "spread", pi)
    normalize = normalized(data)

    def place(common: dict, notes: Notes) -> Lamp | None:
        scale_x, scale_y = np.linalg.norm(common["transform"][:, :2], axis=0)
        area = units.area_of_light(size_x * scale_x, size_y * scale_y, ellipse)
        if area == 0.0:
            notes.skip("light", common["name"], "its area is zero")
            return None
        if spread <= 0.0:
            notes.warn("light", common["name"], "a spread of zero is not supported and left out")
            return None
        radiance = _rgb(color, units.area_radiance(strength, area, normalize))
        return AreaLight(**common, radiance=radiance, size_x=size_x, size_y=size_y, ellipse=ellipse, spread=spread)

    return place


LIGHT_CONVERTERS = {"POINT": _point, "SPOT": _spot, "SUN": _sun, "AREA": _area}
