"""Walking node trees: what a socket is really fed by, through reroutes, muted nodes and group nodes.

Knows nothing about what nodes mean; `values.py` and `surface.py` do.
"""

from __future__ import annotations

from typing import NamedTuple

import bpy

from ...phong_mark import is_phong_tree

# Blender 5.0 takes muted nodes and groups out of a tree before Cycles sees it; before, Cycles did that in its own way.
INLINED = bpy.app.version >= (5, 0, 0)


class Slot(NamedTuple):
    """A socket, with the group nodes (outermost first) that lead to the tree it lives in."""

    socket: object
    groups: tuple = ()

    @property
    def node(self):
        return self.socket.node

    @property
    def key(self) -> tuple:
        return (self.socket.as_pointer(), *(group.as_pointer() for group in self.groups))

    def input(self, name: str) -> Slot | None:
        """An input of the same node by its identifier or name, None if this version of Blender lacks it."""
        socket = find_input(self.node, name)
        return None if socket is None else Slot(socket, self.groups)

    def inputs(self) -> list[Slot]:
        return [Slot(socket, self.groups) for socket in self.node.inputs]


class Route(NamedTuple):
    """Where the value of an input comes from.

    origin  an output of a node that computes something, or an unlinked input
    kinds   the types of the sockets that make of it what they are, from the origin's side to the input itself
    """

    origin: Slot
    kinds: tuple[str, ...]


def find_input(node, name: str):
    """By identifier, which Blender keeps when it renames a socket; else by name (group nodes)."""
    by_identifier = (socket for socket in node.inputs if socket.identifier == name)
    by_name = (socket for socket in node.inputs if socket.name == name and socket.enabled)
    return next(by_identifier, None) or next(by_name, None)


def source(slot: Slot) -> Slot:
    """The output that feeds an input, or the input whose own value holds; see `route`."""
    return route(slot).origin


def route(slot: Slot) -> Route:
    """Follow an input up to where its value comes from.

    Muted nodes and reroutes have no values of their own: where one of them is fed by nothing, the value is that of the
    last input before them, and a muted node never computes. Before Blender 5.0 it was zero: the origin is then the
    input of the muted node or reroute, of which `Evaluator.value` makes that.
    """
    target = here = last_input = slot
    kinds, seen = [slot.socket.type], {slot.key}
    while True:
        step = _before_output(here) if here.socket.is_output else _before_input(here)
        if step is None and here.socket.is_output and not passes_on(here.node):
            return Route(here, tuple(reversed(kinds)))
        if step is None or step.key in seen:  # A cycle, which only a broken file can hold, counts as unplugged.
            return Route(target if INLINED else last_input, tuple(reversed(kinds)))
        seen.add(step.key)
        if not step.socket.is_output:
            last_input = step
            if not passes_on(step.node):
                target = step
                kinds.append(step.socket.type)
            elif not INLINED:
                kinds.append(here.socket.type)
        here = step


def passes_on(node) -> bool:
    """Whether a node computes nothing and only hands on what comes in. What bounds a group can't be muted."""
    return node.bl_idname == "NodeReroute" or (node.mute and not node.bl_idname.startswith("NodeGroup"))


def _before_input(slot: Slot) -> Slot | None:
    for link in slot.socket.links if slot.socket.is_linked else ():
        if link.is_valid and not link.is_muted:
            return Slot(link.from_socket, slot.groups)
    return None


def _before_output(slot: Slot) -> Slot | None:
    """One step up from an output of a node that only passes things on; None from all others."""
    socket, groups = slot
    node = socket.node
    if node.bl_idname == "NodeReroute":
        return Slot(node.inputs[0], groups)
    if passes_on(node):
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


def is_phong_group(node) -> bool:
    """Whether a node is of Lobe's own Phong BSDF, whose inputs are read and whose inside is for other engines."""
    return is_phong_tree(getattr(node, "node_tree", None))
