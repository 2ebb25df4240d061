"""Cancelling an export: what is exported asks `Stop.check` before each step that can take long."""

from __future__ import annotations

from collections.abc import Callable

ITEMS_A_CHECK = 1024  # of instances: a few milliseconds


class ExportStopped(Exception):
    """The caller's `stop` said so."""


class Stop:
    """Blender's answer costs a microsecond: once for every mesh, image and thousandth instance is nothing."""

    def __init__(self, stop: Callable[[], bool] | None = None) -> None:
        self.ask = stop

    def check(self) -> None:
        """Raises ExportStopped once the user has cancelled."""
        if self.ask is not None and self.ask():
            raise ExportStopped
