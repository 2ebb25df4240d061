"""What the user has to be told about an export: as data for the scene report, and as sentences for the render report.

Each note is kept once, in the order of its first appearance.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Hashable, Iterable, Iterator
from typing import NamedTuple, TypeVar

T = TypeVar("T")

# How much it matters: nothing can be rendered; the picture will not show it as asked; it will nearly; it doesn't change
# the picture.
ERROR, WARNING, APPROXIMATED, SKIPPED = LEVELS = ("ERROR", "WARNING", "APPROXIMATED", "SKIPPED")

# Of nearly every scene, so that it comes after all else of its level.
PRINCIPLED_GLOSS = (
    "Principled BSDF's reflections don't grow stronger towards the edges as in Cycles: the same on average, in places "
    "brighter or darker"
)

# Of datablocks, in the order of the report; "" is what holds for the scene as a whole.
KINDS = ("", "camera", "world", "light", "object", "material", "image", "library", "view layer")

# A name as Python writes it: with an apostrophe in it, between double quotes.
QUOTED = r"""(?:'(?:[^'\\]|\\.)*'|"(?:[^"\\]|\\.)*")"""

# Names inside of a text, without which many notes say the same.
_NAMED = re.compile(rf"\b(image|node group|particle system) {QUOTED}")


class Note(NamedTuple):
    """`what` is true of the datablock `name` of that kind."""

    level: str
    kind: str
    name: str
    what: str

    @property
    def sentence(self) -> str:
        return f"{self.kind} {self.name!r}: {self.what}" if self.kind else self.what


class Group(NamedTuple):
    """The same, true of several datablocks; `names` is empty for what holds for the scene as a whole."""

    level: str
    kind: str
    what: str
    names: tuple[str, ...]


class Notes:
    """Collects the notes of one export."""

    def __init__(self) -> None:
        self._notes: dict[Note, None] = {}

    def add(self, level: str, kind: str, name: str, what: str) -> None:
        self._notes[Note(level, kind, name, what)] = None

    def skip(self, kind: str, name: str, why: str) -> None:
        """Left out because it can't change the picture."""
        self.add(SKIPPED, kind, name, why)

    def warn(self, kind: str, name: str, what: str) -> None:
        """The picture will not show it as asked."""
        self.add(WARNING, kind, name, what)

    def approximate(self, kind: str, name: str, what: str) -> None:
        """The picture will show it nearly as asked."""
        self.add(APPROXIMATED, kind, name, what)

    def warn_scene(self, what: str) -> None:
        self.add(WARNING, "", "", what)

    def fail(self, what: str) -> None:
        """Nothing can be rendered."""
        self.add(ERROR, "", "", what)

    @contextlib.contextmanager
    def recorded(self) -> Iterator[Notes]:
        """Notes of their own, for what is kept with them, which are added to these at the end."""
        own = Notes()
        try:
            yield own
        finally:
            self.again(own.all)

    def again(self, notes: Iterable[Note]) -> None:
        """What an export before has said, and this one does too."""
        self._notes.update(dict.fromkeys(notes))

    def alike(self, known: dict, key: Hashable, name: str, find: Callable[[Notes], T]) -> T:
        """What `find` gives for the first datablock of that `key`; what it noted of this one is said of each other, by
        its `name`."""
        if key not in known:
            with self.recorded() as own:
                found = find(own)
            known[key] = found, own.all
            return found
        found, said = known[key]
        if said:
            self.again(note._replace(name=name) for note in said)
        return found

    @property
    def all(self) -> list[Note]:
        return list(self._notes)

    @property
    def skipped(self) -> list[str]:
        """Sentences, for `Scene.skipped`."""
        return [note.sentence for note in self._notes if note.level == SKIPPED]

    @property
    def warnings(self) -> list[str]:
        """Sentences, for `Scene.warnings`."""
        return [note.sentence for note in self._notes if note.level in (WARNING, APPROXIMATED)]


def importance(note: Note | Group) -> tuple[int, bool]:
    """To sort by: what matters most comes first."""
    return LEVELS.index(note.level), note.what == PRINCIPLED_GLOSS


def grouped(notes: Iterable[Note]) -> list[Group]:
    """Equal notes of different datablocks become one, by importance, kind and number.

    What differs in nothing but the name of an image, a node group or a particle system is the same: "image '...'".
    """
    texts: dict[tuple[str, str, str], dict[str, None]] = {}
    names: dict[tuple[str, str, str], dict[str, None]] = {}
    for note in notes:
        key = note.level, note.kind, _NAMED.sub(r"\1 '...'", note.what)
        texts.setdefault(key, {})[note.what] = None
        names.setdefault(key, {})[note.name] = None
    groups = []
    for key, of_datablocks in names.items():
        level, kind, general = key
        what = next(iter(texts[key])) if len(texts[key]) == 1 else general
        groups.append(Group(level, kind, what, tuple(of_datablocks) if kind else ()))
    return sorted(groups, key=lambda group: (*importance(group), KINDS.index(group.kind), -len(group.names)))
