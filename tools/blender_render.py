"""Rendering a .blend inside this Python process, with Lobe or with Cycles, and getting at the pixels.

Shared by render.py, parity.py and the benchmarks. Everything in here expects `enable_lobe()` to have been called.
Errors that the user can mend are ToolErrors: the tools show their text and nothing else.
"""

from __future__ import annotations

import ast
import contextlib
import os
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from . import cycles_peer

ENGINES = ("LOBE", "CYCLES")
PHASES = ("export", "build", "compile", "render", "denoise", "total")


class ToolError(Exception):
    """Something that the user asked for cannot be done; the text says what and why."""


# --- the file and its settings --------------------------------------------------------------------------------


def open_blend(path: Path, scene_name: str | None = None):
    """Open `path` and give back the scene to render (the one that was active when it was saved, or the named)."""
    import bpy

    if not path.is_file():
        raise ToolError(f"{str(path)!r} does not exist: expected a .blend file")
    try:
        bpy.ops.wm.open_mainfile(filepath=str(path.resolve()), load_ui=False)
    except RuntimeError as error:
        raise ToolError(f"{str(path)!r} cannot be opened: {_blender_message(error)}") from error
    if scene_name is None:
        return bpy.context.scene
    if scene_name not in bpy.data.scenes:
        names = ", ".join(repr(s.name) for s in bpy.data.scenes)
        raise ToolError(f"the file has no scene {scene_name!r}: there are {names}")
    bpy.context.window.scene = bpy.data.scenes[scene_name]
    return bpy.data.scenes[scene_name]


def set_value(scene, assignment: str) -> None:
    """Carry out `scene.lobe.KEY=VALUE` (or any other property that hangs below the scene)."""
    path, equals, text = assignment.partition("=")
    keys = path.strip().split(".")
    if not equals or len(keys) < 2 or keys[0] != "scene":
        raise ToolError(f"--set {assignment!r}: expected scene.lobe.KEY=VALUE")
    owner = scene
    for key in keys[1:-1]:
        owner = getattr(owner, key, None)
        if owner is None or not hasattr(owner, "bl_rna"):
            raise ToolError(f"--set {assignment!r}: the scene has nothing called {key!r}")
    prop = owner.bl_rna.properties.get(keys[-1])
    if prop is None:
        known = sorted(p.identifier for p in owner.bl_rna.properties if p.identifier not in ("rna_type", "name"))
        listed = f": there are {', '.join(known)}" if keys[1] == "lobe" else ""
        raise ToolError(f"--set {assignment!r}: there is no setting {keys[-1]!r}{listed}")
    try:
        setattr(owner, keys[-1], _parse(prop, text.strip()))
    except (TypeError, ValueError, AttributeError) as error:
        raise ToolError(f"--set {assignment!r}: {error}") from error


def _parse(prop, text: str):
    """The value that `text` means to a Blender property. Blender itself would clamp without a word."""
    if prop.type == "ENUM":
        choices = [item.identifier for item in prop.enum_items]
        if choices and text not in choices:
            raise ValueError(f"{text!r} is not one of {', '.join(choices)}")
        return text
    if prop.type == "STRING":
        return text
    try:
        value = ast.literal_eval(text.capitalize() if text.lower() in ("true", "false") else text)
    except (ValueError, SyntaxError):
        if prop.type in ("INT", "FLOAT") and text.lower().lstrip("+-") in ("inf", "infinity", "nan"):
            raise ValueError(f"{text} is not finite") from None
        raise ValueError(f"{text!r} is not a value of type {prop.type.lower()}") from None
    if prop.type == "BOOLEAN":
        if value not in (0, 1):
            raise ValueError(f"{text!r} is neither True nor False")
        return bool(value)
    if prop.type in ("INT", "FLOAT") and isinstance(value, int | float):
        if prop.type == "INT" and int(value) != value:
            raise ValueError(f"{text!r} is not a whole number")
        if not prop.hard_min <= value <= prop.hard_max:
            raise ValueError(f"{text} does not lie between {prop.hard_min:g} and {prop.hard_max:g}")
    return value


def set_resolution(scene, width: int, height: int) -> None:
    """Make the picture `width` by `height` pixels, whatever percentage the file holds."""
    scene.render.resolution_x, scene.render.resolution_y = width, height
    scene.render.resolution_percentage = 100


def set_threads(scene, threads: int) -> None:
    """0: as many as the machine has."""
    scene.render.threads_mode = "FIXED" if threads else "AUTO"
    if threads:
        scene.render.threads = threads


def set_engine(scene, engine: str, as_is: bool = False) -> None:
    """Choose the engine. Cycles gets what Lobe would use, and the fair settings, unless `as_is`."""
    try:
        scene.render.engine = engine
    except TypeError as error:
        raise ToolError(f"this Blender has no engine {engine!r}") from error
    if engine == "CYCLES" and not as_is:
        cycles_peer.apply_fair_settings(scene)
        cycles_peer.copy_lobe_settings(scene)
        try:
            cycles_peer.use_osl_phong(scene)
        except cycles_peer.NoShader as error:
            if error.said:
                print(f"Cycles' shader compiler said: {error.said}", file=sys.stderr)
            from bl_ext.user_default.lobe.addon.phong_mark import PHONG_GROUP_NAME

            raise ToolError(
                f"{error}, so it can't draw the exact Phong lobe of {PHONG_GROUP_NAME!r}. With render.py's "
                "--as-is it draws the Glossy BSDF in that node group"
            ) from error


def check_renderable(scene) -> None:
    """What Blender itself would say in other words, or not at all, or only after it has run out of memory."""
    from bl_ext.user_default.lobe.addon.check import nothing_to_begin_with
    from bl_ext.user_default.lobe.addon.export.camera import border, resolution
    from bl_ext.user_default.lobe.engine import LobeError, memory

    if missing := nothing_to_begin_with(scene):
        raise ToolError(missing)
    width, height = resolution(scene.render)
    x0, y0, x1, y1 = border(scene.render, width, height) or (0, 0, width, height)
    try:
        memory.foresee({f"{width} x {height} pixels": memory.OF_PIXEL * (x1 - x0) * (y1 - y0)})
    except LobeError as error:
        raise ToolError(str(error)) from error


# --- rendering ------------------------------------------------------------------------------------------------


def render(
    scene, on_progress: Callable[[int, int], None] | None = None, on_message: Callable[[str], None] | None = None
) -> dict:
    """Render `scene` into Blender's Render Result; gives back the report, with the keys of the command line's JSON.

    on_progress(done, total)  samples; called whenever the engine says how many it has
    on_message(text)          whatever else it says: that it builds, or compiles
    """
    import bpy

    def listen(text, *_):
        found = re.search(r"[Ss]amples?:? (\d+)/(\d+)", str(text))
        if found and on_progress is not None:
            on_progress(int(found[1]), int(found[2]))
        elif not found and on_message is not None:
            on_message(str(text).rsplit("|", 1)[-1].strip())

    _stamp_name_only(scene)
    stereo, scene.render.use_multiview = scene.render.use_multiview, False
    bpy.app.handlers.render_stats.append(listen)
    start = time.perf_counter()
    try:
        bpy.ops.render.render(scene=scene.name)
    except RuntimeError as error:
        raise ToolError(f"the render failed: {_blender_message(error)}") from error
    finally:
        bpy.app.handlers.render_stats.remove(listen)
    total = time.perf_counter() - start
    report = _lobe_report(total) if scene.render.engine == "LOBE" else _cycles_report(scene, total)
    if stereo:
        report["warnings"].append("stereo rendering is not supported here: the picture is the centre view")
    return report


class Checked(NamedTuple):
    """Whether Lobe draws everything as asked, or at least nearly so, and the lines of the scene report."""

    is_honoured: bool
    is_nearly_honoured: bool
    lines: list[str]


def check(scene) -> Checked:
    """Of what Lobe draws of `scene`. Renders nothing."""
    from bl_ext.user_default.lobe.addon import scene_report
    from bl_ext.user_default.lobe.addon.check import check as notes_of
    from bl_ext.user_default.lobe.addon.export.notes import ERROR, WARNING

    report = scene_report.keep(scene_report.key(scene), "check", notes_of(scene))
    is_nearly = not report.of_level(ERROR, WARNING)
    return Checked(scene_report.is_honoured(report), is_nearly, scene_report.lines(report))


def _stamp_name_only(scene) -> None:
    """Blender writes the file's whole path into pictures, where it says more about the machine than about the picture:
    its name stands there as a note instead, unless the file has a note of its own."""
    import bpy

    scene.render.use_stamp_filename = False
    if not scene.render.use_stamp_note:
        scene.render.use_stamp_note = True
        scene.render.stamp_note_text = Path(bpy.data.filepath).name


def _lobe_report(total: float) -> dict:
    from bl_ext.user_default.lobe.addon.report import last_report

    if not last_report:
        raise ToolError("Lobe ended without a picture")
    report = {key: last_report[key] for key in ("engine", "samples", "seconds", "rays")}
    seconds = {phase: last_report["seconds"].get(phase, 0.0) for phase in PHASES[:-1]}
    report["seconds"] = seconds | {"total": total}
    report["peak_memory_mb"] = _peak_memory_mb()
    report["skipped"], report["warnings"] = list(last_report["skipped"]), list(last_report["warnings"])
    return report


def _cycles_report(scene, total: float) -> dict:
    """What Cycles tells: it keeps its times, in hundredths of a second, as metadata of the picture (see `picture`).

    Its synchronisation is both export and the building of its BVH.
    """
    return {
        "engine": scene.render.engine,
        "samples": scene.cycles.samples,
        "seconds": dict.fromkeys(PHASES) | {"total": total},
        "rays": None,
        "peak_memory_mb": _peak_memory_mb(),
        "skipped": [],
        "warnings": [],
    }


def _peak_memory_mb() -> float:
    """Of the whole process, Blender included."""
    from bl_ext.user_default.lobe.addon.memory import current_and_peak_mb

    return round(current_and_peak_mb()[1], 1)


def picture(scene, report: dict | None = None) -> np.ndarray:
    """The Render Result, (h, w, 4) float32, row 0 at the top, scene-linear, premultiplied alpha.

    Fills Cycles' times into `report`.
    """
    from bl_ext.user_default.lobe.addon.compare import pictures

    try:
        pixels, metadata = pictures.rendered(scene, _temporary_prefix())
    except RuntimeError as error:
        raise ToolError(_blender_message(error)) from error
    if report is not None and report["engine"] == "CYCLES":
        _fill_cycles_times(report, metadata)
    return pixels


def passes(scene) -> dict[str, np.ndarray]:
    """What the Render Result has beside the one picture: (h, w) float32, row 0 at the top, by the names of the channels
    in Blender's own multilayer files, such as "ViewLayer.Depth.Z". Nothing where that is one layer's Combined alone.
    """
    import bpy
    import OpenImageIO as oiio
    from bl_ext.user_default.lobe.addon.compare.pictures import image_settings

    newer = {"media_type": "MULTI_LAYER_IMAGE"} if bpy.app.version >= (5, 0) else {}
    folder_in_blenders = tempfile.TemporaryDirectory(dir=bpy.app.tempdir, prefix=_temporary_prefix())
    with folder_in_blenders as folder:
        path = str(Path(folder, "passes.exr"))
        with image_settings(scene, "OPEN_EXR_MULTILAYER", "RGBA", "32", exr_codec="NONE", **newer):
            _render_result().save_render(path, scene=scene)
        channels: dict[str, np.ndarray] = {}
        for part in range(oiio.ImageBuf(path).nsubimages):  # one for each pass from Blender 5 on, else one for all
            buffer = oiio.ImageBuf(path, part, 0)
            pixels = np.asarray(buffer.get_pixels(oiio.FLOAT))
            channels |= {name: pixels[..., i] for i, name in enumerate(buffer.spec().channelnames)}
    return {} if len(channels) == 4 else channels


def _render_result():
    from bl_ext.user_default.lobe.addon.render_slots import render_result

    image = render_result()
    if image is None:
        raise ToolError("nothing has been rendered")
    return image


def remove_temporary_files() -> None:
    """Those of `picture` and `passes`, and Blender's own folder if it is empty, where a process ends without Blender's
    tidying up."""
    import bpy

    folder = Path(bpy.app.tempdir)
    for left in folder.glob(f"{_temporary_prefix()}*"):
        shutil.rmtree(left, ignore_errors=True)
    with contextlib.suppress(OSError):
        folder.rmdir()


def _temporary_prefix() -> str:
    return f"lobe-{os.getpid()}-"


def _fill_cycles_times(report: dict, metadata: dict) -> None:
    from bl_ext.user_default.lobe.addon.compare.run import cycles_seconds

    for name, phase in (("render_time", "render"), ("synchronization_time", "export")):
        report["seconds"][phase] = cycles_seconds(metadata, name)


# --- pictures -------------------------------------------------------------------------------------------------


def save_png(scene, path: Path) -> None:
    """The Render Result through the file's view transform, eight bits; alpha where the film is transparent."""
    from bl_ext.user_default.lobe.addon.compare.pictures import image_settings

    mode = "RGBA" if scene.render.film_transparent else "RGB"
    with image_settings(scene, "PNG", mode, "8"):
        try:
            _render_result().save_render(str(path.resolve()), scene=scene)  # a bare name is no path to Blender
        except RuntimeError as error:
            raise ToolError(f"{str(path)!r} cannot be written: {_blender_message(error)}") from error


def save_exr(
    path: Path,
    pixels: np.ndarray,
    metadata: dict[str, str | float | int],
    others: dict[str, np.ndarray] | None = None,
) -> None:
    """(h, w, 4) scene-linear pixels as a float EXR with `metadata`; `others` are channels as `passes` has them."""
    import OpenImageIO as oiio

    others = others or {}
    pixels = np.dstack([pixels, *others.values()]) if others else pixels
    height, width, channels = pixels.shape
    spec = oiio.ImageSpec(width, height, channels, "float")
    spec.channelnames = ("R", "G", "B", "A", *others)
    spec.attribute("compression", "zip")
    spec.attribute("oiio:ColorSpace", "Linear")
    for key, value in metadata.items():
        spec.attribute(key, value)
    output = oiio.ImageOutput.create(str(path))
    if output is None or not output.open(str(path), spec) or not output.write_image(np.ascontiguousarray(pixels)):
        raise ToolError(f"{str(path)!r} cannot be written: {output.geterror() if output else oiio.geterror()}")
    output.close()


# --- standard output ------------------------------------------------------------------------------------------


@contextlib.contextmanager
def quiet_stdout() -> Iterator[Callable[[str], None]]:
    """Send Blender's own talk on standard output nowhere, for good; gives a function that does write to it.

    At the level of file descriptors, as Blender writes from C. It stays so until the process ends, since Blender
    also talks while it shuts down.
    """
    sys.stdout.flush()
    real = os.fdopen(os.dup(1), "w")
    with open(os.devnull, "w") as nowhere:
        os.dup2(nowhere.fileno(), 1)
    try:
        yield lambda text: print(text, file=real, flush=True)
    finally:
        real.flush()


def _blender_message(error: RuntimeError) -> str:
    from bl_ext.user_default.lobe.addon.faults import blender_message

    return blender_message(error)
