"""Constant folding: what a socket's value comes to, for nodes that compute colours, vectors and numbers.

A value is a float64 array whose last axis is its channels: (1,) for a number, (3,) for a colour or vector, and
(H, W, 3) where an environment image flows through (world.py). Converters are plain functions over such arrays, in
`VALUE_NODES` by the node's `bl_idname`; adding a node is one function and one line.

Of a node without a converter a colour that is linked into it counts for the one that comes out. Whatever else has none
counts as unplugged: the socket's own value holds. The material names either.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..units import LUMINANCE
from .memo import Memo
from .tree import INLINED, Slot, is_phong_group, passes_on, route

# Set by the files that define converters, see nodes_*.py: bl_idname -> function(Evaluator, Slot) -> value or None.
VALUE_NODES: dict[str, Callable] = {}

# What an Evaluator's `texture` converts.
TEXTURES = ("ShaderNodeTexImage", "ShaderNodeTexEnvironment", "ShaderNodeTexSky")


def value_node(*names: str):
    """Register a converter for nodes of these `bl_idname`s."""

    def register(function):
        for name in names:
            VALUE_NODES[name] = function
        return function

    return register


class Evaluator:
    """Evaluates the sockets of one node tree, and names each kind of node that it can't honour once.

    note(sentence, level)  called with what is not drawn as asked; the level is WARNING unless given
    texture         converter for images and skies, (Evaluator, Slot) -> value or None; it differs between materials
                    (average colour) and worlds (the image itself)
    nearest         values that stand for nodes without a constant value, (bl_idname, output name) -> number
    check           called for each node; it raises once the user has cancelled
    """

    def __init__(
        self,
        note: Callable[..., None],
        texture: Callable,
        nearest: dict | None = None,
        check: Callable[[], None] = lambda: None,
    ) -> None:
        self.note = note
        self.texture = texture
        self.nearest = nearest or {}
        self.check = check
        self._known = Memo(None, check)  # Within a cycle, a node counts as unplugged.

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

    def mean_vector(self, slot: Slot | None) -> np.ndarray:
        """(3,); an image flowing in counts with its average."""
        return self.vector(slot).reshape(-1, 3).mean(axis=0)

    def value(self, slot: Slot) -> np.ndarray:
        """What an input comes to, in its own number of channels; as it came, for an input that takes a shader."""
        origin, kinds = route(slot)
        if not origin.socket.is_output:
            value = np.zeros(3) if passes_on(origin.node) else own_value(origin.socket)
        else:
            value = self._known.get(origin.key, lambda: self._compute(origin))
            if value is None:
                return own_value(slot.socket)
        return through(value, origin.socket.type, kinds)

    def _compute(self, slot: Slot) -> np.ndarray | None:
        node = slot.node
        stand_in = self.nearest.get((node.bl_idname, slot.socket.name))
        if stand_in is not None:
            self.note(f"{node_label(node)} is not supported, '{slot.socket.name}' counts as {stand_in:g}")
            return np.array([stand_in])
        if node.bl_idname in TEXTURES:
            return self.texture(self, slot)
        convert = VALUE_NODES.get(node.bl_idname)
        value = convert(self, slot) if convert else None
        return self._unknown(slot) if value is None else value

    def _unknown(self, slot: Slot) -> np.ndarray | None:
        node = slot.node
        linked = [socket for socket in node.inputs if socket.is_linked and socket.type == "RGBA"]
        if slot.socket.type != "RGBA" or not linked:
            self.note(f"{node_label(node)} is not supported and counts as unplugged")
            return None
        self.note(f"{node_label(node)} is not supported, its input '{linked[0].name}' counts as it is")
        return self.value(Slot(linked[0], slot.groups))


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


def through(value: np.ndarray, kind: str, kinds: tuple[str, ...]) -> np.ndarray:
    """A value of one type of socket, as sockets of these types hand it on to the last of them.

    From Blender 5.0 on, a colour that enters or leaves a group by a socket for a number or a vector stays a colour.
    """
    for i, to in enumerate(kinds):
        stays = INLINED and kind == "RGBA" and to in ("VALUE", "VECTOR") and i < len(kinds) - 1
        if to in CONVERT and to != kind and not stays:
            value, kind = CONVERT[to](value, kind), to
    return value


def _to_number(value: np.ndarray, kind: str) -> np.ndarray:
    """(..., 1): a vector becomes a number by its mean, a colour by its luminance."""
    if kind == "VECTOR" and value.shape[-1] == 3:
        return value.mean(axis=-1, keepdims=True)
    return as_number(value)


# Type of a socket -> function(value, type that it had) -> value.
CONVERT: dict[str, Callable] = {
    "VALUE": _to_number,
    "INT": lambda value, kind: np.trunc(_to_number(value, kind)),
    "BOOLEAN": lambda value, kind: (_to_number(value, kind) > 0.0).astype(np.float64),
    "VECTOR": lambda value, kind: as_color(value),
    "RGBA": lambda value, kind: as_color(value),
}


def as_color(value: np.ndarray) -> np.ndarray:
    """(..., 3); a number becomes grey."""
    return np.repeat(value, 3, axis=-1) if value.shape[-1] == 1 else value


def as_number(value: np.ndarray) -> np.ndarray:
    """(..., 1); a colour becomes its luminance."""
    return value if value.shape[-1] == 1 else (value @ LUMINANCE)[..., None]
