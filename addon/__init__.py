"""The Blender side of Lobe: the render engine, its settings and panels, and the export of the scene.

Registering must stay quick: nothing in here imports Numba or a kernel before the first render.
"""

from __future__ import annotations

from . import check, compare, passes, phong_group, precompile, properties, render_engine, render_slots, scene_report, ui

# Unregistered from the last to the first: viewports, which render_engine closes, compile by precompile's process until
# then, not in this one.
_PARTS = (properties, passes, phong_group, scene_report, render_slots, check, compare, precompile, render_engine, ui)


def register() -> None:
    done = []
    try:
        for part in _PARTS:
            part.register()
            done.append(part)
    except Exception:
        # Half an add-on would be left behind: Blender doesn't call unregister when register fails.
        for part in reversed(done):
            part.unregister()
        raise


def unregister() -> None:
    for part in reversed(_PARTS):
        part.unregister()
