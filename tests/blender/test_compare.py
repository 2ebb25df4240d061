"""Compare with Cycles inside Blender: real renders of small pictures, and what is left of them afterwards."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import addon_utils
import bpy
import numpy as np
import pytest

from tests.blender.export_checks import new_material
from tools import blender_render
from tools.lobe_blender import MODULE

compare = sys.modules[f"{MODULE}.addon.compare"]
operators = sys.modules[f"{MODULE}.addon.compare.operators"]
peer = sys.modules[f"{MODULE}.addon.compare.peer"]


@pytest.fixture
def scene(simple_scene):
    """A lamp lights a floor: both engines have noise there."""
    simple_scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.1, 0.1, 0.1, 1.0)
    bpy.ops.mesh.primitive_plane_add(size=20, location=(0, 5, -1))
    bpy.context.object.data.materials.append(new_material("Floor", "ShaderNodeBsdfDiffuse")[0])
    bpy.ops.object.light_add(type="AREA", location=(0, 4, 2))
    bpy.context.object.data.energy = 100.0
    bpy.context.object.data.size = 3.0
    simple_scene.lobe.pixel_filter = "BLACKMAN_HARRIS"
    return simple_scene


def settings(owner) -> dict:
    """All that can be set, of a datablock or a group of properties."""
    found = {}
    for prop in owner.bl_rna.properties:
        if prop.type in ("POINTER", "COLLECTION") or prop.is_readonly or prop.identifier == "use_nodes":
            continue  # the last says on access that it will be gone
        value = getattr(owner, prop.identifier)
        found[prop.identifier] = plain(value) if getattr(prop, "is_array", False) else value
    return found


def plain(value):
    """Also the rows of matrices, which go with their datablock."""
    return tuple(map(plain, value)) if hasattr(value, "__len__") else value


def below(datablock) -> list:
    """Where the settings are that renders look at."""
    paths = ("render", "render.image_settings", "cycles", "lobe", "view_settings")
    return [datablock, *(datablock.path_resolve(path) for path in paths if hasattr(datablock, path.split(".")[0]))]


def state(scene) -> dict:
    things = [scene, *bpy.data.objects, *bpy.data.materials]
    trees = [sorted(f"{link.from_socket.path_from_id()} {link.to_socket.path_from_id()}" for link in tree.links)
             for tree in bpy.data.node_groups]  # fmt: skip
    return {
        "settings": {thing.name: [settings(owner) for owner in below(thing)] for thing in things},
        "links": trees,
        "nodes": [sorted(tree.nodes.keys()) for tree in bpy.data.node_groups],
        "handlers": [list(v) for v in map(bpy.app.handlers.__getattribute__, dir(bpy.app.handlers)) if type(v) is list],
        "scenes": sorted(bpy.data.scenes.keys()),
    }


def upset(scene) -> None:
    """Settings as a user may have them, none of which a comparison can leave alone."""
    scene.cycles.use_adaptive_sampling = scene.cycles.use_denoising = True
    scene.cycles.sample_clamp_indirect, scene.cycles.samples, scene.cycles.seed = 10.0, 77, 5
    scene.cycles.caustics_reflective = False
    scene.lobe.use_adaptive_sampling, scene.lobe.time_limit, scene.lobe.seed = True, 100.0, 3
    scene.render.engine = "CYCLES"
    scene.render.use_border, scene.render.border_max_x = True, 0.5
    scene.render.use_persistent_data = True
    scene.render.image_settings.file_format = "JPEG"
    bpy.data.materials.new("Plain")


def slots() -> list[str]:
    return [slot.name for slot in bpy.data.images["Render Result"].render_slots]


def slot_means() -> list[float]:
    """Of the pictures in the slots "Lobe" and "Cycles"."""
    image = bpy.data.images["Render Result"]
    before, found = image.render_slots.active_index, []
    for name in ("Lobe", "Cycles"):
        image.render_slots.active_index = slots().index(name)
        found.append(compare.run.pictures.rendered(bpy.context.scene)[0][..., :3].mean())
    image.render_slots.active_index = before
    return found


def test_a_comparison(scene) -> None:
    upset(scene)
    scene.lobe.samples = 1024
    before = state(scene)
    assert bpy.ops.lobe.compare_with_cycles() == {"FINISHED"}
    assert state(scene) == before
    outcome = operators.outcome_of(scene)
    found = outcome.figures
    assert outcome.size == (16, 24)  # of the border
    assert outcome.samples == {"LOBE": 1024.0, "CYCLES": 1024.0}
    assert 0.0 < found.noise_lobe < 0.1 and 0.0 < found.noise_cycles < 0.1
    assert abs(found.mean_difference) < 0.005 + found.mean_difference_margin
    assert found.rel_mse > 0.0 and found.speedup > 0.0 and found.flip > 0.0
    assert all(0.0 < timing.sampling <= timing.total + 0.01 for timing in outcome.times.values())
    rows = {what: (was, during) for what, was, during in outcome.changed}
    assert rows["Cycles: Samples"] == ("77", "1024") and rows["Cycles: Use Denoising"] == ("on", "off")
    assert rows["Cycles: Clamp Indirect"] == ("10", "0") and rows["Lobe: Time Limit"] == ("100", "0")
    assert not any("Seed" in what or "Engine" in what for what in rows)  # each render has another one
    assert outcome.unmatched == outcome.different == []


def test_every_setting_that_is_changed_is_listed(scene) -> None:
    """Seen from outside: all that is different while it runs, but for seeds and the engine."""
    upset(scene)
    render = scene.render
    render.use_multiview = render.use_compositing = render.use_sequencer = render.use_stamp_filename = True
    render.use_crop_to_border = False

    def seen() -> dict[tuple[str, str], object]:
        parts = {"Cycles": scene.cycles, "Lobe": scene.lobe, "Blender": scene.render, "Scene": scene}
        return {(name, key): value for name, owner in parts.items() for key, value in settings(owner).items()}

    before = seen()
    with compare.run.Keeper() as keeper:
        compare.run.matching.prepare(scene, keeper, 1.0)
        during = seen()
        listed = [what for what, _, _ in compare.run.matching.changed(keeper.changes)]
    assert seen() == before
    parts = {"Cycles": scene.cycles, "Lobe": scene.lobe, "Blender": scene.render}
    changed = [place for place, value in during.items() if value != before[place] and place[1] != "seed"]
    names = {f"{name}: {parts[name].bl_rna.properties[key].name}" for name, key in changed}
    assert {"Blender: Multiple Views", "Blender: Crop to Render Region", "Blender: Persistent Data"} <= names
    assert names <= set(listed)


TOO_SHORT = "The renders are too short to be timed: take more samples"


def unmatched(scene) -> list[str]:
    """But for what a busy machine makes of so few samples."""
    return [line for line in operators.outcome_of(scene).unmatched if line != TOO_SHORT]


def test_pictures_are_in_slots_and_side_by_side(scene) -> None:
    bpy.ops.lobe.compare_with_cycles()
    assert slots()[:2] == ["Lobe", "Cycles"]
    bpy.ops.lobe.compare_with_cycles()
    assert slots()[:2] == ["Lobe", "Cycles"] and "Lobe" not in slots()[2:]
    outcome = operators.outcome_of(scene)
    lobe, cycles = slot_means()
    assert lobe != cycles and lobe == pytest.approx(cycles, rel=0.1)
    # What the slot of Lobe holds is the picture of F12.
    bpy.data.images["Render Result"].render_slots.active_index = 4
    bpy.ops.render.render()
    assert compare.run.pictures.rendered(scene)[0][..., :3].mean() == lobe
    image = bpy.data.images[operators.IMAGE]
    assert tuple(image.size) == (3 * 32 + 2 * 8, 24) and not image.is_dirty
    pixels = np.array(image.pixels[:]).reshape(24, -1, 4)[::-1]
    assert pixels[:, :32, :3] * 255 == pytest.approx(decoded(outcome.pictures["lobe"]), abs=0.6)
    assert pixels[:, -32:, :3] * 255 == pytest.approx(decoded(outcome.pictures["difference"]), abs=0.6)


def test_the_picture_side_by_side_is_kept_in_the_file(scene, tmp_path) -> None:
    """Blender's temporary folder goes; a comparison in a later session shows its own picture."""
    bpy.ops.lobe.compare_with_cycles()
    bpy.data.images[operators.IMAGE].use_fake_user = True  # as if an editor showed it
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "compared.blend"))
    (Path(bpy.app.tempdir) / "lobe_comparison.png").unlink()
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "compared.blend"))
    image = bpy.data.images[operators.IMAGE]
    assert tuple(image.size) == (3 * 32 + 2 * 8, 24) and np.any(np.array(image.pixels[:]) > 0.5)
    image.filepath = str(tmp_path / "another session" / "lobe_comparison.png")
    bpy.context.scene.render.resolution_x = 40
    bpy.ops.lobe.compare_with_cycles()
    assert sum(image.name.startswith(operators.IMAGE) for image in bpy.data.images) == 1
    image = bpy.data.images[operators.IMAGE]
    assert tuple(image.size) == (3 * 40 + 2 * 8, 24) and not image.is_dirty and len(image.packed_files) == 1
    left = np.array(image.pixels[:]).reshape(24, -1, 4)[::-1, :40, :3] * 255
    shown = decoded(operators.outcome_of(bpy.context.scene).pictures["lobe"])
    assert left == pytest.approx(shown, abs=0.6)


def decoded(content: bytes) -> np.ndarray:
    import OpenImageIO as oiio

    path = f"{bpy.app.tempdir}test.png"
    with open(path, "wb") as file:
        file.write(content)
    return oiio.ImageBuf(path).get_pixels(oiio.UINT8).astype(float)


def test_slots_of_the_user_are_left_alone(scene) -> None:
    bpy.ops.render.render()
    result = bpy.data.images["Render Result"].render_slots
    result[0].name, before = "Mine", compare.run.pictures.rendered(scene)[0]
    scene.lobe.seed += 1
    bpy.ops.lobe.compare_with_cycles()
    assert (slots()[0], slots()[-2:], result.active_index) == ("Mine", ["Lobe", "Cycles"], 0)
    assert np.array_equal(compare.run.pictures.rendered(scene)[0], before)


def test_a_check_after_it_leaves_the_pictures_alone(scene) -> None:
    """The user's slot is the active one again, and the newest picture is in another."""
    bpy.ops.render.render()
    mine = compare.run.pictures.rendered(scene)[0]
    bpy.ops.lobe.compare_with_cycles()
    before = slot_means()
    bpy.ops.lobe.check_scene()
    assert slot_means() == before
    assert bpy.data.images["Render Result"].render_slots.active_index == 0
    assert np.array_equal(compare.run.pictures.rendered(scene)[0], mine)


def test_equal_time(scene) -> None:
    assert bpy.ops.lobe.compare_with_cycles(mode="TIME", seconds=0.3) == {"FINISHED"}
    outcome = operators.outcome_of(scene)
    for timing in outcome.times.values():
        assert 0.2 < timing.sampling < 2.0
    assert outcome.samples["LOBE"] > 4.0
    assert (scene.lobe.samples, scene.lobe.time_limit, scene.cycles.time_limit) == (4, 0.0, 0.0)


@pytest.mark.parametrize("stopped", [False, True])
def test_viewports_do_not_render_beside_it(stopped: bool, tmp_path) -> None:
    """Of this workspace and of another one; where the area becomes another editor meanwhile, they are Rendered when
    the user goes back."""
    bpy.ops.wm.read_homefile(use_factory_startup=True)
    scene = bpy.context.scene
    scene.lobe.samples = scene.render.resolution_x = scene.render.resolution_y = 8
    shown, other = (
        next(area for area in bpy.data.workspaces[name].screens[0].areas if area.type == "VIEW_3D")
        for name in ("Layout", "Shading")
    )
    for area in (shown, other):
        area.spaces.active.shading.type = "RENDERED"
    steps = compare.Comparison(scene, bpy.context.view_layer).steps()
    operators.render_now(next(steps))
    assert [area.spaces.active.shading.type for area in (shown, other)] == ["SOLID"] * 2
    saved = []
    with compare.run.listening(
        save_pre=lambda *_: saved.extend(area.spaces.active.shading.type for area in (shown, other))
    ):
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "saved.blend"), copy=True)
    assert saved == ["RENDERED"] * 2
    assert [area.spaces.active.shading.type for area in (shown, other)] == ["SOLID"] * 2
    shown.type = "IMAGE_EDITOR"
    if not stopped:
        for step in steps:
            operators.render_now(step)
    steps.close()
    shown.type = "VIEW_3D"
    assert [area.spaces.active.shading.type for area in (shown, other)] == ["RENDERED"] * 2


def make_bumpy() -> None:
    """Something that Lobe leaves out."""
    material, diffuse = new_material("Bumpy", "ShaderNodeBsdfDiffuse")
    bump = material.node_tree.nodes.new("ShaderNodeBump")
    material.node_tree.links.new(bump.outputs[0], diffuse.inputs["Normal"])
    bpy.data.objects["Plane"].data.materials[0] = material


def test_what_cannot_be_matched_is_listed(scene) -> None:
    scene.render.use_motion_blur = True
    scene.lobe.hemisphere_sampling = "UNIFORM"
    make_bumpy()
    bpy.ops.mesh.primitive_cube_add(location=(0, 50, 0))
    scene.view_layers.new("Second")
    bpy.ops.lobe.compare_with_cycles()
    listed = unmatched(scene)
    assert "Motion blur is left out" in listed
    assert any(line.startswith("material 'Bumpy': ") for line in listed)
    assert "Of several view layers only 'ViewLayer' is compared" in listed
    assert "Lobe's Hemisphere is Uniform, for which Cycles has nothing" in listed
    differs = bpy.app.version >= (5, 0)  # then it has a Principled BSDF in Cycles
    assert any(line.startswith("object 'Cube': without a material") for line in listed) == differs
    assert len(listed) == 4 + differs
    outcome = operators.outcome_of(scene)
    assert len(outcome.different) == 1 and not any("without a material" in line for line in outcome.different)
    assert not compare.headline_of(outcome).speedup
    page = compare.html(operators.outcome_of(scene))
    assert "Bumpy" in page and "Motion blur" in page


def test_what_is_drawn_nearly_as_asked_is_listed_and_left_to_the_pictures(scene) -> None:
    material, _ = new_material("Usual", "ShaderNodeBsdfPrincipled")
    bpy.data.objects["Plane"].data.materials[0] = material
    bpy.ops.lobe.compare_with_cycles()
    outcome = operators.outcome_of(scene)
    assert any("Principled BSDF" in line for line in outcome.unmatched) and outcome.different == []


def test_ticked_passes_are_listed_and_stay(scene) -> None:
    scene.view_layers[0].use_pass_z = False
    scene.view_layers[0].use_pass_mist = True
    bpy.ops.lobe.compare_with_cycles()
    (line,) = unmatched(scene)
    assert operators.outcome_of(scene).different == []
    assert line.startswith("Passes are ticked in the view layer, and their time is in the figures")
    assert scene.view_layers[0].use_pass_mist and line in compare.html(operators.outcome_of(scene))


def test_passes_that_lobe_does_not_make_are_no_reason_for_a_difference(scene) -> None:
    layer = scene.view_layers[0]
    layer.use_pass_cryptomatte_object = True
    layer.aovs.add().name = "Dirt"
    layer.lightgroups.add(name="Key")
    bpy.ops.lobe.check_scene()
    found = compare.run.matching.not_drawn(scene)
    assert found.different == [] and len(found.others) == 3
    for line, name in zip(sorted(found.others), ("Key", "Dirt", "Cryptomatte Object"), strict=True):
        assert name in line and line.endswith("Cycles makes them, which takes it time")


def test_samples_of_a_view_layer_and_motion_blur_are_left_out(scene) -> None:
    """The scene report is the one of the user's settings all the same."""
    scene.view_layers[0].samples, scene.render.use_motion_blur = 7, True
    bpy.ops.lobe.check_scene()
    report = compare.run.scene_report.report_of(scene)
    found = compare.run.matching.not_drawn(scene).different
    assert len(found) == 2 and "its own number of samples (7)" in found[1] and "motion blur" in found[0]
    bpy.ops.lobe.compare_with_cycles()
    outcome = operators.outcome_of(scene)
    assert outcome.different == [] and unmatched(scene) == ["Motion blur is left out"]
    rows = {what: (was, during) for what, was, during in outcome.changed}
    assert rows["Cycles: Layer Samples"] == ("USE", "Ignore") and rows["Blender: Motion Blur"] == ("on", "off")
    assert compare.run.scene_report.report_of(scene) is report


@pytest.fixture
def phong(scene):
    group = sys.modules[f"{MODULE}.addon.phong_group"].phong_group()
    material, node = new_material("Phong", "ShaderNodeGroup")
    node.node_tree = group
    material.node_tree.links.new(node.outputs[0], material.node_tree.nodes["Material Output"].inputs["Surface"])
    bpy.data.objects["Plane"].data.materials[0] = material
    return scene


def test_phong_surfaces_are_exact_in_cycles_for_the_while(phong) -> None:
    before = state(phong)
    bpy.ops.lobe.compare_with_cycles()
    assert state(phong) == before
    outcome = operators.outcome_of(phong)
    assert ("Cycles: Open Shading Language", "off", "on") in outcome.changed
    (line,) = unmatched(phong)
    assert "Open Shading Language, which slows it" in line


def test_without_open_shading_language_that_is_listed(phong, monkeypatch) -> None:
    before = state(phong)

    import _cycles

    monkeypatch.delattr(_cycles, "osl_compile")
    bpy.ops.lobe.compare_with_cycles()
    assert state(phong) == before
    (line,) = unmatched(phong)
    assert "'Phong BSDF'" in line and "comes near the Phong lobe" in line
    assert line.endswith(": this Blender's Cycles has no Open Shading Language")
    outcome = operators.outcome_of(phong)
    assert outcome.different == [line] and not compare.headline_of(outcome).speedup


def test_what_the_shader_compiler_says_is_for_the_log(phong, monkeypatch, capfd) -> None:
    """It writes to standard error by itself, from C++, with the path of a file that is gone by then."""
    monkeypatch.setattr(peer, "OSL_SOURCE", "shader phong() { nonsense }")
    with compare.run.Keeper() as keeper:
        found = compare.run.matching.prepare(phong, keeper, 0.0)
    (line,) = found.different
    assert line.endswith(": the Open Shading Language of this Blender's Cycles doesn't work")
    (log,) = [line for line in capfd.readouterr().err.splitlines() if "nonsense" in line]
    assert log.startswith("Lobe: Cycles' shader compiler said: ")


def test_a_shader_that_compiles_leaves_nothing_in_the_log(phong, capfd) -> None:
    with compare.run.Keeper() as keeper:
        compare.run.matching.prepare(phong, keeper, 0.0)
    assert capfd.readouterr().err == ""


def test_what_others_write_while_the_shader_compiles_is_not_lost(phong, monkeypatch, capfd) -> None:
    import _cycles

    compile_ = _cycles.osl_compile
    monkeypatch.setattr(_cycles, "osl_compile", lambda *paths: os.write(2, b"another thread\n") and compile_(*paths))
    with compare.run.Keeper() as keeper:
        assert compare.run.matching.prepare(phong, keeper, 0.0).different == []
    assert capfd.readouterr().err == "another thread\n"


def test_an_animated_seed_leaves_the_noise_unknown(scene) -> None:
    scene.lobe.driver_add("seed").driver.expression = "frame"
    bpy.ops.lobe.compare_with_cycles()
    outcome = operators.outcome_of(scene)
    assert np.isnan(outcome.figures.speedup) and outcome.figures.noise_cycles > 0.0
    assert [line.split(",")[0] for line in unmatched(scene)] == ["Both renders of Lobe are the same"]


def test_without_a_camera(scene) -> None:
    scene.camera = None
    before = state(scene)
    with pytest.raises(RuntimeError, match="Lobe can't compare: the scene has no camera"):
        bpy.ops.lobe.compare_with_cycles()
    assert state(scene) == before and operators.outcome_of(scene) is None


def test_without_cycles(scene) -> None:
    addon_utils.disable("cycles")
    try:
        with pytest.raises(RuntimeError, match=r"Cycles is not enabled in this Blender: tick"):
            bpy.ops.lobe.compare_with_cycles()
        assert scene.render.engine == "LOBE"
    finally:
        addon_utils.enable("cycles")


@pytest.mark.parametrize("failing", [1, 2, 4])
def test_settings_come_back_after_an_error(phong, monkeypatch, failing) -> None:
    upset(phong)
    before = state(phong)
    whole, calls = operators.render_now, []

    def render(step, *how):
        calls.append(step.engine)
        if len(calls) == failing:
            raise operators.CompareError("it broke")
        return whole(step, *how)

    monkeypatch.setattr(operators, "render_now", render)
    with pytest.raises(RuntimeError, match="Lobe can't compare: it broke"):
        bpy.ops.lobe.compare_with_cycles()
    assert state(phong) == before and len(calls) == failing


def test_settings_come_back_when_it_is_stopped(phong) -> None:
    """As Escape does: Blender calls the handlers of a cancelled render."""
    upset(phong)
    before = state(phong)
    steps = compare.Comparison(phong, bpy.context.view_layer).steps()
    step = next(steps)
    assert step.text == "Lobe, 1 of 2" and state(phong) != before
    for handler in bpy.app.handlers.render_cancel:
        handler(phong)
    with pytest.raises(compare.Stopped):
        next(steps)
    assert state(phong) == before
    steps = compare.Comparison(phong, bpy.context.view_layer).steps()
    operators.render_now(next(steps))
    next(steps)
    steps.close()
    assert state(phong) == before


def saved_state(path: str) -> dict:
    bpy.ops.wm.open_mainfile(filepath=path)
    return {part: value for part, value in state(bpy.context.scene).items() if part != "handlers"}


def test_a_file_that_is_saved_meanwhile_holds_the_users_settings(phong, tmp_path) -> None:
    """By Ctrl+S in another window, or by a timer of another add-on. The comparison goes on as it was."""
    upset(phong)
    before, paths = state(phong), [str(tmp_path / name) for name in ("before.blend", "meanwhile.blend")]
    bpy.ops.wm.save_as_mainfile(filepath=paths[0], copy=True)
    steps = compare.Comparison(phong, bpy.context.view_layer).steps()
    next(steps)
    during = state(phong)
    assert during != before
    bpy.ops.wm.save_as_mainfile(filepath=paths[1], copy=True)
    assert state(phong) == during
    with pytest.raises(RuntimeError, match="Cannot open file"):
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "no folder" / "saved.blend"), copy=True)
    assert state(phong) == during
    steps.close()
    assert state(phong) == before
    assert saved_state(paths[0]) == saved_state(paths[1])


def test_undo_ends_a_comparison(phong) -> None:
    """Also one that takes back what the user did last before it: that isn't put again."""
    upset(phong)
    bpy.ops.ed.undo_push(message="The scene")
    before = state(phong)
    phong.cycles.samples = 78
    bpy.ops.ed.undo_push(message="Samples")
    steps = compare.Comparison(phong, bpy.context.view_layer).steps()
    next(steps)
    assert bpy.ops.ed.undo() == {"FINISHED"}
    with pytest.raises(compare.CompareError, match="a step was undone or redone meanwhile"):
        next(steps)
    assert state(bpy.context.scene) == before


def test_undo_may_take_away_what_is_compared(phong) -> None:
    """The node group, with the closure that a comparison has put into it."""
    bpy.ops.ed.undo_push(message="One group")
    tree = bpy.data.node_groups["Phong BSDF"].copy()
    bpy.ops.ed.undo_push(message="Two groups")
    before = len(tree.nodes)
    steps = compare.Comparison(phong, bpy.context.view_layer).steps()
    next(steps)
    assert bpy.ops.ed.undo() == {"FINISHED"}
    with pytest.raises(compare.CompareError, match="a step was undone"):
        next(steps)
    (tree,) = bpy.data.node_groups
    assert len(tree.nodes) == before and tree.nodes["Group Output"].inputs[0].is_linked


def test_a_render_without_a_picture_is_no_comparison(scene, monkeypatch) -> None:
    """Blender says FINISHED when an engine has raised."""
    before = state(scene)
    monkeypatch.setattr(operators, "render_now", lambda *_: {"FINISHED"})
    with pytest.raises(RuntimeError, match="Lobe ended without a picture"):
        bpy.ops.lobe.compare_with_cycles()
    assert state(scene) == before


def test_a_scene_that_is_deleted_meanwhile(scene) -> None:
    other = scene.copy()
    steps = compare.Comparison(other, other.view_layers[0]).steps()
    operators.render_now(next(steps))
    bpy.data.scenes.remove(other)
    with pytest.raises(compare.CompareError, match="is gone"):
        next(steps)


def test_the_reports_say_what_came_of_it_and_where_it_is(scene, capfd) -> None:
    make_bumpy()
    bpy.ops.lobe.compare_with_cycles()
    said = [line.partition("Info: ")[2] for line in capfd.readouterr().out.splitlines() if "Info: " in line]
    page = Path(bpy.app.tempdir, "lobe_comparison.html")
    places = f"The pictures are in the render slots Lobe and Cycles, side by side in the image {operators.IMAGE!r}"
    assert f"{places}; the page is {str(page)!r}" in said
    headline = compare.headline_of(operators.outcome_of(scene)).text
    assert headline in page.read_text(encoding="utf-8") and "1 reason under Not Matched" in headline
    assert said[-1] == f"Compared. {headline}. See Render properties > Compare"
    assert not any("Speed-up" in line for line in said)


def test_each_render_says_which_of_its_engine_it_is() -> None:
    steps = [compare.run.Step(n, engine, "Scene", "") for n, (engine, _) in enumerate(compare.run.ORDER, 1)]
    assert [step.text for step in steps] == ["Lobe, 1 of 2", "Cycles, 1 of 2", "Cycles, 2 of 2", "Lobe, 2 of 2"]


def test_saving_the_page(scene, tmp_path) -> None:
    assert not bpy.ops.lobe.save_comparison.poll() and not bpy.ops.lobe.open_comparison.poll()
    bpy.ops.lobe.compare_with_cycles()
    assert bpy.ops.lobe.save_comparison(filepath=str(tmp_path / "page")) == {"FINISHED"}
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert text.startswith("<!doctype html>") and text.count("data:image/png;base64,iVBORw0KGgo") == 4
    assert str(tmp_path) not in text and "http" not in text
    with pytest.raises(RuntimeError, match="cannot be written"):
        bpy.ops.lobe.save_comparison(filepath=str(tmp_path / "no" / "page.html"))
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    assert operators.outcome_of(bpy.context.scene) is None


def test_an_image_of_the_render_results_name_is_left_alone(scene) -> None:
    """Blender then calls its own otherwise."""
    bpy.data.images.new("Render Result", 4, 4)
    bpy.ops.render.render()
    assert compare.run.pictures.rendered(scene)[0].shape == (24, 32, 4)
    assert blender_render.picture(scene).shape == (24, 32, 4)
    path = Path(bpy.app.tempdir, "mine.png")
    blender_render.save_png(scene, path)
    import OpenImageIO as oiio

    assert oiio.ImageBuf(str(path)).spec().width == 32
    assert blender_render.passes(scene) == {}


def test_without_a_view_layer(scene) -> None:
    bpy.context.view_layer.use = False
    for render in (bpy.ops.lobe.compare_with_cycles, lambda: blender_render.check_renderable(scene)):
        with pytest.raises((RuntimeError, blender_render.ToolError), match="no view layer is rendered: tick Use"):
            render()
