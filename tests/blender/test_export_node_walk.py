"""What a socket is fed by: through muted nodes, reroutes and groups as in Cycles, along chains of any length."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from bl_ext.user_default.lobe.addon.export import export_scene
from bl_ext.user_default.lobe.addon.export.images import Images
from bl_ext.user_default.lobe.addon.export.materials import MaterialTable
from bl_ext.user_default.lobe.addon.export.materials.memo import Memo
from bl_ext.user_default.lobe.addon.export.notes import Notes
from bl_ext.user_default.lobe.addon.export.stop import ExportStopped, Stop

from tests.blender.export_checks import (
    add_camera,
    add_object,
    cycles_picture,
    depsgraph,
    new_material,
    node_tree,
    plane_mesh,
)
from tools.cycles_peer import phong_groups

OWN = (0.5, 0.1, 0.3, 1)  # what the emitter's own socket holds
COLOR = (0.2, 0.7, 0.4, 1)  # what is linked
GREY = (0.9, 0.3, 0.6, 1)  # what a muted node's input holds
TINT = (0.8, 0.6, 0.2, 1)  # what a group's input holds
OUT = (0.3, 0.9, 0.2, 1)  # what the input of a Group Output holds


def emitter(tree, feed=None, into: str = "Color"):
    """An Emission whose input `into` is linked from a node or an output."""
    node = tree.nodes.new("ShaderNodeEmission")
    node.inputs["Color"].default_value, node.inputs["Strength"].default_value = OWN, 0.7
    if feed is not None:
        link(tree, feed, node.inputs[into])
    return node


def link(tree, feed, socket):
    return tree.links.new(getattr(feed, "outputs", [feed])[0], socket)


def new_node(tree, kind: str, feed=None, mute: bool = False, into: int = 0, **properties):
    """A node with its first inputs or outputs set to what tells the cases apart, and one input linked."""
    node = tree.nodes.new(kind)
    node.mute = mute
    for key, value in properties.items():
        setattr(node, key, value)
    if kind == "ShaderNodeRGB":
        node.outputs[0].default_value = COLOR
    elif kind == "ShaderNodeValue":
        node.outputs[0].default_value = 1.7
    elif kind == "ShaderNodeGamma":
        node.inputs[0].default_value, node.inputs[1].default_value = GREY, 2.0
    elif kind == "ShaderNodeVectorMath":
        node.inputs[0].default_value = (0.5, 0.2, 0.6)
    elif kind == "ShaderNodeMix":
        node.inputs[6].default_value = node.inputs[7].default_value = GREY
    if feed is not None:
        link(tree, feed, node.inputs[into])
    return node


def rgb(tree, **more):
    return new_node(tree, "ShaderNodeRGB", **more)


def gamma(tree, feed=None, **more):
    return new_node(tree, "ShaderNodeGamma", feed, **more)


def reroute(tree, feed=None):
    return new_node(tree, "NodeReroute", feed)


def muted_mix(tree, feed=None, into: int = 0):
    return new_node(tree, "ShaderNodeMix", feed, True, into, data_type="RGBA").outputs[2]


def vector(tree):
    return new_node(tree, "ShaderNodeVectorMath")


def shader_mix(tree, first, second, factor=None, mute: bool = False):
    node = new_node(tree, "ShaderNodeMixShader", factor, mute)
    node.inputs[0].default_value = 0.3
    for feed, socket in ((first, node.inputs[1]), (second, node.inputs[2])):
        if feed is not None:
            link(tree, feed, socket)
    return node


def muted_link(tree, feed, node):
    link(tree, feed, node.inputs[0]).is_muted = True
    return node


def group(tree, fill, into: str = "Color", out: str = "Color", feed=None):
    """A node of a new group with one input and one output; `fill` gives what feeds the output, from its tree and its
    Group Input."""
    made = bpy.data.node_groups.new("Group", "ShaderNodeTree")
    socket = made.interface.new_socket("In", in_out="INPUT", socket_type=f"NodeSocket{into}")
    if into == "Color":
        socket.default_value = TINT
    elif into == "Vector":
        socket.default_value = TINT[:3]
    made.interface.new_socket("Out", in_out="OUTPUT", socket_type=f"NodeSocket{out}")
    inside, outside = made.nodes.new("NodeGroupInput"), made.nodes.new("NodeGroupOutput")
    if out == "Color":
        outside.inputs[0].default_value = OUT
    inner = fill(made, inside)
    if inner is not None:
        link(made, inner, outside.inputs[0])
    node = tree.nodes.new("ShaderNodeGroup")
    node.node_tree = made
    if feed is not None:
        link(tree, feed, node.inputs[0])
    return node


def lit(into: str = "Color", socket: str = "Color", between=None):
    """A `group` that is an emitter, whose colour or strength is the group's input."""

    def build(tree, feed=None):
        def fill(inner, inside):
            return emitter(inner, between(inner, inside) if between else inside, socket)

        return group(tree, fill, into, "Shader", feed)

    return build


def no_output(tree):
    node = group(tree, lambda t, i: None)
    node.node_tree.nodes.remove(node.node_tree.nodes["Group Output"])
    return node


# What is plugged into Surface, made from the material's tree.
FEEDS = {
    "muted constants": {
        "colour": lambda t: emitter(t, rgb(t, mute=True)),
        "strength": lambda t: emitter(t, new_node(t, "ShaderNodeValue", mute=True), "Strength"),
        "blackbody": lambda t: emitter(t, new_node(t, "ShaderNodeBlackbody", mute=True)),
        "mix factor": lambda t: shader_mix(t, emitter(t), None, new_node(t, "ShaderNodeValue", mute=True)),
        "through a reroute": lambda t: emitter(t, reroute(t, rgb(t, mute=True))),
        "shader": lambda t: muted_emitter(t),
    },
    "muted nodes": {
        "own colour": lambda t: emitter(t, gamma(t, mute=True)),
        "linked": lambda t: emitter(t, gamma(t, rgb(t), mute=True)),
        "of a muted node": lambda t: emitter(t, gamma(t, rgb(t, mute=True), mute=True)),
        "before one that computes": lambda t: emitter(t, gamma(t, gamma(t, mute=True))),
        "mix of nothing": lambda t: emitter(t, muted_mix(t)),
        "mix, its factor linked": lambda t: emitter(t, muted_mix(t, rgb(t), 0)),
        "mix, A linked": lambda t: emitter(t, muted_mix(t, rgb(t), 6)),
        "mix, B linked": lambda t: emitter(t, muted_mix(t, rgb(t), 7)),
        "number of a colour": lambda t: emitter(t, new_node(t, "ShaderNodeMath", rgb(t), True)),
        "shader mix, second linked": lambda t: shader_mix(t, None, emitter(t), mute=True),
        "shader mix of a colour": lambda t: shader_mix(t, None, rgb(t), mute=True),
        "shader sum of nothing": lambda t: new_node(t, "ShaderNodeAddShader", mute=True),
    },
    "reroutes and links": {
        "dangling reroute": lambda t: emitter(t, reroute(t)),
        "dangling reroute, strength": lambda t: emitter(t, reroute(t), "Strength"),
        "dangling reroute, mix factor": lambda t: shader_mix(t, emitter(t), None, reroute(t)),
        "dangling reroute, muted node": lambda t: emitter(t, gamma(t, reroute(t), mute=True)),
        "dangling reroute, surface": reroute,
        "muted link": lambda t: muted_link(t, rgb(t), emitter(t)),
        "muted link before a reroute": lambda t: emitter(t, muted_link(t, rgb(t), reroute(t))),
        "muted link before a node": lambda t: emitter(t, muted_link(t, rgb(t), gamma(t))),
    },
    "group inputs": {
        "unlinked": lit(),
        "linked": lambda t: lit()(t, rgb(t)),
        "muted colour": lambda t: lit()(t, rgb(t, mute=True)),
        "muted node": lambda t: lit()(t, gamma(t, mute=True)),
        "dangling reroute": lambda t: lit()(t, reroute(t)),
        "muted node inside": lit(between=lambda t, i: gamma(t, i, mute=True)),
        "muted inside and outside": lambda t: lit(between=lambda t, i: gamma(t, i, mute=True))(t, rgb(t, mute=True)),
        "reroute inside": lit(between=reroute),
        "dangling reroute inside": lit(between=lambda t, i: reroute(t)),
        "group in a group": lambda t: group(t, lambda t, i: lit()(t, i), out="Shader", feed=rgb(t)),
    },
    "group outputs": {
        "unlinked": lambda t: emitter(t, group(t, lambda t, i: None)),
        "linked": lambda t: emitter(t, group(t, lambda t, i: rgb(t))),
        "muted colour": lambda t: emitter(t, group(t, lambda t, i: rgb(t, mute=True))),
        "dangling reroute": lambda t: emitter(t, group(t, lambda t, i: reroute(t))),
        "its own input": lambda t: emitter(t, group(t, lambda t, i: i)),
        "its own input, muted colour": lambda t: emitter(t, group(t, lambda t, i: i, feed=rgb(t, mute=True))),
        "muted group": lambda t: emitter(t, muted(group(t, lambda t, i: rgb(t)))),
        "muted group, linked": lambda t: emitter(t, muted(group(t, lambda t, i: None, feed=rgb(t)))),
        "no output": lambda t: emitter(t, no_output(t)),
    },
    "types of a group's sockets": {
        "colour to number": lambda t: lit("Float")(t, rgb(t)),
        "colour to number, out": lambda t: emitter(t, group(t, lambda t, i: rgb(t), out="Float")),
        "colour to vector to number": lambda t: lit("Vector", "Strength")(t, rgb(t)),
        "vector to number": lambda t: lit("Float")(t, vector(t)),
        "vector to colour to number": lambda t: lit("Color", "Strength")(t, vector(t)),
        "own vector to number": lit("Vector", "Strength"),
        "number to whole number": lambda t: lit("Int", "Strength")(t, new_node(t, "ShaderNodeValue")),
        "number to yes or no": lambda t: lit("Bool", "Strength")(t, new_node(t, "ShaderNodeValue")),
    },
    "no shader": {
        "colour": rgb,
        "number": lambda t: new_node(t, "ShaderNodeValue"),
        "vector": vector,
        "computed": gamma,
        "through a reroute": lambda t: reroute(t, rgb(t)),
        "through a muted node": lambda t: gamma(t, rgb(t), mute=True),
        "muted": lambda t: rgb(t, mute=True),
        "muted node": lambda t: gamma(t, mute=True),
        "mixed": lambda t: shader_mix(t, emitter(t), rgb(t)),
        "number, mixed": lambda t: shader_mix(t, new_node(t, "ShaderNodeValue"), emitter(t)),
        "added": lambda t: new_node(t, "ShaderNodeAddShader", rgb(t)),
        "from a group": lambda t: group(t, lambda t, i: rgb(t)),
        "from a group, unlinked": lambda t: group(t, lambda t, i: None),
        "from a group's shader output": lambda t: group(t, lambda t, i: i, out="Shader"),
        "through a group's shader input": lambda t: group(t, lambda t, i: i, "Shader", "Shader", rgb(t)),
    },
}


def muted(node):
    node.mute = True
    return node


def muted_emitter(tree):
    return muted(emitter(tree))


@pytest.mark.parametrize("kind", FEEDS)
def test_feeds_are_as_in_cycles(kind: str, tmp_path) -> None:
    """Each case lights one square of a row; Cycles draws them all in one picture."""
    cases = FEEDS[kind]
    for i, build in enumerate(cases.values()):
        material = bpy.data.materials.new(f"Case {i:02}")
        tree = node_tree(material)
        tree.nodes.clear()
        link(tree, build(tree), tree.nodes.new("ShaderNodeOutputMaterial").inputs["Surface"])
        tile = plane_mesh(0.5)
        tile.materials.append(material)
        add_object("Tile", tile, (i + 0.5 - len(cases) / 2, 0, 0))
    add_camera(type="ORTHO", ortho_scale=len(cases))
    scene = export_scene(depsgraph())
    ours = {m.name: m.emission for m in scene.materials}
    picture = cycles_picture(len(cases), 5, 1, tmp_path)[2]
    wrong = [
        f"{name}: {np.round(ours[f'Case {i:02}'], 4)}, Cycles {np.round(picture[i], 4)}"
        for i, name in enumerate(cases)
        if not np.allclose(ours[f"Case {i:02}"], picture[i], atol=1e-4)
    ]
    assert not wrong, "\n".join(wrong)
    assert all("has no output" in warning for warning in scene.warnings)


@pytest.mark.skipif(bpy.app.version < (5, 0), reason="a muted node gives zero there, as in its Cycles")
def test_a_muted_blackbody_leaves_a_lamp_its_colour() -> None:
    lamp = bpy.data.lights.new("Sun", "SUN")
    lamp.energy = 2.0
    tree = node_tree(lamp)
    emission = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeEmission")
    emission.inputs["Color"].default_value = OWN
    link(tree, new_node(tree, "ShaderNodeBlackbody", mute=True), emission.inputs["Color"])
    add_object("Sun", lamp)
    add_camera()
    assert export_scene(depsgraph()).lights[0].irradiance == pytest.approx((1.0, 0.2, 0.6))


def exported(material):
    """The engine's material and the warnings for one Blender material."""
    notes = Notes()
    table = MaterialTable(notes, Images(notes, Stop()))
    return table.materials[table.index(material)], notes.warnings


def chain(bl_idname: str, count: int, feeds: tuple[int, ...], start):
    """A material that ends in `count` nodes of a kind, each feeding these inputs of the next; gives back it and them.

    start  makes the first feed from the material's tree
    """
    material = bpy.data.materials.new("M")
    tree = node_tree(material)
    tree.nodes.clear()
    output, last, nodes = tree.nodes.new("ShaderNodeOutputMaterial"), start(tree), []
    for _ in range(count):
        nodes.append(tree.nodes.new(bl_idname))
        for i in feeds:
            tree.links.new(last.outputs[0], nodes[-1].inputs[i])
        last = nodes[-1]
    tree.links.new(last.outputs[0], output.inputs["Surface"])
    return material, nodes


def test_long_chains_of_shaders() -> None:
    material, _ = chain("ShaderNodeAddShader", 250, (0,), emitter)
    result, warnings = exported(material)
    assert result.emission == pytest.approx((0.35, 0.07, 0.21)) and warnings == []


def test_long_chains_of_values() -> None:
    material, nodes = chain("ShaderNodeMath", 400, (0,), lambda t: new_node(t, "ShaderNodeValue"))
    for node in nodes:
        node.inputs[1].default_value = 0.01
    result, warnings = exported(material)
    assert result.emission == pytest.approx((5.7, 5.7, 5.7)) and warnings == []


def test_shaders_mixed_with_themselves() -> None:
    """Twice as many ways with every node: 2^60 of them."""

    def glossy(tree):
        node = tree.nodes.new("ShaderNodeBsdfAnisotropic")
        node.inputs["Color"].default_value = COLOR
        return node

    material, _ = chain("ShaderNodeMixShader", 60, (1, 2), glossy)
    assert exported(material)[0].ks == pytest.approx(COLOR[:3])


def test_cancelling_is_asked_for() -> None:
    material, _ = chain("ShaderNodeMixShader", 60, (1, 2), emitter)
    notes, asked = Notes(), []
    stop = Stop(lambda: len(asked) > 30 or asked.append(1))
    with pytest.raises(ExportStopped):
        MaterialTable(notes, Images(notes, stop), stop=stop).index(material)


def test_memo_counts_a_cycle_as_unknown_and_forgets_what_failed() -> None:
    memo = Memo(-1, lambda: None)

    def ring(i: int) -> int:
        return memo.get(i % 100, lambda: 1 + ring(i + 1))

    assert ring(0) == 99  # a hundred steps, of which the last finds the first: -1 + 100
    calls = []

    def fails(i: int):
        calls.append(i)
        if i == 50:
            raise ValueError
        return memo.get(("f", i), lambda: fails(i + 1))

    for _ in range(2):
        with pytest.raises(ValueError):
            fails(0)
    assert calls.count(50) == 2


def phong_named(inputs):
    """A material of a group that is only named as Lobe's own, with a Diffuse BSDF inside."""
    made = bpy.data.node_groups.new("Phong BSDF", "ShaderNodeTree")
    for name, kind in inputs:
        made.interface.new_socket(name, in_out="INPUT", socket_type=f"NodeSocket{kind}")
    made.interface.new_socket("BSDF", in_out="OUTPUT", socket_type="NodeSocketShader")
    inside, outside = made.nodes.new("NodeGroupInput"), made.nodes.new("NodeGroupOutput")
    diffuse = made.nodes.new("ShaderNodeBsdfDiffuse")
    made.links.new(inside.outputs[0], diffuse.inputs["Color"])
    made.links.new(diffuse.outputs[0], outside.inputs[0])
    material, node = new_material("M", "ShaderNodeGroup")
    node.node_tree = made
    node.inputs[0].default_value = COLOR
    tree = material.node_tree
    link(tree, node, next(n for n in tree.nodes if n.bl_idname == "ShaderNodeOutputMaterial").inputs["Surface"])
    return material


def test_somebody_elses_phong_group_is_looked_into() -> None:
    result, warnings = exported(phong_named([("Color", "Color")]))
    assert result.kd == pytest.approx(COLOR[:3]) and result.ks == (0, 0, 0) and warnings == []
    assert not phong_groups()


def test_a_phong_group_without_its_mark_is_known_by_its_inputs() -> None:
    material = phong_named([("kd", "Color"), ("ks", "Color"), ("exponent", "Float")])
    group_node = next(node for node in material.node_tree.nodes if node.bl_idname == "ShaderNodeGroup")
    group_node.inputs["exponent"].default_value, group_node.inputs["ks"].default_value = 7.0, COLOR
    assert exported(material)[0].exponent == 7.0
    assert len(phong_groups()) == 1


def test_an_output_for_eevee_alone_is_drawn_and_named() -> None:
    material, _ = new_material("M", "ShaderNodeBsdfDiffuse", Color=COLOR)
    next(n for n in material.node_tree.nodes if n.bl_idname == "ShaderNodeOutputMaterial").target = "EEVEE"
    result, warnings = exported(material)
    assert result.kd == pytest.approx(COLOR[:3])
    assert warnings == ["material 'M': its output is for EEVEE only: drawn here, black in Cycles"]
