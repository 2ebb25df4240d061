"""Cycles as Lobe's peer, for the tools: the names of addon/compare/peer.py, of the extension as it is installed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

ADDON = Path(__file__).resolve().parent.parent / "addon"
SOURCES = (ADDON / "compare" / "peer.py", ADDON / "phong_mark.py")  # what Cycles' renders depend on


def __getattr__(name: str) -> Any:
    """Looked up when used: the tools are imported before `enable_lobe` has made the extension ready."""
    if name.startswith("__"):
        raise AttributeError(name)
    from bl_ext.user_default.lobe.addon.compare import peer

    return getattr(peer, name)
