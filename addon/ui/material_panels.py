"""The material's panels that Blender doesn't have: the Phong lobe at hand, and what Lobe makes of the node tree."""

from __future__ import annotations

import bpy

from ..export.materials.material import always_uses_nodes, uses_nodes
from ..export.materials.surface import DARKER_EDGES
from ..export.materials.tree import is_phong_group, shader_output
from ..export.notes import ERROR, WARNING
from ..export.units import exponent_to_roughness
from ..phong_group import phong_group
from .nodes import draw_surface
from .panel import LobePanel
from .text import draw_text
from .understood import read_soon, understood

INPUTS = ("kd", "ks", "exponent")
ADD = "ShaderNodeAddShader"
BESIDE = {ADD, "ShaderNodeEmission", "ShaderNodeBsdfTransparent"}  # what "Use Phong BSDF" makes of the rest
LEVEL_ICONS = {ERROR: "CANCEL", WARNING: "ERROR"}
HOLE = "Its surface is a hole in the picture (Holdout), which no Phong BSDF can be"
SHINY = 1e-5  # of a reflectance, an emission or a transparency that is worth a node


def phong_node(material):
    """The Phong BSDF that is the material's whole surface, but for nodes beside it that shine or let light through.
    None where there is anything else."""
    if not uses_nodes(material):
        return None
    output = shader_output(material.node_tree, "ShaderNodeOutputMaterial")
    parts = _summands(output.inputs["Surface"]) if output is not None else set()
    phong = {node for node in parts if is_phong_group(node)}
    rest = {node.bl_idname for node in parts - phong}
    return phong.pop() if len(phong) == 1 and rest <= BESIDE else None


def _summands(socket) -> set:
    """The nodes whose sum feeds a shader input, with the Add Shaders that sum them."""
    nodes, sockets = set(), [socket]
    while sockets:
        for link in sockets.pop().links:
            if link.from_node not in nodes and link.from_node.bl_idname == ADD:
                sockets += link.from_node.inputs
            nodes.add(link.from_node)
    return nodes


class _MaterialPanel(LobePanel):
    bl_context = "material"

    @classmethod
    def poll(cls, context) -> bool:
        material = context.material
        return material is not None and material.grease_pencil is None and super().poll(context)


class LOBE_MATERIAL_PT_surface(_MaterialPanel, bpy.types.Panel):
    bl_label = "Surface"

    def draw(self, context):
        material = context.material
        if uses_nodes(material):
            draw_surface(self.layout, material.node_tree, "ShaderNodeOutputMaterial")
            return
        if not always_uses_nodes(material):
            self.layout.prop(material, "use_nodes", icon="NODETREE")
        self.column().prop(material, "diffuse_color", text="Color")


class LOBE_MATERIAL_PT_phong(_MaterialPanel, bpy.types.Panel):
    """What a Phong surface's numbers, which stand above, amount to; or how to get one."""

    bl_label = "Phong"
    bl_parent_id = "LOBE_MATERIAL_PT_surface"

    def draw(self, context):
        node = phong_node(context.material)
        if node is None:
            self.layout.operator(LOBE_OT_use_phong.bl_idname)
            return
        if any(node.inputs[name].is_linked for name in INPUTS):
            self.layout.label(text="Other nodes tell how much it reflects", icon="INFO")
            return
        kd, ks, exponent = (node.inputs[name].default_value for name in INPUTS)
        back = max(kd[channel] + ks[channel] for channel in range(3))
        text = f"Gives back up to {back:.0%} of the light, as sharp as roughness {exponent_to_roughness(exponent):.2g}"
        draw_text(self.layout, context, text, "ERROR" if back > 1.0 + 1e-6 else "INFO")


class LOBE_MATERIAL_PT_understood(_MaterialPanel, bpy.types.Panel):
    bl_label = "As Lobe Draws It"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        known = understood.at_hand(context.material)
        if known is None:
            self.layout.label(text="Reading its images...", icon="TIME")
            read_soon()
            return
        drawn, notes = known
        column = self.column(align=True)
        if drawn is not None:
            for name, value in _rows(drawn):
                split = column.split(factor=0.4)
                label = split.row()
                label.alignment = "RIGHT"
                label.label(text=name)
                split.label(text=value)
        if notes:
            box = self.layout.box().column()
            for note in notes:
                draw_text(box, context, note.what[:1].upper() + note.what[1:], LEVEL_ICONS.get(note.level, "INFO"))
        elif drawn is not None:
            self.layout.label(text="Every node of it is honoured", icon="CHECKMARK")


def _rows(drawn) -> list[tuple[str, str]]:
    """Name and value of the parts of an `engine.Material`; of those that are black, the diffuse one alone is shown."""
    rows = [("Diffuse kd", _triple(drawn.kd))]
    if max(drawn.ks) > 0.0:
        rows += [("Phong ks", _triple(drawn.ks)), ("Exponent", f"{drawn.exponent:.4g}")]
    if any(drawn.emission):
        rows += [("Emission", _triple(drawn.emission)), ("", "W/(m² sr)")]  # below: three numbers fill a column
    if max(drawn.transparency) > 0.0:
        rows.append(("Transparency", _triple(drawn.transparency)))
    return rows


def _triple(color) -> str:
    """One number where the three are equal."""
    numbers = [f"{channel:.3g}" if channel < 100.0 else f"{channel:.0f}" for channel in color]
    return numbers[0] if len(set(numbers)) == 1 else "  ".join(numbers)


class LOBE_OT_use_phong(bpy.types.Operator):
    """Put a Phong BSDF in place of this material's surface, with the kd, ks and exponent that Lobe draws it with now. \
Emission and transparency are kept as nodes of their own; the old nodes stay in the tree, unlinked"""

    bl_idname = "lobe.use_phong"
    bl_label = "Use Phong BSDF"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context) -> bool:
        material = getattr(context, "material", None)
        if material is None or material.library is not None:
            return False
        if phong_node(material) is not None:
            cls.poll_message_set("The surface is a Phong BSDF already")
            return False
        return True

    def execute(self, context):
        material = context.material
        drawn, notes = understood.of(material)
        if drawn is None or drawn.holdout:
            self.report({"ERROR"}, HOLE if drawn is not None else notes[0].what)
            return {"CANCELLED"}
        if not always_uses_nodes(material):
            material.use_nodes = True
        use_phong(material.node_tree, drawn)
        understood.forget_materials()
        lost = _lost(notes, understood.of(material)[1])
        if lost:
            text = "; ".join(lost)
            self.report({"WARNING"}, f"Replaced in {material.name!r}, for all engines (Undo brings it back): {text}")
        return {"FINISHED"}


def _lost(before, after) -> list[str]:
    """What a material that became a Phong surface had and no engine draws any more. Metal and gloss aren't lost."""
    warned = (note for note in before if note.level == WARNING and note not in after)
    return [note.what for note in warned if note.what != DARKER_EDGES]


def use_phong(tree, drawn) -> None:
    """Feed the output of a material's tree by nodes that are exactly `drawn`, an `engine.Material`."""
    output = shader_output(tree, "ShaderNodeOutputMaterial") or tree.nodes.new("ShaderNodeOutputMaterial")
    x, y = output.location

    def node(kind: str, row: int, **inputs):
        made = tree.nodes.new(kind)
        made.location = (x - 260.0, y - 200.0 * row)
        for name, value in inputs.items():
            made.inputs[name].default_value = value
        return made

    phong = node("ShaderNodeGroup", 0)
    phong.node_tree, phong.width = phong_group(), 180.0
    for name, value in (("kd", (*drawn.kd, 1.0)), ("ks", (*drawn.ks, 1.0)), ("exponent", drawn.exponent)):
        phong.inputs[name].default_value = value
    parts = [phong.outputs[0]]
    if (strength := max(drawn.emission)) > SHINY:
        color = (*(channel / strength for channel in drawn.emission), 1.0)
        parts.append(node("ShaderNodeEmission", 1, Color=color, Strength=strength).outputs[0])
    if max(drawn.transparency) > SHINY:
        parts.append(node("ShaderNodeBsdfTransparent", 2, Color=(*drawn.transparency, 1.0)).outputs[0])
    while len(parts) > 1:
        both = tree.nodes.new("ShaderNodeAddShader")
        both.location = (x - 60.0 * len(parts), y - 120.0 * len(parts))
        tree.links.new(parts.pop(), both.inputs[1])
        tree.links.new(parts.pop(), both.inputs[0])
        parts.append(both.outputs[0])
    tree.links.new(parts[0], output.inputs["Surface"])


class LOBE_MATERIAL_PT_settings(_MaterialPanel, bpy.types.Panel):
    bl_label = "Settings"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        self.column().prop(context.material, "pass_index")


CLASSES = (
    LOBE_OT_use_phong,
    LOBE_MATERIAL_PT_surface,
    LOBE_MATERIAL_PT_phong,
    LOBE_MATERIAL_PT_understood,
    LOBE_MATERIAL_PT_settings,
)
