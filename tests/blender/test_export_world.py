"""The world: colours, environment images in Blender's orientation, against Cycles' picture of them."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from bl_ext.user_default.lobe import engine
from bl_ext.user_default.lobe.addon.export import export_scene, images
from bl_ext.user_default.lobe.engine import memory

from tests import little_memory
from tests.blender.export_checks import (
    add_camera,
    add_object,
    cycles_picture,
    depsgraph,
    in_render,
    new_material,
    node_tree,
    plane_mesh,
)

WIDTH, HEIGHT = 32, 16


def new_world():
    """A world with a Background node; gives back its tree and the node."""
    world = bpy.context.scene.world = bpy.data.worlds.new("World")
    tree = node_tree(world)
    tree.nodes.clear()
    background = tree.nodes.new("ShaderNodeBackground")
    output = tree.nodes.new("ShaderNodeOutputWorld")
    tree.links.new(background.outputs[0], output.inputs["Surface"])
    return tree, background


def add_environment(tree, background, image=None):
    node = tree.nodes.new("ShaderNodeTexEnvironment")
    node.image = image
    tree.links.new(node.outputs["Color"], background.inputs["Color"])
    return node


def smooth_image(width: int = 64, height: int = 32):
    """A float image whose every direction has a colour of its own."""
    image = bpy.data.images.new("Sky", width, height, float_buffer=True)
    u = (np.arange(width) + 0.5) / width * 2 * np.pi
    v = (np.arange(height)[:, None] + 0.5) / height
    pixels = np.ones((height, width, 4), np.float32)
    pixels[..., 0] = (1.5 + np.cos(u)) * np.sin(np.pi * v) + 0.2
    pixels[..., 1] = (1.5 + np.sin(u)) * np.sin(np.pi * v) + 0.2
    pixels[..., 2] = 0.2 + v
    image.pixels.foreach_set(pixels.ravel())
    image.pack()
    return image


def panorama_camera():
    """An equirectangular view whose middle is +x, as in an unrotated environment image."""
    add_camera((0, 0, 0), (np.pi / 2, 0, -np.pi / 2), type="PANO", panorama_type="EQUIRECTANGULAR")


def directions(finer: int = 1) -> np.ndarray:
    """(HEIGHT, WIDTH, 3) of the pixels of that view, or of one that many times as large."""
    rows, columns = finer * HEIGHT, finer * WIDTH
    azimuth = (0.5 - (np.arange(columns) + 0.5) / columns) * 2 * np.pi
    height = (((np.arange(rows) + 0.5) / rows - 0.5) * np.pi)[:, None]
    parts = np.cos(height) * np.cos(azimuth), np.cos(height) * np.sin(azimuth), np.sin(height) + 0 * azimuth
    return np.stack(parts, axis=-1)


def radiance(world, d: np.ndarray) -> np.ndarray:
    """What engine.World says that it shines with."""
    if world.image is None:
        return np.broadcast_to(world.color, d.shape)
    d = d @ world.rotation.T
    rows, columns, _ = world.image.shape
    x = (1 - np.arctan2(d[..., 1], d[..., 0]) / np.pi) / 2 * columns - 0.5
    y = np.arccos(np.clip(-d[..., 2], -1, 1)) / np.pi * rows - 0.5
    x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = (x - x0)[..., None], (y - y0)[..., None]

    def texel(i, j):
        return world.image[np.clip(j, 0, rows - 1), i % columns]

    low = (1 - fx) * texel(x0, y0) + fx * texel(x0 + 1, y0)
    high = (1 - fx) * texel(x0, y0 + 1) + fx * texel(x0 + 1, y0 + 1)
    return world.color * ((1 - fy) * low + fy * high)


def box_filtered(world, finer: int = 8) -> np.ndarray:
    """(HEIGHT, WIDTH, 3): what each pixel of that view shows on average."""
    return radiance(world, directions(finer)).reshape(HEIGHT, finer, WIDTH, finer, 3).mean(axis=(1, 3))


def assert_as_in_cycles(folder, tolerance: float = 0.01):
    panorama_camera()
    expected = radiance(export_scene(depsgraph()).world, directions())
    picture = cycles_picture(WIDTH, HEIGHT, 64, folder)
    inside = slice(1, -1)  # The rows at the poles wrap around in Cycles and not here.
    assert np.abs(picture - expected)[inside].max() < tolerance * expected.max()


def test_no_world_is_black():
    add_camera()
    bpy.context.scene.world = None
    assert export_scene(depsgraph()).world.color == (0, 0, 0)


def test_constant(tmp_path):
    _, background = new_world()
    background.inputs["Color"].default_value = (0.2, 0.4, 0.6, 1)
    background.inputs["Strength"].default_value = 2.0
    add_camera()
    assert export_scene(depsgraph()).world.color == pytest.approx((0.4, 0.8, 1.2))
    assert_as_in_cycles(tmp_path)


def test_unrotated_image(tmp_path):
    tree, background = new_world()
    background.inputs["Strength"].default_value = 0.5
    add_environment(tree, background, smooth_image())
    assert_as_in_cycles(tmp_path)


@pytest.mark.parametrize("kind", ["POINT", "TEXTURE", "VECTOR", "NORMAL"])
@pytest.mark.parametrize("scale", [(1, 1, 1), (2, 2, 2), (-1, 1, 1)])
def test_mapping(kind, scale, tmp_path):
    tree, background = new_world()
    node = add_environment(tree, background, smooth_image())
    coordinates, mapping = tree.nodes.new("ShaderNodeTexCoord"), tree.nodes.new("ShaderNodeMapping")
    mapping.vector_type = kind
    mapping.inputs["Rotation"].default_value = (0.5, -0.3, 2.0)
    mapping.inputs["Scale"].default_value = scale
    tree.links.new(coordinates.outputs["Generated"], mapping.inputs["Vector"])
    tree.links.new(mapping.outputs["Vector"], node.inputs["Vector"])
    assert_as_in_cycles(tmp_path, 0.03)
    assert export_scene(depsgraph()).warnings == ["camera 'Camera': type pano is not supported, drawn as perspective"]


@pytest.mark.parametrize("kind", ["AXIS_ANGLE", "EULER_XYZ"])
def test_vector_rotate(kind, tmp_path):
    """Twice, as the order counts."""
    tree, background = new_world()
    node = add_environment(tree, background, smooth_image())
    feed = tree.nodes.new("ShaderNodeTexCoord").outputs["Generated"]
    for turned in (False, True):
        turn = tree.nodes.new("ShaderNodeVectorRotate")
        turn.rotation_type, turn.invert = kind, turned
        for i, value in ((2, (1, 2, 1 + turned)), (3, 0.7), (4, (0.5, -0.3, 2.0 - turned))):
            turn.inputs[i].default_value = value
        tree.links.new(feed, turn.inputs["Vector"])
        feed = turn.outputs["Vector"]
    tree.links.new(feed, node.inputs["Vector"])
    assert_as_in_cycles(tmp_path, 0.03)
    assert export_scene(depsgraph()).warnings == ["camera 'Camera': type pano is not supported, drawn as perspective"]
    turn.inputs["Center"].default_value = (0, 0, 1)
    assert any("Vector Rotate's center" in warning for warning in export_scene(depsgraph()).warnings)


def test_curves_change_the_pixels(tmp_path):
    """Also those beyond 1, which many an HDRI has."""
    tree, background = new_world()
    node, curves = add_environment(tree, background, smooth_image()), tree.nodes.new("ShaderNodeRGBCurve")
    for curve in curves.mapping.curves[1:]:
        curve.points.new(0.5, 0.3)
    tree.links.new(node.outputs["Color"], curves.inputs["Color"])
    tree.links.new(curves.outputs["Color"], background.inputs["Color"])
    assert_as_in_cycles(tmp_path, 0.02)
    assert export_scene(depsgraph()).warnings == ["camera 'Camera': type pano is not supported, drawn as perspective"]


def test_what_changes_colours_unknown_leaves_the_environment():
    tree, background = new_world()
    node, unknown = add_environment(tree, background, smooth_image()), tree.nodes.new("ShaderNodeAmbientOcclusion")
    add_camera()
    tree.links.new(node.outputs["Color"], unknown.inputs["Color"])
    expected = export_scene(depsgraph()).world.image
    tree.links.new(unknown.outputs["Color"], background.inputs["Color"])
    exported = export_scene(depsgraph())
    assert np.array_equal(exported.world.image, expected)
    assert exported.warnings == ["world 'World': Ambient Occlusion is not supported, its input 'Color' counts as it is"]


def test_colour_nodes_change_the_pixels(tmp_path):
    tree, background = new_world()
    node = add_environment(tree, background, smooth_image())
    hue = tree.nodes.new("ShaderNodeHueSaturation")
    hue.inputs["Saturation"].default_value, hue.inputs["Value"].default_value = 0.5, 1.5
    tree.links.new(node.outputs["Color"], hue.inputs["Color"])
    tree.links.new(hue.outputs["Color"], background.inputs["Color"])
    assert_as_in_cycles(tmp_path, 0.02)


def test_byte_image_is_srgb(tmp_path):
    tree, background = new_world()
    image = bpy.data.images.new("Grey", 4, 2)
    image.pixels.foreach_set(np.tile(np.array([0.5, 0.25, 1.0, 1.0], np.float32), 8))
    image.pack()
    add_environment(tree, background, image)
    assert_as_in_cycles(tmp_path)


@pytest.mark.parametrize("suffix, space", [("png", "sRGB"), ("exr", "Linear Rec.709"), ("png", "Non-Color")])
def test_image_file(suffix, space, tmp_path):
    import OpenImageIO as oiio

    path = str(tmp_path / f"sky.{suffix}")
    pixels = np.linspace(0.1, 0.9, 32 * 8 * 3, dtype=np.float32).reshape(32, 8, 3)
    file = oiio.ImageOutput.create(path)
    file.open(path, oiio.ImageSpec(8, 32, 3, "float" if suffix == "exr" else "uint8"))
    file.write_image(pixels)
    file.close()
    tree, background = new_world()
    image = bpy.data.images.load(path)
    image.colorspace_settings.name = space
    add_environment(tree, background, image)
    panorama_camera()
    world = export_scene(depsgraph()).world
    if space != "sRGB":
        assert world.image == pytest.approx(pixels[::-1], abs=0.003)  # Row 0 is at the bottom.
    assert_as_in_cycles(tmp_path)


def image_with_alpha(folder, space: str, kind: str, suffix: str = "png"):
    """A file of smooth colours and smooth alpha, neither near 0 nor 1 everywhere."""
    import OpenImageIO as oiio

    u, v = np.meshgrid((np.arange(64) + 0.5) / 64 * 2 * np.pi, (np.arange(32) + 0.5) / 32)
    waves = np.sin(np.pi * v) * np.array([np.cos(u), np.sin(u), -np.cos(u), np.cos(u + 1)])
    path = str(folder / f"sky.{suffix}")
    file = oiio.ImageOutput.create(path)
    spec = oiio.ImageSpec(64, 32, 4, kind)
    spec.attribute("oiio:UnassociatedAlpha", int(suffix != "exr"))
    file.open(path, spec)
    file.write_image(np.ascontiguousarray((0.55 + 0.4 * waves).transpose(1, 2, 0).astype(np.float32)))
    file.close()
    image = bpy.data.images.load(path)
    image.colorspace_settings.name = space
    return image


@pytest.mark.parametrize(
    ("space", "kind", "suffix", "mode"),
    [
        ("sRGB", "uint8", "png", "STRAIGHT"),
        ("sRGB", "uint16", "png", "STRAIGHT"),
        ("sRGB", "uint8", "png", "CHANNEL_PACKED"),
        ("sRGB", "uint8", "png", "NONE"),
        ("Linear Rec.709", "uint8", "png", "STRAIGHT"),
        ("Non-Color", "uint8", "png", "STRAIGHT"),
        ("Linear Rec.709", "float", "exr", "PREMUL"),
    ],
)
@pytest.mark.parametrize("packed", [False, True])
def test_alpha_of_an_environment(space, kind, suffix, mode, packed, tmp_path):
    """Its colour counts as multiplied with alpha."""
    if packed and kind == "uint16" and bpy.app.version >= (5, 1, 0):
        pytest.skip("Cycles multiplies these twice from 5.1 on")
    tree, background = new_world()
    image = image_with_alpha(tmp_path, space, kind, suffix)
    image.alpha_mode = mode
    if packed:
        image.pack()
    add_environment(tree, background, image)
    assert_as_in_cycles(tmp_path)


@pytest.mark.parametrize(("space", "suffix"), [("sRGB", "png"), ("Linear Rec.709", "exr")])
@pytest.mark.parametrize("packed", [False, True])
def test_what_is_no_environment_counts_with_its_average(space, suffix, packed, tmp_path, monkeypatch):
    """That of what it would shine with; where a file doesn't fit the memory too."""
    tree, background = new_world()
    image = image_with_alpha(tmp_path, space, "uint8" if suffix == "png" else "float", suffix)
    if packed:
        image.pack()
    node = add_environment(tree, background, image)
    add_camera()
    expected = export_scene(depsgraph()).world.image.mean(axis=(0, 1))
    node.projection = "MIRROR_BALL"
    monkeypatch.setattr(images, "STRIP", 64 * 5)
    for room in (1e9, 0.0):
        little_memory.leave(monkeypatch, memory, room)
        scene = export_scene(depsgraph())
        if room or not packed:
            remark = "is not an equirectangular environment, its average colour is drawn"
            assert scene.world.color == pytest.approx(list(expected), rel=1e-5)
        else:
            remark = "needs more memory than can be had (as a file of its own it would need little), drawn magenta"
            assert scene.world.color == (1.0, 0.0, 1.0)
        assert scene.world.image is None and scene.warnings == [f"world 'World': image {image.name!r} {remark}"]


@pytest.mark.parametrize("interpolation", ["Closest", "Cubic", "Smart"])
def test_interpolation_is_named(interpolation):
    tree, background = new_world()
    add_environment(tree, background, smooth_image()).interpolation = interpolation
    add_camera()
    assert export_scene(depsgraph()).warnings == [
        f"world 'World': interpolation '{interpolation}' of image 'Sky' is not supported, drawn as 'Linear'"
    ]


@pytest.mark.parametrize(
    ("name", "value"),
    [("rotation", (0, 0, 1)), ("translation", (1, 0, 0)), ("scale", (1, 1, 2)), ("mapping_x", "NONE")],
)
def test_a_nodes_own_mapping_is_named(name, value):
    tree, background = new_world()
    setattr(add_environment(tree, background, smooth_image()).texture_mapping, name, value)
    add_camera()
    assert export_scene(depsgraph()).warnings == [
        "world 'World': the texture mapping of Environment Texture is not supported, left out: use a Mapping node"
    ]


def test_broken_pixels_are_black():
    tree, background = new_world()
    image = bpy.data.images.new("Broken", 2, 2, float_buffer=True)
    image.pixels.foreach_set(np.array([np.nan, np.inf, -1, 1, *[0.5] * 12], np.float32))
    image.pack()
    add_environment(tree, background, image)
    add_camera()
    scene = export_scene(depsgraph())
    scene.validate()
    assert scene.world.image.min() == 0 and scene.world.image.max() == pytest.approx(0.5, rel=1e-3)


def test_missing_image_is_magenta_and_named():
    tree, background = new_world()
    image = bpy.data.images.new("lost.hdr", 4, 2)
    image.source, image.filepath = "FILE", "//lost.hdr"
    add_environment(tree, background, image)
    add_camera()
    scene = export_scene(depsgraph())
    assert scene.world.color == (1.0, 0.0, 1.0) and scene.world.image is None
    assert scene.warnings == ["world 'World': image 'lost.hdr' is missing, drawn magenta"]


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (None, "is a folder"),
        (b"", "is an empty file"),
        (b"no picture", "cannot be read: its file is damaged or of an unknown format"),
    ],
)
def test_a_file_that_is_no_image_is_magenta_and_named(content, problem, tmp_path):
    tree, background = new_world()
    path = tmp_path / "sky.png"
    path.mkdir() if content is None else path.write_bytes(content)
    image = bpy.data.images.new("sky.png", 4, 2)
    image.source, image.filepath = "FILE", str(path)
    add_environment(tree, background, image)
    add_camera()
    scene = export_scene(depsgraph())
    assert scene.world.color == (1.0, 0.0, 1.0) and scene.world.image is None
    assert scene.warnings == [f"world 'World': image 'sky.png' {problem}, drawn magenta"]


@pytest.mark.parametrize(
    ("suffix", "type_", "channels", "bytes_a_pixel"),
    [("exr", "float", 4, 28), ("png", "uint8", 3, 15), ("", "", 4, 28)],
)
def test_an_image_that_finds_no_memory_is_not_read(suffix, type_, channels, bytes_a_pixel, tmp_path, monkeypatch):
    """What is read and its colour, in float32, have to fit: from a file, and from Blender where there is none."""
    import OpenImageIO as oiio

    image = smooth_image(64, 32)
    if suffix:
        path = str(tmp_path / f"sky.{suffix}")
        file = oiio.ImageOutput.create(path)
        file.open(path, oiio.ImageSpec(64, 32, channels, type_))
        file.write_image(np.ones((32, 64, channels), np.float32))
        file.close()
        image = bpy.data.images.load(path)
    tree, background = new_world()
    add_environment(tree, background, image)
    add_camera()
    need = float(bytes_a_pixel * 64 * 32)
    little_memory.leave(monkeypatch, memory, need)
    assert export_scene(depsgraph()).world.image.shape == (32, 64, 3)
    little_memory.leave(monkeypatch, memory, need - 1)
    with pytest.raises(engine.LobeError) as caught:
        export_scene(depsgraph())
    named = f"image {image.name!r} of 64 x 32 pixels"
    assert str(caught.value) == (
        f"not enough memory: rendering takes some 0.0 GB, 0.0 of it for {named}, and 0.0 GB can be had: {memory.ADVICE}"
    )


def test_environment_node_without_image():
    tree, background = new_world()
    add_environment(tree, background)
    add_camera()
    scene = export_scene(depsgraph())
    assert scene.world.color == (1.0, 0.0, 1.0)
    assert scene.warnings == ["world 'World': Environment Texture has no image, drawn magenta"]


SINGLE, MULTIPLE = ("SINGLE_SCATTERING", "NISHITA"), ("MULTIPLE_SCATTERING",)  # by the names of each Blender


def new_sky(kinds, elevation: float = 25.0, azimuth: float = -40.0):
    """A world of a Sky Texture without a disk, of the first of these types that this Blender has; where the sun is in
    degrees, clockwise from +y."""
    tree, background = new_world()
    sky = tree.nodes.new("ShaderNodeTexSky")
    known = sky.bl_rna.properties["sky_type"].enum_items
    kind = next((kind for kind in kinds if kind in known), None)
    if kind is None:
        pytest.skip("not in this Blender")
    sky.sky_type, sky.sun_disc = kind, False
    sky.sun_elevation, sky.sun_rotation = e, a = np.radians(elevation), np.radians(azimuth)
    sky.sun_direction = np.cos(e) * np.sin(a), np.cos(e) * np.cos(a), np.sin(e)
    tree.links.new(sky.outputs["Color"], background.inputs["Color"])
    return sky


# All between two of the sun's elevations in the table.
@pytest.mark.parametrize(
    ("kinds", "elevation"),
    [(("PREETHAM",), 30.0), (("HOSEK_WILKIE",), 7.0), (SINGLE, 4.0), (SINGLE, 62.0), (MULTIPLE, 16.0)],
)
def test_sky_by_direction(kinds, elevation, tmp_path):
    new_sky(kinds, elevation)
    panorama_camera()
    scene = export_scene(depsgraph())
    assert scene.warnings == ["camera 'Camera': type pano is not supported, drawn as perspective"]
    drawn, picture = box_filtered(scene.world), cycles_picture(WIDTH, HEIGHT, 64, tmp_path)
    assert drawn.mean(axis=(0, 1)) == pytest.approx(picture.mean(axis=(0, 1)), rel=0.05)
    assert np.abs(drawn - picture).mean() < 0.05 * picture.mean()
    assert np.abs(drawn - picture).max() < 0.2 * picture.max()


def test_sky_turned_by_mapping(tmp_path):
    sky = new_sky(("PREETHAM",))
    tree = sky.id_data
    coordinates, mapping = tree.nodes.new("ShaderNodeTexCoord"), tree.nodes.new("ShaderNodeMapping")
    mapping.inputs["Rotation"].default_value = (0.5, -0.3, 2.0)
    tree.links.new(coordinates.outputs["Generated"], mapping.inputs["Vector"])
    tree.links.new(mapping.outputs["Vector"], sky.inputs["Vector"])
    panorama_camera()
    drawn, picture = box_filtered(export_scene(depsgraph()).world), cycles_picture(WIDTH, HEIGHT, 64, tmp_path)
    assert np.abs(drawn - picture).mean() < 0.05 * picture.mean()


def test_sky_has_the_shape_and_rotation_of_an_image_beside_it():
    """The lookup of the sum is the sum of the lookups."""
    sky = new_sky(SINGLE)
    tree = sky.id_data
    add_camera()
    alone = export_scene(depsgraph()).world
    background = tree.nodes["Background"]
    environment = add_environment(tree, background, smooth_image(256, 128))
    mapping, coordinates = tree.nodes.new("ShaderNodeMapping"), tree.nodes.new("ShaderNodeTexCoord")
    mapping.inputs["Rotation"].default_value = (0, 0, 2.0)
    tree.links.new(coordinates.outputs["Generated"], mapping.inputs["Vector"])
    tree.links.new(mapping.outputs["Vector"], environment.inputs["Vector"])
    image = export_scene(depsgraph()).world
    add = tree.nodes.new("ShaderNodeVectorMath")
    tree.links.new(environment.outputs["Color"], add.inputs[0])
    tree.links.new(sky.outputs["Color"], add.inputs[1])
    tree.links.new(add.outputs[0], background.inputs["Color"])
    both = export_scene(depsgraph())
    assert both.warnings == []
    where = directions()[2:-2]
    expected = radiance(image, where) + radiance(alone, where)
    assert radiance(both.world, where) == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize("kinds", [SINGLE, MULTIPLE])
def test_the_suns_disk_is_a_sun_lamp(kinds, tmp_path):
    """A white floor, by Cycles with the disk and without it. The lamp shines where the brightest pixel is."""
    sky = new_sky(kinds, 30.0)
    sky.sun_intensity, sky.sun_size = 0.5, np.radians(12)
    sky.id_data.nodes["Background"].inputs["Strength"].default_value = 3.0
    floor = plane_mesh()
    floor.materials.append(new_material("White", "ShaderNodeBsdfDiffuse", Color=(1, 1, 1, 1))[0])
    floor_object = add_object("Floor", floor)
    add_camera(location=(0, 0, 1))
    assert export_scene(depsgraph()).lights == []
    unlit = cycles_picture(4, 4, 256, tmp_path).mean(axis=(0, 1))
    sky.sun_disc = True
    (sun,) = export_scene(depsgraph()).lights
    lit = cycles_picture(4, 4, 256, tmp_path).mean(axis=(0, 1))
    towards = sun.transform[:, 2]
    assert np.array(sun.irradiance) * towards[2] / np.pi == pytest.approx(lit - unlit, rel=0.05)
    assert sun.angle == pytest.approx(np.radians(12)) and sun.cast_shadow
    bpy.data.objects.remove(floor_object)
    panorama_camera()
    picture = cycles_picture(WIDTH, HEIGHT, 64, tmp_path).sum(axis=2)
    assert directions()[np.unravel_index(picture.argmax(), picture.shape)] @ towards > np.cos(np.radians(12))


def test_no_sun_lamp_where_there_is_no_disk():
    add_camera()
    for kinds, elevation in ((("PREETHAM",), 25.0), (SINGLE, -0.3), (SINGLE, -40.0)):
        new_sky(kinds, elevation).sun_disc = True
        assert export_scene(depsgraph()).lights == []
    sky = new_sky(SINGLE, 0.1)
    sky.sun_disc = True
    assert len(export_scene(depsgraph()).lights) == 1
    sky.sun_intensity = 0.0
    assert export_scene(depsgraph()).lights == []


def test_the_sun_past_the_zenith_comes_down_on_the_other_side():
    sky = new_sky(SINGLE, 150.0, 20.0)
    sky.sun_disc = True
    add_camera()
    past = export_scene(depsgraph())
    sky.sun_elevation, sky.sun_rotation = np.radians(30.0), np.radians(200.0)
    direct = export_scene(depsgraph())
    assert past.lights[0].transform[:, 2] == pytest.approx(direct.lights[0].transform[:, 2], abs=1e-6)
    assert past.world.image == pytest.approx(direct.world.image, rel=1e-4)


def test_colour_nodes_change_the_suns_light():
    """As they do pixels."""
    sky = new_sky(SINGLE)
    sky.sun_disc = True
    tree = sky.id_data
    add_camera()
    before = np.array(export_scene(depsgraph()).lights[0].irradiance)
    node = tree.nodes.new("ShaderNodeVectorMath")
    node.operation = "MULTIPLY"
    node.inputs[1].default_value = (2.0, 0.5, 0.0)
    tree.links.new(sky.outputs["Color"], node.inputs[0])
    tree.links.new(node.outputs[0], tree.nodes["Background"].inputs["Color"])
    assert export_scene(depsgraph()).lights[0].irradiance == pytest.approx(before * (2.0, 0.5, 0.0))
    node.operation, node.inputs[1].default_value = "MINIMUM", (0.1, 0.1, 0.1)  # darker than the sky beside the disk
    assert export_scene(depsgraph()).lights == []


def test_two_skies_have_a_sun_each():
    sky = new_sky(SINGLE)
    sky.sun_disc = True
    tree = sky.id_data
    add_camera()
    (first,) = export_scene(depsgraph()).lights
    second, add = tree.nodes.new("ShaderNodeTexSky"), tree.nodes.new("ShaderNodeVectorMath")
    second.sky_type, second.sun_elevation = sky.sky_type, 1.2
    tree.links.new(sky.outputs["Color"], add.inputs[0])
    tree.links.new(second.outputs["Color"], add.inputs[1])
    tree.links.new(add.outputs[0], tree.nodes["Background"].inputs["Color"])
    suns = export_scene(depsgraph()).lights
    assert sorted(sun.transform[2, 2] for sun in suns) == pytest.approx([np.sin(np.radians(25.0)), np.sin(1.2)])
    low = min(suns, key=lambda sun: sun.transform[2, 2])
    assert low.irradiance == pytest.approx(first.irradiance)


def test_the_sun_is_seen_by_the_rays_that_see_the_world():
    new_sky(SINGLE).sun_disc = True
    add_camera()
    scene = bpy.context.scene
    scene.world.cycles_visibility.diffuse = False
    seen = engine.Visibility.ALL & ~engine.Visibility.DIFFUSE
    assert export_scene(depsgraph()).lights[0].visibility == seen
    scene.render.film_transparent = True  # the camera sees no world then
    assert export_scene(depsgraph()).lights[0].visibility == seen & ~engine.Visibility.CAMERA


@pytest.mark.parametrize(
    ("kinds", "settings", "named"),
    [
        (SINGLE, {"air_density": 2.0, "altitude": 4000.0}, "air and altitude"),
        (("PREETHAM",), {"turbidity": 5.0, "ground_albedo": 0.9}, "turbidity"),
        (("HOSEK_WILKIE",), {"ground_albedo": 0.9}, "ground albedo"),
    ],
)
def test_air_that_is_not_in_the_table_is_named(kinds, settings, named):
    sky = new_sky(kinds)
    add_camera()
    assert export_scene(depsgraph()).warnings == []
    for name, value in settings.items():
        setattr(sky, name, value)
    assert export_scene(depsgraph()).warnings == [f"world 'World': Sky Texture is drawn with its default {named}"]


def test_sky_in_a_material_is_its_average():
    new_world()
    material, node = new_material("Wall", "ShaderNodeBsdfDiffuse")
    sky = material.node_tree.nodes.new("ShaderNodeTexSky")
    material.node_tree.links.new(sky.outputs["Color"], node.inputs["Color"])
    floor = plane_mesh()
    floor.materials.append(material)
    add_object("Floor", floor)
    add_camera()
    scene = export_scene(depsgraph())
    assert min(scene.materials[-1].kd) > 0.1
    assert scene.warnings == [
        "material 'Wall': Sky Texture is drawn in its average colour: textures are not supported yet"
    ]


def test_what_lights_the_scene_counts_for_mixes_by_ray():
    """A backdrop for the camera alone: the other side of the mix lights."""
    tree, light = new_world()
    light.inputs["Color"].default_value = (0.5, 0.5, 0.5, 1)
    backdrop, mix = tree.nodes.new("ShaderNodeBackground"), tree.nodes.new("ShaderNodeMixShader")
    path = tree.nodes.new("ShaderNodeLightPath")
    output = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeOutputWorld")
    backdrop.inputs["Color"].default_value = (0, 1, 0, 1)
    tree.links.new(path.outputs["Is Camera Ray"], mix.inputs[0])
    tree.links.new(light.outputs[0], mix.inputs[1])
    tree.links.new(backdrop.outputs[0], mix.inputs[2])
    tree.links.new(mix.outputs[0], output.inputs["Surface"])
    add_camera()
    scene = export_scene(depsgraph())
    assert scene.world.color == pytest.approx((0.5, 0.5, 0.5))
    assert scene.warnings == ["world 'World': Light Path is not supported, 'Is Camera Ray' counts as 0"]


def test_visibility():
    new_world()
    add_camera()
    flags = bpy.context.scene.world.cycles_visibility
    flags.camera = flags.glossy = False
    visibility = export_scene(depsgraph()).world.visibility
    assert not visibility & (engine.Visibility.CAMERA | engine.Visibility.GLOSSY)
    assert visibility & engine.Visibility.DIFFUSE


# --- images that move -------------------------------------------------------------------------------------------------

GREYS = (0.1, 0.9, 0.4)  # of the frames, as the files have them


def still_images(folder) -> str:
    """The path of the first of three frames."""
    for number, grey in enumerate(GREYS, 1):
        image = bpy.data.images.new("Still", 64, 32)
        image.pixels.foreach_set(np.tile(np.float32([grey, grey, grey, 1.0]), 64 * 32))
        image.filepath_raw, image.file_format = str(folder / f"still_{number:04}.png"), "PNG"
        image.save()
        bpy.data.images.remove(image)
    return str(folder / "still_0001.png")


def movie(folder) -> str:
    """The path of a file of these three frames, by Blender's sequencer."""
    still_images(folder)
    scene = bpy.context.window.scene = bpy.data.scenes.new("Edit")
    editor = scene.sequence_editor_create()
    strips = editor.strips if hasattr(editor, "strips") else editor.sequences  # the former from Blender 4.4 on
    strip = strips.new_image("Stills", str(folder / "still_0001.png"), 1, 1)
    for number in (2, 3):
        strip.elements.append(f"still_{number:04}.png")
    strip.frame_final_duration = scene.frame_end = 3
    render = scene.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = 64, 32, 100
    scene.view_settings.view_transform = "Standard"
    if hasattr(render.image_settings, "media_type"):
        render.image_settings.media_type = "VIDEO"
    render.image_settings.file_format = "FFMPEG"
    render.ffmpeg.format, render.ffmpeg.codec, render.ffmpeg.constant_rate_factor = "MPEG4", "H264", "LOSSLESS"
    render.filepath, render.use_file_extension = str(folder / "film.mp4"), False
    bpy.ops.render.render(animation=True)
    path = render.filepath
    bpy.data.scenes.remove(scene)
    return path


def show_moving(path: str, kind: str, where: str, **of_user) -> None:
    """In the world, or on a surface that fills the picture and shines."""
    tree, background = new_world()
    target = background.inputs["Color"]
    if where == "surface":
        material, emission = new_material("Screen", "ShaderNodeEmission")
        add_object("Screen", plane_mesh(100)).data.materials.append(material)
        tree, target = material.node_tree, emission.inputs["Color"]
    node = tree.nodes.new("ShaderNodeTexImage" if where == "surface" else "ShaderNodeTexEnvironment")
    node.image = bpy.data.images.load(path)
    node.image.source = kind
    node.image_user.frame_duration = 3
    for key, value in of_user.items():
        setattr(node.image_user, key, value)
    tree.links.new(node.outputs["Color"], target)
    add_camera()


def shown() -> float:
    """What a render would draw in the whole picture, in the frame as it is."""
    exported = in_render(lambda engine, graph: export_scene(graph))
    emissions = [material.emission[0] for material in exported.materials if any(material.emission)]
    return float(emissions[0] if emissions else exported.world.image.mean())


@pytest.mark.parametrize(
    "of_user",
    [{}, {"use_cyclic": True}, {"frame_start": 3, "frame_duration": 2}, {"frame_duration": 2, "frame_offset": 1}],
    ids=["plain", "cyclic", "start", "offset"],
)
@pytest.mark.parametrize("where", ["world", "surface"])
def test_a_movie_is_shown_frame_by_frame(tmp_path, where: str, of_user: dict) -> None:
    """In whichever order they are rendered, and whatever Cycles has read of it before."""
    show_moving(movie(tmp_path), "MOVIE", where, use_auto_refresh=True, **of_user)
    scene = bpy.context.scene
    seen = set()
    for frame in (8, 4, 3, 2, 1, -1, 2):
        scene.frame_set(frame)
        lobe = shown()
        seen.add(round(lobe, 2))
        assert cycles_picture(8, 8, 1, tmp_path).mean() == pytest.approx(lobe, abs=0.005), frame
        scene.render.engine = "LOBE"
    assert len(seen) == (3 if not of_user or "use_cyclic" in of_user else 2 + ("frame_offset" in of_user))
    assert [image.name for image in bpy.data.images if image.source == "MOVIE"] == ["film.mp4"]


@pytest.mark.parametrize("where", ["world", "surface"])
def test_a_sequence_that_blender_alone_can_read(tmp_path, monkeypatch, where: str) -> None:
    def unreadable(path):
        raise images.Unreadable

    show_moving(still_images(tmp_path), "SEQUENCE", where, use_auto_refresh=True)
    expected = {frame: (bpy.context.scene.frame_set(frame), shown())[1] for frame in (1, 2, 3)}
    monkeypatch.setattr(images, "_opened", unreadable)
    for frame in (3, 2, 1, 3):
        bpy.context.scene.frame_set(frame)
        assert shown() == pytest.approx(expected[frame], abs=0.005)
    assert expected[1] < expected[3] < expected[2]


def test_a_frame_that_is_missing_is_named_by_its_own_file(tmp_path) -> None:
    show_moving(still_images(tmp_path), "SEQUENCE", "world", use_auto_refresh=True)
    gone = tmp_path / "still_0002.png"
    gone.unlink()
    named = f"world 'World': image 'still_0001.png' shows {str(gone)!r}, which is missing, drawn magenta"
    for frame, expected in ((1, []), (2, [named])):
        bpy.context.scene.frame_set(frame)
        assert in_render(lambda engine, graph: export_scene(graph)).warnings == expected
