"""What the user has to be told about an export. Each sentence is kept once, in the order of its first appearance."""

from __future__ import annotations


class Notes:
    """Collects sentences for `Scene.skipped` and `Scene.warnings`.

    skipped   left out because it can't change the picture
    warnings  the picture will not show it as asked
    """

    def __init__(self) -> None:
        self._skipped: dict[str, None] = {}
        self._warnings: dict[str, None] = {}

    def skip(self, kind: str, name: str, why: str) -> None:
        self._skipped[f"{kind} '{name}': {why}"] = None

    def warn(self, kind: str, name: str, what: str) -> None:
        self._warnings[f"{kind} '{name}': {what}"] = None

    def warn_scene(self, what: str) -> None:
        self._warnings[what] = None

    @property
    def skipped(self) -> list[str]:
        return list(self._skipped)

    @property
    def warnings(self) -> list[str]:
        return list(self._warnings)
