"""The slots of the Render Result, and which of them has the newest picture.

Blender keeps the newest picture beside the slots, and moves it into its slot when a render begins while another slot is
the active one: what the active one holds it throws away. So an operator that renders for its own ends must do that in
the slot of the newest picture, which Blender doesn't tell: it is noted at each render. (Of a Viewport Render Image
Blender tells nobody: one in another slot than the render before it isn't known here.)
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import NamedTuple

import bpy


class _Slot(NamedTuple):
    address: int  # which stays when slots before it are removed
    index: int


_newest: _Slot | None = None  # None before the first render


def render_result() -> bpy.types.Image | None:
    """Made by the very first render. Not by its name, which an image of the user's may have."""
    return next((image for image in bpy.data.images if image.type == "RENDER_RESULT"), None)


@contextlib.contextmanager
def in_newest_slot() -> Iterator[None]:
    """A render in here, of another scene, leaves all pictures where they are. The user's choice of slot comes back."""
    image = render_result()
    newest = _newest_index(image)
    if newest is None:
        yield
        return
    slots = image.render_slots
    before, slots.active_index = slots.active_index, newest
    try:
        yield
    finally:
        image.render_slots.active_index = before


def _newest_index(image: bpy.types.Image | None) -> int | None:
    if image is None or _newest is None or not len(image.render_slots):
        return None
    for index, slot in enumerate(image.render_slots):
        if slot.as_pointer() == _newest.address:
            return index
    # It was removed, and Blender has taken the next one, or the last; or an undo has made all slots anew.
    return min(_newest.index, len(image.render_slots) - 1)


@bpy.app.handlers.persistent
def _note(*_) -> None:
    """A render begins, and goes into the active slot."""
    global _newest
    image = render_result()
    if image is not None and len(image.render_slots):
        index = image.render_slots.active_index
        _newest = _Slot(image.render_slots[index].as_pointer(), index)


@bpy.app.handlers.persistent
def _forget(*_) -> None:
    global _newest
    _newest = None


def register() -> None:
    bpy.app.handlers.render_init.append(_note)
    bpy.app.handlers.load_post.append(_forget)  # not before: a file may not open


def unregister() -> None:
    bpy.app.handlers.load_post.remove(_forget)
    bpy.app.handlers.render_init.remove(_note)
    _forget()
