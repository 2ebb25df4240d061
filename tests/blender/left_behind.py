"""All that an add-on may leave behind in Blender. Also used by scripts that run in a Blender program, by themselves."""

from __future__ import annotations

import os
import sys
import threading
from pathlib import Path

import bpy

MODULE = "bl_ext.user_default.lobe"


def snapshot() -> dict[str, object]:
    """As JSON takes it."""
    menu = bpy.types.NODE_MT_category_shader_shader
    panels = [cls for cls in _subclasses(bpy.types.Panel) if hasattr(cls, "COMPAT_ENGINES")]
    handlers = [getattr(bpy.app.handlers, name) for name in dir(bpy.app.handlers)]
    image_planes = sys.modules.get("bl_operators.image_as_planes")
    users_own = bpy.utils.user_resource("SCRIPTS")  # presets that the user has saved stay
    return {
        "types": sorted(name for name in dir(bpy.types) if "lobe" in name.lower()),
        "property": any(hasattr(owner, "lobe") for owner in (bpy.types.Scene, bpy.types.ViewLayer)),
        "panels": sorted({cls.__name__ for cls in panels if "LOBE" in cls.COMPAT_ENGINES and cls.is_registered}),
        "menu": len(getattr(menu.draw, "_draw_funcs", [menu.draw])),
        "image planes": "LOBE" in getattr(image_planes, "COMPATIBLE_ENGINES", ()),
        "handlers": [len(value) for value in handlers if isinstance(value, list)],
        "engine": any(
            getattr(cls, "bl_idname", "") == "LOBE" and cls.is_registered
            for cls in bpy.types.RenderEngine.__subclasses__()
        ),
        "timers": sorted(name for name, function in _functions() if bpy.app.timers.is_registered(function)),
        "presets": sorted(path for path in bpy.utils.preset_paths("lobe/sampling") if not path.startswith(users_own)),
        "process": _children(),
        "threads": sorted(thread.name for thread in threading.enumerate() if thread.name.lower().startswith("lobe")),
        "variables": sorted(name for name in os.environ if name.startswith("LOBE_")),
    }


def _subclasses(cls: type):
    for sub in cls.__subclasses__():
        yield sub
        yield from _subclasses(sub)


def _functions():
    """Of all the add-on's modules, each with its name: Blender doesn't tell which timers there are."""
    for name, module in list(sys.modules.items()):
        if name.startswith(f"{MODULE}.addon"):
            yield from ((f"{name}.{key}", value) for key, value in vars(module).items() if callable(value))


def _children() -> list[int]:
    """Processes that this one has started and that are still there; an empty list where the system doesn't tell."""
    found = Path("/proc/self/task").glob("*/children")
    return sorted(int(number) for path in found for number in path.read_text().split())
