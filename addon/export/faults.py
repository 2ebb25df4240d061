"""What goes wrong in an export, with the name of what it went wrong with."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from ...engine import LobeError


@contextlib.contextmanager
def naming(kind: str, name: str) -> Iterator[None]:
    """Whatever fails here is about the datablock `name` of that kind; the innermost one is told.
    The exception gets it as an attribute, `lobe_place`: "object 'Cube'"."""
    try:
        yield
    except MemoryError as error:
        raise LobeError(
            f"{kind} {name!r}: not enough memory to export it: use fewer faces, for instance with lower levels of "
            "subdivision, or smaller images"
        ) from error
    except Exception as error:
        if not hasattr(error, "lobe_place"):
            error.lobe_place = f"{kind} {name!r}"
        raise
