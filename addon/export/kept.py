"""Exported meshes that are kept from one state of a viewport's scene to the next."""

from __future__ import annotations

from collections.abc import Callable

from ...engine import Mesh
from .changes import uid_of


class KeptMeshes:
    """By the evaluated datablock that each comes from, for as long as nothing that it depends on has changed.

    An evaluated datablock is told by its address. One that is freed may leave it to another: whose it is, and how
    large, has to be the same too, and `forget` drops what was evaluated again.
    """

    def __init__(self) -> None:
        self._meshes: dict[tuple, Mesh | None] = {}
        self._asked: dict[tuple, Mesh | None] = {}  # in the export that is under way

    def get(self, data, owner, parent, export: Callable[[], Mesh | None]) -> Mesh | None:
        """Of an evaluated bpy mesh that an object shows, for which another may have placed it."""
        owners = tuple(map(uid_of, (data, owner, parent)))
        key = (owners, data.as_pointer(), len(data.vertices), len(data.loops), len(data.polygons))
        if key not in self._asked:
            self._asked[key] = self._meshes[key] if key in self._meshes else export()
        return self._asked[key]

    def forget(self, uids: set[int]) -> None:
        """Drop the meshes of these objects and datablocks, by their `uid_of`."""
        self._meshes = {key: mesh for key, mesh in self._meshes.items() if uids.isdisjoint(key[0])}

    def forget_all(self) -> None:
        self._meshes = {}

    def finish(self) -> None:
        """The export is over: what it didn't ask for is gone from the scene."""
        self._meshes, self._asked = self._asked, {}
