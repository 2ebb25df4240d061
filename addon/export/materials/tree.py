"""Walking node trees: what a socket is really fed by, through reroutes, muted nodes and group nodes.

Knows nothing about what nodes mean; `values.py` and `shaders.py` do.
"""

from __future__ import annotations

from typing import NamedTuple

MAX_DEPTH = 200  # Blender allows no cycles, but a broken file can hold one.


class Slot(NamedTuple):
    """A socket, with the group nodes (outermost first) that lead to the tree it lives in."""

    socket: object
    groups: tuple = ()

    @property
    def node(self):
        return self.socket.node

    def input(self, name: str) -> Slot | None:
        """An input of the same node by its identifier or name, None if this version of Blender lacks it."""
        socket = find_input(self.node, name)
        return None if socket is None else Slot(socket, self.groups)

    def inputs(self) -> list[Slot]:
        return [Slot(socket, self.groups) for socket in self.node.inputs]


def find_input(node, name: str):
    """By identifier, which Blender keeps when it renames a socket; else by name (group nodes)."""
    by_identifier = (socket for socket in node.inputs if socket.identifier == name)
    by_name = (socket for socket in node.inputs if socket.name == name and socket.enabled)
    return next(by_identifier, None) or next(by_name, None)


def source(slot: Slot) -> Slot:
    """Follow an input to the output socket that feeds it, or to the input whose own value holds.

    The result is an output of a node that computes something, or an unlinked input.
    """
    for _ in range(MAX_DEPTH):
        socket, groups = slot
        step = _before_input(socket, groups) if not socket.is_output else _before_output(socket, groups)
        if step is None:
            return slot
        slot = step
    return slot


def _before_input(socket, groups) -> Slot | None:
    for link in socket.links if socket.is_linked else ():
        if link.is_valid and not link.is_muted:
            return Slot(link.from_socket, groups)
    return None


def _before_output(socket, groups) -> Slot | None:
    """One step up from an output of a node that only passes things on; None from all others."""
    node = socket.node
    if node.bl_idname == "NodeReroute":
        return Slot(node.inputs[0], groups)
    if node.mute:
        passed = next((link.from_socket for link in node.internal_links if link.to_socket == socket), None)
        return Slot(passed, groups) if passed is not None else None
    if node.bl_idname == "NodeGroupInput" and groups:
        outer = next((s for s in groups[-1].inputs if s.identifier == socket.identifier), None)
        return Slot(outer, groups[:-1]) if outer is not None else None
    if node.bl_idname == "ShaderNodeGroup" and node.node_tree is not None and not is_phong_group(node):
        inner = group_output(node.node_tree)
        socket_in = next((s for s in inner.inputs if s.identifier == socket.identifier), None) if inner else None
        return Slot(socket_in, (*groups, node)) if socket_in is not None else None
    return None


def group_output(tree):
    """The active Group Output of a node group, None if it has none."""
    outputs = [node for node in tree.nodes if node.bl_idname == "NodeGroupOutput"]
    return next((node for node in outputs if node.is_active_output), outputs[0] if outputs else None)


def shader_output(tree, kind: str):
    """The output node (`kind`: ShaderNodeOutputMaterial, ...World, ...Light) that Cycles would take, or None.

    Active ones come first, and of those the ones for Cycles before the ones for all engines; EEVEE's own count last.
    """
    rank = {"CYCLES": 0, "ALL": 1}
    outputs = [node for node in tree.nodes if node.bl_idname == kind and not node.mute]
    outputs.sort(key=lambda node: (rank.get(node.target, 2), not node.is_active_output))
    return outputs[0] if outputs else None


# Marks the tree of the `Phong BSDF` group (see addon/phong_group.py); its name does as well.
PHONG_MARK = "lobe_phong"
PHONG_NAME = "Phong BSDF"


def is_phong_group(node) -> bool:
    """Whether a group node is Lobe's own Phong BSDF, whose inputs are read and whose inside is for other engines."""
    tree = getattr(node, "node_tree", None)
    return tree is not None and (PHONG_MARK in tree or tree.name == PHONG_NAME)
