"""Makes both engines render the same scene in the same way, and lists what was changed for that and what can't be."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import NamedTuple

import bpy

from .. import scene_report
from ..check import nothing_to_begin_with
from ..export.notes import APPROXIMATED, ERROR, WARNING
from ..export.unsupported import is_beside_the_picture
from ..passes import wanted_passes
from . import peer
from .keeping import Change, Keeper

UNLIMITED = 65536  # samples, where the time is what ends a render
# What changes the noise, or the time, of Lobe alone.
LOBES_OWN = ("hemisphere_sampling", "lobe_selection", "road")
OSL_IS_SLOWER = (
    "For the exact Phong lobe Cycles shades with Open Shading Language, which slows it: with a Glossy BSDF it would "
    "take less time, and draw something else"
)
# Whose settings they are, by where in the scene.
OWNERS = {"cycles": "Cycles", "lobe": "Lobe", "render": "Blender"}


class CompareError(Exception):
    """The comparison can't be made; the text says why and what to do."""


class Unmatched(NamedTuple):
    """What can't be matched, as sentences."""

    different: list[str]  # the engines draw different things, and their times don't compare
    others: list[str]  # what else there is to know


def prepare(scene, keeper: Keeper, seconds: float) -> Unmatched:
    """Settings of both engines for a comparison: of equal samples, Lobe's, or where `seconds` isn't 0 of equal time.

    Returns what can't be matched, so far.
    """
    if not hasattr(scene, "cycles"):
        raise CompareError("Cycles is not enabled in this Blender: tick 'Cycles Render Engine' in Preferences, Add-ons")
    if missing := nothing_to_begin_with(scene):
        raise CompareError(missing)
    lobe, render = scene.lobe, scene.render
    _quiet_viewports(keeper)
    if seconds:
        keeper.put(lobe, "samples", UNLIMITED)
    keeper.put(lobe, "time_limit", seconds)
    for key in ("use_adaptive_sampling", "use_denoising"):  # their thresholds don't mean the same, nor their filters
        if hasattr(lobe, key):
            keeper.put(lobe, key, False)
    others = _left_out(render) + _passes(scene)
    for key in ("use_compositing", "use_sequencer", "use_freestyle", "use_multiview", "use_persistent_data"):
        keeper.put(render, key, False)
    if render.use_border:
        keeper.put(render, "use_crop_to_border", True)
    # Adds an entry to the metadata in place of the file's path.
    keeper.put(render, "use_stamp_filename", False)
    different = _linked_objects()
    peer.apply_fair_settings(scene, keeper.put)
    peer.copy_lobe_settings(scene, keeper.put)
    keeper.put(scene.cycles, "time_limit", seconds)
    phong = _phong(scene, keeper)
    others += phong.others
    others += [
        f"Lobe's {lobe.bl_rna.properties[key].name} is {getattr(lobe, key).capitalize()}, for which Cycles has nothing"
        for key in LOBES_OWN
        if lobe.is_property_set(key) and getattr(lobe, key) != lobe.bl_rna.properties[key].default
    ]
    return Unmatched(different + phong.different, others)


def _quiet_viewports(keeper: Keeper) -> None:
    """Viewports in Rendered mode would take time from the renders: they are Solid for the while. They are told by
    their address, which stays for as long as there is such a space."""
    rendered = {space.as_pointer() for space in _spaces() if space.shading.type == "RENDERED"}

    def show(before: str, after: str) -> None:
        for space in _spaces():
            if space.as_pointer() in rendered and space.shading.type == before:
                space.shading.type = after

    def quiet() -> None:
        show("RENDERED", "SOLID")

    quiet()
    keeper.at_end(lambda: show("SOLID", "RENDERED"), quiet)


def _spaces() -> Iterator[bpy.types.SpaceView3D]:
    """The 3D viewports of all workspaces, also those that an area has had before it became another editor: while a
    comparison runs the user may change the workspace or maximise an area, and a render may be shown in its place."""
    for screen in bpy.data.screens:
        for area in screen.areas:
            yield from (space for space in area.spaces if space.type == "VIEW_3D")


def _passes(scene) -> list[str]:
    """Left on, as the compositor may be linked to them."""
    if not any(wanted_passes(layer) for layer in scene.view_layers if layer.use):
        return []
    return [
        "Passes are ticked in the view layer, and their time is in the figures: untick them to compare the pictures"
    ]


def _left_out(render) -> list[str]:
    """What Blender would do to both pictures afterwards, and what Cycles alone would do: a comparison shows neither."""
    found = []
    scene = render.id_data
    tree = getattr(scene, "compositing_node_group", None) or getattr(scene, "node_tree", None)
    if render.use_compositing and tree is not None and getattr(scene, "use_nodes", True):
        found.append("The compositor is left out")
    editor = scene.sequence_editor
    strips = "strips" if hasattr(editor, "strips") else "sequences"  # the former from Blender 4.4 on
    if render.use_sequencer and editor is not None and len(getattr(editor, strips)):
        found.append("The video sequencer is left out")
    if render.use_freestyle:
        found.append("Freestyle is left out")
    if render.use_motion_blur:
        found.append("Motion blur is left out")
    if render.use_multiview:
        found.append("Of a stereo picture only the centre view is compared")
    return found


def _linked_objects() -> list[str]:
    """Objects of other files, whose settings can't be changed."""
    names = [
        obj.name_full
        for obj in bpy.data.objects
        if obj.library is not None
        and obj.type == "MESH"
        and any(getattr(peer.shadow_terminator(obj), key) for key in peer.terminator_offsets(obj))
    ]
    if not names:
        return []
    return [f"Linked objects keep Cycles' shadow terminator offset, which Lobe doesn't have: {_listed(names)}"]


def _phong(scene, keeper: Keeper) -> Unmatched:
    """The exact Phong lobe in Cycles, where it can do that; else its own stand-in is what it draws."""
    groups = peer.phong_groups()
    names = _listed([tree.name for tree in groups])
    stand_in = f"Cycles draws the node group {names} with a Glossy BSDF that only comes near the Phong lobe"
    if not groups:
        return Unmatched([], [])
    if any(tree.library is not None for tree in groups):
        return Unmatched([f"{stand_in}: it is linked from another file"], [])
    try:
        peer.use_osl_phong(scene, keeper.put, keeper.at_end)
    except peer.NoShader as error:
        if error.said:
            print(f"Lobe: Cycles' shader compiler said: {error.said}", file=sys.stderr)
        return Unmatched([f"{stand_in}: {error}"], [])
    return Unmatched([], [OSL_IS_SLOWER])


def _listed(names: list[str], most: int = 8) -> str:
    more = len(names) - most
    return ", ".join(repr(name) for name in names[:most]) + (f" and {more} more" if more > 0 else "")


def not_drawn(scene) -> Unmatched:
    """What Lobe, in its newest render of the scene, did not draw as asked: there the pictures differ in earnest. What
    it drew nearly as asked is for the pictures to tell, and passes that it doesn't make change nothing in them."""
    report = scene_report.report_of(scene)
    if report is None:
        return Unmatched([], [])
    different, others, beside = [], [], []
    for group in report.of_level(ERROR, WARNING, APPROXIMATED):
        if is_beside_the_picture(group.kind, group.what):
            beside.append(f"{scene_report.sentence(group)}. Cycles makes them, which takes it time")
        else:
            (others if group.level == APPROXIMATED else different).append(scene_report.sentence(group))
    return Unmatched(different, others + beside)


def changed(changes: list[Change]) -> list[tuple[str, str, str]]:
    """(setting, as it was, in the comparison): those of the scene one by one, those of objects and materials counted.

    The last value of a setting that was changed twice.
    """
    settings: dict[tuple, tuple[str, str, str]] = {}
    counted: dict[tuple[str, str], tuple[set[int], str]] = {}
    for change in changes:
        if change.kind != "Scene":
            found = counted.setdefault((change.kind, change.label), (set(), _shown(change.during)))
            found[0].add(change.datablock)
        elif change.key != "seed":  # of which each render has another
            place = change.path, change.key
            before = settings[place][1] if place in settings else _shown(change.before)
            settings[place] = f"{OWNERS[change.path]}: {change.label}", before, _shown(change.during)
    rows = [row for row in settings.values() if row[1] != row[2]]
    for (kind, label), (datablocks, during) in counted.items():
        number = len(datablocks)
        rows.append(
            (f"{kind}: {label}", f"{number} {kind.lower()}{'s' if number > 1 else ''} of another value", during)
        )
    return rows


def _shown(value) -> str:
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, float):
        return f"{value:.4g}"
    if not isinstance(value, str) or len(value) <= 3:  # "CPU"
        return str(value)
    return value.replace("_", " ").capitalize()
