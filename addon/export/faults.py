"""What goes wrong in an export, with the name of what it went wrong with."""

from __future__ import annotations

from typing import Literal

from ...engine import LobeError


class naming:
    """Whatever fails in this context is about the datablock `name` of that kind; the innermost one is told.
    The exception gets it as an attribute, `lobe_place`: "object 'Cube'". Entered for each of maybe many thousand."""

    __slots__ = ("_kind", "_name")

    def __init__(self, kind: str, name: str) -> None:
        self._kind, self._name = kind, name

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind, error, trace) -> Literal[False]:
        if isinstance(error, MemoryError):
            raise LobeError(
                f"{self._kind} {self._name!r}: not enough memory to export it: use fewer faces, for instance with "
                "lower levels of subdivision, or smaller images"
            ) from error
        if isinstance(error, Exception) and not hasattr(error, "lobe_place"):
            error.lobe_place = f"{self._kind} {self._name!r}"
        return False
