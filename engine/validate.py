"""The border: everything that both roads take for granted about a scene, checked once before a render.

Whole arrays are checked at a time, so that a million triangles or instances cost a few milliseconds. Each failure
raises SceneError with the name of the object at fault and what to do about it. Faces without area, objects scaled
to nothing and scenes without objects are fine: they are drawn as what they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import chain, compress

import numpy as np

from .errors import SceneError
from .fieldtypes import check_all, check_fields
from .scene import (
    AreaLight,
    Camera,
    Instances,
    Lamp,
    Material,
    Mesh,
    PointLight,
    Scene,
    SpotLight,
    SunLight,
    Visibility,
    World,
    scene_error,
)

# Metres. The kernels square the cross product of a triangle's edges: beyond, float32 overflows.
MAX_REACH = 1e9
# Metres, of lamps: they have no edges to multiply, but the square of a distance must fit float32.
MAX_LAMP_REACH = 1e18
# Lamps whose numbers all lie below this, and their radius above its inverse, pass every check.
EVERYDAY = 1e9
# A lamp's radius or a sun's angle below this counts as 0: their squares vanish in float32.
SMALLEST_SIZE = 1e-15
# From here on float64 rounds to an infinite float32.
FLOAT32_END = 2.0**128 - 2.0**103
# Pixels: of a side, as in Blender, and of the region that is rendered: its sums take 36 bytes each.
MAX_SIDE, MAX_PIXELS = 1 << 16, 1 << 28
# Rows of any array: the kernels' tables number them by int32.
MAX_ROWS = (1 << 31) - 1
# How far from orthogonal a rotation may be.
ROTATION_TOLERANCE = 1e-4


def validate_scene(scene: Scene) -> None:
    """Raises SceneError for the first thing in `scene` that cannot be rendered."""
    _check_types(scene)
    _check_picture(scene)
    _check_camera(scene.camera)
    _check_instance_arrays(scene.instances)
    extents = np.zeros((len(scene.meshes), 3))
    for index, mesh in enumerate(scene.meshes):
        try:
            extents[index] = _check_mesh(mesh)
        except SceneError as error:
            raise SceneError(_owner(scene.instances, index, mesh.name) + str(error)) from None
    for material in scene.materials:
        _check_material(material)
    _check_instances(scene.instances, len(scene.meshes), scene.materials)
    _check_reach(scene.instances, extents)
    for light in _uncommon(scene.lights):
        _check_light(light)
    _check_world(scene.world)
    _check_passes(scene)


def _check_types(scene: Scene) -> None:
    """Every field of everything holds what its dataclass declares; of arrays, that they are arrays."""
    check_fields(scene, lambda problem: SceneError(f"the scene: {problem}"))
    if scene.camera is not None:
        check_fields(scene.camera, _camera_error)
        if scene.camera.aperture is not None:
            check_fields(scene.camera.aperture, lambda problem: _camera_error(f"its aperture's {problem}"))
    check_fields(scene.instances, partial(scene_error, "instances", "all"))
    check_fields(scene.world, lambda problem: SceneError(f"the world: {problem}"))
    for kind, records in (("mesh", scene.meshes), ("material", scene.materials), ("light", scene.lights)):
        check_all(records, partial(_record_error, kind))


def _record_error(kind: str, record: Mesh | Material | Lamp, problem: str) -> SceneError:
    return scene_error(kind, record.name, problem)


def _camera_error(problem: str) -> SceneError:
    return SceneError(f"the camera: {problem}")


def _check_picture(scene: Scene) -> None:
    width, height = scene.width, scene.height
    if width < 1 or height < 1:
        raise SceneError(f"the resolution is {width} x {height} pixels: set both to 1 or more")
    if max(width, height) > MAX_SIDE:
        raise SceneError(f"the resolution is {width} x {height} pixels: set both to {MAX_SIDE} or less")
    x0, y0, x1, y1 = scene.render_region
    if x0 >= x1 or y0 >= y1:
        raise SceneError(f"the render region ({x0}, {y0}) to ({x1}, {y1}) is empty: make it at least one pixel large")
    if x0 < 0 or y0 < 0 or x1 > width or y1 > height:
        raise SceneError(
            f"the render region ({x0}, {y0}) to ({x1}, {y1}) reaches outside the picture of {width} x {height} pixels: "
            "move it inside"
        )
    if (x1 - x0) * (y1 - y0) > MAX_PIXELS:
        raise SceneError(
            f"the picture of {x1 - x0} x {y1 - y0} pixels has more than {MAX_PIXELS / 1e6:.0f} million: set a lower "
            "resolution, or render it in regions"
        )
    if not (np.isfinite(scene.exposure) and scene.exposure >= 0):
        raise SceneError(f"the film exposure is {scene.exposure}: set it to 0 or more")


def _check_camera(camera: Camera | None) -> None:
    if camera is None:
        raise SceneError("the scene has no camera: add one, or make one the active camera")
    axes = _check_transform("the camera", camera.transform)[:, :3]
    if abs(np.linalg.det(axes / np.maximum(np.linalg.norm(axes, axis=0), 1e-300))) < 1e-6:
        raise SceneError("the camera: its axes do not span space, check its scale and that of its parents")
    left, right, bottom, top = camera.window
    if not _fits(camera.window) or left >= right or bottom >= top:
        raise SceneError(f"the camera: its view {tuple(camera.window)} is empty, check focal length, sensor and scale")
    if not camera.clip_start >= 0:
        raise SceneError(f"the camera: clip start is {camera.clip_start} m, set it to 0 or more")
    if not (_fits(camera.clip_start) and camera.clip_end > camera.clip_start):
        raise SceneError(
            f"the camera: clip start ({camera.clip_start} m) must be nearer than clip end ({camera.clip_end} m)"
        )
    lens = camera.aperture
    if lens is None:
        return
    if not (_fits(lens.radius) and lens.radius >= 0):
        raise SceneError(f"the camera: its aperture radius is {lens.radius} m, set it to 0 or more")
    if not (_fits(lens.focus_distance) and lens.focus_distance > 0):
        raise SceneError(f"the camera: its focus distance is {lens.focus_distance} m, set it above 0")
    if not (lens.ratio > 0 and _fits((lens.ratio, lens.radius / lens.ratio))):
        raise SceneError(f"the camera: its aperture ratio is {lens.ratio}, set it above 0")
    if not _fits(lens.rotation):
        raise SceneError(f"the camera: its aperture rotation is {lens.rotation}, set it to a number")


def _check_mesh(mesh: Mesh) -> np.ndarray:
    """Gives back how far the mesh reaches from its own origin, (3,)."""
    _check_array("mesh", mesh.name, "vertices", mesh.vertices, (None, 3), np.float32)
    _check_array("mesh", mesh.name, "triangles", mesh.triangles, (None, 3), np.uint32)
    extent = np.abs(mesh.bounds()).max(axis=0)
    if not np.all(np.isfinite(extent)):
        vertex = int(np.argmin(np.isfinite(mesh.vertices).all(axis=1)))
        where = ", ".join(f"{x:g}" for x in mesh.vertices[vertex])
        raise scene_error(
            "mesh", mesh.name, f"vertex {vertex} is at ({where}); remove it, or the modifier or driver that made it"
        )
    _check_indices(mesh, "triangles", mesh.triangles, len(mesh.vertices), "vertices")
    faces = len(mesh.triangles)
    if mesh.normals is not None:
        _check_array("mesh", mesh.name, "normals", mesh.normals, (None, 3), np.float32)
        bad = _first_bad_row(mesh.normals)
        if bad is not None:
            where = ", ".join(f"{x:g}" for x in mesh.normals[bad])
            raise scene_error("mesh", mesh.name, f"normal {bad} is ({where}); clear its custom normals")
        if mesh.normal_indices is not None:
            _check_array("mesh", mesh.name, "normal_indices", mesh.normal_indices, (faces, 3), np.uint32)
            _check_indices(mesh, "normal_indices", mesh.normal_indices, len(mesh.normals), "normals")
        elif len(mesh.normals) < len(mesh.vertices):
            _check_indices(mesh, "normal_indices", mesh.triangles, len(mesh.normals), "normals")
    if mesh.material_slots is not None:
        _check_array("mesh", mesh.name, "material_slots", mesh.material_slots, (faces,), np.int32)
        if faces and mesh.material_slots.min() < 0:
            raise scene_error("mesh", mesh.name, f"a face has the material slot {mesh.material_slots.min()}, below 0")
    if mesh.uvs is not None:
        _check_array("mesh", mesh.name, "uvs", mesh.uvs, (faces, 3, 2), np.float32)
    return extent


def _owner(instances: Instances, mesh: int, name: str) -> str:
    """The first object that shows a mesh, where that has another name: what the user finds it by."""
    shown = np.flatnonzero(np.asarray(instances.mesh) == mesh)
    number = int(instances.object[shown[0]]) if len(shown) and len(instances.object) > shown[0] else -1
    known = 0 <= number < len(instances.object_names) and instances.object_names[number] != name
    return f"object {instances.object_names[number]!r}, " if known else ""


def _check_reach(instances: Instances, extents: np.ndarray) -> None:
    """Products of far coordinates overflow float32: the object would be drawn black or be missing without a word.
    Bounds of boxes, so a box that reaches out may be refused for a mesh that just doesn't."""
    if not len(instances):
        return
    moved = np.einsum("nij,nj->ni", np.abs(instances.transforms[:, :, :3]), extents[instances.mesh])
    reach = (moved + np.abs(instances.transforms[:, :, 3])).max(axis=1)
    far = int(np.argmax(reach))
    if reach[far] > MAX_REACH:
        raise scene_error(
            "object",
            instances.object_names[instances.object[far]],
            f"it reaches {reach[far]:.2g} m from the origin, and {MAX_REACH:g} m is the limit; check its location, "
            "scale and modifiers",
        )


def _check_indices(mesh: Mesh, what: str, indices: np.ndarray, count: int, of_what: str) -> None:
    """`indices`: (T, 3) uint32, each below `count`."""
    if not len(indices) or indices.max() < count:
        return
    face = int(np.argmax((indices >= count).any(axis=1)))
    raise scene_error(
        "mesh", mesh.name, f"face {face} of its {what} asks for number {indices[face].max()} of {count} {of_what}"
    )


def _check_instance_arrays(instances: Instances) -> None:
    """Types and shapes alone: messages about other things look up objects in these arrays."""
    count = len(np.atleast_1d(instances.mesh))
    for what, dtype in (
        ("mesh", np.int32),
        ("material_offset", np.int32),
        ("slot_count", np.int32),
        ("visibility", np.uint8),
        ("object", np.int32),
    ):
        _check_array("instances", "all", what, getattr(instances, what), (count,), dtype)
    _check_array("instances", "all", "transforms", instances.transforms, (count, 3, 4), np.float64)
    _check_array("instances", "all", "material_table", instances.material_table, (None,), np.int32)
    if instances.pass_index is not None:
        named = (len(instances.object_names),)
        _check_array("instances", "all", "pass_index", instances.pass_index, named, np.int32)


def _check_instances(instances: Instances, mesh_count: int, materials: Sequence[Material]) -> None:
    count = len(instances.mesh)
    if not count:
        return
    names = instances.object_names
    _reject(
        instances.object, (instances.object < 0) | (instances.object >= len(names)), None, "object name", len(names)
    )
    _reject(instances.mesh, (instances.mesh < 0) | (instances.mesh >= mesh_count), instances, "mesh", mesh_count)
    unknown_rays = instances.visibility > int(Visibility.ALL)
    _reject(instances.visibility, unknown_rays, instances, "visibility", int(Visibility.ALL) + 1)
    bad = _first_bad_row(instances.transforms.reshape(count, 12))
    if bad is not None:
        raise scene_error(
            "object",
            names[instances.object[bad]],
            "its transform holds values that are not finite; check its location, rotation, scale, drivers and parents",
        )

    offset, slots = instances.material_offset.astype(np.int64), instances.slot_count.astype(np.int64)
    outside = (slots < 1) | (offset < 0) | (offset + slots > len(instances.material_table))
    if outside.any():
        name = names[instances.object[np.argmax(outside)]]
        raise scene_error("object", name, "its material slots lie outside the table; give it at least one slot")
    table = instances.material_table
    unknown = (table < 0) | (table >= len(materials))
    if unknown.any():
        entry = int(np.argmax(unknown))
        users = (offset <= entry) & (entry < offset + slots)
        name = names[instances.object[np.argmax(users)]] if users.any() else "nobody"
        raise scene_error(
            "object", name, f"its material number {table[entry]} is not one of {len(materials)} materials"
        )


def _reject(indices: np.ndarray, outside: np.ndarray, instances: Instances | None, what: str, count: int) -> None:
    if not outside.any():
        return
    bad = int(np.argmax(outside))
    problem = f"its {what} number {indices[bad]} is not one of {count}"
    if instances is None:
        raise SceneError(f"instance {bad}: {problem}")
    raise scene_error("object", instances.object_names[instances.object[bad]], problem)


def _check_passes(scene: Scene) -> None:
    mist = scene.mist
    check_fields(mist, lambda problem: SceneError(f"the mist: {problem}"))
    if not (_fits((mist.start, mist.depth)) and mist.depth >= 0):
        raise SceneError(f"the mist goes from {mist.start} m for {mist.depth} m: set its depth to 0 or more")
    if mist.falloff not in (0.5, 1.0, 2.0):
        raise SceneError(f"the mist's falloff is {mist.falloff}: it must be 0.5, 1 or 2")
    if not (_fits(scene.occlusion_distance) and scene.occlusion_distance >= 0):
        raise SceneError(f"ambient occlusion looks {scene.occlusion_distance} m far: set its distance to 0 or more")
    if not 0.0 <= scene.alpha_threshold <= 1.0:
        raise SceneError(f"the passes' alpha threshold is {scene.alpha_threshold}: it must lie between 0 and 1")


def _check_material(material: Material) -> None:
    def fail(problem: str) -> SceneError:
        return scene_error("material", material.name, problem)

    for what, label in (("kd", "diffuse colour kd"), ("ks", "Phong colour ks"), ("emission", "emission")):
        value = np.asarray(getattr(material, what), np.float64)
        if value.shape != (3,) or not _fits(value):
            raise fail(f"its {label} is {_text(value)}; set it to three finite numbers{_limit(value)}")
        if np.any(value < 0):
            raise fail(f"its {label} is negative {_text(value)}; set every channel to 0 or more")
    if not (np.isfinite(material.exponent) and material.exponent >= 0):
        raise fail(f"its Phong exponent is {material.exponent:g}; set it to 0 or more")
    value = np.asarray(material.transparency, np.float64)
    if value.shape != (3,) or not np.all((value >= 0) & (value <= 1)):
        raise fail(f"its transparency is {_text(value)}; set every channel between 0 and 1")


def _uncommon(lights: Sequence[Lamp]) -> list[Lamp]:
    """Those that are to be checked one by one: of point lamps only the few whose numbers are not all everyday ones,
    as a scene may hold 100,000 of them."""
    points = [light for light in lights if type(light) is PointLight]
    if {(light.transform.shape, light.transform.dtype) for light in points} != {((3, 4), np.dtype(np.float64))}:
        return list(lights)
    matrices = np.concatenate([light.transform for light in points]).reshape(-1, 12)
    intensity = np.fromiter(chain.from_iterable(light.intensity for light in points), float).reshape(-1, 3)
    radius = np.fromiter((light.radius for light in points), float)
    everyday = (np.abs(matrices) < EVERYDAY).all(axis=1) & ((intensity >= 0) & (intensity < EVERYDAY)).all(axis=1)
    everyday &= (radius == 0) | ((radius > 1 / EVERYDAY) & (radius < EVERYDAY))
    common = set(map(id, compress(points, everyday)))
    return [light for light in lights if id(light) not in common]


def _check_light(light: Lamp) -> None:
    def fail(problem: str) -> SceneError:
        return scene_error("light", light.name, problem)

    _check_transform(f"light {light.name!r}", light.transform)
    energy = {PointLight: "intensity", SpotLight: "intensity", AreaLight: "radiance", SunLight: "irradiance"}
    if type(light) not in energy:
        raise fail(f"Lobe does not know lights of the kind {type(light).__name__}")
    value = np.asarray(getattr(light, energy[type(light)]), np.float64)
    if value.shape != (3,) or not _fits(value):
        raise fail(f"its energy is not finite {_text(value)}; set it to a number{_limit(value)}")
    if np.any(value < 0):
        raise fail("its energy is negative; Lobe cannot subtract light, set it to 0 or more")

    if isinstance(light, PointLight):
        if not (_fits(light.radius) and light.radius >= 0):
            raise fail(f"its radius is {light.radius:g} m; set it to 0 or more")
        if light.radius >= SMALLEST_SIZE and not _fits(value / (np.pi * light.radius**2)):
            raise fail(f"its energy is too much for its radius of {light.radius:g} m; lower it, or set the radius to 0")
    if isinstance(light, SpotLight):
        if not 0 < light.half_angle <= np.pi / 2 * (1 + 1e-6):
            angle = np.degrees(2 * light.half_angle)
            raise fail(f"its spot size is {angle:g} degrees; set it above 0 and to 180 at most")
        if not 0 <= light.blend <= 1:
            raise fail(f"its spot blend is {light.blend:g}; set it between 0 and 1")
    if isinstance(light, AreaLight):
        if not (_fits((light.size_x, light.size_y)) and min(light.size_x, light.size_y) >= 0):
            raise fail(f"its size is {light.size_x:g} x {light.size_y:g} m; set both to 0 or more")
        if not 0 < light.spread <= np.pi * (1 + 1e-6):
            raise fail(f"its spread is {np.degrees(light.spread):g} degrees; set it above 0 and to 180 at most")
    if isinstance(light, SunLight):
        if not 0 <= light.angle <= np.pi * (1 + 1e-6):
            raise fail(f"its angle is {np.degrees(light.angle):g} degrees; set it between 0 and 180")
        if light.angle >= SMALLEST_SIZE and not _fits(value / (np.pi * np.sin(light.angle / 2) ** 2)):
            raise fail("its energy is too much for its angle; lower it, or set the angle to 0")
        return  # its place does not matter
    _check_lamp_reach(light)


def _check_lamp_reach(light: Lamp) -> None:
    matrix = np.abs(np.asarray(light.transform, np.float64))
    reach = float(matrix[:, 3].max())
    if isinstance(light, PointLight):
        reach += light.radius
    if isinstance(light, AreaLight):
        reach += float(max(matrix[:, 0].max() * light.size_x, matrix[:, 1].max() * light.size_y))
    if reach > MAX_LAMP_REACH:
        raise scene_error(
            "light",
            light.name,
            f"it reaches {reach:.2g} m from the origin, and {MAX_LAMP_REACH:g} m is the limit; check its location, "
            "size and scale",
        )


def _check_world(world: World) -> None:
    color = np.asarray(world.color, np.float64)
    if color.shape != (3,) or not _fits(color):
        raise SceneError(f"the world: its colour is {_text(color)}; set it to three finite numbers{_limit(color)}")
    if np.any(color < 0):
        raise SceneError(f"the world: its colour is negative {_text(color)}; set every channel to 0 or more")
    rotation = world.rotation
    if rotation.shape != (3, 3) or rotation.dtype.kind not in "fiu" or not np.all(np.isfinite(rotation)):
        raise SceneError("the world: its rotation is not finite; check the mapping of its image")
    if not np.allclose(rotation @ rotation.T, np.eye(3), rtol=0, atol=ROTATION_TOLERANCE):
        raise SceneError("the world: its rotation scales or shears; check the mapping of its image")
    if world.image is None:
        return
    if world.image.ndim != 3 or world.image.shape[2] != 3:
        raise SceneError(f"the world: its image has the shape {np.shape(world.image)}, it must be (height, width, 3)")
    if world.image.dtype != np.float32:
        raise SceneError(f"the world: its image holds {world.image.dtype} values, it must hold float32")
    height, width, _ = world.image.shape
    if not height or not width:
        raise SceneError(f"the world: its image has {width} x {height} pixels; load it again or choose another")
    if height * width > MAX_PIXELS:
        raise SceneError(
            f"the world: its image of {width} x {height} pixels has more than {MAX_PIXELS / 1e6:.0f} million: make it "
            "smaller"
        )
    bad = _first_bad_row(world.image.reshape(-1, 3))
    if bad is not None:
        raise SceneError(
            f"the world: pixel ({bad % width}, {bad // width}) of its image, counted from the bottom left, is not "
            "finite; repair the image or choose another"
        )
    if float(world.image.min()) < 0:
        bad = int(np.argmax((world.image < 0).any(axis=2)))
        raise SceneError(
            f"the world: pixel ({bad % width}, {bad // width}) of its image, counted from the bottom left, is negative "
            f"{_text(world.image.reshape(-1, 3)[bad])}; set every channel to 0 or more"
        )
    # Tables sum up neighbouring pixels: room for some of them is left.
    if not _fits(8 * float(world.image.max()) * np.maximum(color, 1)):
        raise SceneError(
            f"the world: the brightest pixel of its image has the value {world.image.max():g}, too much to calculate "
            "with; lower it or the strength"
        )


def _check_transform(who: str, transform: np.ndarray) -> np.ndarray:
    """Gives back the (3, 4) float64 matrix."""
    if transform.shape != (3, 4):
        raise SceneError(f"{who}: its transform has the shape {transform.shape}, it must be (3, 4)")
    if transform.dtype.kind not in "fiu":
        raise SceneError(f"{who}: its transform holds {transform.dtype} values, it must hold numbers")
    matrix = transform.astype(np.float64)
    if not _fits(matrix):
        raise SceneError(
            f"{who}: its transform holds values that are not finite; "
            "check its location, rotation, scale, drivers and parents"
        )
    return matrix


def _check_array(
    kind: str, name: str, what: str, value: np.ndarray, shape: tuple[int | None, ...], dtype: type
) -> None:
    """The type and shape of one array; None in `shape` stands for any length."""
    fits = value.ndim == len(shape) and all(
        want is None or want == have for want, have in zip(shape, value.shape, strict=True)
    )
    if not fits:
        wanted = ", ".join("n" if length is None else str(length) for length in shape)
        raise scene_error(kind, name, f"{what} has the shape {value.shape}, it must be ({wanted})")
    if value.dtype != dtype:
        raise scene_error(kind, name, f"{what} holds {value.dtype} values, it must hold {np.dtype(dtype)}")
    if len(value) > MAX_ROWS:
        raise scene_error(kind, name, f"{what} has {len(value)} rows, and {MAX_ROWS} is the limit")


def _first_bad_row(rows: np.ndarray) -> int | None:
    """Index of the first row of an (n, k) array that holds a NaN or an infinity, None if there is none.

    A sum in float64 over float32 values cannot overflow, and it is a NaN or an infinity exactly if one of them is:
    one pass without temporaries decides the usual case.
    """
    with np.errstate(invalid="ignore"):
        total = np.add.reduce(rows, axis=None, dtype=np.float64)
    if np.isfinite(total):
        return None
    finite = np.isfinite(rows).all(axis=1)
    return None if finite.all() else int(np.argmin(finite))


def _fits(value) -> bool:
    """All of it is finite, also in float32, which is what the kernels calculate with."""
    return bool((np.abs(np.asarray(value, np.float64)) < FLOAT32_END).all())


def _limit(value: np.ndarray) -> str:
    """What to add to a message that asks for finite numbers, if these are but are too large for float32."""
    return f" below {np.finfo(np.float32).max:.2g}" if np.all(np.isfinite(value)) else ""


def _text(value: np.ndarray) -> str:
    return "(" + ", ".join(f"{x:g}" for x in value.ravel()) + ")"
