"""The table of what skipping saves covers every feature that can be forced on."""

from __future__ import annotations

import pytest
import scenes

from benchmarks import features
from benchmarks.common import SCENES
from benchmarks.features import CHOICES, FORCED, LEFT_OUT, TELLING, asked, more_bytes, pair
from engine.features import EMITTER_TREE, EVERYTHING, LISTED_LAMPS, ONE_EMITTER, TRACED_LAMPS, Features
from engine.passes import has_data_passes, has_light_passes
from engine.settings import Settings


def test_every_feature_has_a_row_or_a_reason():
    assert set(LEFT_OUT) == set(FORCED) >= set(EVERYTHING)
    assert sorted([*LEFT_OUT, *CHOICES]) == sorted(Features._fields)  # each once
    assert set(TELLING) <= set(LEFT_OUT) and set(TELLING.values()) <= set(SCENES)


def test_the_row_of_lamp_shapes_has_both_ways_to_meet_lamps():
    own = Features(emitter_choice=ONE_EMITTER)
    both = pair(own, "lamp_shapes")
    assert both is not None and both.forced == own._replace(lamp_shapes=LISTED_LAMPS | TRACED_LAMPS)
    assert pair(own._replace(lamp_shapes=LISTED_LAMPS), "lamp_shapes") is None
    assert "one after the other" in LEFT_OUT["lamp_shapes"] and "Embree" in LEFT_OUT["lamp_shapes"]


def test_passes_are_asked_for():
    passes = asked(Settings(), "light_passes").passes
    assert has_light_passes(passes) and not has_data_passes(passes)
    assert asked(Settings(), "holdout") == Settings()


def test_a_scene_with_the_feature_is_no_measure_of_it():
    assert pair(Features(phong=1), "phong") is None
    assert pair(Features(emitter_choice=EMITTER_TREE), "emitter_choice") is None


def test_the_feature_is_the_only_difference():
    own = Features(smooth=1, emitter_choice=ONE_EMITTER)
    both = pair(own, "emitter_choice")
    assert both is not None and both.own == own and both.forced == own._replace(emitter_choice=EMITTER_TREE)


@pytest.mark.parametrize(
    ("feature", "expected"),
    [
        ("smooth", 3 * 4),  # of each triangle three numbers of normals
        ("mesh_emitters", 4),  # an emitter's number
        ("phong", 0),
    ],
)
def test_tables_grow_by_what_a_feature_keeps_of_each_triangle(feature, expected):
    scene = scenes.lit_sphere()
    count = len(scene.meshes[0].triangles)
    assert count > 1000
    assert more_bytes(scene, Settings(threads=2), feature) == expected * count


def test_memory_is_that_of_every_thread():
    """Passes of the light need more of a batch."""
    one, three = (more_bytes(scenes.lit_sphere(), Settings(threads=n), "light_passes") for n in (1, 3))
    assert one > 50_000
    assert three == 3 * one


def test_a_lone_emitter_has_a_tree_where_the_choice_is_forced_and_nowhere_else():
    scene = scenes.lit_sphere()
    assert more_bytes(scene, Settings(), "emitter_choice") == 8  # its path; the empty tree has a node as well
    assert more_bytes(scene, Settings(), "clamp") == 0


@pytest.mark.parametrize(("feature", "scene"), [("smooth", "many_lights"), ("phong", "first"), ("suns", "first")])
def test_a_feature_is_measured_where_it_tells(monkeypatch, feature, scene):
    """Where that scene is among those that lack it; otherwise on the first of these."""
    monkeypatch.setattr(features, "_ratio", lambda *_: "1.00 (1.00 to 1.00)")
    monkeypatch.setattr(features, "_compiled", lambda _: (1.0, 0))
    given = {"first": scenes.lit_sphere(), "many_lights": scenes.lit_sphere()}
    row = features.measure(given, feature, threads=1, runs=1)
    assert row["scene"] == scene


@pytest.mark.long  # compiles kernels without a cache, as the table does
def test_a_row_is_measured(monkeypatch):
    monkeypatch.setattr(features, "SAMPLES", 1)
    monkeypatch.setattr(features, "COMPILATIONS", 1)
    row = features.measure({"sphere": scenes.lit_sphere(size=16)}, "holdout", threads=1, runs=2)
    assert (row["feature"], row["left out"], row["scene"]) == ("holdout", LEFT_OUT["holdout"], "sphere")
    low, high = ratio(row["render with it / without"])
    assert 0.0 < low <= high
    assert float(row["tables and threads, kB"]) == 0.0
    assert int(row["machine code, kB"]) != 0
    assert float(row["compile with it / without"]) > 0.0


def ratio(text: str) -> tuple[float, float]:
    """The smallest and the largest of "middle (low to high)"."""
    _, low, _, high = text.replace("(", "").replace(")", "").split()
    return float(low), float(high)
