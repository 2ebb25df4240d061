"""The whole of a dependency graph to `engine.Scene`, part by part."""

from __future__ import annotations

import os
from collections.abc import Callable

import bpy

from ...engine import Mist, Scene
from ..denoise import MISSING, is_missing, print_what_was_tried
from ..passes import wanted_passes
from .camera import border, export_camera, resolution
from .faults import naming
from .instances import Placement
from .kept import Kept
from .notes import Notes
from .settings import film_exposure, property_group
from .unsupported import note_cycles_scene, note_view_layer

# Exponents of Blender's mist, see Cycles' blender/sync.cpp.
MIST_FALLOFF = {"QUADRATIC": 2.0, "LINEAR": 1.0, "INVERSE_QUADRATIC": 0.5}

WORKING_SPACE = "Linear Rec.709"


def export_scene(
    depsgraph, stop: Callable[[], bool] | None = None, notes: Notes | None = None, kept: Kept | None = None
) -> Scene:
    """Everything that the picture of an evaluated dependency graph depends on, as plain arrays.

    stop   asked often; once it says True, ExportStopped is raised
    notes  is told what is not drawn as asked, as data; the scene has the same as sentences
    kept   of the export before of the same view layer, that has heard of all changes since; after an error it is spoilt

    Raises SceneError without a camera; all else that cannot be rendered is for `Scene.validate` to say. Nothing of
    Blender's is kept.
    """
    scene = depsgraph.scene_eval
    view_layer = depsgraph.view_layer_eval
    render = scene.render
    width, height = resolution(render)
    notes = Notes() if notes is None else notes
    kept = Kept() if kept is None else kept
    kept.stop.ask = stop
    with naming("camera", scene.camera.name_full if scene.camera else ""):
        camera = export_camera(scene, notes)
    materials = kept.table(depsgraph, notes)
    placement = Placement(
        depsgraph, materials, notes, kept.stop, kept.meshes, with_uvs="UV" in wanted_passes(depsgraph.view_layer)
    )
    kept.placed(materials)
    world, suns = kept.world(depsgraph, notes)
    note_libraries(notes)
    note_working_space(notes)
    note_scene(depsgraph.scene, notes)
    note_denoising(scene, notes)
    note_cycles_scene(scene, notes)
    note_view_layer(view_layer, notes)
    exported = Scene(
        camera=camera,
        width=width,
        height=height,
        region=border(render, width, height),
        meshes=placement.meshes,
        instances=placement.instances,
        materials=materials.materials,
        lights=placement.lights + suns,
        world=world,
        exposure=film_exposure(scene),
        transparent_film=render.film_transparent,
        mist=export_mist(scene.world),
        occlusion_distance=scene.world.light_settings.distance if scene.world else Scene.occlusion_distance,
        alpha_threshold=depsgraph.view_layer.pass_alpha_threshold,
    )
    kept.finish(exported, notes)
    exported.skipped, exported.warnings = notes.skipped, notes.warnings
    return exported


def export_mist(world) -> Mist:
    """Of the scene's world, whichever the view layer shows: so does Cycles."""
    if world is None:
        return Mist()
    mist = world.mist_settings
    return Mist(mist.start, mist.depth, MIST_FALLOFF[mist.falloff])


def note_libraries(notes: Notes) -> None:
    """Names linked files that are gone: Blender left out what was in them when it opened the file."""
    for library in bpy.data.libraries:
        path = bpy.path.abspath(library.filepath, library=library.parent)
        held_here = library.packed_file is not None or getattr(library, "is_archive", False)
        if not held_here and not os.path.isfile(path):
            notes.warn("library", library.filepath, "it is missing, and so is what is linked from it")


def working_space() -> str:
    """Of the open file, which has one from Blender 5.0 on."""
    return getattr(getattr(bpy.data, "colorspace", None), "working_space", WORKING_SPACE)


def note_working_space(notes: Notes) -> None:
    """All conversions of colours here are to the default."""
    space = working_space()
    if space != WORKING_SPACE:
        notes.warn_scene(f"the working space {space} is not supported: colours are taken for {WORKING_SPACE}")


def note_scene(scene, notes: Notes) -> None:
    """Names what the render settings ask for and the engine does not do."""
    render = scene.render
    if render.use_motion_blur:
        notes.warn_scene("motion blur is not supported and left out")
    if render.use_multiview:
        notes.warn_scene("stereo rendering is not supported, every view is the centre one")
    if render.use_freestyle:
        note_freestyle(scene.view_layers, notes)


def note_freestyle(view_layers, notes: Notes) -> None:
    """Blender puts the lines over every engine's picture. It has EEVEE draw them, but for Cycles, which draws its own:
    EEVEE dithers what one can see through."""
    for layer in view_layers:
        lines = layer.freestyle_settings.linesets if layer.use and layer.use_freestyle else ()
        styles = [line.linestyle for line in lines if line.show_render and line.linestyle is not None]
        if any(style.alpha < 1.0 or len(style.alpha_modifiers) for style in styles):
            what = "Freestyle lines that one can see through are drawn by EEVEE, which makes them grainy"
            notes.approximate("view layer", layer.name, what)


def note_denoising(scene, notes: Notes) -> None:
    if getattr(property_group(scene, "lobe"), "use_denoising", False) and is_missing():
        notes.warn_scene(MISSING)
        print_what_was_tried()
