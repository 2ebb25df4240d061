"""Lamps: what is exported, lit by the engine's own definitions (engine/scene.py), against Cycles' picture of it."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from bl_ext.user_default.lobe import engine
from bl_ext.user_default.lobe.addon.export import export_scene

from tests.blender.export_checks import (
    add_camera,
    add_object,
    cycles_picture,
    depsgraph,
    new_material,
    node_tree,
    plane_mesh,
)

PIXELS = 12
WIDTH = 6.0  # metres that the picture is wide


def new_light(kind: str, location=(0.3, -0.2, 2.0), rotation=(0.3, -0.2, 0.4), scale=(1, 1, 1), **properties):
    data = bpy.data.lights.new("Lamp", kind)
    for key, value in properties.items():
        setattr(data, key, value)
    return add_object("Lamp", data, location, rotation, scale)


def stage() -> None:
    """A white diffuse floor at z = 0, seen from straight above."""
    floor = plane_mesh()
    floor.materials.append(new_material("White", "ShaderNodeBsdfDiffuse", Color=(1, 1, 1, 1))[0])
    add_object("Floor", floor)
    camera = add_camera(type="ORTHO", ortho_scale=WIDTH)
    camera.location.z = 50.0


def exported_light():
    scene = export_scene(depsgraph())
    assert len(scene.lights) == 1
    return scene.lights[0]


def floor_points(per_pixel: int) -> np.ndarray:
    """(PIXELS * per_pixel, PIXELS * per_pixel, 3), rows from the bottom as in the picture."""
    places = (np.arange(PIXELS * per_pixel) + 0.5) / (PIXELS * per_pixel) * WIDTH - WIDTH / 2
    x, y = np.meshgrid(places, places)
    return np.stack([x, y, np.zeros_like(x)], axis=-1)


def square_grid(count: int) -> tuple[np.ndarray, np.ndarray]:
    middle = (np.arange(count) + 0.5) / count
    u, v = np.meshgrid(middle, middle)
    return u.ravel(), v.ravel()


def disk_grid(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Points on the unit disk that stand for equal areas."""
    u, v = square_grid(count)
    radius, angle = np.sqrt(u), 2 * np.pi * v
    return radius * np.cos(angle), radius * np.sin(angle)


def frame(axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors across each of `axis` (..., 3)."""
    helper = np.where(np.abs(axis[..., :1]) < 0.5, [1.0, 0, 0], [0, 1.0, 0])
    first = np.cross(helper, axis)
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    return first, np.cross(axis, first)


def spot_factor(light, wi: np.ndarray) -> np.ndarray:
    """The cone's share of light that travels along -wi."""
    if not isinstance(light, engine.SpotLight):
        return np.ones(wi.shape[:-1])
    local = wi @ np.linalg.inv(light.transform[:, :3]).T
    cosine = local[..., 2] / np.linalg.norm(local, axis=-1)
    edge = np.cos(light.half_angle)
    s = np.clip((cosine - edge) / max((1 - edge) * light.blend, 1e-9), 0, 1)
    return s * s * (3 - 2 * s)


def irradiance(light, p: np.ndarray, count: int = 24) -> np.ndarray:
    """(..., 3) on a floor that faces up, by quadrature over the lamp as engine/scene.py defines it."""
    origin, axes = light.transform[:, 3], light.transform[:, :3]
    if isinstance(light, engine.SunLight):
        towards = np.broadcast_to(axes[:, 2] / np.linalg.norm(axes[:, 2]), p.shape)
        if light.angle == 0:
            return np.array(light.irradiance) * towards[..., 2:]
        radiance = np.array(light.irradiance) / (np.pi * np.sin(light.angle / 2) ** 2)
        return over_cone(light, towards, 1 - np.cos(light.angle / 2), radiance, count)
    to_light = origin - p
    distance = np.linalg.norm(to_light, axis=-1, keepdims=True)
    axis = to_light / distance
    if isinstance(light, engine.AreaLight):
        return area_irradiance(light, p, count)
    if light.radius == 0:
        return np.array(light.intensity) * (spot_factor(light, axis)[..., None] * axis[..., 2:] / distance**2)
    radiance = np.array(light.intensity) / (np.pi * light.radius**2)
    if light.soft_falloff:
        x, y = disk_grid(count)
        first, second = frame(axis)
        total = np.zeros(p.shape[:-1])
        for a, b in zip(x, y, strict=True):
            wi = to_light + light.radius * (a * first + b * second)
            d2 = (wi**2).sum(-1)
            wi /= np.sqrt(d2)[..., None]
            total += spot_factor(light, wi) * np.maximum(wi[..., 2], 0) * (wi * axis).sum(-1) / d2
        return radiance * (total / len(x) * np.pi * light.radius**2)[..., None]
    one_minus_cos = 1 - np.sqrt(1 - (light.radius / distance[..., 0]) ** 2)
    return over_cone(light, axis, one_minus_cos, radiance, count)


def over_cone(light, axis: np.ndarray, one_minus_cos, radiance: np.ndarray, count: int) -> np.ndarray:
    """Constant radiance over a cone of directions, times the spot's factor."""
    first, second = frame(axis)
    total = np.zeros(axis.shape[:-1])
    for u, v in zip(*square_grid(count), strict=True):
        cosine = 1 - u * one_minus_cos
        sine, angle = np.sqrt(1 - cosine**2), 2 * np.pi * v
        across = np.cos(angle) * first + np.sin(angle) * second
        wi = np.asarray(cosine)[..., None] * axis + np.asarray(sine)[..., None] * across
        total += spot_factor(light, wi) * np.maximum(wi[..., 2], 0)
    return radiance * (total / count**2 * 2 * np.pi * one_minus_cos)[..., None]


def area_irradiance(light, p: np.ndarray, count: int) -> np.ndarray:
    origin, axes = light.transform[:, 3], light.transform[:, :3]
    beam = -axes[:, 2] / np.linalg.norm(axes[:, 2])
    if light.spread < 0.5:
        return narrow_beam(light, p, beam, count)
    u, v = square_grid(count)
    x, y = disk_grid(count) if light.ellipse else (2 * u - 1, 2 * v - 1)
    side_x, side_y = axes[:, 0] * light.size_x / 2, axes[:, 1] * light.size_y / 2
    area = np.linalg.norm(np.cross(side_x, side_y)) * (np.pi if light.ellipse else 4)
    half = light.spread / 2
    total = np.zeros(p.shape[:-1])
    for a, b in zip(x, y, strict=True):
        wi = origin + a * side_x + b * side_y - p
        d2 = (wi**2).sum(-1)
        wi /= np.sqrt(d2)[..., None]
        cosine = np.maximum(-(wi @ beam), 1e-9)
        share = np.where(cosine > 1e-8, cosine, 0)
        if light.spread < np.pi - 1e-6:
            share *= np.maximum(np.tan(half) - np.sqrt(1 / cosine**2 - 1), 0) / (np.tan(half) - half)
        total += share * np.maximum(wi[..., 2], 0) / d2
    return np.array(light.radiance) * (total / len(x) * area)[..., None]


def narrow_beam(light, p: np.ndarray, beam: np.ndarray, count: int) -> np.ndarray:
    """Quadrature over the directions within the spread: few points of the lamp are seen from one on the floor."""
    origin, axes, half = light.transform[:, 3], light.transform[:, :3], light.spread / 2
    first, second = frame(beam)
    total = np.zeros(p.shape[:-1])
    for x, y in zip(*disk_grid(count), strict=True):
        tangent = np.tan(half) * np.hypot(x, y)
        wi = -beam + np.tan(half) * (x * first + y * second)
        solid_angle = np.pi * np.tan(half) ** 2 / count**2 / np.linalg.norm(wi) ** 3
        wi /= np.linalg.norm(wi)
        distance = ((origin - p) @ beam) / (wi @ beam)
        local = (p + distance[..., None] * wi - origin) @ np.linalg.inv(axes).T
        hit = (np.abs(local[..., 0]) < light.size_x / 2) & (np.abs(local[..., 1]) < light.size_y / 2)
        share = max(np.tan(half) - tangent, 0) / (np.tan(half) - half)
        total += hit * share * wi[2] * solid_angle
    return np.array(light.radiance) * total[..., None]


LAMPS = {
    "point": {"kind": "POINT", "shadow_soft_size": 0.0, "energy": 30, "color": (1, 0.5, 0.25)},
    "point soft": {"kind": "POINT", "shadow_soft_size": 0.8, "energy": 30, "use_soft_falloff": True},
    "point sphere": {"kind": "POINT", "shadow_soft_size": 0.8, "energy": 30, "use_soft_falloff": False},
    "point scaled": {"kind": "POINT", "shadow_soft_size": 0.5, "energy": 30, "scale": (2, 0.5, 3)},
    "spot hard": {"kind": "SPOT", "shadow_soft_size": 0.0, "energy": 100, "spot_blend": 0.0, "spot_size": 1.2},
    "spot": {"kind": "SPOT", "shadow_soft_size": 0.0, "energy": 100, "spot_blend": 0.6, "spot_size": 1.2},
    "spot soft": {"kind": "SPOT", "shadow_soft_size": 0.4, "energy": 100, "spot_blend": 0.4, "spot_size": 1.5},
    "spot sphere": {
        "kind": "SPOT", "shadow_soft_size": 0.4, "energy": 100, "spot_blend": 0.4, "spot_size": 1.5,
        "use_soft_falloff": False,
    },
    "spot scaled": {
        "kind": "SPOT", "shadow_soft_size": 0.2, "energy": 100, "spot_blend": 0.4, "spot_size": 1.2,
        "scale": (1, 2, 0.7),
    },
    "spot wide": {"kind": "SPOT", "shadow_soft_size": 0.1, "energy": 100, "spot_blend": 1.0, "spot_size": np.pi},
    "square": {"kind": "AREA", "energy": 40, "size": 1.0, "scale": (2, 3, 4)},
    "rectangle": {"kind": "AREA", "energy": 40, "shape": "RECTANGLE", "size": 1.0, "size_y": 0.3},
    "disk": {"kind": "AREA", "energy": 40, "shape": "DISK", "size": 1.3},
    "ellipse": {"kind": "AREA", "energy": 40, "shape": "ELLIPSE", "size": 1.3, "size_y": 0.4, "scale": (1, 2, 1)},
    "spread": {"kind": "AREA", "energy": 40, "size": 1.0, "spread": 1.2},
    "small spread": {"kind": "AREA", "energy": 1, "size": 1.0, "spread": 0.12},
    "tiny spread": {"kind": "AREA", "energy": 1, "size": 1.0, "spread": 0.02},
    "mirrored": {"kind": "AREA", "energy": 40, "size": 1.0, "spread": 2.0, "scale": (-1, 1, 1)},
    "sun": {"kind": "SUN", "energy": 2, "angle": 0.0},
    "sun disk": {"kind": "SUN", "energy": 2, "angle": 0.6},
    "sun scaled": {"kind": "SUN", "energy": 2, "angle": 0.01, "scale": (3, 1, 2)},
}  # fmt: skip

if "normalize" in bpy.types.Light.bl_rna.properties:
    LAMPS |= {
        "point raw": {"kind": "POINT", "shadow_soft_size": 0.0, "energy": 3, "normalize": False},
        "sphere raw": {"kind": "POINT", "shadow_soft_size": 0.4, "energy": 3, "normalize": False},
        "area raw": {"kind": "AREA", "size": 0.5, "energy": 3, "normalize": False},
        "sun raw": {"kind": "SUN", "angle": 0.3, "energy": 3, "normalize": False},
        "sun point raw": {"kind": "SUN", "angle": 0.0, "energy": 3, "normalize": False},
        "exposed": {"kind": "POINT", "energy": 3, "exposure": 1.5, "color": (1, 0.5, 0.2)},
        "warm": {"kind": "POINT", "energy": 3, "use_temperature": True, "temperature": 3000, "color": (1, 0.5, 0.2)},
    }


@pytest.mark.parametrize("name", LAMPS)
def test_lamp_lights_a_floor_as_in_cycles(name, tmp_path):
    stage()
    new_light(**LAMPS[name])
    light = exported_light()
    fine = 20 if getattr(light, "spread", np.pi) < 0.5 else 4  # A narrow beam has sharp edges.
    expected = irradiance(light, floor_points(fine)) / np.pi
    expected = expected.reshape(PIXELS, fine, PIXELS, fine, 3).mean(axis=(1, 3))
    picture = cycles_picture(PIXELS, PIXELS, 256 if fine == 4 else 8192, tmp_path)
    assert picture.mean() == pytest.approx(expected.mean(), rel=0.01)
    assert np.abs(picture - expected).mean() < 0.03 * expected.mean()


def test_lamp_nodes_multiply_its_colour():
    add_camera()
    lamp = new_light("POINT", energy=4 * np.pi, color=(1, 0.5, 1))
    emission = next(node for node in node_tree(lamp.data).nodes if node.bl_idname == "ShaderNodeEmission")
    emission.inputs["Color"].default_value = (0.5, 1, 0, 1)
    emission.inputs["Strength"].default_value = 3.0
    assert exported_light().intensity == pytest.approx((1.5, 1.5, 0))


def test_dark_lamps_are_left_out():
    add_camera()
    new_light("POINT", energy=0.0)
    new_light("SUN", color=(0, 0, 0))
    new_light("AREA", size=0.0)
    scene = export_scene(depsgraph())
    assert scene.lights == []
    assert scene.skipped == [
        "light 'Lamp': its strength is zero",
        "light 'Lamp.001': its strength is zero",
        "light 'Lamp.002': its area is zero",
    ]


def test_negative_energy_is_refused_by_name():
    add_camera()
    new_light("POINT", energy=-1.0)
    with pytest.raises(engine.SceneError, match="light 'Lamp': its energy is negative"):
        export_scene(depsgraph()).validate()


def test_visibility_and_shadow():
    add_camera()
    lamp = new_light("POINT", use_shadow=False)
    lamp.visible_camera, lamp.visible_diffuse, lamp.visible_glossy = False, True, False
    light = exported_light()
    assert not light.cast_shadow
    assert light.visibility & engine.Visibility.DIFFUSE
    assert not light.visibility & (engine.Visibility.CAMERA | engine.Visibility.GLOSSY)


SHEARED = "light 'Lamp': it is sheared by its parents, which Cycles lights otherwise: apply their scale"


@pytest.mark.parametrize(
    ("kind", "rotation", "warnings"),
    [
        ("AREA", (0.3, -0.2, 0.4), [SHEARED]),
        ("SPOT", (0.3, -0.2, 0.4), [SHEARED]),
        ("AREA", (0, 0, 0), []),  # turned no way, it is only stretched
        ("SPOT", (0, np.pi / 2, 0), []),
        ("POINT", (0.3, -0.2, 0.4), []),
        ("SUN", (0.3, -0.2, 0.4), []),
    ],
)
def test_sheared_lamps_are_named(kind, rotation, warnings):
    add_camera()
    lamp = new_light(kind, rotation=rotation)
    lamp.parent = add_object("Stretched", None, scale=(1, 0.4, 1.3))
    assert export_scene(depsgraph()).warnings == warnings


def test_a_spot_without_a_cone_is_named():
    add_camera()
    new_light("SPOT", scale=(0, 0, 0))
    assert export_scene(depsgraph()).warnings == [
        "light 'Lamp': its scale is zero, which leaves no cone to shine through: set it above 0"
    ]


def test_lamps_of_an_instanced_collection():
    add_camera()
    collection = bpy.data.collections.new("Lamps")
    collection.objects.link(bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "POINT")))
    for x in (1.0, 2.0, 3.0):
        empty = add_object("Empty", None, (x, 0, 0))
        empty.instance_type, empty.instance_collection = "COLLECTION", collection
    lights = export_scene(depsgraph()).lights
    assert sorted(light.transform[0, 3] for light in lights) == [1.0, 2.0, 3.0]


def test_lamps_on_the_points_of_one_object():
    """What they share is read once: the size, but not the place, and not what an area lamp's scale makes of it."""
    add_camera()
    places = bpy.data.meshes.new("Places")
    places.from_pydata([(1, 0, 0), (2, 0, 0), (3, 0, 0)], [], [])
    carrier = add_object("Places", places)
    carrier.instance_type = "VERTS"
    new_light("POINT", location=(0, 0, 0), rotation=(0, 0, 0), shadow_soft_size=0.25).parent = carrier
    lights = export_scene(depsgraph()).lights
    assert sorted(light.transform[0, 3] for light in lights) == [0.0, 1.0, 2.0, 3.0]  # Blender shows it itself too
    assert {light.radius for light in lights} == {0.25}
    first, second = (add_object("Empty", None, (x, 0, 0), scale=(x, x, x)) for x in (1, 2))
    collection = bpy.data.collections.new("Lamps")
    collection.objects.link(bpy.data.objects.new("Area", bpy.data.lights.new("Area", "AREA")))
    for empty in (first, second):
        empty.instance_type, empty.instance_collection = "COLLECTION", collection
    one, two = (light for light in export_scene(depsgraph()).lights if isinstance(light, engine.AreaLight))
    assert one.radiance[0] == pytest.approx(4 * two.radiance[0])
