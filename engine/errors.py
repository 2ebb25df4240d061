"""The errors that Lobe raises on purpose. Their text is for the user: what is wrong, where, and what to do."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator


class LobeError(Exception):
    """Base of every error whose message may be shown to the user as it stands."""


class SceneError(LobeError):
    """The scene description cannot be rendered: names the object at fault."""


class SettingsError(LobeError):
    """A render setting is out of its range: names the setting."""


@contextlib.contextmanager
def told_of_memory() -> Iterator[None]:
    """Where there is too little of it in here, the error says what the user can do."""
    try:
        yield
    except MemoryError as error:
        from .memory import ADVICE

        raise LobeError(f"not enough memory to render this scene: {ADVICE}") from error
