"""The table of what skipping saves covers every feature that can be forced on."""

from __future__ import annotations

from benchmarks.features import CHOICES, FORCED, LEFT_OUT, asked, pair
from engine.features import EMITTER_TREE, EVERYTHING, ONE_EMITTER, Features
from engine.passes import has_data_passes, has_light_passes
from engine.settings import Settings


def test_every_feature_has_a_row_or_a_reason():
    assert set(LEFT_OUT) == set(FORCED) >= set(EVERYTHING)
    assert sorted([*LEFT_OUT, *CHOICES]) == sorted(Features._fields)  # each once


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
