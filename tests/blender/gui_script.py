"""What `test_gui.py` does in a Blender with a window: what a user does first, with the mouse where that is the point.

    blender --python gui_script.py -- PACKAGE.zip FILE.blend

Steps are generators, which wait by yielding seconds; Blender goes on meanwhile. What was seen is written beside this
file: JSON, and PNGs of single areas.
"""

from __future__ import annotations

import functools
import json
import shutil
import subprocess
import sys
import time
import traceback
from pathlib import Path

import bpy
import numpy as np

FOLDER = Path(__file__).parent
PACKAGE, BLEND = sys.argv[-2:]
SEEN: dict = {"picture": {}}
TOOLS = ("xdotool", "import")  # the mouse, and ImageMagick's pictures of the display
PATIENCE = 240.0  # seconds: the first picture compiles
ENGINE_ROW = 56  # pixels at resolution scale 1, from the top of the Render tab to the middle of the engine's menu
FIRST_ITEM, ITEM = 24, 23  # from there to the first item of the opened menu, and from item to item
drawn: list = []  # every new Picture that was drawn in a viewport


def window():
    return bpy.context.window_manager.windows[0]


@functools.cache
def handle() -> str:
    """The display's number of Blender's window."""
    found = subprocess.run(["xdotool", "search", "--onlyvisible", "--name", "Blender"], capture_output=True, text=True)
    return found.stdout.split()[0]


def area(kind: str):
    """The largest area of a kind."""
    return max((a for a in window().screen.areas if a.type == kind), key=lambda a: a.width * a.height)


def region(of):
    return next(region for region in of.regions if region.type == "WINDOW")


def over(of):
    """The context of an area."""
    return bpy.context.temp_override(window=window(), area=of, region=region(of))


def until(condition):
    begun = time.perf_counter()
    while not condition():
        if time.perf_counter() - begun > PATIENCE:
            raise TimeoutError(traceback.format_stack()[-2])
        yield 0.05


def shoot(of, name: str) -> None:
    """As the display shows it: Blender's own screenshots are black with software OpenGL."""
    part = f"{of.width}x{of.height}+{of.x}+{window().height - of.y - of.height}"
    subprocess.run(["import", "-window", handle(), "-crop", part, "+repage", FOLDER / f"{name}.png"], check=True)


def xdotool(*arguments: object) -> None:
    """Not waited for: Blender has to go on to take the events in."""
    subprocess.Popen(["xdotool", *map(str, arguments)])


def point(of, right: float, down: float):
    """Move the mouse to so many pixels from the upper left corner of an area's main region."""
    inside = region(of)
    x, y = round(inside.x + right), round(window().height - inside.y - inside.height + down)
    xdotool("mousemove", "--window", handle(), x - 5, y)
    yield 0.5
    xdotool("mousemove", "--window", handle(), x, y)
    yield 0.5


def click(of, right: float, down: float):
    yield from point(of, right, down)
    xdotool("click", 1)
    yield 1.0


def engines() -> list[str]:
    """In the order of the menu; the property itself lists none that are add-ons."""
    try:
        bpy.context.scene.render.engine = ""
    except TypeError as error:
        return str(error).partition("(")[2].rstrip(")").replace("'", "").split(", ")
    raise AssertionError("an engine without a name")


def install():
    bpy.context.preferences.view.show_splash = False
    # The operator that dropping the file on the window runs.
    bpy.ops.extensions.package_install_files(filepath=PACKAGE, repo="user_default", enable_on_install=True)
    open_panels()
    yield 1.0
    bpy.ops.wm.open_mainfile(filepath=BLEND, load_ui=False)
    yield 1.0
    SEEN["engines"] = engines()


def choose():
    """By script, and with the mouse."""
    render, properties = bpy.context.scene.render, area("PROPERTIES")
    properties.spaces.active.context = "RENDER"
    render.engine = "CYCLES"
    yield 1.0
    render.engine = "LOBE"
    yield 1.0
    SEEN["by script"] = bpy.context.engine
    render.engine = "CYCLES"
    yield 1.0
    yield from click(properties, 60, 25)  # on a text: the first click makes the window the active one
    middle = 0.7 * region(properties).width
    yield from click(properties, middle, ENGINE_ROW)
    yield from click(properties, middle, ENGINE_ROW + FIRST_ITEM + engines().index("LOBE") * ITEM)
    SEEN["by mouse"] = bpy.context.scene.render.engine


def press_f12():
    """The picture at its own size, in the area that Blender puts it into."""
    done: list = []
    bpy.app.handlers.render_complete.append(lambda *_: done.append(True))
    bpy.context.preferences.view.render_display_type = "AREA"
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 384, 256, 100
    scene.lobe.samples = 16
    view = area("VIEW_3D")
    yield from point(view, view.width / 2, view.height / 2)
    xdotool("key", "F12")
    yield from until(lambda: done)
    yield 1.0
    editor = area("IMAGE_EDITOR")
    with over(editor):
        bpy.ops.image.view_all()
        bpy.ops.image.view_zoom_ratio(ratio=1.0)
    yield 1.0
    shoot(editor, "f12")
    bpy.data.images["Render Result"].save_render(str(FOLDER / "f12_saved.png"))
    editor.type = "VIEW_3D"
    yield 1.0


def watch_drawing() -> None:
    from bl_ext.user_default.lobe.addon.draw import Drawing

    whole = Drawing.draw

    def draw(self, picture, view):
        if picture is not self._picture:
            drawn.append(picture)
        whole(self, picture, view)

    Drawing.draw = draw


def refined(name: str, first: int):
    """Wait for the last picture of those that come after `first`, and note it."""
    view = area("VIEW_3D")
    yield from until(lambda: len(drawn) > first and drawn[-1].samples == drawn[-1].total)
    yield 1.0
    shoot(view, name)
    picture = drawn[-1].pixels
    SEEN["picture"][name] = np.asarray(picture[..., :3], np.float64).mean(axis=(0, 1)).tolist()


def look_around():
    """The viewport in Rendered mode: through the camera, orbiting with the mouse, and with another material."""
    watch_drawing()
    bpy.context.scene.lobe.viewport_samples = 16
    view = area("VIEW_3D")
    space = view.spaces.active
    space.shading.type = "RENDERED"
    space.region_3d.view_perspective = "CAMERA"
    yield from refined("viewport", 0)
    space.region_3d.view_perspective = "PERSP"
    yield from refined("freed", len(drawn))
    first = len(drawn)
    yield from point(view, view.width / 2, view.height / 2)
    xdotool("mousedown", 2)
    yield 0.5
    for _ in range(10):
        xdotool("mousemove_relative", "--", -8, 2)
        yield 0.1
    xdotool("mouseup", 2)
    yield from refined("orbited", first)
    first = len(drawn)
    for material in filter(is_phong, bpy.data.materials):
        group = next(node for node in material.node_tree.nodes if node.type == "GROUP")
        group.inputs["kd"].default_value = (0.6, 0.1, 0.05, 1.0)
        group.inputs["ks"].default_value = (0.4, 0.4, 0.4, 1.0)
    yield from refined("edited", first)
    space.shading.type = "SOLID"
    yield 1.0


# Tab -> what to show there: the type of the object that has to be active, and that of a lamp.
TABS = {
    "render": ("RENDER", None),
    "view_layer": ("VIEW_LAYER", None),
    "world": ("WORLD", None),
    "material": ("MATERIAL", "MESH"),
    "object": ("OBJECT", "MESH"),
    "camera": ("DATA", "CAMERA"),
    "lamp_point": ("DATA", "POINT"),
    "lamp_spot": ("DATA", "SPOT"),
    "lamp_area": ("DATA", "AREA"),
    "lamp_sun": ("DATA", "SUN"),
}


def open_panels() -> None:
    """All of Lobe's, in part closed by default, before Blender has drawn and remembers them."""
    ui = sys.modules["bl_ext.user_default.lobe.addon.ui"]
    for cls in reversed(ui._CLASSES):
        bpy.utils.unregister_class(cls)
    for cls in ui._CLASSES:
        if issubclass(cls, bpy.types.Panel):
            cls.bl_options = set(getattr(cls, "bl_options", ())) - {"DEFAULT_CLOSED"}
        bpy.utils.register_class(cls)


def panels():
    """Every tab that has panels of Lobe's, open, in a column as wide as Blender's and in a wide one."""
    watch_previews()
    unsupported()
    layer = bpy.context.view_layer
    layer.use_pass_mist = layer.use_pass_ambient_occlusion = True  # these have panels of the world
    activate("MESH")
    yield 0.3
    area("PROPERTIES").spaces.active.context = "MATERIAL"
    yield 0.3
    yield from until(bpy.ops.lobe.check_scene.poll)  # not before the materials' icons are rendered
    bpy.ops.lobe.check_scene()
    lamp = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "POINT"))
    bpy.context.collection.objects.link(lamp)
    narrow, wide = area("PROPERTIES"), area("VIEW_3D")
    wide.type = "PROPERTIES"
    yield 1.0
    for name, (tab, kind) in TABS.items():
        SEEN["tab"] = name
        if kind in ("POINT", "SPOT", "AREA", "SUN"):
            lamp.data.type = kind
            bpy.context.view_layer.objects.active = lamp
        elif kind is not None:
            activate(kind)
        yield 0.3
        for column in (narrow, wide):
            column.spaces.active.context = tab
            column.tag_redraw()
        yield 1.0
        yield from until(lambda: not bpy.app.is_job_running("RENDER_PREVIEW"))
        yield 1.0
        shoot(narrow, f"panel_{name}_narrow")
        shoot(wide, f"panel_{name}")
    wide.type = "VIEW_3D"
    yield 1.0


def watch_previews() -> None:
    """Notes which tab was open whenever Lobe rendered a preview."""
    from bl_ext.user_default.lobe.addon import session

    class Session(session.Session):
        def __init__(self, engine, depsgraph):
            super().__init__(engine, depsgraph)
            if engine.is_preview:
                SEEN["previews"].append(SEEN["tab"])

    SEEN["previews"], SEEN["tab"] = [], ""
    session.Session = Session


def activate(kind: str) -> None:
    """An object of a type, one with a Phong surface if there is any."""
    of_kind = [o for o in bpy.data.objects if o.type == kind]
    phong = [o for o in of_kind if o.active_material and is_phong(o.active_material)]
    bpy.context.view_layer.objects.active = (phong or of_kind)[0]


def is_phong(material) -> bool:
    return any(node.type == "GROUP" for node in material.node_tree.nodes)


def unsupported() -> None:
    """Something for the Scene Report."""
    scene = bpy.context.scene
    scene.render.use_motion_blur = True
    for number in range(3):
        material = bpy.data.materials.new(f"Glass {number}")
        material.use_nodes = True
        tree = material.node_tree
        glass = tree.nodes.new("ShaderNodeBsdfGlass")
        tree.links.new(glass.outputs[0], tree.nodes["Material Output"].inputs[0])
        mesh = bpy.data.meshes.new("Pane")
        mesh.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [], [(0, 1, 2)])
        mesh.materials.append(material)
        scene.collection.objects.link(bpy.data.objects.new(f"Pane {number}", mesh))
    scene.collection.objects.link(bpy.data.objects.new("Fog", bpy.data.volumes.new("Fog")))


STEPS = (install, choose, press_f12, look_around, panels)


def run() -> None:
    def all_steps():
        SEEN["missing"] = [tool for tool in TOOLS if not shutil.which(tool)]
        for step in STEPS if not SEEN["missing"] else ():
            print("step", step.__name__, flush=True)
            yield from step()

    going = all_steps()

    def tick() -> float | None:
        try:
            return next(going)
        except StopIteration:
            pass
        except Exception:
            SEEN["error"] = traceback.format_exc()
        (FOLDER / "seen.json").write_text(json.dumps(SEEN))
        bpy.ops.wm.quit_blender()
        return None

    bpy.app.timers.register(tick, first_interval=2.0, persistent=True)


run()
