"""A node tree's surface in a panel: through the output node that Lobe renders, which may not be EEVEE's."""

from __future__ import annotations

from ..export.materials.tree import find_input, shader_output


def draw_surface(layout, tree, kind: str) -> None:
    """kind: ShaderNodeOutputMaterial, ...World or ...Light"""
    layout.use_property_split = True
    output = shader_output(tree, kind)
    if output is None:
        layout.label(text="No output node")
    else:
        layout.template_node_view(tree, output, find_input(output, "Surface"))
