"""Side by side with Cycles: the same scene by both engines, what differs, and who is the faster at equal error.

`run` makes the renders and the figures, `headline` says what they come to, `page` is the HTML; `operators` is the
button, tools/compare.py the command.
"""

from __future__ import annotations

from .headline import headline_of
from .operators import register, unregister
from .page import difference_rows, engine_rows, html
from .run import CompareError, Comparison, Outcome, Stopped

__all__ = [
    "CompareError",
    "Comparison",
    "Outcome",
    "Stopped",
    "difference_rows",
    "engine_rows",
    "headline_of",
    "html",
    "register",
    "unregister",
]
