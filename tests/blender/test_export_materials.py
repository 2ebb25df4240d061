"""Materials: shader nodes on the engine's lobes, constants folded as Cycles folds them, the rest named."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from bl_ext.user_default.lobe import engine
from bl_ext.user_default.lobe.addon.export import export_scene, images, units
from bl_ext.user_default.lobe.addon.export.materials.nodes_color import BLEND
from bl_ext.user_default.lobe.addon.export.materials.nodes_math import MATH, VECTOR_MATH
from bl_ext.user_default.lobe.addon.export.materials.surface import DARKER_EDGES
from bl_ext.user_default.lobe.addon.export.notes import PRINCIPLED_GLOSS
from bl_ext.user_default.lobe.addon.phong_group import phong_group
from bl_ext.user_default.lobe.engine import memory

from tests import little_memory
from tests.blender.export_checks import add_camera, add_object, cycles_picture, depsgraph, new_material, plane_mesh

AVERAGE = "is drawn in its average colour: textures are not supported yet"
DARKER = f"material 'M': {DARKER_EDGES}"


def exported(material):
    """The engine's material and the warnings for one Blender material."""
    if bpy.context.scene.camera is None:
        add_camera()
    plane = plane_mesh()
    plane.materials.append(material)
    add_object("Plane", plane)
    scene = export_scene(depsgraph())
    scene.validate()
    result = next(m for m in scene.materials if m.name == material.name)
    return result, scene.warnings


def output_of(material):
    return next(node for node in material.node_tree.nodes if node.bl_idname == "ShaderNodeOutputMaterial")


def test_diffuse():
    material, warnings = exported(new_material("M", "ShaderNodeBsdfDiffuse", Color=(0.1, 0.2, 0.3, 1))[0])
    assert material.kd == pytest.approx((0.1, 0.2, 0.3)) and material.ks == (0, 0, 0)
    assert warnings == []


def test_glossy():
    material, warnings = exported(
        new_material("M", "ShaderNodeBsdfAnisotropic", Color=(0.1, 0.2, 0.3, 1), Roughness=0.5)[0]
    )
    assert material.ks == pytest.approx((0.1, 0.2, 0.3)) and material.kd == (0, 0, 0)
    assert material.exponent == pytest.approx(30)
    assert warnings == [DARKER]


def test_emission():
    material, _ = exported(new_material("M", "ShaderNodeEmission", Color=(1, 0.5, 0, 1), Strength=4)[0])
    assert material.emission == pytest.approx((4, 2, 0))


def test_transparent():
    material, _ = exported(new_material("M", "ShaderNodeBsdfTransparent", Color=(1, 0.5, 0, 1))[0])
    assert material.transparency == pytest.approx((1, 0.5, 0))


def phong_material(**inputs):
    material, node = new_material("M", "ShaderNodeGroup")
    node.node_tree = phong_group()
    for key, value in inputs.items():
        node.inputs[key].default_value = value
    material.node_tree.links.new(node.outputs[0], output_of(material).inputs["Surface"])
    return material


def test_phong_group_is_exact():
    made = phong_material(kd=(0.1, 0.2, 0.3, 1), ks=(0.4, 0.5, 0.6, 1), exponent=123.0)
    material, warnings = exported(made)
    assert material.kd == pytest.approx((0.1, 0.2, 0.3))
    assert material.ks == pytest.approx((0.4, 0.5, 0.6))
    assert material.exponent == pytest.approx(123)
    assert warnings == []


def test_negative_exponent_is_refused_by_name():
    with pytest.raises(engine.SceneError, match="material 'M': its Phong exponent is -1"):
        exported(phong_material(exponent=-1.0))


def shader_pair(combine: str, first: str, second: str):
    """A material of two shaders; gives back it and the three nodes."""
    material, node = new_material("M", combine)
    tree = material.node_tree
    sides = [tree.nodes.new(name) for name in (first, second)]
    shader_inputs = [socket for socket in node.inputs if socket.type == "SHADER"]
    for side, socket in zip(sides, shader_inputs, strict=True):
        if len(side.outputs):
            tree.links.new(side.outputs[0], socket)
    return material, node, *sides


def test_mix_and_add():
    material, node, diffuse, glossy = shader_pair(
        "ShaderNodeMixShader", "ShaderNodeBsdfDiffuse", "ShaderNodeBsdfAnisotropic"
    )
    node.inputs[0].default_value = 0.25
    diffuse.inputs["Color"].default_value = glossy.inputs["Color"].default_value = (1, 1, 1, 1)
    result, _ = exported(material)
    assert result.kd == pytest.approx([0.75] * 3) and result.ks == pytest.approx([0.25] * 3)

    material, *_ = shader_pair("ShaderNodeAddShader", "ShaderNodeBsdfDiffuse", "ShaderNodeEmission")
    material.name = "Sum"
    result, _ = exported(material)
    assert result.kd == pytest.approx([0.8] * 3) and result.emission == pytest.approx([1.0] * 3)


def test_more_than_full_transparency_is_limited():
    material, *_ = shader_pair("ShaderNodeAddShader", "ShaderNodeBsdfTransparent", "ShaderNodeBsdfTransparent")
    result, warnings = exported(material)
    assert result.transparency == (1, 1, 1)
    assert warnings == ["material 'M': it lets through more light than there is, limited to all of it"]


def test_a_vector_becomes_a_number_by_its_mean():
    material, emission = new_material("M", "ShaderNodeEmission", Color=(1, 1, 1, 1))
    combine = material.node_tree.nodes.new("ShaderNodeCombineXYZ")
    for socket, value in zip(combine.inputs, (1, 2, 6), strict=True):
        socket.default_value = value
    material.node_tree.links.new(combine.outputs[0], emission.inputs["Strength"])
    assert exported(material)[0].emission == pytest.approx((3, 3, 3))


def test_an_unused_side_is_not_named():
    material, node, *_ = shader_pair("ShaderNodeMixShader", "ShaderNodeBsdfDiffuse", "ShaderNodeBsdfGlass")
    node.inputs[0].default_value = 0.0
    assert exported(material)[1] == []


def test_lobes_of_different_roughness_become_one():
    material, _, first, second = shader_pair(
        "ShaderNodeMixShader", "ShaderNodeBsdfAnisotropic", "ShaderNodeBsdfAnisotropic"
    )
    first.inputs["Roughness"].default_value, second.inputs["Roughness"].default_value = 0.2, 0.6
    result, warnings = exported(material)
    assert result.ks == pytest.approx([0.8] * 3)
    assert result.exponent == pytest.approx(units.roughness_to_exponent(0.4))
    assert warnings == [DARKER, "material 'M': several reflections of different roughness are drawn as one"]


PRINCIPLED = {
    "Base_Color": [(0.8, 0.8, 0.8, 1), (1, 1, 1, 1), (0.9, 0.1, 0.0, 1)],
    "Metallic": [0.0, 0.5, 1.0],
    "Roughness": [0.0, 0.5, 1.0],
    "IOR": [1.0, 1.45, 3.0],
    "Specular_IOR_Level": [0.0, 0.5, 1.0],
    "Transmission_Weight": [0.0, 1.0],
    "Alpha": [1.0, 0.3],
}


@pytest.mark.parametrize("seed", range(20))
def test_principled_conserves_energy(seed):
    random = np.random.default_rng(seed)
    inputs = {name: values[random.integers(len(values))] for name, values in PRINCIPLED.items()}
    material, _ = exported(new_material("M", "ShaderNodeBsdfPrincipled", **inputs)[0])
    total = np.add(material.kd, material.ks) + material.transparency
    assert np.all(total <= 1 + 1e-6) and np.all(np.array(material.kd) >= 0)


def test_principled_ends():
    plain, warnings = exported(
        new_material("Plain", "ShaderNodeBsdfPrincipled", Base_Color=(0.5, 0.2, 0.1, 1), Specular_IOR_Level=0.0)[0]
    )
    assert plain.kd == pytest.approx((0.5, 0.2, 0.1)) and plain.ks == pytest.approx((0, 0, 0))
    metal, warnings = exported(
        new_material("Metal", "ShaderNodeBsdfPrincipled", Base_Color=(1, 1, 1, 1), Metallic=1.0, Roughness=0.5)[0]
    )
    assert metal.kd == (0, 0, 0) and metal.ks == pytest.approx((1, 1, 1)) and metal.exponent == pytest.approx(30)
    glow, warnings = exported(
        new_material("Glow", "ShaderNodeBsdfPrincipled", Emission_Color=(1, 0.5, 0, 1), Emission_Strength=2.0)[0]
    )
    assert glow.emission == pytest.approx((2, 1, 0))
    # Of the gloss of the third; the first has none.
    assert warnings == [DARKER.replace("'M'", "'Metal'"), f"material 'Glow': {PRINCIPLED_GLOSS}"]


def test_principled_base_colour_above_one_is_kept_where_cycles_keeps_it():
    """In what is diffuse; metal and what light passes through are limited to all of it."""
    inputs = {"Base_Color": (1.7, 0.3, 0.2, 1), "Specular_IOR_Level": 0.0}
    plain, warnings = exported(new_material("Plain", "ShaderNodeBsdfPrincipled", **inputs)[0])
    assert plain.kd == pytest.approx((1.7, 0.3, 0.2)) and warnings == []
    metal, _ = exported(new_material("Metal", "ShaderNodeBsdfPrincipled", Metallic=1.0, **inputs)[0])
    assert metal.ks[0] == pytest.approx(1.0) and metal.kd == (0, 0, 0)
    clear, _ = exported(new_material("Clear", "ShaderNodeBsdfPrincipled", Transmission_Weight=1.0, **inputs)[0])
    assert np.all(np.array(clear.transparency) + clear.ks <= 1.0)


@pytest.mark.parametrize("strength", [1e39, 1e31])
def test_endless_emission_is_refused_by_name(strength):
    """Blender turns 1e39 into the largest number that it can hold."""
    material, emission = new_material("M", "ShaderNodeEmission", Color=(1, 1, 1, 1))
    value = material.node_tree.nodes.new("ShaderNodeValue")
    value.outputs[0].default_value = strength
    material.node_tree.links.new(value.outputs[0], emission.inputs["Strength"])
    with pytest.raises(engine.SceneError, match=r"material 'M': its emission is \S+; set it to 1e30 or less"):
        exported(material)


def test_principled_names_what_it_leaves_out():
    inputs = {"Coat_Weight": 1.0, "Sheen_Weight": 0.5, "Subsurface_Weight": 1.0, "Transmission_Weight": 0.5}
    warnings = exported(new_material("M", "ShaderNodeBsdfPrincipled", **inputs)[0])[1]
    for word in ("coat", "sheen", "subsurface", "transmission"):
        assert sum(word in warning for warning in warnings) == 1


def test_rough_lobes_of_lossy_distributions_reflect_less():
    for distribution, share in (("MULTI_GGX", 1.0), ("GGX", 0.49), ("BECKMANN", 0.8)):
        assert units.rough_share(distribution, 1.0) == pytest.approx(share)
        assert units.rough_share(distribution, 0.5) == 1.0
    material, node = new_material("M", "ShaderNodeBsdfAnisotropic", Color=(1, 1, 1, 1), Roughness=1.0)
    node.distribution = "GGX"
    assert exported(material)[0].ks == pytest.approx([0.49] * 3)


@pytest.mark.parametrize("exponent", [0.0, 1.0, 50.0, 1e4])
def test_exponent_and_roughness_are_inverse(exponent):
    assert units.roughness_to_exponent(units.exponent_to_roughness(exponent)) == pytest.approx(exponent, abs=1e-9)


@pytest.mark.parametrize(
    "bl_idname, label",
    [
        ("ShaderNodeBsdfGlass", "Glass BSDF"),
        ("ShaderNodeBsdfRefraction", "Refraction BSDF"),
        ("ShaderNodeSubsurfaceScattering", "Subsurface Scattering"),
        ("ShaderNodeBsdfTranslucent", "Translucent BSDF"),
        ("ShaderNodeBsdfToon", "Toon BSDF"),
        ("ShaderNodeBsdfSheen", "Sheen BSDF"),
        ("ShaderNodeBsdfHair", "Hair BSDF"),
        ("ShaderNodeBsdfHairPrincipled", "Principled Hair BSDF"),
        ("ShaderNodeScript", "Script"),
    ],
)
def test_unsupported_shaders_are_named_once(bl_idname, label):
    material, _ = new_material("M", bl_idname)
    shader = material.node_tree.nodes[-1]
    if bl_idname == "ShaderNodeScript":
        shader.outputs.new("NodeSocketShader", "BSDF")
        material.node_tree.links.new(shader.outputs[0], output_of(material).inputs["Surface"])
    plane = plane_mesh()
    plane.materials.append(material)
    add_object("Second", plane)
    warnings = exported(material)[1]
    assert len(warnings) == 1
    assert warnings[0].startswith(f"material 'M': {label} is not supported, drawn as ")


def test_the_holdout_shader_is_one_alone_and_named_in_a_mix():
    material, holdout = new_material("M", "ShaderNodeHoldout")
    found, warnings = exported(material)
    assert found == engine.Material("M", holdout=True) and warnings == []
    tree = material.node_tree
    mix, diffuse = tree.nodes.new("ShaderNodeMixShader"), tree.nodes.new("ShaderNodeBsdfDiffuse")
    for shader, socket in ((holdout, 1), (diffuse, 2)):
        tree.links.new(shader.outputs[0], mix.inputs[socket])
    tree.links.new(mix.outputs[0], output_of(material).inputs["Surface"])
    found, warnings = exported(material)
    assert not found.holdout and warnings == ["material 'M': Holdout is not supported, drawn as black"]


def test_normal_maps_volumes_and_displacement_are_named():
    material, diffuse = new_material("M", "ShaderNodeBsdfDiffuse")
    tree, output = material.node_tree, output_of(material)
    for name, target in (
        ("ShaderNodeBump", diffuse.inputs["Normal"]),
        ("ShaderNodeVolumeScatter", output.inputs["Volume"]),
        ("ShaderNodeDisplacement", output.inputs["Displacement"]),
    ):
        tree.links.new(tree.nodes.new(name).outputs[0], target)
    assert exported(material)[1] == [
        "material 'M': volumes are not supported and left out",
        "material 'M': displacement is not supported, the surface stays as it is",
        "material 'M': Bump is not supported, the surface keeps its own normals",
    ]


def volume_material():
    """Thin air in Volume, nothing in Surface."""
    material, volume = new_material("M", "ShaderNodeVolumeScatter", Density=0.0)
    tree = material.node_tree
    tree.links.clear()
    tree.links.new(volume.outputs[0], output_of(material).inputs["Volume"])
    return material


@pytest.mark.parametrize("muted", [False, True])
def test_a_volume_alone_has_no_surface(muted: bool):
    """A muted volume shader is none: then the surface is black, as where nothing is linked at all."""
    material = volume_material()
    material.node_tree.nodes["Volume Scatter"].mute = muted
    expected = engine.Material("M") if muted else engine.Material("M", transparency=(1.0, 1.0, 1.0))
    said = [] if muted else ["material 'M': volumes are not supported and left out"]
    assert exported(material) == (expected, said)


@pytest.mark.parametrize("muted", [False, True])
def test_a_volume_alone_lets_as_much_light_through_as_in_cycles(tmp_path, muted: bool):
    """To the camera, which looks at a sunlit floor through it, and in shadows, also where the material asks for opaque
    ones."""
    material = volume_material()
    material.use_transparent_shadow = False
    material.node_tree.nodes["Volume Scatter"].mute = muted
    bpy.ops.mesh.primitive_cube_add(size=4.0)
    bpy.context.object.data.materials.append(material)
    floor = plane_mesh(100.0)
    floor.materials.append(new_material("Floor", "ShaderNodeBsdfDiffuse", Color=(0.5, 0.5, 0.5, 1))[0])
    add_object("Floor", floor, (0, 0, -2.1))
    add_object("Sun", bpy.data.lights.new("Sun", "SUN")).data.energy = np.pi
    add_camera(angle=0.1)
    found = next(m for m in export_scene(depsgraph()).materials if m.name == "M")
    assert cycles_picture(16, 16, 16, tmp_path).mean() / 0.5 == pytest.approx(found.transparency[0], abs=1e-3)


def test_empty_trees_are_black():
    material, _ = new_material("M", "ShaderNodeBsdfDiffuse")
    material.node_tree.links.clear()
    assert exported(material)[0] == engine.Material("M")
    material.node_tree.nodes.clear()
    material.name = "N"
    assert exported(material) == (engine.Material("N"), ["material 'N': it has no output node, drawn black"])


def group_with(node_name: str, socket_kind: str, output_name: str):
    """A node group around one shader, its colour an input of the group."""
    group = bpy.data.node_groups.new("Group", "ShaderNodeTree")
    group.interface.new_socket("Tint", in_out="INPUT", socket_type=socket_kind)
    group.interface.new_socket("Out", in_out="OUTPUT", socket_type="NodeSocketShader")
    inside, outside = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
    shader = group.nodes.new(node_name)
    group.links.new(inside.outputs["Tint"], shader.inputs["Color"])
    group.links.new(shader.outputs[output_name], outside.inputs["Out"])
    return group


def test_groups_reroutes_and_muted_nodes():
    inner = group_with("ShaderNodeBsdfDiffuse", "NodeSocketColor", "BSDF")
    outer = bpy.data.node_groups.new("Outer", "ShaderNodeTree")
    outer.interface.new_socket("Tint", in_out="INPUT", socket_type="NodeSocketColor")
    outer.interface.new_socket("Out", in_out="OUTPUT", socket_type="NodeSocketShader")
    inside, outside = outer.nodes.new("NodeGroupInput"), outer.nodes.new("NodeGroupOutput")
    nested, reroute = outer.nodes.new("ShaderNodeGroup"), outer.nodes.new("NodeReroute")
    nested.node_tree = inner
    outer.links.new(inside.outputs["Tint"], reroute.inputs[0])
    outer.links.new(reroute.outputs[0], nested.inputs["Tint"])
    outer.links.new(nested.outputs["Out"], outside.inputs["Out"])

    material, node = new_material("M", "ShaderNodeGroup")
    tree = material.node_tree
    node.node_tree = outer
    tree.links.new(node.outputs["Out"], output_of(material).inputs["Surface"])
    invert, color = tree.nodes.new("ShaderNodeInvert"), tree.nodes.new("ShaderNodeRGB")
    color.outputs[0].default_value = (0.1, 0.2, 0.3, 1)
    invert.mute = True
    tree.links.new(color.outputs[0], invert.inputs["Color"])
    tree.links.new(invert.outputs[0], node.inputs["Tint"])
    result, warnings = exported(material)
    assert result.kd == pytest.approx((0.1, 0.2, 0.3))
    assert warnings == []
    invert.mute = False
    material.name = "N"
    assert exported(material)[0].kd == pytest.approx((0.9, 0.8, 0.7))


def test_one_group_with_two_inputs_is_evaluated_twice():
    group = group_with("ShaderNodeBsdfDiffuse", "NodeSocketColor", "BSDF")
    material, _, first, second = shader_pair("ShaderNodeAddShader", "ShaderNodeGroup", "ShaderNodeGroup")
    shader_inputs = output_of(material).inputs["Surface"].links[0].from_node.inputs
    for node, color, socket in ((first, (0.5, 0, 0, 1), shader_inputs[0]), (second, (0, 0.25, 0, 1), shader_inputs[1])):
        node.node_tree = group
        node.inputs["Tint"].default_value = color
        material.node_tree.links.new(node.outputs[0], socket)
    assert exported(material)[0].kd == pytest.approx((0.5, 0.25, 0))


def test_muted_links_and_outputs_for_other_engines():
    material, _ = new_material("M", "ShaderNodeBsdfDiffuse", Color=(1, 0, 0, 1))
    tree = material.node_tree
    eevee, glass = tree.nodes.new("ShaderNodeOutputMaterial"), tree.nodes.new("ShaderNodeBsdfGlass")
    eevee.target = "EEVEE"
    eevee.is_active_output = True
    tree.links.new(glass.outputs[0], eevee.inputs["Surface"])
    assert exported(material) == (engine.Material("M", kd=(1.0, 0.0, 0.0)), [])
    output_of(material).inputs["Surface"].links[0].is_muted = True
    material.name = "N"
    assert exported(material)[0] == engine.Material("N")


def test_textures_are_drawn_in_their_average_colour(tmp_path):
    image = bpy.data.images.new("Half", 2, 1, float_buffer=True)
    image.pixels.foreach_set(np.array([1, 0, 0, 1, 0, 0.5, 0, 1], np.float32))
    image.pack()
    material, diffuse = new_material("M", "ShaderNodeBsdfDiffuse")
    texture = material.node_tree.nodes.new("ShaderNodeTexImage")
    texture.image = image
    material.node_tree.links.new(texture.outputs["Color"], diffuse.inputs["Color"])
    result, warnings = exported(material)
    assert result.kd == pytest.approx((0.5, 0.25, 0), abs=1e-3)
    assert warnings == [f"material 'M': image 'Half' {AVERAGE}"]


def see_through(alpha_mode: str, outputs):
    """A square that shines with these outputs of an image of which half is clear, as colour and strength."""
    image = bpy.data.images.new("Half", 8, 4, alpha=True)
    pixels = np.zeros((4, 8, 4), np.float32)
    pixels[:, :4] = (1.0, 0.5, 0.25, 1.0)
    image.pixels.foreach_set(pixels.ravel())
    image.alpha_mode = alpha_mode
    image.pack()
    material, emission = new_material("M", "ShaderNodeEmission", Color=(1, 1, 1, 1), Strength=1)
    texture = material.node_tree.nodes.new("ShaderNodeTexImage")
    texture.image, texture.interpolation = image, "Closest"
    for output in outputs:
        into = "Strength" if output == "Alpha" else "Color"
        material.node_tree.links.new(texture.outputs[output], emission.inputs[into])
    mesh = plane_mesh(0.5)
    mesh.uv_layers.new().data.foreach_set("uv", (0, 0, 1, 0, 1, 1, 0, 1))
    mesh.materials.append(material)
    add_object("Plane", mesh)
    add_camera(type="ORTHO", ortho_scale=1)
    return export_scene(depsgraph())


@pytest.mark.parametrize("alpha_mode", ["STRAIGHT", "PREMUL", "CHANNEL_PACKED", "NONE"])
@pytest.mark.parametrize("outputs", [("Color",), ("Color", "Alpha"), ("Alpha",)])
def test_alpha_counts_as_in_cycles(alpha_mode, outputs, tmp_path):
    """Its average over the picture. Cycles leaves a colour multiplied with an alpha that nobody asks for."""
    scene = see_through(alpha_mode, outputs)
    expected = cycles_picture(16, 16, 1, tmp_path).mean(axis=(0, 1))
    darkened = outputs == ("Color",) and alpha_mode in ("STRAIGHT", "PREMUL")
    if "Color" not in outputs or alpha_mode in ("STRAIGHT", "PREMUL"):  # Else what is clear counts in Cycles' average.
        assert scene.materials[1].emission == pytest.approx(list(expected), abs=2e-3)
    assert scene.warnings == [f"material 'M': image 'Half' {AVERAGE}"] + darkened * [
        "material 'M': image 'Half' has alpha that is not linked: its colour is drawn times its average alpha"
    ]


@pytest.mark.parametrize("tile", [0, 16])
@pytest.mark.parametrize(
    ("suffix", "kind", "channels"), [("exr", "float", 4), ("tif", "uint8", 3), ("tif", "uint8", 4)]
)
def test_an_average_is_read_in_strips_and_takes_little_memory(suffix, kind, channels, tile, tmp_path, monkeypatch):
    """Of rows of 70 pixels, in strips of 16, where none could be had for the whole; also of what begins elsewhere."""
    import OpenImageIO as oiio

    path = str(tmp_path / f"wall.{suffix}")
    spec = oiio.ImageSpec(70, 50, channels, kind)
    spec.attribute("oiio:UnassociatedAlpha", int(suffix != "exr"))
    spec.tile_width = spec.tile_height = tile
    if suffix == "exr":
        spec.x, spec.y = 5, -7
    file = oiio.ImageOutput.create(path)
    assert file.open(path, spec)
    random = np.random.default_rng(2).random((50, 70, channels), np.float32)
    file.write_image(random * np.linspace(0, 1, 50, dtype=np.float32)[:, None, None])  # no strip is like another
    file.close()
    material, diffuse = new_material("M", "ShaderNodeBsdfDiffuse")
    texture = material.node_tree.nodes.new("ShaderNodeTexImage")
    texture.image = bpy.data.images.load(path)
    texture.image.colorspace_settings.name = "Linear Rec.709" if suffix == "exr" else "sRGB"
    material.node_tree.links.new(texture.outputs["Color"], diffuse.inputs["Color"])
    whole = images.read_file(path)
    linear = whole.color if suffix == "exr" else units.srgb_to_linear(whole.color / np.float32(255))
    expected = linear.mean(axis=(0, 1)) if channels == 3 else (linear * whole.alpha[..., None]).mean(axis=(0, 1))

    monkeypatch.setattr(images, "STRIP", 70 * 20)
    little_memory.leave(monkeypatch, memory, 0.0)
    strips = list(images.file_strips(path))
    assert [len(strip.color) for strip in strips] == ([16, 16, 16, 2] if tile else [20, 20, 10])
    assert np.array_equal(np.concatenate([strip.color for strip in reversed(strips)]), whole.color)
    result, warnings = exported(material)
    assert result.kd == pytest.approx(expected, rel=1e-5)
    assert warnings[0] == f"material 'M': image 'wall.{suffix}' {AVERAGE}"


@pytest.mark.parametrize("is_float", [False, True])
def test_an_average_of_what_blender_has_is_taken_in_strips(is_float, monkeypatch):
    image = bpy.data.images.new("Wall", 70, 50, float_buffer=is_float)
    pixels = np.random.default_rng(2).random((50, 70, 4), np.float32)
    pixels[..., 3] = 1.0
    image.pixels.foreach_set((pixels * np.linspace(0.1, 1, 50, dtype=np.float32)[:, None, None]).ravel())
    image.pack()
    material, diffuse = new_material("M", "ShaderNodeBsdfDiffuse")
    texture = material.node_tree.nodes.new("ShaderNodeTexImage")
    texture.image = image
    material.node_tree.links.new(texture.outputs["Color"], diffuse.inputs["Color"])
    expected, _ = exported(material)
    monkeypatch.setattr(images, "STRIP", 70 * 20)
    assert [len(strip.color) for strip in images.datablock_strips(image)] == [20, 20, 10]
    little_memory.leave(monkeypatch, memory, 70.0 * 50 * 16)
    assert exported(material)[0].kd == pytest.approx(expected.kd, rel=1e-9)

    little_memory.leave(monkeypatch, memory, 70.0 * 50 * 16 - 1)
    result, warnings = exported(material)
    assert result.kd == (1.0, 0.0, 1.0)
    too_large = "needs more memory than can be had (as a file of its own it would need little)"
    assert warnings == [f"material 'M': image 'Wall' {too_large}, drawn magenta"]


def test_missing_images_are_magenta_and_named():
    image = bpy.data.images.new("lost.png", 4, 2)
    image.source, image.filepath = "FILE", "//lost.png"
    material, diffuse = new_material("M", "ShaderNodeBsdfDiffuse")
    texture = material.node_tree.nodes.new("ShaderNodeTexImage")
    texture.image = image
    material.node_tree.links.new(texture.outputs["Color"], diffuse.inputs["Color"])
    result, warnings = exported(material)
    assert result.kd == pytest.approx((1, 0, 1))
    assert warnings == ["material 'M': image 'lost.png' is missing, drawn magenta"]


def test_what_cannot_be_folded_counts_as_unplugged():
    material, diffuse = new_material("M", "ShaderNodeBsdfDiffuse", Color=(0.3, 0.4, 0.5, 1))
    noise = material.node_tree.nodes.new("ShaderNodeTexNoise")
    material.node_tree.links.new(noise.outputs["Color"], diffuse.inputs["Color"])
    material.node_tree.links.new(noise.outputs[0], diffuse.inputs["Roughness"])
    result, warnings = exported(material)
    assert result.kd == pytest.approx((0.3, 0.4, 0.5))
    assert warnings == ["material 'M': Noise Texture is not supported and counts as unplugged"]


def test_a_colour_counts_for_what_an_unknown_node_makes_of_it():
    material, diffuse = new_material("M", "ShaderNodeBsdfDiffuse", Color=(0.3, 0.4, 0.5, 1))
    tree = material.node_tree
    rgb, occlusion = tree.nodes.new("ShaderNodeRGB"), tree.nodes.new("ShaderNodeAmbientOcclusion")
    rgb.outputs[0].default_value = (0.1, 0.7, 0.2, 1)
    tree.links.new(rgb.outputs[0], occlusion.inputs["Color"])
    tree.links.new(occlusion.outputs["Color"], diffuse.inputs["Color"])
    result, warnings = exported(material)
    assert result.kd == pytest.approx((0.1, 0.7, 0.2))
    assert warnings == ["material 'M': Ambient Occlusion is not supported, its input 'Color' counts as it is"]
    tree.links.new(occlusion.outputs["AO"], diffuse.inputs["Roughness"])
    assert len(exported(material)[1]) == 2


ORANGE = (0.8, 0.3, 0.1, 1)

# Node, its properties, the values of its inputs in order (None: leave it), and the index of its output.
VALUES = [
    ("ShaderNodeRGB", {}, [], 0),
    ("ShaderNodeValue", {}, [], 0),
    *(("ShaderNodeBlackbody", {}, [t], 0) for t in (400, 900, 1500, 2200, 3000, 5000, 6500, 9000, 20000)),
    *(("ShaderNodeMath", {"operation": name}, [0.7, 0.4, 0.3], 0) for name in MATH),
    *(("ShaderNodeMath", {"operation": name}, [-2.3, 1.7, 0.2], 0) for name in MATH),
    *(("ShaderNodeMath", {"operation": name}, [0.0, 0.0, 0.0], 0) for name in MATH),
    *(("ShaderNodeWavelength", {}, [t], 0) for t in (370, 400, 452.5, 500, 550, 600, 700, 790)),
    ("ShaderNodeMath", {"operation": "MULTIPLY", "use_clamp": True}, [2.0, 3.0], 0),
    *(
        ("ShaderNodeVectorMath", {"operation": name}, [(0.7, -0.4, 0.3), (0.2, 0.9, 0.5), (0.1, 0.6, -0.2), 0.7], out)
        for name in VECTOR_MATH
        for out in (0, 1)
        if (name in ("DOT_PRODUCT", "DISTANCE", "LENGTH")) == (out == 1)
    ),
    *(
        ("ShaderNodeMixRGB", {"blend_type": name}, [0.6, first, second], 0)
        for name in BLEND
        for first, second in ((ORANGE, (0.2, 0.5, 0.9, 1)), ((0.0, 0.5, 1.0, 1), (0.0, 0.0, 0.0, 1)))
    ),
    *(
        ("ShaderNodeMix", {"data_type": "RGBA", "blend_type": name}, {0: 0.6, 6: ORANGE, 7: (0.2, 0.5, 0.9, 1)}, 2)
        for name in BLEND
    ),
    ("ShaderNodeMix", {"data_type": "RGBA", "clamp_factor": False}, {0: 1.6, 6: ORANGE, 7: (0.9, 0.5, 0.9, 1)}, 2),
    ("ShaderNodeMix", {"data_type": "FLOAT"}, {0: 0.3, 2: 0.1, 3: 0.9}, 0),
    ("ShaderNodeMix", {"data_type": "VECTOR"}, {0: 0.3, 4: (0.1, 0.2, 0.3), 5: (0.9, 0.8, 0.1)}, 1),
    (
        "ShaderNodeMix",
        {"data_type": "VECTOR", "factor_mode": "NON_UNIFORM"},
        {1: (0.3, 0.1, 0.9), 4: (0.1, 0.2, 0.3), 5: (0.9, 0.8, 0.1)},
        1,
    ),
    ("ShaderNodeGamma", {}, [ORANGE, 2.2], 0),
    ("ShaderNodeBrightContrast", {}, [ORANGE, 0.2, 0.4], 0),
    ("ShaderNodeHueSaturation", {}, [0.7, 0.5, 1.4, 0.8, ORANGE], 0),
    ("ShaderNodeInvert", {}, [0.7, ORANGE], 0),
    *(("ShaderNodeCombineColor", {"mode": mode}, [0.7, 0.4, 0.6], 0) for mode in ("RGB", "HSV", "HSL")),
    *(("ShaderNodeSeparateColor", {"mode": mode}, [ORANGE], out) for mode in ("RGB", "HSV", "HSL") for out in range(3)),
    ("ShaderNodeCombineXYZ", {}, [0.1, 0.2, 0.3], 0),
    *(("ShaderNodeSeparateXYZ", {}, [(0.1, 0.2, 0.3)], out) for out in range(3)),
    ("ShaderNodeRGBToBW", {}, [ORANGE], 0),
    *(("ShaderNodeClamp", {"clamp_type": kind}, [0.9, 0.7, 0.2], 0) for kind in ("MINMAX", "RANGE")),
    *(
        ("ShaderNodeMapRange", {"interpolation_type": kind, "clamp": clamp}, [value, 0.2, 0.8, 0.1, 0.5, 3.0], 0)
        for kind in ("LINEAR", "STEPPED", "SMOOTHSTEP", "SMOOTHERSTEP")
        for clamp in (True, False)
        for value in (0.1, 0.55, 0.9)
    ),
    (
        "ShaderNodeMapRange",
        {"data_type": "FLOAT_VECTOR"},
        {6: (0.3, 0.5, 0.9), 7: (0, 0, 0), 8: (1, 1, 1), 9: (0.1, 0.2, 0.3), 10: (0.9, 0.8, 0.1)},
        1,
    ),
    *(("ShaderNodeValToRGB", {}, [value], out) for value in (0.0, 0.3, 1.0) for out in (0, 1)),
    *(
        (kind, {"label": beyond}, inputs, 0)
        for beyond in ("HORIZONTAL", "EXTRAPOLATED")
        for kind, inputs in (
            ("ShaderNodeRGBCurve", [1.0, ORANGE]),
            ("ShaderNodeRGBCurve", [0.3, ORANGE]),
            ("ShaderNodeRGBCurve", [1.0, (-0.4, 1.7, 2.5, 1)]),
            ("ShaderNodeRGBCurve", [0.5, (9.0, 20.0, 50.0, 1)]),
            ("ShaderNodeVectorCurve", [1.0, (0.3, 0.8, -0.6)]),
            ("ShaderNodeVectorCurve", [0.4, (-1.5, 2.5, 1.5)]),
            *(("ShaderNodeFloatCurve", [share, value]) for share, value in ((1.0, 0.3), (0.6, 0.3), (1.0, 1.8))),
        )
    ),
    *(
        (
            "ShaderNodeVectorRotate",
            {"rotation_type": kind, "invert": invert},
            [(0.7, 0.4, 0.3), (0.1, 0.2, -0.4), (1.0, 0.5, -2.0), 0.8, (0.4, -0.2, 1.1)],
            0,
        )
        for kind in ("AXIS_ANGLE", "X_AXIS", "Y_AXIS", "Z_AXIS", "EULER_XYZ")
        for invert in (False, True)
    ),
    ("ShaderNodeVectorRotate", {}, [(0.7, 0.4, 0.3), (0.1, 0.2, 0.0), (0.0, 0.0, 0.0), 0.8], 0),
]


def is_known(case) -> bool:
    """Whether this Blender has such a node and such a choice: newer ones have more."""
    node = getattr(bpy.types, case[0], None)
    properties = {key: node.bl_rna.properties.get(key) for key in case[1]} if node else {}
    enums = {key: prop.enum_items for key, prop in properties.items() if prop and prop.type == "ENUM"}
    return node is not None and None not in properties.values() and all(case[1][k] in enums[k] for k in enums)


def value_material(name: str, case):
    """An emitter of what a value node gives."""
    bl_idname, properties, inputs, out = case
    material, emission = new_material(name, "ShaderNodeEmission")
    node = material.node_tree.nodes.new(bl_idname)
    for key, value in properties.items():
        setattr(node, key, value)
    if bl_idname == "ShaderNodeRGB":
        node.outputs[0].default_value = (0.2, 0.4, 0.6, 1)
    elif bl_idname == "ShaderNodeValue":
        node.outputs[0].default_value = 0.7
    elif bl_idname == "ShaderNodeValToRGB":
        node.color_ramp.elements[0].color, node.color_ramp.elements[1].color = (0.9, 0.1, 0.2, 0.5), (0.1, 0.6, 0.8, 1)
    elif hasattr(node, "mapping"):
        node.mapping.extend = node.label
        for i, curve in enumerate(node.mapping.curves):
            curve.points.new(0.4, 0.5 + 0.1 * i)
            curve.points[-1].location = 1.2, 0.9
    for i, value in inputs.items() if isinstance(inputs, dict) else enumerate(inputs):
        node.inputs[i].default_value = value
    material.node_tree.links.new(node.outputs[out], emission.inputs["Color"])
    return material


def test_value_nodes_fold_as_in_cycles(tmp_path):
    """Each case lights one square of a row; Cycles draws them all in one picture."""
    cases = [case for case in VALUES if is_known(case)]
    count = len(cases)
    assert count == len(VALUES) or bpy.app.version < (5, 0)
    for i, case in enumerate(cases):
        tile = plane_mesh(0.5, f"Tile {i}")
        tile.materials.append(value_material(f"Case {i:03}", case))
        add_object("Tile", tile, (i + 0.5 - count / 2, 0, 0))
    add_camera(type="ORTHO", ortho_scale=count)
    scene = export_scene(depsgraph())
    ours = {m.name: m.emission for m in scene.materials}
    picture = cycles_picture(count, 5, 1, tmp_path)[2]  # Blender allows no fewer rows than four.
    wrong = []
    for i, case in enumerate(cases):
        if not np.allclose(np.maximum(ours[f"Case {i:03}"], 0), np.maximum(picture[i], 0), atol=2e-3, rtol=1e-3):
            wrong.append(f"{case}: {np.round(ours[f'Case {i:03}'], 4)}, Cycles {np.round(picture[i], 4)}")
    assert not wrong, "\n".join(wrong)
    assert scene.warnings == []


@pytest.mark.parametrize(
    ("kind", "expected"),
    [("POINT", (1.5, 2.75, 3.5)), ("TEXTURE", (0.75, 0.25, 0.5)), ("VECTOR", (0.5, 0.75, 0.5))],
)
def test_mapped_coordinates_count_with_the_middle(kind: str, expected) -> None:
    """Scaled and mirrored, turned a quarter about z, moved."""
    material, emission = new_material("M", "ShaderNodeEmission", Strength=1)
    tree = material.node_tree
    place, mapping = tree.nodes.new("ShaderNodeTexCoord"), tree.nodes.new("ShaderNodeMapping")
    mapping.vector_type = kind
    if kind == "POINT":
        mapping.inputs["Location"].default_value = (1, 2, 3)
    mapping.inputs["Rotation"].default_value = (0, 0, np.pi / 2)
    mapping.inputs["Scale"].default_value = (2 / 3, -2, 1) if kind == "TEXTURE" else (1.5, -1, 1)
    tree.links.new(place.outputs["Object"], mapping.inputs["Vector"])
    tree.links.new(mapping.outputs[0], emission.inputs["Color"])
    result, warnings = exported(material)
    assert result.emission == pytest.approx(expected)
    assert warnings == ["material 'M': Texture Coordinate is not supported and counts with its middle"]
