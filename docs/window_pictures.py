"""The documentation's pictures of Blender with Lobe in it. In a Blender with a window and Lobe installed:

    blender --window-geometry 0 0 1180 880 --python docs/window_pictures.py -- FILE.blend FOLDER

FILE is sample_blends/world.blend; FOLDER gets the pictures, which go into docs/images/. Needs ImageMagick and xdotool.
"""

from __future__ import annotations

import subprocess
import sys
import traceback
from pathlib import Path

import bpy

FILE, FOLDER = sys.argv[-2:]
PATIENCE = 400  # seconds, for the viewport
WIDER, HIGHER = 90, 200  # pixels that the properties get on top


def window():
    return bpy.context.window_manager.windows[0]


def area(kind: str):
    return max((a for a in window().screen.areas if a.type == kind), key=lambda a: a.width * a.height)


def handle() -> str:
    """The display's number of Blender's window."""
    search = ["xdotool", "search", "--onlyvisible", "--name", "Blender"]
    return subprocess.run(search, capture_output=True, text=True).stdout.split()[0]


def drag(x: int, y: int, right: int, up: int):
    """With the mouse, from a place in the window, which is measured from its lower left corner."""
    for part, action in ((0.0, "mousedown"), (0.5, ""), (1.0, "mouseup")):
        place = round(x + part * right), round(window().height - y - part * up)
        subprocess.Popen(["xdotool", "mousemove", "--window", handle(), *map(str, place)])
        yield 0.5
        if action:
            subprocess.Popen(["xdotool", action, "1"])
        yield 0.5


def shoot(name: str, left: int, bottom: int, width: int, height: int, scale: str = "100%") -> None:
    """Part of the window, which is measured from its lower left corner, in few colours."""
    part = f"{width}x{height}+{left}+{window().height - bottom - height}"
    path = Path(FOLDER) / f"{name}.png"
    options = ["-crop", part, "+repage", "-resize", scale, "+dither", "-colors", "96", "-strip"]
    subprocess.run(["import", "-window", handle(), *options, path], check=True)


def show(kind: str, height: int) -> None:
    """The upper part of the properties."""
    properties = area("PROPERTIES")
    shoot(kind, properties.x, properties.y + properties.height - height, properties.width, height)


def watch_drawing() -> list:
    """A list that gets every picture that is drawn in the viewport."""
    from bl_ext.user_default.lobe.addon.draw import Drawing

    drawn, whole = [], Drawing.draw

    def draw(self, picture, view):
        drawn.append(picture)
        whole(self, picture, view)

    Drawing.draw = draw
    return drawn


def open_panels() -> None:
    """The Scene Report, and what Lobe makes of a material, before Blender has drawn them."""
    ui = sys.modules["bl_ext.user_default.lobe.addon.ui"]
    for cls in reversed(ui._CLASSES):
        bpy.utils.unregister_class(cls)
    for cls in (ui.report_panel.LOBE_RENDER_PT_scene_report, ui.material_panels.LOBE_MATERIAL_PT_understood):
        cls.bl_options = set()
    for cls in ui._CLASSES:
        bpy.utils.register_class(cls)


def add_glass() -> None:
    """Something for the Scene Report."""
    for name in ("Window", "Bottle"):
        material = bpy.data.materials.new(name)
        material.use_nodes = True
        glass = material.node_tree.nodes.new("ShaderNodeBsdfGlass")
        material.node_tree.links.new(glass.outputs[0], material.node_tree.nodes["Material Output"].inputs[0])
        mesh = bpy.data.meshes.new(name)
        mesh.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [], [(0, 1, 2)])
        mesh.materials.append(material)
        bpy.context.collection.objects.link(bpy.data.objects.new(name, mesh))
    bpy.context.collection.objects.link(bpy.data.objects.new("Fog", bpy.data.volumes.new("Fog")))
    bpy.context.scene.render.use_motion_blur = True


def steps():
    bpy.context.preferences.view.show_splash = False
    bpy.ops.wm.open_mainfile(filepath=FILE, load_ui=False)
    yield 1.0
    open_panels()
    drawn = watch_drawing()
    bpy.context.scene.lobe.viewport_samples = 400
    properties, view = area("PROPERTIES"), area("VIEW_3D")
    properties.spaces.active.context = "RENDER"
    yield from drag(view.x + 300, view.y + 300, 5, 0)  # makes the window the active one
    yield from drag(properties.x - 1, properties.y + 100, -WIDER, 0)
    space = view.spaces.active
    space.overlay.show_overlays = False
    space.shading.type = "RENDERED"
    space.region_3d.view_perspective = "CAMERA"
    space.region_3d.view_camera_zoom = 20
    for _ in range(PATIENCE):
        yield 1.0
        if drawn and drawn[-1].samples == drawn[-1].total:
            break
    yield 1.0
    shoot("window", 0, view.y, window().width, window().height - view.y, "53%")
    yield from drag(properties.x + 150, properties.y + properties.height + 1, 0, HIGHER)
    space.shading.type = "SOLID"
    bpy.context.view_layer.objects.active = next(o for o in bpy.data.objects if o.name.startswith("Suzanne"))
    properties.spaces.active.context = "MATERIAL"
    yield 1.0
    show("material_panel", 645)
    add_glass()
    properties.spaces.active.context = "RENDER"
    while not bpy.ops.lobe.check_scene.poll():  # the material's icon is still being rendered
        yield 1.0
    bpy.ops.lobe.check_scene()
    yield 1.0
    show("scene_report", 446)


def run() -> None:
    going = steps()

    def tick() -> float | None:
        try:
            return next(going)
        except StopIteration:
            pass
        except Exception:
            traceback.print_exc()
        bpy.ops.wm.quit_blender()
        return None

    bpy.app.timers.register(tick, first_interval=2.0, persistent=True)


run()
