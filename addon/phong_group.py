"""The `Phong BSDF` node group: kd, ks and exponent exactly, for Lobe, and the nearest thing to it in other engines.

The exporter reads the group node's inputs and never looks inside. What stands inside is for Cycles and EEVEE:
a Diffuse and a Glossy BSDF, the roughness made from the exponent by n = 2 / roughness^4 - 2 (docs/materials.md).
"""

from __future__ import annotations

import bpy

from .phong_mark import PHONG_GROUP_NAME, PHONG_MARK, is_phong_tree


def phong_group() -> bpy.types.NodeTree:
    """The file's Phong group, made on first use. A library's copy is left alone: its owner may change it."""
    for tree in bpy.data.node_groups:
        if is_phong_tree(tree) and tree.library is None:
            return tree
    return _make_group()


def _make_group() -> bpy.types.NodeTree:
    tree = bpy.data.node_groups.new(PHONG_GROUP_NAME, "ShaderNodeTree")
    tree[PHONG_MARK] = 1
    _make_sockets(tree.interface)

    def node(kind: str, x: float, y: float, **values) -> bpy.types.Node:
        made = tree.nodes.new(kind)
        made.location = (x, y)
        for key, value in values.items():
            setattr(made, key, value)
        return made

    inside = node("NodeGroupInput", -800, 0)
    diffuse = node("ShaderNodeBsdfDiffuse", 0, 150)
    # Of Cycles' distributions Beckmann has the tail that is nearest to a power of the cosine.
    glossy = node("ShaderNodeBsdfAnisotropic", 0, -50, distribution="BECKMANN")
    plus_two = node("ShaderNodeMath", -600, -150, operation="ADD")
    over = node("ShaderNodeMath", -400, -150, operation="DIVIDE")
    root = node("ShaderNodeMath", -200, -150, operation="POWER")
    both = node("ShaderNodeAddShader", 250, 50)
    outside = node("NodeGroupOutput", 450, 50)

    plus_two.inputs[1].default_value = 2.0
    over.inputs[0].default_value = 2.0
    root.inputs[1].default_value = 0.25
    for source, target in (
        (inside.outputs["kd"], diffuse.inputs["Color"]),
        (inside.outputs["ks"], glossy.inputs["Color"]),
        (inside.outputs["exponent"], plus_two.inputs[0]),
        (plus_two.outputs[0], over.inputs[1]),
        (over.outputs[0], root.inputs[0]),
        (root.outputs[0], glossy.inputs["Roughness"]),
        (diffuse.outputs[0], both.inputs[0]),
        (glossy.outputs[0], both.inputs[1]),
        (both.outputs[0], outside.inputs["BSDF"]),
    ):
        tree.links.new(source, target)
    return tree


def _make_sockets(interface: bpy.types.NodeTreeInterface) -> None:
    interface.new_socket("BSDF", in_out="OUTPUT", socket_type="NodeSocketShader")
    for name, level, text in (
        (
            "kd",
            0.5,
            "Diffuse reflectance, 0 to 1. Energy is conserved while kd + ks stays at or below 1. Costs no time",
        ),
        (
            "ks",
            0.3,
            "Reflectance of the Phong lobe, 0 to 1. Above 0 it takes a little more time",
        ),
    ):
        socket = interface.new_socket(name, in_out="INPUT", socket_type="NodeSocketColor")
        socket.default_value = (level, level, level, 1.0)
        socket.description = text
    socket = interface.new_socket("exponent", in_out="INPUT", socket_type="NodeSocketFloat")
    socket.default_value, socket.min_value, socket.max_value = 50.0, 0.0, 1e6
    socket.description = (
        "Sharpness of the Phong lobe, a number without unit: about 10 is satin, 1000 nearly a mirror. Costs no time; "
        "high ones can throw bright specks of noise on other surfaces"
    )


class LOBE_OT_add_phong_node(bpy.types.Operator):
    """Add a Phong BSDF: diffuse and Phong reflectance, and the exponent, exactly as Lobe renders them"""

    bl_idname = "lobe.add_phong_node"
    bl_label = "Phong BSDF"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context) -> bool:
        return _edits_object_shader(context)

    def execute(self, context):
        space = context.space_data
        tree = space.edit_tree
        for old in tree.nodes:
            old.select = False
        node = tree.nodes.new("ShaderNodeGroup")
        node.node_tree = phong_group()
        node.width = 180
        node.location = space.cursor_location
        node.select = True
        tree.nodes.active = node
        return {"FINISHED"}

    def invoke(self, context, event):
        context.space_data.cursor_location_from_region(event.mouse_region_x, event.mouse_region_y)
        self.execute(context)
        return bpy.ops.node.translate_attach_remove_on_cancel("INVOKE_DEFAULT")


def _edits_object_shader(context) -> bool:
    space = context.space_data
    return (
        space is not None
        and space.type == "NODE_EDITOR"
        and space.tree_type == "ShaderNodeTree"
        and space.shader_type == "OBJECT"
        and space.edit_tree is not None
    )


def _draw_in_menu(self, context) -> None:
    if _edits_object_shader(context):
        self.layout.operator(LOBE_OT_add_phong_node.bl_idname)


_MENU = bpy.types.NODE_MT_category_shader_shader  # Add > Shader, in 4.x and 5.x alike


def register() -> None:
    bpy.utils.register_class(LOBE_OT_add_phong_node)
    _MENU.append(_draw_in_menu)


def unregister() -> None:
    _MENU.remove(_draw_in_menu)
    bpy.utils.unregister_class(LOBE_OT_add_phong_node)
