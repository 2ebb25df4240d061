"""What one render has packed and built, for the next one of a scene that shares parts with it."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .pack import Packed


class Prepared:
    """Give the same one to `render` for each frame of an animation: what the frames have in common is then neither
    packed nor built again, and the pictures are the same to the bit.

    Of a scene only what was replaced is looked at: meshes, instances, images, worlds and lists of lamps that are the
    same objects as before are taken for unchanged. It holds as much memory as a render does.
    """

    def __init__(self) -> None:
        self._packed: Packed | None = None

    def take(self) -> Packed | None:
        """What there is, once: what can't be used is gone before anything new is built."""
        packed, self._packed = self._packed, None
        return packed

    def put(self, packed: Packed) -> None:
        self._packed = packed
