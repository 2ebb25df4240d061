"""Exported meshes that are kept from one state of a scene to the next."""

from __future__ import annotations

from collections.abc import Callable

from ...engine import Mesh
from .changes import uid_of


class KeptMeshes:
    """By the evaluated datablock that each comes from, for as long as nothing that it depends on has changed.

    An evaluated datablock is told by its address. One that is freed may leave it to another, but that other one has
    just been evaluated: nothing is taken over for an object or a datablock that `forget` was told of.
    """

    def __init__(self) -> None:
        self._meshes: dict[tuple, tuple[set[int], Mesh | None]] = {}  # with the `uid_of` all that it depends on
        self._asked: dict[tuple, tuple[set[int], Mesh | None]] = {}  # the same, in the export that is under way
        self._changed: set[int] = set()

    def get(self, data, owner, parent, with_uvs: bool, export: Callable[[], Mesh | None]) -> Mesh | None:
        """Of an evaluated bpy mesh that an object shows, which another one may have placed."""
        key = (data.as_pointer(), uid_of(data), len(data.vertices), len(data.loops), len(data.polygons), with_uvs)
        depends = {uid_of(data), uid_of(owner), uid_of(parent)}
        if key not in self._asked:
            kept = self._meshes.get(key) if depends.isdisjoint(self._changed) else None
            self._asked[key] = kept or (depends, export())
        return self._asked[key][1]

    def forget(self, uids: set[int]) -> None:
        """These objects and datablocks, by their `uid_of`, have been evaluated again."""
        self._changed |= uids
        self._meshes = {key: kept for key, kept in self._meshes.items() if kept[0].isdisjoint(uids)}

    def finish(self) -> None:
        """The export is over: what it didn't ask for is gone from the scene."""
        self._meshes, self._asked, self._changed = self._asked, {}, set()
