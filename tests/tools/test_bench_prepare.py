"""What benchmarks switch off in a user's file, so that both engines do the same."""

from __future__ import annotations

import pytest

from tools.lobe_blender import enable_lobe

enable_lobe()  # before anything imports bpy

import bpy  # noqa: E402
from bl_ext.user_default.lobe.addon.compare import matching  # noqa: E402

from benchmarks import common  # noqa: E402
from benchmarks.convergence import plan, runs  # noqa: E402

LOBES = "use_adaptive_sampling", "use_denoising"
BLENDERS = "use_compositing", "use_sequencer", "use_persistent_data", "use_border"


@pytest.fixture
def blend(tmp_path):
    """A file with everything on that a comparison goes without."""
    bpy.ops.wm.read_homefile(use_factory_startup=True)
    scene = bpy.context.scene
    for key in LOBES:
        setattr(scene.lobe, key, True)
    for key in BLENDERS:
        setattr(scene.render, key, True)
    scene.lobe.time_limit = 7.0
    for light in bpy.data.lights:
        light.use_soft_falloff = True
    path = tmp_path / "everything.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


class Witness:
    """Stands in for matching's Keeper, and makes no change."""

    def __init__(self) -> None:
        self.changes: list[tuple[str, str]] = []

    def put(self, owner, key: str, value) -> None:
        if getattr(owner, key) != value:
            self.changes.append((type(owner).__name__, key))

    def at_end(self, *_) -> None:
        pass


def test_nothing_is_left_on(blend):
    scene = common.prepare(blend, (8, 8), 1)
    assert not any(getattr(scene.lobe, key) for key in LOBES)
    assert scene.lobe.time_limit == 0.0
    assert not any(getattr(scene.render, key) for key in BLENDERS[:-1])
    assert scene.render.use_crop_to_border
    assert len(bpy.data.lights) and not any(light.use_soft_falloff for light in bpy.data.lights)


def test_compare_with_cycles_finds_nothing_more_to_switch_off(blend):
    scene = common.prepare(blend, (8, 8), 1)
    witness = Witness()
    matching.prepare(scene, witness, 0.0)
    own = {key for owner, key in witness.changes if "Cycles" not in owner}
    assert own <= {
        "use_stamp_filename",  # which every render of the tools does
        "emission_sampling", "shadow_terminator_geometry_offset", "shadow_terminator_shading_offset",  # Cycles'
    }  # fmt: skip


def textured_world(*groups: str):
    """A world with an image, inside as many node groups as are named."""
    world = bpy.data.worlds.new("World")
    if bpy.app.version < (5, 0):
        world.use_nodes = True
    tree = world.node_tree
    for name in groups:
        node = tree.nodes.new("ShaderNodeGroup")
        node.node_tree = bpy.data.node_groups.new(name, "ShaderNodeTree")
        tree = node.node_tree
    tree.nodes.new("ShaderNodeTexCoord")
    return world, tree


@pytest.mark.parametrize("groups", [(), ("one", "in one")])
def test_a_world_with_a_texture_is_known(groups):
    bpy.ops.wm.read_homefile(use_factory_startup=True)
    scene = bpy.context.scene
    assert not runs.has_textured_world(scene)
    scene.world, tree = textured_world(*groups)
    assert not runs.has_textured_world(scene)  # coordinates are no texture
    tree.nodes.new("ShaderNodeTexEnvironment")
    assert runs.has_textured_world(scene)
    scene.world = None
    assert not runs.has_textured_world(scene)


def test_every_variant_sets_the_map_of_such_a_world(blend):
    """And takes back what the one before has set."""
    renderer = runs.BlenderRenderer(plan.Settings(blend, resolution=(8, 8), threads=1))
    scene = renderer.scene = common.prepare(blend, (8, 8), 1)
    scene.world, tree = textured_world()
    tree.nodes.new("ShaderNodeTexGradient")
    found = []
    for variant in (*plan.with_maps(plan.DEFAULT), plan.DEFAULT):
        assert renderer(plan.job("pilot", "CYCLES", 1, 0, variant)).report["textured_world"]
        settings = scene.world.cycles
        found.append(
            settings.sampling_method if settings.sampling_method == "AUTOMATIC" else settings.sample_map_resolution
        )
    assert found == ["AUTOMATIC", 1024, 2048, "AUTOMATIC"]
