"""Render passes: the boxes of a view layer, the names that Blender knows their pictures by, and getting them there."""

from __future__ import annotations

from typing import NamedTuple

import bpy
import numpy as np
from bpy.props import BoolProperty, PointerProperty


class Kind(NamedTuple):
    """Of a pass: where its box is, what it is called from Blender 5 on and what in 4, its channels and their type.

    box  a property of the view layer, or of Lobe's own group there
    """

    box: str
    name: str
    old_name: str
    channels: str = "RGB"
    type: str = "COLOR"


# By the engine's names, in the order of Blender's own engines: so are the sockets of the Render Layers node.
KINDS = {
    "DEPTH": Kind("use_pass_z", "Depth", "Depth", "Z", "VALUE"),
    "MIST": Kind("use_pass_mist", "Mist", "Mist", "Z", "VALUE"),
    "POSITION": Kind("use_pass_position", "Position", "Position", "XYZ", "VECTOR"),
    "NORMAL": Kind("use_pass_normal", "Normal", "Normal", "XYZ", "VECTOR"),
    "UV": Kind("use_pass_uv", "UV", "UV", "UVA", "VECTOR"),
    "OBJECT_INDEX": Kind("use_pass_object_index", "Object Index", "IndexOB", "X", "VALUE"),
    "MATERIAL_INDEX": Kind("use_pass_material_index", "Material Index", "IndexMA", "X", "VALUE"),
    "DIFFUSE_DIRECT": Kind("use_pass_diffuse_direct", "Diffuse Direct", "DiffDir"),
    "DIFFUSE_INDIRECT": Kind("use_pass_diffuse_indirect", "Diffuse Indirect", "DiffInd"),
    "DIFFUSE_COLOR": Kind("use_pass_diffuse_color", "Diffuse Color", "DiffCol"),
    "GLOSSY_DIRECT": Kind("use_pass_glossy_direct", "Glossy Direct", "GlossDir"),
    "GLOSSY_INDIRECT": Kind("use_pass_glossy_indirect", "Glossy Indirect", "GlossInd"),
    "GLOSSY_COLOR": Kind("use_pass_glossy_color", "Glossy Color", "GlossCol"),
    "EMISSION": Kind("use_pass_emit", "Emission", "Emit"),
    "ENVIRONMENT": Kind("use_pass_environment", "Environment", "Env"),
    "AMBIENT_OCCLUSION": Kind("use_pass_ambient_occlusion", "Ambient Occlusion", "AO"),
    "SAMPLE_COUNT": Kind("pass_sample_count", "Debug Sample Count", "Debug Sample Count", "X", "VALUE"),
    "DENOISING_ALBEDO": Kind("denoising_data", "Denoising Albedo", "Denoising Albedo"),
    "DENOISING_NORMAL": Kind("denoising_data", "Denoising Normal", "Denoising Normal", "XYZ", "VECTOR"),
}


# Of a picture that is denoised, Combined before that, by Cycles' name in every version. Nobody ticks it.
NOISY = "Noisy Image"


def update_sockets(properties: bpy.types.PropertyGroup, _context) -> None:
    """Of a scene's Render Layers nodes, all at once: Blender does this by itself for its own boxes alone."""
    properties.id_data.view_layers[0].update_render_passes()


class LobeViewLayer(bpy.types.PropertyGroup):
    """`view_layer.lobe`: the boxes that Blender itself doesn't have."""

    denoising_data: BoolProperty(
        name="Denoising Data",
        description="Albedo and normal of the first surface, by which the compositor's Denoise node tells edges from "
        "noise. Takes the time of one more ray for each sample",
        update=update_sockets,
    )
    pass_sample_count: BoolProperty(
        name="Sample Count",
        description="How many samples each pixel took: fewer where adaptive sampling stopped early. Takes no time",
        update=update_sockets,
    )


def blender_name(name: str) -> str:
    """Of a pass of the engine."""
    kind = KINDS[name]
    return kind.name if bpy.app.version >= (5, 0, 0) else kind.old_name


def wanted_passes(view_layer) -> tuple[str, ...]:
    """The engine's names of the passes whose boxes are ticked. Of an original view layer: asking an evaluated one for
    Lobe's group would make it one, which nobody frees."""
    own = getattr(view_layer, "lobe", None)  # absent where the add-on isn't registered
    return tuple(name for name, kind in KINDS.items() if getattr(view_layer, kind.box, getattr(own, kind.box, False)))


def register_passes(engine: bpy.types.RenderEngine, scene, view_layer) -> None:
    """Blender makes room in the render's result for what is named here, and sockets in the compositor."""
    from .export.settings import property_group  # the export imports this module

    engine.register_pass(scene, view_layer, "Combined", 4, "RGBA", "COLOR")
    for name in wanted_passes(view_layer):
        kind = KINDS[name]
        engine.register_pass(scene, view_layer, blender_name(name), len(kind.channels), kind.channels, kind.type)
    if getattr(property_group(scene, "lobe"), "use_denoising", False):
        engine.register_pass(scene, view_layer, NOISY, 4, "RGBA", "COLOR")


def fill_passes(layer, pictures: dict[str, np.ndarray], noisy: np.ndarray | None = None) -> None:
    """Write the pictures of passes into a layer of the result. pictures: (h, w, channels) by the engine's names; noisy:
    (h, w, 4), of a picture that is denoised."""
    by_name = {blender_name(name): picture for name, picture in pictures.items()}
    if noisy is not None:
        by_name[NOISY] = noisy
    for render_pass in layer.passes:
        if render_pass.name in by_name:  # once for each view
            flat = np.ascontiguousarray(by_name[render_pass.name], dtype=np.float32)
            render_pass.rect.foreach_set(flat.reshape(-1))


def register() -> None:
    bpy.utils.register_class(LobeViewLayer)
    bpy.types.ViewLayer.lobe = PointerProperty(
        type=LobeViewLayer, name="Lobe", description="Passes of the Lobe renderer"
    )


def unregister() -> None:
    del bpy.types.ViewLayer.lobe
    bpy.utils.unregister_class(LobeViewLayer)
