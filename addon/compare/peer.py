"""Cycles as Lobe's peer: the settings that make a comparison fair, and an exact Phong BRDF for the `Phong BSDF` group.

Used by "Compare with Cycles", and through tools/cycles_peer.py by the tools, the benchmarks and the scripts of
sample_blends/. Every setting that is touched here is one that changes the expected picture, not its speed; Cycles
keeps its own sampling pattern, light tree and ray acceleration as they are.

put(owner, key, value) makes each change, so that whoever wants to can take it back: a comparison does, also for as long
as Blender saves a file.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from ..phong_mark import is_phong_tree

Put = Callable[[object, str, object], None]
AtEnd = Callable[[Callable[[], None], Callable[[], None]], None]

OSL_NODE_NAME = "Phong peer (Open Shading Language)"

# `phong_ramp` with eight equal colours is ks (n + 2) / (2 pi) cos^n(alpha), see Cycles' closure/bsdf_phong_ramp.h.
OSL_SOURCE = """shader phong(color kd = 0, color ks = 1, float n = 10, output closure color BSDF = 0)
{
    color ramp[8] = {1, 1, 1, 1, 1, 1, 1, 1};
    BSDF = kd * diffuse(N) + ks * phong_ramp(N, n, ramp);
}
"""

# What Lobe does not have, or does not do unless asked: off.
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
    "use_layer_samples": "IGNORE",  # those of the scene, in every view layer
    "transparent_max_bounces": 1024,
    "direct_light_sampling_type": "MULTIPLE_IMPORTANCE_SAMPLING",
    "device": "CPU",
}


class NoShader(Exception):
    """Cycles can't draw the exact Phong lobe here; the text says why."""

    def __init__(self, text: str, said: str = "") -> None:
        super().__init__(text)
        self.said = said  # by its compiler, in one line: for a log


def apply_fair_settings(scene, put: Put = setattr) -> None:
    """Set `scene.cycles`, and the objects and materials of `scene`'s file, to what `FAIR` lists, shadow
    terminator offsets 0, emission from both sides; and the scene to no motion blur.

    Bounces, filter, samples and seed are not touched: see `copy_lobe_settings`.
    """
    import bpy

    for key, value in FAIR.items():
        if hasattr(scene.cycles, key):  # older and newer versions lack some
            put(scene.cycles, key, value)
    put(scene.render, "use_motion_blur", False)
    for obj in bpy.data.objects:
        if obj.library is None:
            for key in terminator_offsets(obj):
                put(shadow_terminator(obj), key, 0.0)
    for material in bpy.data.materials:
        if material.library is None:
            put(material.cycles, "emission_sampling", "FRONT_BACK")


def terminator_offsets(obj) -> tuple[str, str]:
    """The names of an object's two offsets."""
    shading = "shadow_terminator_shading_offset"  # in Blender 4.2 "shadow_terminator_offset"
    if not hasattr(shadow_terminator(obj), shading):
        shading = "shadow_terminator_offset"
    return "shadow_terminator_geometry_offset", shading


def shadow_terminator(obj):
    """What holds an object's shadow terminator offsets: the object itself, in Blender 4.2 its Cycles settings."""
    return obj if hasattr(obj, "shadow_terminator_geometry_offset") else obj.cycles


def copy_lobe_settings(scene, put: Put = setattr) -> None:
    """Give Cycles the bounces, filter, clamps, samples and seed that `scene.lobe` holds.

    Bounces mean the same in both (see tests/tools/test_cycles_peer.py).
    """
    lobe = scene.lobe
    for key, value in {
        "max_bounces": lobe.max_bounces,
        "diffuse_bounces": lobe.diffuse_bounces,
        "glossy_bounces": lobe.glossy_bounces,
        "transmission_bounces": lobe.max_bounces,
        "min_light_bounces": 0,
        "min_transparent_bounces": 0,
        "pixel_filter_type": lobe.pixel_filter,
        "filter_width": lobe.filter_width,
        "samples": lobe.samples,
        "seed": lobe.seed,
        "sample_clamp_direct": lobe.clamp_direct,
        "sample_clamp_indirect": lobe.clamp_indirect,
    }.items():
        put(scene.cycles, key, value)


def phong_groups() -> list:
    """The node groups that hold a Phong BRDF for Lobe."""
    import bpy

    return [tree for tree in bpy.data.node_groups if is_phong_tree(tree)]


def use_osl_phong(scene, put: Put = setattr, at_end: AtEnd = lambda undo, again: None) -> bool:
    """Put the exact Phong closure into every `Phong BSDF` group and switch Cycles to Open Shading Language.

    at_end is given what takes it out of a group, and what puts it in again. Returns whether the file has such a group;
    without one the shading system stays as it is (it is the faster). Raises NoShader.
    """
    groups = phong_groups()
    missing = any(OSL_NODE_NAME not in tree.nodes for tree in groups)
    bytecode = _compile_osl(OSL_SOURCE) if missing else ""  # before any change: this may fail
    for tree in groups:
        exact = _ExactPhong(tree, bytecode)
        exact.put_in()
        at_end(exact.take_out, exact.put_in)
    if groups:
        put(scene.cycles, "shading_system", True)
    return bool(groups)


class _ExactPhong:
    """The exact closure in one group. The group and what is in it are looked up each time, as an undo makes all of it
    anew; where that has taken the closure out, or the group is gone, there is nothing left to take out."""

    def __init__(self, tree, bytecode: str) -> None:
        self._group = tree.session_uid
        self._bytecode = bytecode
        self._has_node = OSL_NODE_NAME in tree.nodes  # of the user's own: it stays
        link = next(iter(_output(tree).links), None)  # one at most
        self._fed_by = (link.from_node.name, link.from_socket.identifier) if link else None

    def put_in(self) -> None:
        tree = self._tree()
        if tree is not None:
            node = tree.nodes.get(OSL_NODE_NAME) or _add_osl_node(tree, self._bytecode)
            tree.links.new(node.outputs["BSDF"], _output(tree))

    def take_out(self) -> None:
        tree = self._tree()
        if tree is None or OSL_NODE_NAME not in tree.nodes:
            return
        if not self._has_node:
            tree.nodes.remove(tree.nodes[OSL_NODE_NAME])
        for link in _output(tree).links:
            tree.links.remove(link)
        name, identifier = self._fed_by or ("", "")
        if name in tree.nodes:
            source = next(socket for socket in tree.nodes[name].outputs if socket.identifier == identifier)
            tree.links.new(source, _output(tree))

    def _tree(self):
        import bpy

        return next((tree for tree in bpy.data.node_groups if tree.session_uid == self._group), None)


def _output(tree):
    """The input of the group's output node that takes the surface."""
    return next(node for node in tree.nodes if node.bl_idname == "NodeGroupOutput").inputs[0]


def _add_osl_node(tree, bytecode: str):
    """A script node with compiled code and sockets made by hand: the bpy wheel lacks `oslquery`, which does this."""
    node = tree.nodes.new("ShaderNodeScript")
    node.name = node.label = OSL_NODE_NAME
    node.mode = "INTERNAL"
    node.bytecode = bytecode
    node.bytecode_hash = hashlib.md5(node.bytecode.encode()).hexdigest()
    for kind, name in (("NodeSocketColor", "kd"), ("NodeSocketColor", "ks"), ("NodeSocketFloat", "n")):
        node.inputs.new(type=kind, name=name, identifier=name)
    node.outputs.new(type="NodeSocketShader", name="BSDF", identifier="BSDF")

    inputs = next(n for n in tree.nodes if n.bl_idname == "NodeGroupInput").outputs
    for name, socket in (("kd", "kd"), ("ks", "ks"), ("exponent", "n")):
        tree.links.new(inputs[name], node.inputs[socket])
    return node


def _compile_osl(source: str) -> str:
    try:
        from _cycles import osl_compile
    except ImportError as error:
        raise NoShader("this Blender's Cycles has no Open Shading Language") from error
    with tempfile.TemporaryDirectory() as folder:
        osl, oso, said = (Path(folder, name) for name in ("phong.osl", "phong.oso", "said"))
        osl.write_text(source)
        with _stderr_to(said):
            compiled = osl_compile(str(osl), str(oso))
        if not compiled:
            text = "the Open Shading Language of this Blender's Cycles doesn't work"
            raise NoShader(text, " / ".join(said.read_text(errors="replace").split("\n")[:-1]))
        if others := said.read_bytes():  # of Blender's other threads: the compiler has nothing to complain of
            os.write(2, others)
        return oso.read_text()


@contextlib.contextmanager
def _stderr_to(path: Path) -> Iterator[None]:
    """Standard error goes to a file for the while, also what is written from C++, as the compiler's messages are."""
    with path.open("wb") as file:
        try:
            real = os.dup(2)
        except OSError:  # a Blender for Windows without its console: then nobody reads it
            yield
            return
        try:
            os.dup2(file.fileno(), 2)
            yield
        finally:
            os.dup2(real, 2)
            os.close(real)
