"""What `test_viewport_window.py` does in a Blender with a window, step by step, between which Blender goes on.

What was seen is written beside this file, as JSON; the last argument is the number of rings of a ball.
"""

from __future__ import annotations

import json
import sys
import threading
import time
import traceback
from pathlib import Path

import bpy
import gpu
import numpy as np
from mathutils import Quaternion

SEEN: dict = {"threads": {}, "picture": {}, "milliseconds": {}, "standstill": {}}
PATIENCE = 240.0  # seconds: the first step compiles
drawn: list = []  # (time, Picture) of every picture that was new when it was drawn
view_pixels: list[np.ndarray] = []  # of the region as it was drawn last, scene-linear


def threads() -> list[str]:
    return sorted(thread.name for thread in threading.enumerate() if thread.name.startswith("Lobe"))


def problems() -> list[str]:
    """What is written into the viewports instead of a picture."""
    from bl_ext.user_default.lobe.addon.render_engine import _viewports

    return [viewport._problem or viewport._failure() for viewport in _viewports]


def areas() -> list:
    return [area for area in bpy.context.window_manager.windows[0].screen.areas if area.type == "VIEW_3D"]


def shading(kind: str) -> None:
    for area in areas():
        area.spaces.active.shading.type = kind


def watch_drawing() -> None:
    """Note every new picture, and the pixels of the region."""
    from bl_ext.user_default.lobe.addon.draw import Drawing

    whole = Drawing.draw

    def draw(self, picture, view):
        new = picture is not self._picture
        whole(self, picture, view)
        if new:
            drawn.append((time.perf_counter(), picture))
        buffer = gpu.state.active_framebuffer_get().read_color(0, 0, view.width, view.height, 4, 0, "FLOAT")
        buffer.dimensions = view.width * view.height * 4  # as numpy takes it otherwise its axes are mixed up
        view_pixels[:] = [np.array(buffer, np.float32).reshape(view.height, view.width, 4)]

    Drawing.draw = draw


def until(condition):
    """Gives back how long Blender stood still at most, in seconds: nothing else is called meanwhile."""
    begun = last = time.perf_counter()
    longest = 0.0
    while not condition():
        if time.perf_counter() - begun > PATIENCE:
            raise TimeoutError(threads())
        yield 0.005
        longest, last = max(longest, time.perf_counter() - last), time.perf_counter()
    return longest


def finished() -> bool:
    return bool(drawn) and drawn[-1][1].samples == drawn[-1][1].total


def step(name: str, change):
    """Change something, wait for its first picture and its last, and note what is seen."""
    print("step", name, flush=True)
    first, begun = len(drawn), time.perf_counter()
    change()
    for area in areas():
        area.tag_redraw()
    SEEN["standstill"][name] = yield from until(lambda: len(drawn) > first)
    SEEN["milliseconds"][name] = 1e3 * (drawn[first][0] - begun)
    yield from until(finished)
    yield 0.5  # so that it is drawn, too
    picture = drawn[-1][1]
    SEEN["picture"][name] = {
        "size": picture.size,
        "region": picture.region,
        "samples": picture.samples,
        "mean": picture.pixels.mean(axis=(0, 1)).tolist(),
        "seen": view_pixels[0][..., :3].mean(axis=(0, 1)).tolist(),
    }
    SEEN["threads"][name] = threads()


def make_scene(rings: int) -> None:
    scene = bpy.context.scene
    scene.render.engine = "LOBE"
    scene.lobe.viewport_samples = 8
    bpy.ops.mesh.primitive_uv_sphere_add(segments=2 * rings, ring_count=rings, location=(2.5, 0, 0.5))
    bpy.ops.mesh.primitive_plane_add(size=20, location=(0, 0, -1))
    bpy.data.materials["Material"].use_nodes = True


def orbit(seconds: float):
    """Turn the view at every tick; how many new pictures there were in a second, and how often Blender drew."""
    view = areas()[0].spaces.active.region_3d
    first, begun, ticks = len(drawn), time.perf_counter(), 0
    while time.perf_counter() - begun < seconds:
        view.view_rotation = Quaternion((0, 0, 1), 0.01) @ view.view_rotation
        ticks += 1
        yield 0.01
    SEEN["orbit"] = {"updates": (len(drawn) - first) / seconds, "ticks": ticks / seconds}


def steps():
    bpy.context.preferences.view.show_splash = False
    make_scene(int(sys.argv[-1]))
    watch_drawing()
    SEEN["threads"]["before"] = threads()
    view, data = areas()[0].spaces.active.region_3d, bpy.data
    yield from step("rendered", lambda: shading("RENDERED"))
    yield from step("moved", lambda: setattr(view, "view_distance", view.view_distance * 0.8))
    yield from orbit(3.0)
    yield from until(finished)
    inputs = data.materials["Material"].node_tree.nodes["Principled BSDF"].inputs
    yield from step("material", lambda: setattr(inputs["Base Color"], "default_value", (1.0, 0.0, 0.0, 1.0)))
    yield from step("lamp", lambda: setattr(data.lights[0], "energy", 3 * data.lights[0].energy))
    yield from step("hidden", lambda: data.objects["Plane"].hide_set(True))
    yield from step("shown", lambda: data.objects["Plane"].hide_set(False))
    yield from step("samples", lambda: setattr(bpy.context.scene.lobe, "viewport_samples", 12))
    yield from step("camera", lambda: setattr(view, "view_perspective", "CAMERA"))
    yield from step("frame", lambda: setattr(bpy.context.scene.camera.data, "passepartout_alpha", 1.0))
    yield from step("orthographic", lambda: setattr(view, "view_perspective", "ORTHO"))
    yield from step("resized", split)
    begun = time.process_time()
    yield 2.0
    SEEN["idle"] = (time.process_time() - begun) / 2.0
    bad = data.materials["Material"].node_tree.nodes["Principled BSDF"].inputs["Emission Strength"]
    bad.default_value = 1e35
    yield 1.0
    SEEN["problem"] = problems()
    bad.default_value = 0.0
    yield 1.0
    SEEN["problem after"] = problems()
    shading("SOLID")
    yield 1.0
    SEEN["threads"]["left"] = threads()
    yield from step("again", lambda: setattr(areas()[0].spaces.active.shading, "type", "RENDERED"))
    yield from previews()
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=False)
    yield 1.0
    SEEN["threads"]["another file"] = threads()


def previews():
    """The icons of a material and a world: how much their pixels vary, which those of an empty one don't."""
    SEEN["preview"] = {}
    for datablock in (bpy.data.materials["Material"], bpy.data.worlds[0]):
        with bpy.context.temp_override(id=datablock):
            bpy.ops.ed.lib_id_generate_preview()

        def pixels(datablock=datablock) -> np.ndarray:
            preview = datablock.preview_ensure()
            return np.array(preview.image_pixels_float[:], np.float32)

        begun = time.perf_counter()
        while not np.any(pixels()) and time.perf_counter() - begun < 60:
            yield 0.1
        yield 1.0
        SEEN["preview"][datablock.name] = float(pixels().std())


def split() -> None:
    area = areas()[0]
    region = next(region for region in area.regions if region.type == "WINDOW")
    with bpy.context.temp_override(window=bpy.context.window_manager.windows[0], area=area, region=region):
        bpy.ops.screen.area_split(direction="VERTICAL", factor=0.6)
    areas()[-1].spaces.active.shading.type = "SOLID"


def run() -> None:
    going = steps()

    def tick() -> float | None:
        try:
            return next(going)
        except StopIteration:
            pass
        except Exception:
            SEEN["error"] = traceback.format_exc()
        Path(__file__).with_suffix(".json").write_text(json.dumps(SEEN))
        bpy.ops.wm.quit_blender()
        return None

    bpy.app.timers.register(tick, first_interval=1.0, persistent=True)


run()
