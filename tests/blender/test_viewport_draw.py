"""What a viewport draws of the open file, called as Blender calls the engine; the drawing itself is only noted."""

from __future__ import annotations

import importlib
import threading
import time
from collections.abc import Callable, Iterator
from types import SimpleNamespace

import bpy
import pytest
from mathutils import Matrix

from tests.blender.export_checks import add_object, depsgraph
from tools.lobe_blender import MODULE

pytest.importorskip("gpu")
PATIENCE = 120.0  # seconds: the first test of a fresh checkout compiles
WIDTH, HEIGHT = 16, 8


class Shown:
    """A 3D viewport in Rendered mode, with the engine that Blender keeps for it.

    pictures  that were drawn
    messages  that were drawn in their place
    status    Blender's second text
    """

    def __init__(self) -> None:
        self.viewport = self.ends_viewport = None
        self.redraws = 0
        self.pictures: list = []
        self.messages: list[str] = []
        self.status: str | None = None
        self.said: list[str] = []
        spaces = [area.spaces.active for screen in bpy.data.screens for area in screen.areas if area.type == "VIEW_3D"]
        self.context = SimpleNamespace(
            space_data=spaces[0],
            region=SimpleNamespace(width=WIDTH, height=HEIGHT),
            region_data=SimpleNamespace(
                window_matrix=Matrix(), view_matrix=Matrix.Translation((0, 0, -5)), view_perspective="ORTHO"
            ),
        )

    def tag_redraw(self) -> None:
        self.redraws += 1

    def update_stats(self, _first: str, second: str) -> None:
        self.status = second

    def report(self, _kind: set, message: str) -> None:
        self.said.append(message)

    def _viewport(self):
        return render_engine().LobeRenderEngine._viewport(self)

    def update(self, _scene=None, graph=None) -> None:
        render_engine().LobeRenderEngine.view_update(self, self.context, graph or depsgraph())

    def after(self, edit: Callable[[], object]) -> None:
        """Only here does a dependency graph say what has changed."""
        bpy.app.handlers.depsgraph_update_post.append(self.update)
        try:
            edit()
            bpy.context.view_layer.update()
        finally:
            bpy.app.handlers.depsgraph_update_post.remove(self.update)
        self.draw()

    def draw(self) -> None:
        render_engine().LobeRenderEngine.view_draw(self, self.context, depsgraph())

    def draw_until(self, condition: Callable[[], bool]) -> None:
        deadline = time.perf_counter() + PATIENCE
        while not condition():
            assert time.perf_counter() < deadline, (self.status, self.messages, self.said)
            time.sleep(0.01)
            self.draw()

    def finished(self) -> bool:
        return self.status == "Sample 2/2"

    def instances(self) -> int:
        return len(self.viewport._scene.instances)


def render_engine():
    return importlib.import_module(f"{MODULE}.addon.render_engine")


@pytest.fixture
def shown(simple_scene, monkeypatch) -> Iterator[Shown]:
    """Of a cube, two samples."""
    simple_scene.lobe.viewport_samples = 2
    bpy.ops.mesh.primitive_cube_add()
    draw = importlib.import_module(f"{MODULE}.addon.draw")
    shown = Shown()
    monkeypatch.setattr(draw.Drawing, "draw", lambda _self, picture, _view: shown.pictures.append(picture))
    monkeypatch.setattr(draw, "message", lambda _region, text: shown.messages.append(text))
    yield shown
    if shown.viewport is not None:
        shown.viewport.close()


@pytest.mark.parametrize("what", ["no such file", "no .blend"])
def test_a_file_that_cannot_be_opened_leaves_the_viewport_alive(shown, tmp_path, what: str) -> None:
    """Blender calls `load_pre` before it looks for the file, and goes on with the engine that it has."""
    path = tmp_path / "other.blend"
    if what == "no .blend":
        path.write_text(what)
    shown.update()
    shown.draw_until(shown.finished)
    closed, redraws = shown.viewport, shown.redraws
    with pytest.raises(RuntimeError, match=r"other\.blend"):
        bpy.ops.wm.open_mainfile(filepath=str(path))
    assert closed.is_closed and shown.redraws > redraws
    shown.pictures.clear()
    shown.draw()
    assert shown.viewport is not closed and shown.instances() == 1
    shown.draw_until(lambda: shown.finished() and bool(shown.pictures))
    shown.after(lambda: setattr(bpy.context.object, "location", (1, 0, 0)))
    assert shown.viewport._scene.instances.transforms[0, 0, 3] == 1.0
    assert shown.said == shown.messages == []


def test_a_crash_in_the_export_is_said_in_the_viewport(shown, monkeypatch, capfd) -> None:
    """Until an edit leads to an export that works; in the console it stands once."""
    instances = importlib.import_module(f"{MODULE}.addon.export.instances")
    shown.update()
    shown.draw_until(shown.finished)
    drawn = len(shown.pictures)

    def crash(*_arguments) -> None:
        raise KeyError("on purpose")

    with monkeypatch.context() as broken:
        broken.setattr(instances, "note_object", crash)
        for x in (1, 2):
            shown.after(lambda x=x: setattr(bpy.context.object, "location", (x, 0, 0)))
            assert "object 'Cube'" in shown.messages[-1] and "on purpose" in shown.messages[-1]
            assert shown.status == "" and len(shown.pictures) == drawn
    assert capfd.readouterr().err.count("Traceback") == 1
    said = len(shown.messages)
    shown.after(lambda: setattr(bpy.context.object, "location", (3, 0, 0)))
    assert shown.viewport._scene.instances.transforms[0, 0, 3] == 3.0
    shown.draw_until(shown.finished)
    assert len(shown.messages) == said


def test_a_crash_while_drawing_is_said_until_it_is_over(shown, monkeypatch, capfd) -> None:
    viewport = importlib.import_module(f"{MODULE}.addon.viewport")
    shown.update()
    shown.draw_until(shown.finished)
    with monkeypatch.context() as broken:
        broken.setattr(viewport, "export_view", lambda *_: 1 / 0)
        shown.draw()
        shown.draw()
    assert len(shown.messages) == 2 and "ZeroDivisionError" in shown.messages[0] and shown.status == ""
    assert capfd.readouterr().err.count("Traceback") == 1
    shown.draw()
    assert len(shown.messages) == 2 and shown.finished()


def test_object_types_that_the_viewport_hides(shown) -> None:
    """Blender evaluates nothing for that: the viewport looks at every draw."""
    add_object("Lamp", bpy.data.lights.new("Lamp", "POINT"), (0, 0, 5)).data.energy = 10
    space = shown.context.space_data

    def seen() -> tuple[int, int]:
        shown.draw()
        return len(shown.viewport._scene.instances), len(shown.viewport._scene.lights)

    shown.update()
    assert seen() == (1, 1)
    space.show_object_viewport_mesh = False
    assert seen() == (0, 1)
    shown.after(lambda: setattr(bpy.data.lights["Lamp"], "energy", 20))
    assert seen() == (0, 1)
    space.show_object_viewport_light = False
    assert seen() == (0, 0)
    space.show_object_viewport_mesh = space.show_object_viewport_light = True
    assert seen() == (1, 1)
    exported = shown.viewport._scene
    space.show_object_viewport_armature = False
    assert seen() == (1, 1) and shown.viewport._scene is exported
    assert shown.said == shown.messages == []


@pytest.mark.parametrize("on_own_thread", [True, False])
def test_a_texture_is_freed_where_that_may_be_done(shown, on_own_thread: bool) -> None:
    """On a thread of a viewport's own there is no graphics context."""
    draw = importlib.import_module(f"{MODULE}.addon.draw")
    shown.update()
    shown.viewport._drawing._texture = texture = object()
    if on_own_thread:
        thread = threading.Thread(target=shown.viewport.close)
        thread.start()
        thread.join()
    else:
        shown.viewport.close()
    assert shown.viewport._drawing._texture is None
    assert draw._dropped == ([texture] if on_own_thread else [])
    draw._dropped.clear()
