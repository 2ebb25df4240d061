"""The sample scenes hold what their names promise, in small files that need nothing beside them."""

from __future__ import annotations

import pytest

from tools import blender_render as br
from tools.lobe_blender import enable_lobe

enable_lobe()  # before anything imports bpy

import bpy  # noqa: E402

SCENES = ("cornell_diffuse", "plates_phong", "lamps", "world", "instances", "many_lights")


def evaluated_triangles() -> tuple[int, int]:
    """(triangles, instances) of the open file's scene."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    triangles = instances = 0
    sizes: dict[str, int] = {}
    for item in depsgraph.object_instances:
        if item.object.type != "MESH":
            continue
        name = item.object.data.name
        if name not in sizes:
            item.object.data.calc_loop_triangles()
            sizes[name] = len(item.object.data.loop_triangles)
        triangles += sizes[name]
        instances += item.is_instance
    return triangles, instances


@pytest.mark.parametrize("name", SCENES)
def test_file(repository, name):
    path = repository / "sample_blends" / f"{name}.blend"
    assert path.with_suffix(".py").is_file()
    assert path.stat().st_size < 1_000_000
    scene = br.open_blend(path)
    assert scene.render.engine == "LOBE" and scene.camera is not None
    assert not bpy.data.libraries
    for image in bpy.data.images:
        assert image.source != "FILE" or image.packed_file, image.name
    cycles = scene.cycles
    assert not cycles.use_adaptive_sampling and cycles.sample_clamp_indirect == 0
    assert cycles.max_bounces == scene.lobe.max_bounces
    for obj in bpy.data.objects:
        assert obj.shadow_terminator_geometry_offset == 0, obj.name
    for light in bpy.data.lights:
        assert light.type not in ("POINT", "SPOT") or not light.use_soft_falloff, light.name


def opened(repository, name):
    return br.open_blend(repository / "sample_blends" / f"{name}.blend")


def test_cornell(repository):
    scene = opened(repository, "cornell_diffuse")
    assert (scene.render.resolution_x, scene.render.resolution_y) == (512, 512)
    assert evaluated_triangles() == (38, 0)
    kinds = {node.bl_idname for m in bpy.data.materials for node in m.node_tree.nodes}
    assert kinds == {"ShaderNodeBsdfDiffuse", "ShaderNodeEmission", "ShaderNodeAddShader", "ShaderNodeOutputMaterial"}


def test_plates(repository):
    opened(repository, "plates_phong")
    assert [s.view_settings.exposure for s in bpy.data.scenes] == [0.0, 4.0]
    plates = sorted((obj for obj in bpy.data.objects if obj.name.startswith("Plate")), key=lambda o: o.location.y)
    groups = [p.active_material.node_tree.nodes["Group"] for p in plates]
    exponents = [g.inputs["exponent"].default_value for g in groups]
    assert len(exponents) == 4 and exponents == sorted(set(exponents))


def test_lamps(repository):
    opened(repository, "lamps")
    lights = [obj.data for obj in bpy.data.objects if obj.type == "LIGHT"]
    assert {light.type for light in lights} == {"POINT", "SPOT", "AREA", "SUN"}
    assert {light.shape for light in lights if light.type == "AREA"} == {"SQUARE", "RECTANGLE", "DISK", "ELLIPSE"}
    assert {light.shadow_soft_size > 0 for light in lights if light.type == "POINT"} == {False, True}
    assert {obj.visible_camera for obj in bpy.data.objects if obj.type == "LIGHT"} == {False, True}


def test_instances(repository):
    opened(repository, "instances")
    triangles, instances = evaluated_triangles()
    assert triangles > 1_000_000 and instances == 10_000


def test_many_lights(repository):
    opened(repository, "many_lights")
    lamps = sum(obj.type == "LIGHT" and obj.data.type == "POINT" for obj in bpy.data.objects)
    assert lamps + len(bpy.data.objects["Windows"].data.polygons) == 10_000
