"""The verdicts of benchmarks/parity.py on made-up pictures whose truth is known, and which pictures it renders."""

from __future__ import annotations

import importlib
from argparse import Namespace
from types import SimpleNamespace

import numpy as np
import pytest

from tools import metrics

SHAPE = (8, 16, 24, 3)
SHARE = 0.01  # of indirect light: a tenth of it less is half of what the mean's tolerance allows


@pytest.fixture(scope="module")
def parity(repository):
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(repository / "benchmarks"))
        yield importlib.import_module("parity")


@pytest.fixture
def rng():
    return np.random.default_rng(1)


def light(rng, indirect=1.0, noise=0.02):
    """Pictures with direct and indirect light, and others of the indirect light alone."""
    bounced = indirect * SHARE * rng.normal(1, 5 * noise, SHAPE)
    return rng.normal(1, noise, SHAPE) + bounced, bounced


def options(against="CYCLES", **changes):
    return Namespace(against=against, resolution=(24, 16), samples=64, seeds=8, assignments=[], **changes)


def verdict(parity, ours, theirs, against="CYCLES"):
    return parity.row("lamps", options(against), ours[0], theirs[0], ours[1], theirs[1])["verdict"]


def test_equal_pictures_pass(parity, rng):
    assert verdict(parity, light(rng), light(rng)) == "pass"


def test_wide_intervals_are_left_open(parity, rng):
    assert verdict(parity, light(rng, noise=0.5), light(rng, noise=0.5)) == "open: mean, indirect"


@pytest.mark.parametrize("factor", [0.9, 1.1])
@pytest.mark.parametrize("against", ["CYCLES", "REFERENCE"])
def test_wrong_indirect_light_fails_where_the_whole_picture_passes(parity, rng, factor, against):
    assert verdict(parity, light(rng, factor), light(rng), against) == "FAIL: indirect"


@pytest.mark.parametrize("against", ["CYCLES", "REFERENCE"])
def test_no_indirect_light_fails(parity, rng, against):
    found = verdict(parity, light(rng, 0.0), light(rng), against)
    assert found.startswith("FAIL") and "indirect" in found


def test_other_brightness_fails(parity, rng):
    ours, theirs = light(rng), light(rng)
    assert verdict(parity, (ours[0] * 1.005, ours[1]), theirs).startswith("FAIL: mean")
    assert metrics.judge_mean(ours[0] * 1.005, theirs[0], 0.01) == "pass"


def test_a_difference_that_shows_but_is_tolerated_passes(parity, rng):
    ours, theirs = light(rng, noise=0.005), light(rng, noise=0.005)
    assert verdict(parity, (ours[0] * 1.0015, ours[1]), theirs) == "pass"


def test_bias_fails_that_neither_pixels_nor_means_show(parity, rng):
    ours, theirs = light(rng, noise=0.05), light(rng, noise=0.05)
    board = np.indices(SHAPE[1:3]).sum(axis=0) % 2 * 2 - 1.0
    assert "bias" in verdict(parity, (ours[0] + 0.02 * board[..., None], ours[1]), theirs)
    assert "bias" not in verdict(parity, ours, theirs)


def test_wrong_pixels_fail(parity, rng):
    ours, theirs = light(rng), light(rng)
    ours[0][:, 0, :6] += 0.3
    ours[0][:, 1, :6] -= 0.3
    assert "pixels" in verdict(parity, ours, theirs)


@pytest.mark.parametrize("value", [0.0, np.nan])
def test_pictures_without_light_or_numbers_fail(parity, rng, value):
    ours = light(rng)
    for broken in ((ours[0] * value, ours[1]), (ours[0], ours[1] * value)):
        assert verdict(parity, broken, light(rng)).startswith("FAIL")
        assert verdict(parity, light(rng), broken).startswith("FAIL")


def test_a_scene_without_indirect_light_passes(parity, rng):
    black = np.zeros(SHAPE)
    assert verdict(parity, (light(rng)[0], black), (light(rng)[0], black)) == "pass"


def test_chance_hardly_ever_fails_a_mean(parity, rng):
    """The 95 % interval would refuse 25 of 500."""
    found = [metrics.judge_mean(*rng.normal(1, 0.1, (2, 8, 2, 2, 1)), 0.002) for _ in range(500)]
    assert found.count("FAIL") <= 3


def test_only_a_fail_ends_in_an_error(parity):
    rows = [{"verdict": "pass"}, {"verdict": "open: mean"}]
    assert not parity.failed(rows)
    assert parity.failed([*rows, {"verdict": "FAIL: bias"}])


def test_every_sample_scene_has_a_plan(parity):
    for plans in parity.PLANS.values():
        assert set(plans) == set(parity.common.SCENES)


def test_settings_of_the_command_line_come_before_the_plan(parity):
    chosen = options()
    assert parity.plan_of("lamps", chosen) == ((24, 16), 64)
    chosen.samples = None
    assert parity.plan_of("lamps", chosen) == ((24, 16), parity.PLANS["CYCLES"]["lamps"].samples)
    assert parity.plan_of("my.blend", chosen) == ((24, 16), parity.OTHER_SCENES.samples)


@pytest.mark.parametrize("against, part", [("CYCLES", 8), ("REFERENCE", 1)])
def test_indirect_light_is_the_difference_of_two_limits(parity, monkeypatch, against, part):
    """Each engine's picture shows 2 with bounces and 1.5 without."""
    scene, calls = SimpleNamespace(lobe=SimpleNamespace(max_bounces=5)), []

    def render(scene, engine, samples, seed):
        calls.append((samples, seed, scene.lobe.max_bounces))
        return np.full((2, 3, 3), 2.0 if scene.lobe.max_bounces else 1.5), {}

    monkeypatch.setattr(parity.common, "render", render)
    plan = parity.Plan((3, 2), 64)
    whole, indirect = parity.whole_and_indirect(scene, "LOBE", plan, against, range(1, 3))
    assert whole.shape == indirect.shape == (2, 2, 3, 3)
    assert np.all(whole == 2.0) and np.all(indirect == 0.5)
    samples = 64 // part
    expected = {(64, 5), (samples, 5), (samples, 0)}
    assert sorted(calls) == sorted((n, seed, limit) for n, limit in expected for seed in (1, 2))
    assert scene.lobe.max_bounces == 5
