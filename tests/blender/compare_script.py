"""What `test_compare_window.py` does in a Blender with a window: a comparison to its end, and one with Escape.

What was seen is written beside this file, as JSON.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import time
import traceback
from pathlib import Path

import bpy

SEEN: dict = {}
PATIENCE = 240.0  # seconds: the first render compiles


def settings() -> list:
    from bl_ext.user_default.lobe.addon.compare import peer

    scene = bpy.context.scene
    values = [getattr(scene.cycles, key) for key in ("samples", "seed", "use_adaptive_sampling", "max_bounces")]
    values += [getattr(scene.lobe, key) for key in ("samples", "seed", "time_limit")]
    lists = ("render_init", "render_cancel", "render_stats", "save_pre", "save_post", "undo_post")
    handlers = [len(getattr(bpy.app.handlers, name)) for name in lists]
    terminator = peer.shadow_terminator(bpy.data.objects["Cube"]).shadow_terminator_geometry_offset
    return [*values, scene.render.engine, scene.render.use_compositing, terminator, handlers]


def rendering() -> bool:
    return bpy.app.is_job_running("RENDER")


def until(condition):
    begun = time.perf_counter()
    while not condition():
        if time.perf_counter() - begun > PATIENCE:
            raise TimeoutError
        yield 0.05


def running() -> bool:
    window = bpy.context.window_manager.windows[0]
    return any(operator.bl_idname == "LOBE_OT_compare_with_cycles" for operator in window.modal_operators)


def listeners() -> list[list[str]]:
    """The operators of Lobe's that take the events of each window."""
    return [
        [operator.bl_idname for operator in window.modal_operators if operator.bl_idname.startswith("LOBE_")]
        for window in bpy.context.window_manager.windows
    ]


def xdotool(*arguments: str) -> str:
    return subprocess.check_output(["xdotool", *arguments], text=True)


def press() -> None:
    window = bpy.context.window_manager.windows[0]
    with bpy.context.temp_override(window=window, area=window.screen.areas[0]):
        SEEN["returned"] = sorted(bpy.ops.lobe.compare_with_cycles("INVOKE_DEFAULT"))


def steps():
    from bl_ext.user_default.lobe.addon.compare import operators

    scene = bpy.context.scene
    scene.render.engine = "LOBE"
    scene.render.resolution_x, scene.render.resolution_y = 64, 48
    scene.lobe.samples = 8
    before = settings()
    press()
    yield from until(rendering)
    SEEN["changed meanwhile"] = settings() != before
    SEEN["said meanwhile"] = operators.running()
    yield 0.3
    SEEN["held meanwhile"] = listeners()
    yield from until(lambda: not running())
    SEEN["as before"] = settings() == before
    SEEN["said afterwards"] = operators.running()
    outcome = operators.outcome_of(scene)
    SEEN["size"], SEEN["noise"] = outcome.size, [outcome.figures.noise_lobe, outcome.figures.noise_cycles]
    editors = [a for w in bpy.context.window_manager.windows for a in w.screen.areas if a.type == "IMAGE_EDITOR"]
    SEEN["shown"] = [area.spaces.active.image.name for area in editors if area.spaces.active.image]
    yield 0.3
    SEEN["held afterwards"] = listeners()
    SEEN["slots"] = [slot.name for slot in bpy.data.images["Render Result"].render_slots]
    yield 0.5
    if shutil.which("xdotool"):
        scene.render.resolution_x, scene.render.resolution_y = 640, 480
        scene.lobe.samples = 4096
        operators._outcomes.clear()
        bpy.ops.ed.undo_push(message="The settings")
        scene.lobe.seed = 5
        bpy.ops.ed.undo_push(message="The seed")
        before = settings()
        press()
        yield from until(rendering)
        yield 1.0
        during, undone = settings(), []
        bpy.app.handlers.undo_post.append(lambda *_: undone.append(True))
        focused = xdotool("getwindowfocus")
        for window in xdotool("search", "--onlyvisible", "--name", "Blender").split():
            xdotool("windowfocus", window, "sleep", "0.2", "key", "ctrl+z")
            yield 0.5
        xdotool("windowfocus", focused.strip(), "sleep", "0.2")
        bpy.app.handlers.undo_post.pop()
        SEEN["undo"] = {"heard": bool(undone), "changed": settings() != during, "running": running()}
        xdotool("key", "Escape")
        begun = time.perf_counter()
        yield from until(lambda: not running())
        SEEN["escape"] = {
            "seconds": time.perf_counter() - begun,
            "as before": settings() == before,
            "outcome": operators.outcome_of(scene) is not None,
        }


def run():
    """A timer of Blender's: each step of the generator gives the seconds until the next."""
    try:
        return next(RUN)
    except StopIteration:
        pass
    except Exception:
        SEEN["error"] = traceback.format_exc()
    Path(__file__).with_suffix(".json").write_text(json.dumps(SEEN))
    bpy.ops.wm.quit_blender()


RUN = steps()
if "--" in sys.argv:
    bpy.app.timers.register(run, first_interval=2.0)
