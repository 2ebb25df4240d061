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

sys.path.insert(0, str(Path(__file__).parent))  # where `left_behind` is copied to, too
SEEN: dict = {"threads": {}, "picture": {}, "milliseconds": {}, "standstill": {}, "exports": {}, "draws": {}}
PATIENCE = 240.0  # seconds: the first step compiles
EDITS = (210, 1008)  # after which memory is measured: multiples of 14, which leave the scene as it was
made: list = []  # (time, Picture) of every picture that was rendered
drawn: list = []  # (time, Picture) of every picture that was new when it was drawn
draws: list = []  # (Picture, width and height of the region) of every time that Blender drew
exports: list = []  # a list of instances for each time that all of them were walked
icons: list = []  # the names of what `Session` rendered as previews
looks: list = []  # a function for each time that somebody wants the region's pixels, scene-linear, as drawn next


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
    """Note every new picture, when it is there and when it is drawn, and the region's pixels for who wants them."""
    from bl_ext.user_default.lobe.addon.draw import Drawing
    from bl_ext.user_default.lobe.engine import Interactive

    whole, publish = Drawing.draw, Interactive._publish

    def published(self, picture):
        made.append((time.perf_counter(), picture))
        return publish(self, picture)

    def draw(self, picture, view):
        new = picture is not self._picture
        whole(self, picture, view)
        draws.append((picture, (view.width, view.height)))
        if new:
            drawn.append((time.perf_counter(), picture))
        if looks:  # it takes the graphics card long
            buffer = gpu.state.active_framebuffer_get().read_color(0, 0, view.width, view.height, 4, 0, "FLOAT")
            buffer.dimensions = view.width * view.height * 4  # as numpy takes it otherwise its axes are mixed up
            looks.pop()(np.array(buffer, np.float32).reshape(view.height, view.width, 4))

    Drawing.draw, Interactive._publish = draw, published


def watch_exports() -> None:
    """Count the walks over the scene's objects, and the icons that Lobe renders."""
    from bl_ext.user_default.lobe.addon.export.instances import Placement
    from bl_ext.user_default.lobe.addon.session import Session

    collect, render = Placement._collect, Session.render

    def collected(self, items):
        exports.append(collect(self, items))
        return exports[-1]

    def rendered(self, report):
        render(self, report)
        if self.engine.is_preview and self.scene is not None:
            icons.append([material.name for material in self.scene.materials])

    Placement._collect, Session.render = collected, rendered


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
    first, first_made, first_draw, first_export = len(drawn), len(made), len(draws), len(exports)
    begun = time.perf_counter()
    change()
    redraw()
    SEEN["standstill"][name] = yield from until(lambda: len(drawn) > first)
    times = {"made": made[first_made][0], "drawn": drawn[first][0]}
    SEEN["milliseconds"][name] = {what: 1e3 * (when - begun) for what, when in times.items()}
    yield from until(finished)
    yield 0.5  # so that it is drawn, too
    picture = drawn[-1][1]
    pixels: list[np.ndarray] = []
    looks.append(pixels.append)
    redraw()
    yield from until(lambda: pixels)
    SEEN["picture"][name] = {
        "size": picture.size,
        "region": picture.region,
        "samples": picture.samples,
        "mean": picture.pixels.mean(axis=(0, 1)).tolist(),
        "seen": pixels[0][..., :3].mean(axis=(0, 1)).tolist(),
    }
    SEEN["threads"][name] = threads()
    SEEN["exports"][name] = len(exports) - first_export
    SEEN["draws"][name] = [(old is drawn[first - 1][1] if first else False, size) for old, size in draws[first_draw:]]


def redraw() -> None:
    for area in areas():
        area.tag_redraw()


def make_scene(rings: int) -> None:
    scene = bpy.context.scene
    scene.render.engine = "LOBE"
    scene.lobe.viewport_samples = 8
    bpy.ops.mesh.primitive_uv_sphere_add(segments=2 * rings, ring_count=rings, location=(2.5, 0, 0.5))
    bpy.ops.mesh.primitive_plane_add(size=20, location=(0, 0, -1))
    bpy.data.materials["Material"].use_nodes = True
    SEEN["blender"] = bpy.app.version_string
    SEEN["triangles"] = sum(len(face.vertices) - 2 for data in bpy.data.meshes for face in data.polygons)


def orbit(name: str, seconds: float):
    """Turn the view at every tick; how many pictures in a second were rendered, how many drawn, and how often Blender
    drew at all."""
    view = areas()[0].spaces.active.region_3d
    first, first_made, begun, ticks = len(drawn), len(made), time.perf_counter(), 0
    while time.perf_counter() - begun < seconds:
        view.view_rotation = Quaternion((0, 0, 1), 0.01) @ view.view_rotation
        ticks += 1
        yield 0.01
    counts = {"drawn": len(drawn) - first, "made": len(made) - first_made, "ticks": ticks}
    SEEN[name] = {what: count / seconds for what, count in counts.items()}


def edit(number: int) -> None:
    """One of all kinds that a viewport hears of, in turn, each back and forth."""
    data, scene, high = bpy.data, bpy.context.scene, (number // 7 + 1) % 2
    view = areas()[0].spaces.active.region_3d
    kinds = [
        lambda: setattr(data.objects["Sphere"], "location", (2.5, 0, 0.5 + 0.1 * high)),
        lambda: setattr(socket("Material", "Base Color"), "default_value", (1.0, 0.5 * high, 0.0, 1.0)),
        lambda: setattr(data.lights[0], "energy", 3000.0 + 100.0 * high),
        lambda: setattr(data.worlds[0].node_tree.nodes["Background"].inputs["Strength"], "default_value", 1 + high),
        lambda: data.objects["Cube"].hide_set(bool(high)),
        lambda: setattr(scene.lobe, "max_bounces", 3 + high),
        lambda: setattr(view, "view_distance", view.view_distance * (1.01 if high else 1 / 1.01)),
    ]
    kinds[number % len(kinds)]()


def edits(count: int):
    """Each as soon as the one before is in a picture. How much memory is in use afterwards, in MB."""
    from bl_ext.user_default.lobe.addon.memory import current_and_peak_mb

    for number in range(count):
        before = len(made)
        edit(number)
        redraw()
        yield from until(lambda before=before: len(made) > before)
        for pictures in (made, drawn, draws, exports):  # they would hold every picture
            del pictures[:-2]
    yield from until(finished)
    return current_and_peak_mb()[0]


def socket(material: str, name: str):
    return bpy.data.materials[material].node_tree.nodes["Principled BSDF"].inputs[name]


def steps():
    bpy.context.preferences.view.show_splash = False
    make_scene(int(sys.argv[-1]))
    watch_drawing()
    watch_exports()
    SEEN["threads"]["before"] = threads()
    view, data = areas()[0].spaces.active.region_3d, bpy.data
    yield from orbit("orbit in Solid", 3.0)
    yield from step("rendered", lambda: shading("RENDERED"))
    yield from step("moved", lambda: setattr(view, "view_distance", view.view_distance * 0.8))
    yield from orbit("orbit", 3.0)
    yield from until(finished)
    red = (1.0, 0.0, 0.0, 1.0)
    yield from step("material", lambda: setattr(socket("Material", "Base Color"), "default_value", red))
    yield from step("lamp", lambda: setattr(data.lights[0], "energy", 3 * data.lights[0].energy))
    yield from step("hidden", lambda: data.objects["Plane"].hide_set(True))
    yield from step("shown", lambda: data.objects["Plane"].hide_set(False))
    yield from step("samples", lambda: setattr(bpy.context.scene.lobe, "viewport_samples", 12))
    yield from step("camera", lambda: setattr(view, "view_perspective", "CAMERA"))
    yield from step("frame", lambda: setattr(bpy.context.scene.camera.data, "passepartout_alpha", 1.0))
    yield from step("orthographic", lambda: setattr(view, "view_perspective", "ORTHO"))
    SEEN["memory"] = []
    for count in EDITS:
        SEEN["memory"].append((yield from edits(count)))
    yield from step("resized", split)
    begun = time.process_time()
    yield 2.0
    SEEN["idle"] = (time.process_time() - begun) / 2.0
    bad = socket("Material", "Emission Strength")
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
    yield from on_and_off()


def previews():
    """The icons of a material and a world: how much their pixels vary, which those of an empty one don't."""
    SEEN["preview"], SEEN["icons"] = {}, {}
    for datablock in (bpy.data.materials["Material"], bpy.data.worlds[0]):
        before = len(icons)
        with bpy.context.temp_override(id=datablock):
            bpy.ops.ed.lib_id_generate_preview()

        def pixels(datablock=datablock) -> np.ndarray:
            preview = datablock.preview_ensure()
            return np.array(preview.image_pixels_float[:], np.float32)

        begun = time.perf_counter()
        while not (len(icons) > before and pixels().std() > 0.01) and time.perf_counter() - begun < 60:
            yield 0.1
        yield 1.0
        # While an engine's Python runs, on whatever thread, Blender lets no other call operators.
        yield from until(lambda: not bpy.app.is_job_running("RENDER_PREVIEW"))
        SEEN["preview"][datablock.name] = float(pixels().std())
        SEEN["icons"][datablock.name] = icons[before:]


def on_and_off():
    """Twenty times, the last ones with a viewport that Lobe renders."""
    import addon_utils
    from left_behind import MODULE, snapshot

    addon_utils.disable(MODULE)
    yield 0.5
    SEEN["before"] = snapshot()
    for number in range(20):
        addon_utils.enable(MODULE, default_set=True)
        if number >= 15:
            bpy.context.window_manager.windows[0].scene.render.engine = "LOBE"
            shading("RENDERED")
            yield 0.5
        if number in (0, 15):
            SEEN["enabled" if number == 0 else "rendering"] = snapshot()
        addon_utils.disable(MODULE)
        yield 0.1
        shading("SOLID")
    yield 1.0
    SEEN["after"] = snapshot()


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
