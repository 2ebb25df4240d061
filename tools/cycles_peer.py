"""Cycles as Lobe's peer: the settings that make a comparison fair, and an exact Phong BRDF for the `Phong BSDF` group.

Changes the open file in memory and never saves it. Used by tools/render.py, the benchmarks and the scripts of
sample_blends/. Every setting that is touched here is one that changes the expected picture, not its speed; Cycles
keeps its own sampling pattern, light tree and ray acceleration at their defaults.
"""

from __future__ import annotations

import hashlib
import tempfile
from pathlib import Path

PHONG_GROUP_NAME = "Phong BSDF"
OSL_NODE_NAME = "Phong peer (Open Shading Language)"

# `phong_ramp` with eight equal colours is ks (n + 2) / (2 pi) cos^n(alpha), see Cycles' closure/bsdf_phong_ramp.h.
OSL_SOURCE = """shader phong(color kd = 0, color ks = 1, float n = 10, output closure color BSDF = 0)
{
    color ramp[8] = {1, 1, 1, 1, 1, 1, 1, 1};
    BSDF = kd * diffuse(N) + ks * phong_ramp(N, n, ramp);
}
"""

# What Lobe does not have, or does not do unless asked: off. REFERENCE of each value: Cycles' own documentation.
FAIR = {
    "use_adaptive_sampling": False,
    "use_denoising": False,
    "sample_clamp_direct": 0.0,
    "sample_clamp_indirect": 0.0,
    "light_sampling_threshold": 0.0,
    "blur_glossy": 0.0,
    "caustics_reflective": True,
    "caustics_refractive": True,
    "use_fast_gi": False,
    "use_guiding": False,
    "use_camera_cull": False,
    "use_distance_cull": False,
    "time_limit": 0.0,
    "use_sample_subset": False,
    "use_animated_seed": False,
    "transparent_max_bounces": 1024,
    "direct_light_sampling_type": "MULTIPLE_IMPORTANCE_SAMPLING",
    "device": "CPU",
}


def apply_fair_settings(scene) -> None:
    """Set `scene.cycles`, and the objects and materials of `scene`'s file, to what REFERENCE section 4 lists.

    Bounces, filter, samples and seed are not touched: see `copy_lobe_settings`.
    """
    import bpy

    for key, value in FAIR.items():
        if hasattr(scene.cycles, key):  # older and newer versions lack some
            setattr(scene.cycles, key, value)
    for obj in bpy.data.objects:
        if obj.library is None:
            shadow_terminator(obj).shadow_terminator_geometry_offset = 0.0
            shadow_terminator(obj).shadow_terminator_shading_offset = 0.0
    for material in bpy.data.materials:
        if material.library is None:
            material.cycles.emission_sampling = "FRONT_BACK"


def shadow_terminator(obj):
    """What holds an object's shadow terminator offsets: the object itself, in Blender 4.2 its Cycles settings."""
    return obj if hasattr(obj, "shadow_terminator_geometry_offset") else obj.cycles


def set_bounces(scene, total: int, diffuse: int, glossy: int) -> None:
    """Lobe's limits in Cycles' terms; they mean the same (see tests/tools/test_cycles_peer.py)."""
    scene.cycles.max_bounces = total
    scene.cycles.diffuse_bounces = diffuse
    scene.cycles.glossy_bounces = glossy
    scene.cycles.transmission_bounces = total
    scene.cycles.min_light_bounces = 0
    scene.cycles.min_transparent_bounces = 0


def copy_lobe_settings(scene) -> None:
    """Give Cycles the bounces, filter, clamps, samples and seed that `scene.lobe` holds."""
    lobe, cycles = scene.lobe, scene.cycles
    set_bounces(scene, lobe.max_bounces, lobe.diffuse_bounces, lobe.glossy_bounces)
    cycles.pixel_filter_type = lobe.pixel_filter
    cycles.filter_width = lobe.filter_width
    cycles.samples = lobe.samples
    cycles.seed = lobe.seed
    cycles.sample_clamp_direct = lobe.clamp_direct
    cycles.sample_clamp_indirect = lobe.clamp_indirect


def phong_groups() -> list:
    """The node groups that hold a Phong BRDF for Lobe."""
    import bpy

    groups = [tree for tree in bpy.data.node_groups if tree.bl_idname == "ShaderNodeTree"]
    named = [tree for tree in groups if tree.name == PHONG_GROUP_NAME]  # which can be somebody else's
    named = [tree for tree in named if {"kd", "ks", "exponent"} <= set(tree.interface.items_tree.keys())]
    return [tree for tree in groups if tree.get("lobe_phong") or tree in named]


def use_osl_phong(scene) -> bool:
    """Put the exact Phong closure into every `Phong BSDF` group and switch Cycles to Open Shading Language.

    Returns whether the file has such a group; without one the shading system stays as it is (it is the faster).
    """
    groups = phong_groups()
    for tree in groups:
        node = tree.nodes.get(OSL_NODE_NAME) or _add_osl_node(tree)
        output = next(n for n in tree.nodes if n.bl_idname == "NodeGroupOutput")
        tree.links.new(node.outputs["BSDF"], output.inputs[0])
    if groups:
        scene.cycles.shading_system = True
    return bool(groups)


def _add_osl_node(tree):
    """A script node with compiled code and sockets made by hand: the bpy wheel lacks `oslquery`, which does this."""
    node = tree.nodes.new("ShaderNodeScript")
    node.name = node.label = OSL_NODE_NAME
    node.mode = "INTERNAL"
    node.bytecode = _compile_osl(OSL_SOURCE)
    node.bytecode_hash = hashlib.md5(node.bytecode.encode()).hexdigest()
    for kind, name in (("NodeSocketColor", "kd"), ("NodeSocketColor", "ks"), ("NodeSocketFloat", "n")):
        node.inputs.new(type=kind, name=name, identifier=name)
    node.outputs.new(type="NodeSocketShader", name="BSDF", identifier="BSDF")

    inputs = next(n for n in tree.nodes if n.bl_idname == "NodeGroupInput").outputs
    for name, socket in (("kd", "kd"), ("ks", "ks"), ("exponent", "n")):
        tree.links.new(inputs[name], node.inputs[socket])
    return node


def _compile_osl(source: str) -> str:
    import _cycles

    with tempfile.TemporaryDirectory() as folder:
        osl, oso = Path(folder, "phong.osl"), Path(folder, "phong.oso")
        osl.write_text(source)
        if not _cycles.osl_compile(str(osl), str(oso)):
            raise RuntimeError("Cycles could not compile the Open Shading Language Phong shader")
        return oso.read_text()
