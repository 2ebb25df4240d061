"""An export can take seconds: cancelling it takes effect soon, and is no error."""

from __future__ import annotations

import importlib

import bpy
import numpy as np
import pytest
from bl_ext.user_default.lobe.addon.export import ExportStopped, export_scene

from tests.blender.export_checks import add_camera, add_object, in_render, plane_mesh
from tools.lobe_blender import MODULE


def scatter(count: int) -> None:
    """As many planes as vertices, 3 microseconds each."""
    mesh = bpy.data.meshes.new("Points")
    mesh.vertices.add(count)
    mesh.vertices.foreach_set("co", np.random.default_rng(0).random(3 * count, np.float32))
    owner = add_object("Points", mesh)
    owner.instance_type = "VERTS"
    child = add_object("Plane", plane_mesh(0.01))
    child.parent = owner


def test_a_running_export_asks_often_whether_to_stop() -> None:
    """Once for a thousand objects or so, which take it some 3 milliseconds."""
    scatter(30_000)
    add_camera()
    asked: list[int] = []

    def export(engine, graph) -> None:
        with pytest.raises(ExportStopped):
            export_scene(graph, stop=lambda: bool(asked.append(1)) or len(asked) > 20)

    in_render(export)
    assert len(asked) == 21  # it is asked no more once it has said so


def test_an_export_that_is_not_stopped_asks_for_each_mesh() -> None:
    add_camera()
    for i in range(5):
        add_object(f"Plane {i}", plane_mesh(name=f"Plane {i}"), (0, 0, i))
    asked = []
    scene = in_render(lambda engine, graph: export_scene(graph, stop=lambda: bool(asked.append(1))))
    assert len(scene.meshes) == 5
    assert len(asked) >= 5


def test_a_cancelled_export_is_a_cancelled_render(simple_scene, monkeypatch, capfd) -> None:
    session = importlib.import_module(f"{MODULE}.addon.session")
    report = importlib.import_module(f"{MODULE}.addon.report").last_report
    traced = []
    monkeypatch.setattr(session.Session, "cancelled", lambda self: True)
    monkeypatch.setattr(session.lobe, "render", lambda *a, **k: traced.append(1))
    add_object("Plane", plane_mesh())
    bpy.ops.render.render()  # without an error
    assert not traced
    assert report["stopped"] and report["samples"] == 0
    assert "Traceback" not in capfd.readouterr().err
