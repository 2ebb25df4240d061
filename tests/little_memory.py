"""A computer with little memory left."""

from __future__ import annotations


def leave(monkeypatch, memory, room: float) -> None:
    """So many bytes can be had, and every need is held against them, however small. memory: the module."""
    monkeypatch.setattr(memory, "SMALL", 0)
    monkeypatch.setattr(memory, "available", lambda: room)
