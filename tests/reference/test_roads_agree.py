"""The compiled road against the reference, and the reference against itself with everything drawn differently."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import scenes
from agreement import assert_agree, pictures

from engine.pack import lamps
from engine.scene import Aperture, AreaLight, Material, PointLight, Scene, SpotLight, Visibility

SIZE = 16


def bokeh() -> Scene:
    """A small square far behind the focus, which shows the lens's shape: a triangle, stretched and turned."""
    scene = Scene(width=SIZE, height=SIZE, camera=scenes.camera())
    scene.camera = replace(scene.camera, aperture=Aperture(1.0, 2.0, blades=3, rotation=0.3, ratio=1.25))
    scene.materials = [Material("lamp", emission=(1.0, 1.0, 1.0))]
    scene.add_instance(scenes.quad_mesh((-0.4, 8, -0.4), (0.8, 0, 0), (0, 0, 0.8), "lamp"))
    return scene


def sheared(kind: str) -> Scene:
    """A lamp whose axes are not perpendicular, as under a parent that is scaled unevenly."""
    scene = scenes.lamp_room([kind], SIZE)
    shear = np.array([[1.0, 0.8, 0.3], [0.0, 0.9, -0.4], [0.0, 0.0, 1.0]])
    scene.lights[0].transform[:, :3] = scene.lights[0].transform[:, :3] @ shear
    return scene


def wide_spot() -> Scene:
    """A point beside a spot that leans so far over that a part of its cone is more than 90 degrees off its axis."""
    scene = scenes.lamp_room(["point", "spot"], SIZE)
    point, spot = scene.lights
    assert isinstance(point, PointLight) and isinstance(spot, SpotLight)
    leaning = spot.transform.copy()
    leaning[:, :3] = np.array([[1.0, 0.0, 0.9], [0.0, 1.0, 0.0], [0.0, 0.0, 0.6]])
    scene.lights = [
        replace(point, intensity=(0.2, 0.2, 0.2)),
        replace(spot, transform=leaning, half_angle=math.radians(75), blend=0.2),
    ]
    return scene


def coincident(*changes: dict, kinds=("area", "area"), turn=1.0) -> Scene:
    """Lamps with one shape at one place, each changed; the last one turned if `turn` is -1."""
    scene = scenes.lamp_room(list(kinds), SIZE, ks=0.6, exponent=300.0)
    for light in scene.lights:
        light.transform[:, 3] = (0.3, 0.9, 0.8)
        light.transform[:, :3] = scenes.place(towards=(0.1, -1.0, -0.2))[:, :3]
    scene.lights[-1].transform[:, 1:3] *= turn
    scene.lights = [replace(light, **change) for light, change in zip(scene.lights, changes, strict=True)]
    return scene


def overlapping() -> Scene:
    """Three lamps of one plane, each partly over the next."""
    scene = coincident({}, {"radiance": (0.0, 5.0, 0.0)}, {"size_y": 1.5}, kinds=("area", "ellipse", "area"))
    for step, light in enumerate(scene.lights):
        light.transform[:, 3] += 0.35 * step * light.transform[:, 0]
    return scene


def crowd(step: float) -> Scene:
    """Many faint lamps of three kinds, each so far behind the one before."""
    scene = scenes.lamp_room(["area", "sphere", "soft"], SIZE, ks=0.6, exponent=300.0)
    area, *points = scene.lights
    assert isinstance(area, AreaLight)
    faint: list = [replace(area, radiance=tuple(value / 40 for value in area.radiance))]
    for light in points:
        assert isinstance(light, PointLight)
        faint.append(replace(light, intensity=tuple(value / 40 for value in light.intensity)))
    apart = np.array([[0, 0, 0, step]])
    scene.lights = [replace(light, transform=light.transform + i * apart) for i in range(40) for light in faint]
    return scene


def flush() -> Scene:
    """Lamps in the plane of a mirror-like ceiling."""
    scene = scenes.lamp_room(["area", "ellipse"], SIZE, ks=0.6, exponent=300.0)
    for x, light in zip((-1.0, 1.0), scene.lights, strict=True):
        light.transform[:] = scenes.place((x, 0.5, 2.0))
    scene.add_instance(scenes.quad_mesh((-3, -3, 2.0), (0, 6, 0), (6, 0, 0)), materials=(0,))
    return scene


def sheet_inside() -> Scene:
    """Between the disk of a soft lamp and the sphere around it, by which rays meet the disk: a sheet that hides half
    of the disk."""
    scene = scenes.lamp_room(["soft"], SIZE, ks=0.6, exponent=300.0)
    x, y, z = scene.lights[0].transform[:, 3]
    scene.add_instance(scenes.quad_mesh((x - 0.6, y - 0.6, z - 0.2), (0.6, 0, 0), (0, 1.2, 0)), materials=(0,))
    return scene


def everything_shines() -> Scene:
    """Lamps, suns and a sky together, none of them negligible: the choice among the groups."""
    scene = scenes.lamp_room(["area", "sphere", "wide_sun", "sun"], SIZE)
    scene.lights.append(replace(scenes.lamp("wide_sun"), transform=scenes.place((0, 0, 0), (0.2, 0.5, -0.1))))
    scene.world = replace(scenes.sky_plate(SIZE).world, color=(0.5, 0.3, 0.4))
    return scene


NO_CAMERA, NO_GLOSS = Visibility.ALL & ~Visibility.CAMERA, Visibility.ALL & ~Visibility.GLOSSY


def pane(visibility: Visibility) -> Scene:
    """Before the emitters hangs a film that some rays pass as if it were not there: an area lamp and two emissive
    squares, one of which shadow rays do not meet, in a floor like a mirror."""
    scene = scenes.lamp_room(["area"], SIZE, exponent=1000.0)
    scene.materials += [Material("film", transparency=(0.5, 0.3, 0.0)), Material("glow", emission=(2.0, 3.0, 3.0))]
    scene.add_instance(scenes.quad_mesh((-2, -2, 1.2), (4, 0, 0), (0, 3.5, 0)), materials=(2,), visibility=visibility)
    for x, seen in ((-1.5, Visibility.ALL), (0.5, Visibility.ALL & ~Visibility.SHADOW)):
        scene.add_instance(scenes.quad_mesh((x, 1.5, 0.5), (1, 0, 0), (0, 0, 1)), materials=(3,), visibility=seen)
    return scene


def hole() -> Scene:
    """A ball that shines and half passes light stands out of the picture, and in the reflections of its room."""
    scene = scenes.lamp_room(["area"], SIZE, exponent=1000.0)
    kind = {"kd": (0.2, 0.3, 0.3), "emission": (0.5, 0.2, 0.1), "transparency": (0.5, 0.3, 0.0)}
    scene.materials += [Material("hole", holdout=True, **kind), Material("film", transparency=(0.6,) * 3)]
    scene.add_instance(scenes.sphere_mesh(12, 0.4), scenes.place((0.1, 0, 0.5)), materials=(2,))
    scene.add_instance(scenes.quad_mesh((-0.5, -0.6, 0), (0.5, 0, 0), (0, 0, 1)), materials=(3,))
    scene.transparent_film = True
    return scene


def cut(**planes: float) -> Scene:
    """Lamps of all sizes, of which the camera's near or far plane leaves a part."""
    scene = scenes.lamp_room(["sphere", "soft", "spot_sphere", "area", "ellipse"], SIZE)
    scene.camera = replace(scene.camera, **planes)
    return scene


def hole_before_lamps() -> Scene:
    """A hole that half passes light hangs before one half of a lamp of each shape."""
    scene = scenes.lamp_room(["sphere", "area"], SIZE)
    scene.lights[1].transform[:] = scenes.place((0.9, 0.2, 1.2), towards=(0.0, -1.0, 0.2))
    scene.materials.append(Material("hole", holdout=True, transparency=(0.5, 0.3, 0.0)))
    scene.add_instance(scenes.quad_mesh((0.3, -1.5, 0.5), (0.5, 0, 0), (0, 0, 2)), materials=(2,))
    scene.transparent_film = True
    return scene


SCENES: dict[str, Callable[[], Scene]] = {
    "cornell": lambda: scenes.cornell(SIZE),
    "phong plates": lambda: scenes.phong_plates(SIZE),
    "sky": lambda: scenes.sky_plate(SIZE),
    "all lamps": lambda: scenes.lamp_room(list(scenes.LAMP_KINDS), SIZE),
    "three blades": bokeh,
    "all groups": everything_shines,
    "one lamp and a sun": lambda: scenes.lamp_room(["area", "wide_sun"], SIZE),
    **{f"sheared {kind}": lambda kind=kind: sheared(kind) for kind in ("area", "ellipse", "spread", "spot_sphere")},
    "a wide sheared spot": wide_spot,
    "a lamp twice": lambda: coincident({}, {}),
    "lamps back to back": lambda: coincident({}, {"radiance": (0.0, 5.0, 0.0)}, turn=-1.0),
    "a lamp twice, hidden": lambda: coincident({"visibility": NO_CAMERA}, {"visibility": NO_GLOSS}),
    "a lamp twice, one without shadow": lambda: coincident({"cast_shadow": False}, {}),
    "lamps that overlap in a plane": overlapping,
    "a crowd of lamps in a row": lambda: crowd(0.002),
    "a crowd of lamps in one place": lambda: crowd(0.0),
    "lamps in the plane of a ceiling": flush,
    "a sheet inside a soft lamp": sheet_inside,
    "two shapes in one": lambda: coincident({}, {"size_x": 1.5}, kinds=("area", "ellipse")),
    "sphere and disk in one": lambda: coincident({}, {}, kinds=("soft", "sphere")),
    "pane hidden from shadow rays": lambda: pane(Visibility.ALL & ~Visibility.SHADOW),
    "a hole": hole,
    "a hole before lamps": hole_before_lamps,
    "lamps across the near plane": lambda: cut(clip_start=3.97),
    "lamps across the far plane": lambda: cut(clip_end=3.97),
    "pane for shadow rays only": lambda: pane(Visibility.SHADOW),
    **{kind: lambda kind=kind: scenes.lamp_room([kind], SIZE) for kind in scenes.LAMP_KINDS},
}


@pytest.mark.parametrize("name", SCENES)
def test_compiled_agrees_with_reference(name):
    scene = SCENES[name]()
    assert_agree(pictures(scene, road="COMPILED"), pictures(scene, road="REFERENCE"))


# With what has to be told apart: kinds, inside and outside, in front of surfaces and behind, who sees them.
LAMPS = (
    "all lamps",
    "a lamp twice, hidden",
    "lamps in the plane of a ceiling",
    "a sheet inside a soft lamp",
    "pane hidden from shadow rays",
    "a hole before lamps",
    "lamps across the near plane",
    "lamps across the far plane",
)
# How many round and flat lamps may be listed: the others are Embree's.
LISTS = {"neither": (0, 0), "flat ones alone": (0, 16), "round ones alone": (128, 0)}


@pytest.mark.parametrize("lists", LISTS)
@pytest.mark.parametrize("name", LAMPS)
def test_lamps_in_the_list_are_met_as_those_in_embree_s_scene(name, lists, monkeypatch):
    scene = SCENES[name]()
    listed = pictures(scene, road="COMPILED")
    most_round, most_flat = LISTS[lists]
    monkeypatch.setattr(lamps, "MOST_LISTED_ROUND", most_round)
    monkeypatch.setattr(lamps, "MOST_LISTED_FLAT", most_flat)
    traced = pictures(scene, road="COMPILED")
    assert_agree(listed, traced)
    if name != "a sheet inside a soft lamp":  # from within a soft lamp only listed ones share their light with rays
        # At the rim of a lamp, and of a surface before it, a rounding decides.
        same = np.all(np.isclose(listed, traced, rtol=1e-3, atol=1e-5), axis=-1)
        assert np.mean(same) > 0.99


@pytest.mark.parametrize("name", ["cornell", "phong plates", "all lamps"])
def test_reference_does_not_depend_on_how_directions_are_drawn(name):
    scene = SCENES[name]()
    one = pictures(scene, road="REFERENCE")
    other = pictures(scene, road="REFERENCE", lobe_selection="CLASSIC", hemisphere_sampling="UNIFORM")
    assert_agree(one, other)


def test_a_wrong_picture_is_noticed():
    """Three percent less light all over."""
    scene = SCENES["sun"]()
    one = pictures(scene, road="REFERENCE")
    dimmer = scenes.lamp_room(["sun"], SIZE)
    dimmer.exposure = 0.97
    with pytest.raises(AssertionError, match="differ"):
        assert_agree(one, pictures(dimmer, road="REFERENCE"))
