"""Blender's materials to `engine.Material`: constants folded, what has no counterpart named once per material.

`tree.py` walks sockets, `values.py` and `nodes_*.py` fold colours and numbers, `surface.py` and `shaders_*.py` turn
shader nodes into lobes. Adding a node is one decorated function in a file that is imported here.
"""

from __future__ import annotations

from . import (  # noqa: F401
    nodes_color,
    nodes_curves,
    nodes_input,
    nodes_math,
    shaders_basic,
    shaders_nearest,
    shaders_principled,
)
from .material import MaterialTable

__all__ = ["MaterialTable"]
