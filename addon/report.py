"""What a render tells the user when it is done: once in Blender's reports, once as data for the command line."""

from __future__ import annotations

import bpy

from ..engine import Result, Scene, Visibility
from . import scene_report
from .export.notes import APPROXIMATED, WARNING, grouped
from .memory import current_and_peak_mb
from .scene_report import note_from_sentence

# The newest finished render, ready for JSON. `tools/render.py` prints it. View layers are summed.
last_report: dict = {}

GREASE_PENCIL = ("GPENCIL", "GREASEPENCIL")  # the types of its objects, before Blender 4.3 and from then on
LONG_COMPILE = 5.0  # seconds: a kernel from the disk cache is there before that

REJECTED = (
    "samples that are not finite come from a light or an emission too strong to calculate with. Where there is none, "
    "this is a bug in Lobe"
)


def start_report(is_preview: bool = False) -> dict:
    """An empty report for a frame. The one before is forgotten, so that a failed render doesn't show it again; but an
    icon, which may be drawn right after a render or beside it, leaves it alone."""
    if not is_preview:
        last_report.clear()
    return {
        "engine": "LOBE",
        "samples": 0.0,
        "seconds": {"export": 0.0, "build": 0.0, "compile": 0.0, "render": 0.0, "total": 0.0},
        "rays": 0,
        "peak_memory_mb": 0.0,
        "skipped": [],
        "warnings": [],
        "notes": [],  # these two go to the scene report, the rest to `last_report`
        "scene_key": None,
        "not_exported": [],
        "rejected": 0,
        "stopped": False,
        "road": "",
    }


def add_layer(report: dict, scene: Scene, result: Result, export_seconds: float, total_seconds: float) -> None:
    """Add one view layer's render to the report of the frame.

    Of what is skipped, the scene's own part is for the user: the rest tells which code the kernel does without.
    """
    report["samples"] = result.samples
    report["road"] = result.road
    seconds = report["seconds"]
    for phase, value in {**result.seconds, "export": export_seconds, "total": total_seconds}.items():
        seconds[phase] = seconds.get(phase, 0.0) + value
    report["rays"] += result.rays
    report["rejected"] += result.rejected
    report["stopped"] |= result.stopped
    report["peak_memory_mb"] = round(current_and_peak_mb()[1], 1)
    for key, sentences in (
        ("skipped", result.skipped),
        ("not_exported", scene.skipped),
        ("warnings", result.warnings),
    ):
        report[key] += [s for s in dict.fromkeys(sentences) if s not in report[key]]


def nothing_to_see(scene: Scene, depsgraph) -> list[str]:
    """Why the picture that an evaluated graph was exported for comes out empty or black, where that is certain. Blender
    puts Grease Pencil over it."""
    is_lit = any(scene.world.color)
    if not len(scene.instances):
        backdrop = is_lit and scene.world.visibility & Visibility.CAMERA and not scene.transparent_film
        lamps = any(lamp.visibility & Visibility.CAMERA for lamp in scene.lights)
        if backdrop or lamps or has_grease_pencil(depsgraph):
            return []
        return ["there is nothing to render: no object has faces, and no world shows behind them"]
    if is_lit or scene.lights or any(any(material.emission) for material in scene.materials):
        return []
    return ["nothing gives light, so every surface is black: add a lamp, an emission or a world colour"]


def has_grease_pencil(depsgraph) -> bool:
    if not getattr(depsgraph.view_layer, "use_grease_pencil", True):  # from Blender 5.0 on
        return False
    return any(isinstance(id_, bpy.types.Object) and id_.type in GREASE_PENCIL for id_ in depsgraph.ids)


def publish(report: dict, engine) -> None:
    """Show the report to the user, and keep it. Some of the warnings are of the export, some of the engine."""
    scene_key, exported = report.pop("scene_key"), report.pop("notes")
    known = {note.sentence: note for note in exported}
    warnings = [known.get(text) or note_from_sentence(WARNING, text) for text in report["warnings"]]
    groups = grouped(warnings)
    if scene_key is not None:
        scene_report.keep(scene_key, "render", dict.fromkeys([*warnings, *exported]))
    last_report.clear()
    last_report.update(report, warnings=[scene_report.sentence(group) for group in groups])
    for group in groups:
        kind = "INFO" if group.level == APPROXIMATED else "WARNING"
        engine.report({kind}, f"Lobe: {scene_report.sentence(group)}")
    if report["rejected"]:  # how many is one of the warnings
        engine.report({"WARNING"}, f"Lobe: {REJECTED}")
    if report["not_exported"]:
        engine.report({"INFO"}, "Lobe left out: " + ", ".join(report["not_exported"]))
    engine.report({"INFO"}, summary(report))  # last, where the status bar shows it


def summary(report: dict) -> str:
    """One line. Compiling, which happens once, is told apart: else it would be taken for Lobe's speed."""
    seconds = report["seconds"]
    compiling = seconds["compile"] if seconds["compile"] > LONG_COMPILE else 0.0
    text = f"Lobe: {report['samples']:.0f} samples in {seconds['total'] - compiling:.2f} s"
    if seconds["render"] > 0.0:
        text += f", {report['rays'] / 1e6 / seconds['render']:.1f} million rays per second"
    return f"{text} (and {compiling:.0f} s of compiling, once)" if compiling else text
