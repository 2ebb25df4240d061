"""Constant folding: what a socket's value comes to, for nodes that compute colours, vectors and numbers.

A value is a float64 array whose last axis is its channels: (1,) for a number, (3,) for a colour or vector, and
(H, W, 3) where an environment image flows through (world.py). Converters are plain functions over such arrays, in
`VALUE_NODES` by the node's `bl_idname`; adding a node is one function and one line.

Whatever has no converter counts as unplugged: the socket's own value holds, and the material names it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..units import LUMINANCE
from .tree import Slot, is_phong_group, source

# Set by the files that define converters, see nodes_*.py: bl_idname -> function(Evaluator, Slot) -> value or None.
VALUE_NODES: dict[str, Callable] = {}


def value_node(*names: str):
    """Register a converter for nodes of these `bl_idname`s."""

    def register(function):
        for name in names:
            VALUE_NODES[name] = function
        return function

    return register


class Evaluator:
    """Evaluates the sockets of one node tree, and names each kind of node that it can't honour once.

    note(sentence)  called with what is not drawn as asked
    texture         converter for image nodes, (Evaluator, Slot) -> value or None; it differs between materials
                    (average colour) and worlds (the image itself)
    nearest         values that stand for nodes without a constant value, (bl_idname, output name) -> number
    """

    def __init__(self, note: Callable[[str], None], texture: Callable, nearest: dict | None = None) -> None:
        self.note = note
        self.texture = texture
        self.nearest = nearest or {}
        self._known: dict = {}

    def color(self, slot: Slot | None, default=(0.0, 0.0, 0.0)) -> np.ndarray:
        return np.asarray(default, np.float64) if slot is None else as_color(self.value(slot))

    def number(self, slot: Slot | None, default: float = 0.0) -> float:
        """A single number; an image flowing in counts with its average."""
        if slot is None:
            return default
        value = as_number(self.value(slot))
        return float(value.mean())

    def array(self, slot: Slot | None, default: float = 0.0) -> np.ndarray:
        return np.array([default]) if slot is None else as_number(self.value(slot))

    def vector(self, slot: Slot | None) -> np.ndarray:
        return np.zeros(3) if slot is None else as_color(self.value(slot))

    def value(self, slot: Slot) -> np.ndarray:
        """What an input comes to, in its own number of channels."""
        origin = source(slot)
        if not origin.socket.is_output:
            return own_value(origin.socket)
        computed = self._output(origin)
        if computed is None:
            return own_value(slot.socket)
        if origin.socket.type == "VECTOR" and slot.socket.type == "VALUE" and computed.shape[-1] == 3:
            return computed.mean(axis=-1, keepdims=True)  # A vector becomes a number by its mean, a colour does not.
        return computed

    def _output(self, slot: Slot) -> np.ndarray | None:
        node = slot.node
        key = (node.as_pointer(), slot.socket.identifier, tuple(g.as_pointer() for g in slot.groups))
        if key not in self._known:
            self._known[key] = None  # A cycle finds this, and counts as unplugged.
            self._known[key] = self._compute(slot)
        return self._known[key]

    def _compute(self, slot: Slot) -> np.ndarray | None:
        node = slot.node
        stand_in = self.nearest.get((node.bl_idname, slot.socket.name))
        if stand_in is not None:
            self.note(f"{node_label(node)} is not supported, '{slot.socket.name}' counts as {stand_in:g}")
            return np.array([stand_in])
        if node.bl_idname in ("ShaderNodeTexImage", "ShaderNodeTexEnvironment"):
            return self.texture(self, slot)
        convert = VALUE_NODES.get(node.bl_idname)
        value = convert(self, slot) if convert else None
        if value is None:
            self.note(f"{node_label(node)} is not supported and counts as unplugged")
        return value


def node_label(node) -> str:
    """What the user sees on the node when it has no label of its own: "Noise Texture"."""
    if is_phong_group(node):
        return "Phong BSDF"
    return node.bl_label or node.bl_idname


def own_value(socket) -> np.ndarray:
    """The value that a socket has when nothing is linked to it."""
    default = getattr(socket, "default_value", None)
    if default is None or isinstance(default, str):
        return np.zeros(3)
    try:
        return np.array(default[:3], np.float64)
    except TypeError:
        return np.array([float(default)])


def as_color(value: np.ndarray) -> np.ndarray:
    """(..., 3); a number becomes grey."""
    return np.repeat(value, 3, axis=-1) if value.shape[-1] == 1 else value


def as_number(value: np.ndarray) -> np.ndarray:
    """(..., 1); a colour becomes its luminance."""
    return value if value.shape[-1] == 1 else (value @ LUMINANCE)[..., None]
