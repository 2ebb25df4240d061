"""Lobe, a path tracer for Blender. This is the extension's entry: Blender calls `register` and `unregister`.

Importing it loads nothing: the engine alone is `import engine` from the repository's root.
"""

from __future__ import annotations


def register() -> None:
    from . import addon

    addon.register()


def unregister() -> None:
    from . import addon

    addon.unregister()
