"""What went wrong, in words for the user: the same after F12, in a check, in a viewport and in the tools."""

from __future__ import annotations

from ..engine import LobeError


def is_defect(error: BaseException) -> bool:
    """Whether it is Lobe that is at fault, so that the console should have the whole of it."""
    return not isinstance(error, LobeError | MemoryError)


def blender_message(error: RuntimeError) -> str:
    """The text of what `bpy.ops` raises, in one line: without its "Error: " and its place in a file of Python."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip() and not line.startswith("Location:")]
    return " ".join(line.removeprefix("Error: ") for line in lines)


def message_of(error: BaseException) -> str:
    """With what it happened at, where the export knows that (see `export/faults.py`)."""
    if isinstance(error, MemoryError):  # where nothing more is known: most places raise a LobeError for it
        return "not enough memory: close other programs, or show fewer objects"
    if not is_defect(error):
        return str(error)
    what = (str(error).splitlines() or [""])[0]  # of a compiler's error the rest is pages
    place = f" at {error.lobe_place}" if hasattr(error, "lobe_place") else ""
    return f"Lobe failed{place} ({type(error).__name__}: {what}). This is a bug: the console has the details"
