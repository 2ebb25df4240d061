"""The scene report: for each scene, what Lobe does not draw as asked, as the newest check or render found it.

It is kept in this process alone: a scene's session number, which no other scene gets until Blender ends, is the key.
Loading a file forgets everything. The panel and `tools/render.py --check` show the same groups.
"""

from __future__ import annotations

import ast
import itertools
import re
from collections.abc import Iterable
from typing import NamedTuple

import bpy

from .export.notes import APPROXIMATED, ERROR, KINDS, QUOTED, SKIPPED, WARNING, Group, Note, grouped

HONOURED = "Lobe draws everything in this scene as asked"
HEADINGS = {
    ERROR: "Cannot be rendered",
    WARNING: "Not drawn as asked",
    APPROXIMATED: "Drawn nearly as asked",
    SKIPPED: "Left out, which changes nothing",
}
NOT_HONOURED = (ERROR, WARNING, APPROXIMATED)
NAMES_A_LINE = 8  # of the command line
REDRAW_INTERVAL = 0.5  # seconds

_SENTENCE = re.compile(rf"({'|'.join(filter(None, KINDS))}) ({QUOTED}): (.*)", re.DOTALL)


class Report(NamedTuple):
    source: str  # "check" or "render"
    groups: tuple[Group, ...]
    number: int  # of all reports of this process, from 1

    def of_level(self, *levels: str) -> list[Group]:
        return [group for group in self.groups if group.level in levels]


_reports: dict[int, Report] = {}
_numbers = itertools.count(1)
_to_redraw = False


def key(scene) -> int:
    """Of a scene, evaluated or not."""
    return scene.original.session_uid


def keep(scene_key: int, source: str, notes: Iterable[Note]) -> Report:
    """Replace a scene's report. May be called on any thread."""
    global _to_redraw
    report = _reports[scene_key] = Report(source, tuple(grouped(notes)), next(_numbers))
    _to_redraw = True
    return report


def restore(scene_key: int, report: Report | None) -> None:
    """Put a report back that renders with other settings than the user's have replaced."""
    global _to_redraw
    if report is None:
        _reports.pop(scene_key, None)
    else:
        _reports[scene_key] = report
    _to_redraw = True


def report_of(scene) -> Report | None:
    """None for a scene that was neither checked nor rendered since its file was opened."""
    return _reports.get(key(scene))


def note_from_sentence(level: str, sentence: str) -> Note:
    """The engine's messages are sentences: "light 'Key': its radius is negative". The name is as Python writes it."""
    found = _SENTENCE.fullmatch(sentence)
    if found is None:
        return Note(level, "", "", sentence)
    kind, name, what = found.groups()
    return Note(level, kind, ast.literal_eval(name), what)


def is_honoured(report: Report) -> bool:
    """Whether everything is drawn as asked."""
    return not report.of_level(*NOT_HONOURED)


def lines(report: Report, names_a_line: int | None = NAMES_A_LINE) -> list[str]:
    """A heading for each level, a line for each group with its number and some of the names; None: with all."""
    if not report.groups:
        return [HONOURED]
    text = [HONOURED] if is_honoured(report) else []
    for level, heading in HEADINGS.items():
        groups = report.of_level(level)
        text += [f"{heading}:"] if groups else []
        text += [
            f"{len(group.names) or '-':>7}  {group.kind or 'scene':<10}  {_described(group, names_a_line)}"
            for group in groups
        ]
    return text


def sentence(group: Group) -> str:
    """All in one line, however many datablocks it is true of."""
    if not group.names:
        return group.what
    names = ", ".join(map(repr, group.names[:NAMES_A_LINE]))
    more = len(group.names) - NAMES_A_LINE
    return f"{group.kind} {names}" + (f" and {more} more" if more > 0 else "") + f": {group.what}"


def _described(group: Group, names_a_line: int | None) -> str:
    names = ", ".join(group.names[:names_a_line])
    more = len(group.names) - (len(group.names) if names_a_line is None else names_a_line)
    return group.what + (f": {names}" if names else "") + (f" and {more} more" if more > 0 else "")


@bpy.app.handlers.persistent
def _forget(*_) -> None:
    """Another file is open: not earlier, for one that can't be opened leaves this one open."""
    _reports.clear()


def _redraw() -> float:
    """Renders end on a thread that may not ask for this."""
    global _to_redraw
    if _to_redraw:
        _to_redraw = False
        redraw_properties()
    return REDRAW_INTERVAL


def redraw_properties() -> None:
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "PROPERTIES":
                area.tag_redraw()


def register() -> None:
    # While the add-on was off, files were opened without a word to it.
    known = {key(scene) for scene in getattr(bpy.data, "scenes", ())}
    for scene_key in _reports.keys() - known:
        del _reports[scene_key]
    bpy.app.handlers.load_post.append(_forget)
    if not bpy.app.background:
        bpy.app.timers.register(_redraw, persistent=True)


def unregister() -> None:
    if bpy.app.timers.is_registered(_redraw):
        bpy.app.timers.unregister(_redraw)
    bpy.app.handlers.load_post.remove(_forget)
