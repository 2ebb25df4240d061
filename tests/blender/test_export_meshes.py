"""Meshes and instances: geometry, normals, slots and sharing, for every kind of object that Blender draws."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import bpy
import numpy as np
import pytest
from bl_ext.user_default.lobe import engine
from bl_ext.user_default.lobe.addon.export import export_scene, meshes
from bl_ext.user_default.lobe.addon.export.instances import matrices_at_once, matrices_one_by_one
from bl_ext.user_default.lobe.addon.export.meshes import _table_in_place, _triangle_corners
from bl_ext.user_default.lobe.addon.export.stop import Stop
from mathutils import Matrix

from tests.blender.export_checks import (
    add_camera,
    add_object,
    depsgraph,
    in_render,
    new_material,
    plane_mesh,
    warnings_of,
)


def exported():
    if bpy.context.scene.camera is None:
        add_camera()
    scene = in_render(lambda engine, graph: export_scene(graph))
    scene.validate()
    return scene


def only_mesh():
    scene = exported()
    assert len(scene.meshes) == 1
    return scene.meshes[0]


def area(mesh) -> float:
    a, b, c = (mesh.vertices[mesh.triangles[:, i]] for i in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def cube_mesh(smooth: bool = False):
    bpy.ops.mesh.primitive_cube_add(size=2)
    mesh = bpy.context.object.data
    if smooth:
        mesh.shade_smooth()
    return mesh


def test_flat_faces_need_no_normals():
    cube_mesh()
    mesh = only_mesh()
    assert mesh.vertices.shape == (8, 3) and mesh.triangles.shape == (12, 3)
    assert mesh.normals is None and mesh.normal_indices is None and mesh.material_slots is None
    assert area(mesh) == pytest.approx(24)


def test_faces_keep_their_direction():
    """The geometric normal by the order of the corners points outwards."""
    cube_mesh()
    mesh = only_mesh()
    a, b, c = (mesh.vertices[mesh.triangles[:, i]] for i in range(3))
    assert np.all((np.cross(b - a, c - a) * (a + b + c)).sum(axis=1) > 0)


def test_smooth_meshes_share_one_normal_for_each_vertex():
    cube_mesh(smooth=True)
    mesh = only_mesh()
    assert mesh.normals.shape == (8, 3) and mesh.normal_indices is None
    assert mesh.normals == pytest.approx(mesh.vertices / np.sqrt(3), abs=1e-6)


def test_sharp_faces_among_smooth_ones_have_corner_normals():
    data = cube_mesh(smooth=True)
    data.polygons[0].use_smooth = False
    mesh = only_mesh()
    assert mesh.normals.shape == (24, 3) and mesh.normal_indices.shape == (12, 3)
    face = data.polygons[0]
    of_face = [t for t, corner in enumerate(mesh.normal_indices) if set(corner) <= set(face.loop_indices)]
    assert len(of_face) == 2
    for triangle in of_face:
        assert mesh.normals[mesh.normal_indices[triangle]] == pytest.approx(np.tile(face.normal, (3, 1)), abs=1e-6)


def test_custom_normals():
    data = cube_mesh(smooth=True)
    data.normals_split_custom_set([(0.0, 0.6, 0.8)] * len(data.loops))
    mesh = only_mesh()
    indices = mesh.triangles if mesh.normal_indices is None else mesh.normal_indices
    corner_normals = mesh.normals[indices].reshape(-1, 3)
    assert corner_normals == pytest.approx(np.tile((0.0, 0.6, 0.8), (len(corner_normals), 1)), abs=1e-3)


def test_normals_belong_to_their_corners():
    """On a sphere of triangles, quads and n-gons, every corner normal is the normal of its vertex."""
    bpy.ops.mesh.primitive_uv_sphere_add(segments=12, ring_count=7)
    data = bpy.context.object.data
    data.shade_smooth()
    data.normals_split_custom_set_from_vertices([v.co.normalized() for v in data.vertices])
    mesh = only_mesh()
    indices = mesh.triangles if mesh.normal_indices is None else mesh.normal_indices
    assert mesh.normals[indices] == pytest.approx(mesh.vertices[mesh.triangles], abs=2e-3)


def test_n_gons():
    bpy.ops.mesh.primitive_circle_add(vertices=17, fill_type="NGON", radius=1)
    mesh = only_mesh()
    assert len(mesh.triangles) == 15
    assert area(mesh) == pytest.approx(17 / 2 * np.sin(2 * np.pi / 17), rel=1e-5)


def corners_through_rna(mesh) -> np.ndarray:
    corners = np.empty(3 * len(mesh.loop_triangles), np.int32)
    mesh.loop_triangles.foreach_get("loops", corners)
    return corners.reshape(-1, 3)


@pytest.mark.parametrize("vertices", [4, 5, 32])
def test_triangle_corners_are_read_where_they_lie(vertices):
    bpy.ops.mesh.primitive_cylinder_add(vertices=vertices)
    mesh = bpy.context.object.data
    mesh.calc_loop_triangles()
    table = _table_in_place(mesh.loop_triangles)
    assert table is not None
    np.testing.assert_array_equal(table, corners_through_rna(mesh))


@pytest.mark.parametrize("padding, shift", [(4, 0), (0, 1)])
def test_a_table_of_another_layout_is_read_through_rna(padding, shift, monkeypatch):
    """Wider rows, or other numbers than RNA gives."""
    monkeypatch.setattr(meshes, "FEW", 0)  # of a few triangles nobody asks where they lie
    cube_mesh()
    mesh = bpy.context.object.data
    mesh.calc_loop_triangles()

    class Triangle:
        def __init__(self, index):
            self.index = index
            self.loops = [corner + shift for corner in mesh.loop_triangles[index].loops]

        def as_pointer(self):
            return mesh.loop_triangles[self.index].as_pointer() + padding * self.index

    class Table(list):
        def foreach_get(self, name, out):
            mesh.loop_triangles.foreach_get(name, out)

    class Data:
        loops, polygons = mesh.loops, mesh.polygons
        loop_triangles = Table(Triangle(i) for i in range(len(mesh.loop_triangles)))

    assert _table_in_place(Data.loop_triangles) is None
    np.testing.assert_array_equal(_triangle_corners(Data, 12), corners_through_rna(mesh))


def test_loose_parts_and_empty_meshes_are_left_out():
    mesh = bpy.data.meshes.new("Loose")
    mesh.from_pydata([(0, 0, 0), (1, 0, 0), (2, 0, 0), (3, 0, 0), (0, 1, 0)], [(2, 3)], [(0, 1, 4)])
    add_object("Loose", mesh)
    add_object("Empty", bpy.data.meshes.new("Empty"))
    edge = bpy.data.meshes.new("Edge")
    edge.from_pydata([(0, 0, 0), (1, 0, 0)], [(0, 1)], [])
    add_object("Edge", edge)
    scene = exported()
    assert [mesh.name for mesh in scene.meshes] == ["Loose"]
    assert len(scene.meshes[0].triangles) == 1
    assert scene.skipped == ["object 'Empty': it has no faces", "object 'Edge': it has no faces"]


def test_nan_vertices_are_refused_by_name():
    mesh = plane_mesh(name="Broken")
    mesh.vertices[2].co.x = float("nan")
    add_object("Broken", mesh)
    with pytest.raises(engine.SceneError, match="mesh 'Broken': vertex 2 is at"):
        exported()


def test_slots_of_faces():
    data = cube_mesh()
    red, green = (new_material(name, "ShaderNodeBsdfDiffuse")[0] for name in ("Red", "Green"))
    data.materials.append(red)
    data.materials.append(green)
    data.polygons[3].material_index = 1
    scene = exported()
    assert sorted(scene.meshes[0].material_slots) == [0] * 10 + [1] * 2
    instances = scene.instances
    first = instances.material_offset[0]
    assert instances.slot_count[0] == 2
    names = [scene.materials[i].name for i in instances.material_table[first : first + 2]]
    assert names == ["Red", "Green"]


def test_slots_linked_to_objects():
    """Two objects share a mesh, and one of them brings its own material."""
    data = plane_mesh()
    data.materials.append(new_material("Of data", "ShaderNodeBsdfDiffuse")[0])
    add_object("First", data)
    second = add_object("Second", data)
    second.material_slots[0].link = "OBJECT"
    second.material_slots[0].material = new_material("Of object", "ShaderNodeBsdfDiffuse")[0]
    scene = exported()
    assert len(scene.meshes) == 1
    by_name = {
        scene.instances.object_names[o]: scene.materials[scene.instances.material_table[offset]].name
        for o, offset in zip(scene.instances.object, scene.instances.material_offset, strict=True)
    }
    assert by_name == {"First": "Of data", "Second": "Of object"}


def test_objects_without_material_are_default_grey():
    add_object("Plane", plane_mesh())
    empty_slot = plane_mesh(name="Empty slot")
    empty_slot.materials.append(None)
    add_object("Empty slot", empty_slot)
    scene = exported()
    assert scene.materials == [engine.DEFAULT_MATERIAL]
    assert list(scene.instances.material_table) == [0]


def test_transforms_are_kept_as_matrices():
    data = plane_mesh()
    add_object("Plane", data, (1, 2, 3), (0.1, 0.2, 0.3), (-1, 2, 0.5))
    scene = exported()
    matrix = np.array(bpy.data.objects["Plane"].matrix_world)[:3]
    assert scene.instances.transforms[0] == pytest.approx(matrix)
    assert np.linalg.det(scene.instances.transforms[0][:, :3]) < 0


def test_modifiers_are_applied():
    data = cube_mesh()
    add_object("Plain", data)
    bpy.context.object.modifiers.new("Subdivide", "SUBSURF").levels = 2
    scene = exported()
    assert sorted(len(mesh.triangles) for mesh in scene.meshes) == [12, 192]


def test_a_mesh_in_edit_mode_shows_in_the_viewport():
    cube_mesh()
    add_camera()
    bpy.ops.object.mode_set(mode="EDIT")
    assert len(export_scene(depsgraph()).meshes[0].triangles) == 12
    bpy.context.object.modifiers.new("Subdivide", "SUBSURF").levels = 1
    assert len(export_scene(depsgraph()).meshes[0].triangles) == 48
    bpy.ops.object.mode_set(mode="OBJECT")
    assert len(export_scene(depsgraph()).meshes[0].triangles) == 48


def test_curves_text_surfaces_and_metaballs():
    bpy.ops.object.text_add()
    bpy.context.object.data.extrude = 0.1
    bpy.ops.curve.primitive_bezier_circle_add()
    bpy.context.object.data.bevel_depth = 0.1
    bpy.ops.surface.primitive_nurbs_surface_sphere_add()
    bpy.ops.object.metaball_add()
    bpy.context.object.data.materials.append(new_material("Slime", "ShaderNodeBsdfDiffuse")[0])
    bpy.ops.curve.primitive_bezier_curve_add()  # No faces.
    scene = exported()
    assert len(scene.meshes) == len(scene.instances) == 4
    assert [material.name for material in scene.materials] == ["default grey", "Slime"]


def test_unsupported_kinds_are_named():
    add_object("Fog", bpy.data.volumes.new("Fog"))
    add_object("Hair", bpy.data.hair_curves.new("Hair"))
    warnings = exported().warnings
    assert "object 'Fog': volumes are not supported and left out" in warnings
    assert "object 'Hair': hair curves are not supported and left out" in warnings


def test_particle_hair_is_named():
    data = plane_mesh()
    emitter = add_object("Head", data)
    emitter.modifiers.new("Hair", "PARTICLE_SYSTEM")
    emitter.particle_systems[0].settings.type = "HAIR"
    warnings = warnings_of(exported())
    assert len(warnings) == 1
    assert warnings[0].startswith("object 'Head': hair of particle system")


def test_hidden_collections_and_objects():
    hidden = bpy.data.collections.new("Hidden")
    bpy.context.scene.collection.children.link(hidden)
    hidden.hide_render = True
    hidden.objects.link(bpy.data.objects.new("In hidden", plane_mesh()))
    add_object("Off", plane_mesh()).hide_render = True
    excluded = bpy.data.collections.new("Excluded")
    bpy.context.scene.collection.children.link(excluded)
    excluded.objects.link(bpy.data.objects.new("In excluded", plane_mesh()))
    bpy.context.view_layer.layer_collection.children["Excluded"].exclude = True
    add_object("Shown", plane_mesh())
    assert exported().instances.object_names == ["Shown"]


def test_ray_visibility():
    plane = add_object("Plane", plane_mesh())
    plane.visible_camera = plane.visible_shadow = False
    gone = add_object("Gone", plane_mesh())
    gone.visible_camera = gone.visible_diffuse = gone.visible_glossy = gone.visible_shadow = False
    scene = exported()
    assert list(scene.instances.visibility) == [engine.Visibility.DIFFUSE | engine.Visibility.GLOSSY]
    assert scene.skipped == ["object 'Gone': it is hidden from every ray"]


def test_visibility_of_duplicates_depends_on_the_instancer():
    collection = bpy.data.collections.new("Things")
    thing = bpy.data.objects.new("Thing", plane_mesh())
    collection.objects.link(thing)
    thing.visible_glossy = False
    empty = add_object("Empty", None)
    empty.instance_type, empty.instance_collection = "COLLECTION", collection
    empty.visible_camera = False
    scene = exported()
    assert list(scene.instances.visibility) == [engine.Visibility.DIFFUSE | engine.Visibility.SHADOW]


def test_indirect_only_and_holdout_collections():
    for name in ("Indirect", "Holdout"):
        collection = bpy.data.collections.new(name)
        bpy.context.scene.collection.children.link(collection)
        collection.objects.link(bpy.data.objects.new(name, plane_mesh()))
    children = bpy.context.view_layer.layer_collection.children
    children["Indirect"].indirect_only = True
    children["Holdout"].holdout = True
    scene = exported()
    instances = scene.instances
    visibility = dict(zip(instances.object_names, instances.visibility, strict=True))
    assert visibility["Indirect"] == engine.Visibility.ALL & ~engine.Visibility.CAMERA
    slots = dict(zip(instances.object_names, instances.material_table[instances.material_offset], strict=True))
    assert [scene.materials[slots[name]].holdout for name in ("Indirect", "Holdout")] == [False, True]
    assert warnings_of(scene) == []


def test_shadow_catcher_is_named():
    add_object("Catcher", plane_mesh()).is_shadow_catcher = True
    bpy.context.scene.collection.objects.link(bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "POINT")))
    assert warnings_of(exported()) == ["object 'Catcher': shadow catchers are not supported, drawn as it is"]


def test_light_linking_is_named():
    plane = add_object("Plane", plane_mesh())
    plane.light_linking.receiver_collection = bpy.data.collections.new("Receivers")
    assert warnings_of(exported()) == ["object 'Plane': light linking is not supported, every lamp lights everything"]


def geometry_nodes(object_, make):
    """Give the object a geometry-nodes modifier; `make(tree)` returns the socket of the geometry that comes out."""
    tree = bpy.data.node_groups.new("Geometry", "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    tree.links.new(make(tree), tree.nodes.new("NodeGroupOutput").inputs[0])
    object_.modifiers.new("Geometry", "NODES").node_group = tree


def cube_with_material(tree, material):
    cube, assign = tree.nodes.new("GeometryNodeMeshCube"), tree.nodes.new("GeometryNodeSetMaterial")
    assign.inputs["Material"].default_value = material
    tree.links.new(cube.outputs["Mesh"], assign.inputs["Geometry"])
    return assign.outputs["Geometry"]


@pytest.mark.parametrize("as_instances", [False, True])
def test_geometry_nodes_bring_their_own_materials(as_instances):
    own, other = (new_material(name, "ShaderNodeBsdfDiffuse")[0] for name in ("Own", "Other"))
    data = plane_mesh()
    data.materials.append(own)
    object_ = add_object("Plane", data)

    def make(tree):
        geometry = cube_with_material(tree, other)
        if not as_instances:
            return geometry
        points, place = tree.nodes.new("GeometryNodeMeshLine"), tree.nodes.new("GeometryNodeInstanceOnPoints")
        points.inputs["Count"].default_value = 5
        tree.links.new(points.outputs[0], place.inputs["Points"])
        tree.links.new(geometry, place.inputs["Instance"])
        return place.outputs["Instances"]

    geometry_nodes(object_, make)
    scene = exported()
    instances = scene.instances
    assert len(scene.meshes) == 1 and len(instances) == (5 if as_instances else 1)
    slots = scene.meshes[0].material_slots
    used = instances.material_offset + (0 if slots is None else slots[0])
    assert {scene.materials[i].name for i in instances.material_table[used]} == {"Other"}


def grid_of_instances(side: int):
    """A triangle at each vertex of a grid; neither the grid nor the triangle itself are drawn."""
    vertices = [(x, y, 0) for x in range(side) for y in range(side)]
    grid = bpy.data.meshes.new("Grid")
    grid.from_pydata(vertices, [], [])
    parent = add_object("Grid", grid)
    parent.instance_type = "VERTS"
    parent.show_instancer_for_render = False
    mesh = bpy.data.meshes.new("Triangle")
    mesh.from_pydata([(0, 0, 0), (0.5, 0, 0), (0, 0.5, 0)], [], [(0, 1, 2)])
    add_object("Triangle", mesh).parent = parent


def test_both_ways_to_read_matrices_agree():
    grid_of_instances(3)
    bpy.context.scene.objects[0].matrix_world @= Matrix.Rotation(1.0, 4, (1, 2, 3)) @ Matrix.Scale(-2.0, 4, (0, 1, 0))
    items = depsgraph().object_instances
    count = len(items)
    at_once, one_by_one = (read(items, count, Stop()) for read in (matrices_at_once, matrices_one_by_one))
    assert at_once.shape == (count, 3, 4) and at_once.dtype == one_by_one.dtype == np.float32
    assert np.array_equal(at_once, one_by_one)


EXPORT_AND_END = f"""
import sys
sys.path.insert(0, {str(Path(__file__).resolve().parents[2])!r})
from tools.lobe_blender import enable_lobe
enable_lobe()
from bl_ext.user_default.lobe.addon.export import export_scene
from tests.blender.export_checks import add_camera, depsgraph
from tests.blender.test_export_meshes import grid_of_instances
grid_of_instances(8)
add_camera()
assert len(export_scene(depsgraph()).instances) >= 64
"""


def test_instances_leave_no_memory_behind():
    """Blender counts its own memory, and complains at the end about what nobody freed."""
    done = subprocess.run([sys.executable, "-c", EXPORT_AND_END], capture_output=True, text=True, check=True)
    assert "Not freed" not in done.stdout + done.stderr


def test_instances_share_their_mesh():
    grid_of_instances(4)
    scene = exported()
    assert len(scene.meshes) == 1 and len(scene.instances) == 16
    places = {tuple(np.round(transform[:, 3]).astype(int)) for transform in scene.instances.transforms}
    assert places == {(x, y, 0) for x in range(4) for y in range(4)}


def calls_of_an_export(counted_calls):
    """The scene, and how many calls Python makes for it."""

    def run(_engine, graph):
        scenes = []
        calls = counted_calls(lambda: scenes.append(export_scene(graph)))
        return scenes[0], calls

    return in_render(run)


def test_an_instance_costs_no_call_of_a_function(counted_calls):
    add_camera()
    grid_of_instances(100)
    scene, calls = calls_of_an_export(counted_calls)
    assert len(scene.instances) == 10_000
    assert 0 < calls < 25_000, "two of C for each, none of Python"


def test_a_triangle_costs_no_call_of_a_function(counted_calls):
    add_camera()
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=707, y_subdivisions=707)
    bpy.context.object.data.shade_smooth()
    scene, calls = calls_of_an_export(counted_calls)
    assert len(scene.meshes[0].triangles) == 2 * 707**2
    assert 0 < calls < 3_000


def test_nothing_of_blenders_is_kept():
    """The arrays survive the file they came from."""
    cube_mesh(smooth=True)
    mesh = only_mesh()
    vertices = mesh.vertices.copy()
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.mesh.primitive_uv_sphere_add()
    assert np.array_equal(mesh.vertices, vertices)


def test_material_override():
    add_object("Plane", plane_mesh())
    bpy.context.view_layer.material_override = new_material("Clay", "ShaderNodeBsdfDiffuse")[0]
    scene = exported()
    assert scene.materials[scene.instances.material_table[0]].name == "Clay"
