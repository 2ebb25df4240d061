"""Settings of the user's that a comparison changes for the while: what they were, and how to put them back.

Datablocks are remembered by their session number, not as Python's objects: those die when the user undoes a step.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator
from functools import partial
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


@contextlib.contextmanager
def listening(**functions: Callable) -> Iterator[None]:
    """For the while they are in Blender's lists of handlers, by whose names they are given."""
    for name, function in functions.items():
        getattr(bpy.app.handlers, name).append(function)
    try:
        yield
    finally:
        for name, function in functions.items():
            if function in getattr(bpy.app.handlers, name):  # opening a file removes them
                getattr(bpy.app.handlers, name).remove(function)


class _Step(NamedTuple):
    undo: Callable[[], None]
    again: Callable[[], None] | None


class Keeper:
    """A context manager. At its end, whatever ended it, everything that was changed through it is as before.

    So it is while Blender saves a file, whoever has asked for that; once the file is written all is changed again.
    """

    def __init__(self) -> None:
        self.changes: list[Change] = []
        self.undone = False  # whether a step was undone or redone meanwhile, and with it what was changed here
        self._steps: list[_Step] = []
        self._saving = False
        self._listening = listening(
            save_pre=self._before_saving,
            save_post=self._after_saving,
            save_post_fail=self._after_saving,
            undo_post=self._on_undo,
            redo_post=self._on_undo,
        )

    def __enter__(self) -> Keeper:
        self._listening.__enter__()
        return self

    def __exit__(self, *_) -> None:
        self._listening.__exit__(None, None, None)
        steps, self._steps = self._steps, []
        _all_of([*(step.undo for step in reversed(steps)), self._put_back])

    def put(self, owner, key: str, value) -> None:
        """`setattr` that is taken back at the end. What is so already isn't touched."""
        before = getattr(owner, key)
        if before == value:
            return
        datablock = owner.id_data
        kind, path = datablock.bl_rna.identifier, "" if owner == datablock else owner.path_from_id()
        label = owner.bl_rna.properties[key].name
        setattr(owner, key, value)
        self.changes.append(Change(kind, datablock.session_uid, path, key, label, before, getattr(owner, key)))

    def at_end(self, undo: Callable[[], None], again: Callable[[], None] | None = None) -> None:
        """undo is called at the end, the last one first, before the settings are put back; for what a file would hold
        also before one is saved, and `again` after that. Either may come when the user has undone it already."""
        self._steps.append(_Step(undo, again))

    def _before_saving(self, *_) -> None:
        self._saving = True
        _all_of([*(step.undo for step in reversed(self._steps) if step.again), self._put_back])

    def _after_saving(self, *_) -> None:
        if self._saving and not self.undone:
            _all_of([self._put_again, *(step.again for step in self._steps if step.again)])
        self._saving = False

    def _on_undo(self, *_) -> None:
        self.undone = True

    def _put_back(self) -> None:
        found = _datablocks()
        _all_of(partial(self._set, found, change, change.during, change.before) for change in reversed(self.changes))

    def _put_again(self) -> None:
        found = _datablocks()
        _all_of(partial(self._set, found, change, change.before, change.during) for change in self.changes)

    def _set(self, found: dict[str, dict[int, Any]], change: Change, now, value) -> None:
        datablock = found[change.kind].get(change.datablock)
        if datablock is None:  # deleted meanwhile
            return
        owner = datablock.path_resolve(change.path) if change.path else datablock
        if self.undone and getattr(owner, change.key) != now:  # the user's undo was there first
            return
        setattr(owner, change.key, value)


def _datablocks() -> dict[str, dict[int, Any]]:
    """By their kind and session number."""
    return {
        kind: {datablock.session_uid: datablock for datablock in getattr(bpy.data, collection)}
        for kind, collection in _COLLECTIONS.items()
    }


def _all_of(calls: Iterable[Callable[[], None]]) -> None:
    """Also those that come after one that fails. Raises the first error."""
    errors = []
    for call in calls:
        try:
            call()
        except Exception as error:
            errors.append(error)
    if errors:
        raise errors[0]
