"""What `Scene.validate` says, word for word: these messages are all that a user sees of a bad scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scenes

from engine.errors import SceneError
from engine.scene import (
    Aperture,
    AreaLight,
    Instances,
    Material,
    Mesh,
    PointLight,
    Scene,
    SpotLight,
    SunLight,
    Visibility,
    World,
)

NAN, INF = float("nan"), float("inf")


def good() -> Scene:
    scene = scenes.cornell()
    scene.lights = [scenes.lamp(kind) for kind in scenes.LAMP_KINDS]
    scene.world = World(image=scenes.sky_image())
    return scene


def with_camera(**changes):
    def change(scene):
        scene.camera = replace(scene.camera, **changes)

    return change


def with_scene(**changes):
    def change(scene):
        for key, value in changes.items():
            setattr(scene, key, value)

    return change


def with_material(**changes):
    return with_scene(materials=[Material("Paint", **changes)] * 4)


def with_light(light):
    return with_scene(lights=[light])


def with_world(**changes):
    return with_scene(world=World(**changes))


def with_mesh(**changes):
    """The first mesh, 'floor': 4 vertices, 2 faces."""

    def change(scene):
        scene.meshes[0] = replace(scene.meshes[0], **changes)

    return change


def with_instances(**changes):
    def change(scene):
        arrays = {key: function(getattr(scene.instances, key).copy()) for key, function in changes.items()}
        scene.instances = replace(scene.instances, **arrays)

    return change


def put(index, value):
    def change(array):
        array[index] = value
        return array

    return change


def vertices(index=2, value=(NAN, 0, 1)):
    return put(index, value)(np.zeros((4, 3), np.float32))


def image(index, value):
    return put(index, value)(scenes.sky_image())


TURNED_OVER = np.zeros((3, 4))
LOST = np.full((3, 4), NAN)

CASES = {
    "no camera": (with_scene(camera=None), "the scene has no camera: add one, or make one the active camera"),
    "zero resolution": (with_scene(width=0), "the resolution is 0 x 32 pixels: set both to 1 or more"),
    "negative resolution": (with_scene(height=-2), "the resolution is 32 x -2 pixels: set both to 1 or more"),
    "empty region": (
        with_scene(region=(4, 4, 4, 8)),
        "the render region (4, 4) to (4, 8) is empty: make it at least one pixel large",
    ),
    "region outside": (
        with_scene(region=(0, 0, 33, 8)),
        "the render region (0, 0) to (33, 8) reaches outside the picture of 32 x 32 pixels: move it inside",
    ),
    "exposure": (with_scene(exposure=-1.0), "the film exposure is -1.0: set it to 0 or more"),
    "camera lost": (
        with_camera(transform=LOST),
        (
            "the camera: its transform holds values that are not finite; "
            "check its location, rotation, scale, drivers and parents"
        ),
    ),
    "camera without axes": (
        with_camera(transform=TURNED_OVER),
        "the camera: its axes do not span space, check its scale and that of its parents",
    ),
    "camera window": (
        with_camera(window=(0.5, -0.5, -0.5, 0.5)),
        "the camera: its view (0.5, -0.5, -0.5, 0.5) is empty, check focal length, sensor and scale",
    ),
    "camera clip": (
        with_camera(clip_start=2.0, clip_end=1.0),
        "the camera: clip start (2.0 m) must be nearer than clip end (1.0 m)",
    ),
    "camera clip behind": (
        with_camera(clip_start=-1.0),
        "the camera: clip start is -1.0 m, set it to 0 or more",
    ),
    "camera too far": (
        with_camera(transform=scenes.place((0, 1e39, 0))),
        (
            "the camera: its transform holds values that are not finite; "
            "check its location, rotation, scale, drivers and parents"
        ),
    ),
    "camera lens": (
        with_camera(aperture=Aperture(radius=-0.1, focus_distance=1)),
        "the camera: its aperture radius is -0.1 m, set it to 0 or more",
    ),
    "camera focus": (
        with_camera(aperture=Aperture(radius=0.1, focus_distance=0.0)),
        "the camera: its focus distance is 0.0 m, set it above 0",
    ),
    "NaN vertex": (
        with_mesh(vertices=vertices()),
        "mesh 'floor': vertex 2 is at (nan, 0, 1); remove it, or the modifier or driver that made it",
    ),
    "infinite vertex": (
        with_mesh(vertices=vertices(3, (0, -INF, 0))),
        "mesh 'floor': vertex 3 is at (0, -inf, 0); remove it, or the modifier or driver that made it",
    ),
    "both infinities": (
        with_mesh(vertices=vertices(slice(1, 3), ((INF, 0, 0), (-INF, 0, 0)))),
        "mesh 'floor': vertex 1 is at (inf, 0, 0); remove it, or the modifier or driver that made it",
    ),
    "vertex dtype": (
        with_mesh(vertices=np.zeros((4, 3))),
        "mesh 'floor': vertices holds float64 values, it must hold float32",
    ),
    "vertex shape": (
        with_mesh(vertices=np.zeros((4, 2), np.float32)),
        "mesh 'floor': vertices has the shape (4, 2), it must be (n, 3)",
    ),
    "vertex list": (with_mesh(vertices=[[0, 0, 0]]), "mesh 'floor': vertices is a list, it must be a numpy array"),
    "vertex index": (
        with_mesh(triangles=np.array([[0, 1, 2], [0, 2, 4]], np.uint32)),
        "mesh 'floor': face 1 of its triangles asks for number 4 of 4 vertices",
    ),
    "NaN normal": (
        with_mesh(normals=vertices()),
        "mesh 'floor': normal 2 is (nan, 0, 1); clear its custom normals",
    ),
    "normal index": (
        with_mesh(normals=np.zeros((3, 3), np.float32)),
        "mesh 'floor': face 1 of its normal_indices asks for number 3 of 3 normals",
    ),
    "normal index shape": (
        with_mesh(normals=np.zeros((3, 3), np.float32), normal_indices=np.zeros((1, 3), np.uint32)),
        "mesh 'floor': normal_indices has the shape (1, 3), it must be (2, 3)",
    ),
    "material slot": (
        with_mesh(material_slots=np.array([0, -1], np.int32)),
        "mesh 'floor': a face has the material slot -1, below 0",
    ),
    "transform": (
        with_instances(transforms=put((4, 1, 3), INF)),
        (
            "object 'right': its transform holds values that are not finite; "
            "check its location, rotation, scale, drivers and parents"
        ),
    ),
    "transform shape": (
        with_instances(transforms=lambda a: a[:2]),
        "instances 'all': transforms has the shape (2, 3, 4), it must be (8, 3, 4)",
    ),
    "mesh index": (with_instances(mesh=put(2, 9)), "object 'back': its mesh number 9 is not one of 7"),
    "object index": (with_instances(object=put(2, 9)), "instance 2: its object name number 9 is not one of 8"),
    "material index": (
        with_instances(material_table=put(3, 7)),
        "object 'left': its material number 7 is not one of 4 materials",
    ),
    "no slots": (
        with_instances(slot_count=put(1, 0)),
        "object 'ceiling': its material slots lie outside the table; give it at least one slot",
    ),
    "exponent": (with_material(exponent=-1.0), "material 'Paint': its Phong exponent is -1; set it to 0 or more"),
    "NaN exponent": (with_material(exponent=NAN), "material 'Paint': its Phong exponent is nan; set it to 0 or more"),
    "kd": (
        with_material(kd=(0.5, -0.1, 0)),
        "material 'Paint': its diffuse colour kd is negative (0.5, -0.1, 0); set every channel to 0 or more",
    ),
    "ks": (
        with_material(ks=(0, 0, -2)),
        "material 'Paint': its Phong colour ks is negative (0, 0, -2); set every channel to 0 or more",
    ),
    "NaN ks": (
        with_material(ks=(0, NAN, 0)),
        "material 'Paint': its Phong colour ks is (0, nan, 0); set it to three finite numbers",
    ),
    "emission": (
        with_material(emission=(-1, 0, 0)),
        "material 'Paint': its emission is negative (-1, 0, 0); set every channel to 0 or more",
    ),
    "emission above float32": (
        with_material(emission=(1e39, 0, 0)),
        "material 'Paint': its emission is (1e+39, 0, 0); set it to three finite numbers below 3.4e+38",
    ),
    "transparency": (
        with_material(transparency=(0, 0, 1.5)),
        "material 'Paint': its transparency is (0, 0, 1.5); set every channel between 0 and 1",
    ),
    "light energy": (
        with_light(PointLight("Lamp", intensity=(-1.0, 0, 0))),
        "light 'Lamp': its energy is negative; Lobe cannot subtract light, set it to 0 or more",
    ),
    "area energy": (
        with_light(AreaLight("Panel", radiance=(1.0, -1, 0))),
        "light 'Panel': its energy is negative; Lobe cannot subtract light, set it to 0 or more",
    ),
    "sun energy": (
        with_light(SunLight("Sun", irradiance=(-1.0, -1, -1))),
        "light 'Sun': its energy is negative; Lobe cannot subtract light, set it to 0 or more",
    ),
    "NaN energy": (
        with_light(PointLight("Lamp", intensity=(NAN, 0, 0))),
        "light 'Lamp': its energy is not finite (nan, 0, 0); set it to a number",
    ),
    "energy above float32": (
        with_light(PointLight("Lamp", intensity=(1e39, 0, 0))),
        "light 'Lamp': its energy is not finite (1e+39, 0, 0); set it to a number below 3.4e+38",
    ),
    "energy of a small lamp": (
        with_light(PointLight("Lamp", intensity=(1e10, 0, 0), radius=1e-15)),
        "light 'Lamp': its energy is too much for its radius of 1e-15 m; lower it, or set the radius to 0",
    ),
    "energy of a small sun": (
        with_light(SunLight("Sun", irradiance=(1e10, 0, 0), angle=1e-15)),
        "light 'Sun': its energy is too much for its angle; lower it, or set the angle to 0",
    ),
    "light too far": (
        with_light(PointLight("Lamp", scenes.place((0, 0, 1e19)))),
        (
            "light 'Lamp': it reaches 1e+19 m from the origin, and 1e+18 m is the limit; "
            "check its location, size and scale"
        ),
    ),
    "light too large": (
        with_light(AreaLight("Panel", size_y=1e19)),
        (
            "light 'Panel': it reaches 1e+19 m from the origin, and 1e+18 m is the limit; "
            "check its location, size and scale"
        ),
    ),
    "light radius": (
        with_light(PointLight("Lamp", radius=-0.5)),
        "light 'Lamp': its radius is -0.5 m; set it to 0 or more",
    ),
    "light lost": (
        with_light(PointLight("Lamp", LOST)),
        (
            "light 'Lamp': its transform holds values that are not finite; "
            "check its location, rotation, scale, drivers and parents"
        ),
    ),
    "spot size": (
        with_light(SpotLight("Lamp", half_angle=0.0)),
        "light 'Lamp': its spot size is 0 degrees; set it above 0 and to 180 at most",
    ),
    "spot too wide": (
        with_light(SpotLight("Lamp", half_angle=np.pi)),
        "light 'Lamp': its spot size is 360 degrees; set it above 0 and to 180 at most",
    ),
    "spot blend": (
        with_light(SpotLight("Lamp", blend=1.5)),
        "light 'Lamp': its spot blend is 1.5; set it between 0 and 1",
    ),
    "area size": (
        with_light(AreaLight("Panel", size_x=-1)),
        "light 'Panel': its size is -1 x 1 m; set both to 0 or more",
    ),
    "area spread": (
        with_light(AreaLight("Panel", spread=0)),
        "light 'Panel': its spread is 0 degrees; set it above 0 and to 180 at most",
    ),
    "sun angle": (
        with_light(SunLight("Sun", angle=-np.pi)),
        "light 'Sun': its angle is -180 degrees; set it between 0 and 180",
    ),
    "world colour": (
        with_world(color=(-1, 0, 0)),
        "the world: its colour is negative (-1, 0, 0); set every channel to 0 or more",
    ),
    "world image NaN": (
        with_world(image=image((3, 5), NAN)),
        (
            "the world: pixel (5, 3) of its image, counted from the bottom left, is not finite; "
            "repair the image or choose another"
        ),
    ),
    "world image infinite": (
        with_world(image=image((0, 31), INF)),
        (
            "the world: pixel (31, 0) of its image, counted from the bottom left, is not finite; "
            "repair the image or choose another"
        ),
    ),
    "world image shape": (
        with_world(image=np.zeros((8, 8), np.float32)),
        "the world: its image has the shape (8, 8), it must be (height, width, 3)",
    ),
    "world image empty": (
        with_world(image=np.zeros((0, 8, 3), np.float32)),
        "the world: its image has 8 x 0 pixels; load it again or choose another",
    ),
    "world image dtype": (
        with_world(image=np.zeros((8, 8, 3))),
        "the world: its image holds float64 values, it must hold float32",
    ),
    "world rotation": (
        with_world(rotation=np.full((3, 3), INF)),
        "the world: its rotation is not finite; check the mapping of its image",
    ),
    "world rotation scaled": (
        with_world(rotation=2 * np.eye(3)),
        "the world: its rotation scales or shears; check the mapping of its image",
    ),
    "world image too bright": (
        with_world(image=image((3, 5), 2e38), color=(2.0, 1.0, 1.0)),
        (
            "the world: the brightest pixel of its image has the value 2e+38, too much to calculate with; "
            "lower it or the strength"
        ),
    ),
    "object out of reach": (
        with_instances(transforms=put((4, 1, 3), -2e9)),
        (
            "object 'right': it reaches 2e+09 m from the origin, and 1e+09 m is the limit; "
            "check its location, scale and modifiers"
        ),
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_bad_scene_says_what_is_wrong(case):
    change, message = CASES[case]
    scene = good()
    change(scene)
    with pytest.raises(SceneError) as caught:
        scene.validate()
    assert str(caught.value) == message


def test_good_scenes_pass():
    good().validate()
    for scene in (scenes.furnace(), scenes.lit_sphere(), scenes.plate(), scenes.phong_plates(), scenes.sky_plate()):
        scene.validate()


def test_extreme_scenes_pass():
    scene = good()
    scene.materials = [Material("mirror", ks=(1.0, 1.0, 1.0), exponent=1e39)] * 4
    scene.instances.transforms[0, 0, 3] = 0.99e9
    scene.lights = [
        PointLight("star", scenes.place((1.5e11, 0, 0)), intensity=(1e24,) * 3, radius=7e8),
        PointLight("dot", intensity=(1e10,) * 3, radius=1e-20),
        SunLight("sun", scenes.place((1e30, 0, 0)), irradiance=(1e10,) * 3, angle=1e-20),
    ]
    scene.world = World(image=scenes.sky_image(), rotation=np.diag([1.0, -1.0, 1.0]) + 1e-6)
    scene.validate()


def test_empty_scene_passes():
    Scene(camera=scenes.camera()).validate()


def test_empty_mesh_and_faces_without_area_pass():
    scene = Scene(camera=scenes.camera())
    scene.add_instance(Mesh("empty", np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint32)))
    scene.add_instance(Mesh("point", np.zeros((1, 3), np.float32), np.zeros((2, 3), np.uint32)))
    scene.add_instance(scenes.cube_mesh(), np.zeros((3, 4)), name="scaled to nothing")
    scene.validate()


def far_scene(size: float, scale: float = 1.0) -> Scene:
    scene = Scene(camera=scenes.camera())
    mesh = Mesh("plane", np.full((4, 3), size, np.float32), np.array([[0, 1, 2]], np.uint32))
    scene.add_instance(mesh, np.eye(3, 4) * scale, name="Vast")
    return scene


def test_what_is_very_far_away_passes():
    far_scene(9e8).validate()
    far_scene(9.0, 1e8).validate()


@pytest.mark.parametrize(("size", "scale"), [(3e38, 1.0), (3.0, 1e38)])
def test_what_is_too_far_away_is_named(size, scale):
    with pytest.raises(SceneError) as caught:
        far_scene(size, scale).validate()
    assert str(caught.value) == (
        "object 'Vast': it reaches 3e+38 m from the origin, and 1e+09 m is the limit; "
        "check its location, scale and modifiers"
    )


def test_a_mesh_under_another_name_is_named_by_its_object():
    scene = Scene(camera=scenes.camera())
    mesh = Mesh("Plane.001", np.full((3, 3), NAN, np.float32), np.array([[0, 1, 2]], np.uint32))
    scene.add_instance(mesh, name="Table")
    with pytest.raises(SceneError) as caught:
        scene.validate()
    assert str(caught.value) == (
        "object 'Table', mesh 'Plane.001': vertex 0 is at (nan, nan, nan); "
        "remove it, or the modifier or driver that made it"
    )


@pytest.mark.parametrize(
    "change",
    [
        {"radius": NAN},
        {"intensity": (1.0, -1.0, 1.0)},
        {"transform": np.full((3, 4), INF)},
        {"radius": "wide"},
        {"radius": 1 << 70},
        {"intensity": (1.0, 1.0)},
        {"intensity": (1.0, "much", 1.0)},
        {"intensity": np.ones((1, 3))},
        {"transform": np.ma.masked_array(np.eye(3, 4))},
        {"transform": np.eye(4)},
        {"cast_shadow": 1},
        {"soft_falloff": None},
        {"visibility": 99},
        {"visibility": Visibility(99)},
        {"visibility": [1]},
    ],
    ids=str,
)
@pytest.mark.parametrize("one", [1.0, 1], ids=["everyday", "whole numbers"])
def test_one_bad_lamp_among_many_is_named(change, one):
    lamps = [PointLight(f"Lamp {i}", intensity=(one, one, one), radius=0.1) for i in range(50)]
    scene = Scene(camera=scenes.camera(), lights=lamps)
    scene.validate()
    scene.lights[30] = replace(lamps[30], **change)
    with pytest.raises(SceneError, match="light 'Lamp 30'"):
        scene.validate()


def test_a_large_scene_is_checked_in_whole_arrays(counted_calls):
    """No Python for each vertex, face or instance: counted, as times say more about the machine."""
    faces, count = 1_000_000, 500_000
    mesh = Mesh(
        "large",
        np.zeros((faces, 3), np.float32),
        np.arange(3 * faces, dtype=np.uint32).reshape(faces, 3) % faces,
        material_slots=np.zeros(faces, np.int32),
    )
    scene = Scene(camera=scenes.camera(), meshes=[mesh])
    scene.instances = Instances(
        mesh=np.zeros(count, np.int32),
        transforms=np.tile(np.eye(3, 4), (count, 1, 1)),
        material_offset=np.zeros(count, np.int32),
        slot_count=np.ones(count, np.int32),
        material_table=np.zeros(1, np.int32),
        visibility=np.full(count, 15, np.uint8),
        object=np.zeros(count, np.int32),
        object_names=["leaf"],
    )
    assert 0 < counted_calls(scene.validate) < 2_000
