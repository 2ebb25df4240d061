"""Settings of the user's that a comparison changes for the while: what they were, and how to put them back.

Datablocks are remembered by their session number, not as Python's objects: those die when the user undoes a step.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import bpy

_COLLECTIONS = {"Scene": "scenes", "Object": "objects", "Material": "materials"}


class Change(NamedTuple):
    kind: str  # of the datablock: "Scene"
    datablock: int  # its session number
    path: str  # from the datablock to what has the setting: "cycles"
    key: str
    label: str  # as the user knows it
    before: Any
    during: Any


class Keeper:
    """A context manager. At its end, whatever ended it, everything that was changed through it is as before."""

    def __init__(self) -> None:
        self.changes: list[Change] = []
        self._undo: list[Callable[[], None]] = []

    def __enter__(self) -> Keeper:
        return self

    def __exit__(self, *_) -> None:
        errors = []
        for undo in [*reversed(self._undo), self._put_back]:
            try:
                undo()
            except Exception as error:  # the others must be undone all the same
                errors.append(error)
        self._undo = []
        if errors:
            raise errors[0]

    def put(self, owner, key: str, value) -> None:
        """`setattr` that is taken back at the end. What is so already isn't touched."""
        before = getattr(owner, key)
        if before == value:
            return
        datablock = owner.id_data
        kind, path = datablock.bl_rna.identifier, "" if owner == datablock else owner.path_from_id()
        label = owner.bl_rna.properties[key].name
        setattr(owner, key, value)
        self.changes.append(Change(kind, datablock.session_uid, path, key, label, before, value))

    def at_end(self, undo: Callable[[], None]) -> None:
        """Called at the end, the last one first, before the settings are put back."""
        self._undo.append(undo)

    def _put_back(self) -> None:
        """Also what comes after one that can't be set any more."""
        found = {
            kind: {datablock.session_uid: datablock for datablock in getattr(bpy.data, collection)}
            for kind, collection in _COLLECTIONS.items()
        }
        errors = []
        for change in reversed(self.changes):
            datablock = found[change.kind].get(change.datablock)
            if datablock is None:  # deleted meanwhile
                continue
            try:
                setattr(datablock.path_resolve(change.path) if change.path else datablock, change.key, change.before)
            except (TypeError, AttributeError, ValueError) as error:
                errors.append(error)
        if errors:
            raise errors[0]
