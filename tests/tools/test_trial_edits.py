"""The edits of benchmarks/trials.py that change the estimator leave its mean what it is."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest

from tools.exported import exported
from tools.lobe_blender import enable_lobe

SIZE, SAMPLES, SEEDS = (48, 32), 128, 24


@pytest.fixture(scope="module")
def trials(script):
    return script("trials")


@pytest.fixture(scope="module")
def lamps(trials):
    """The sample scene: lamps of many kinds, a sun, a world, Phong surfaces; so a light tree and shares of groups."""
    enable_lobe()
    trials.common.prepare(trials.common.scene_path("lamps"), SIZE, 2)
    return exported()


def means(trials, engine, lamps, settings: dict, first: int) -> np.ndarray:
    """(SEEDS, 3): of pictures that an engine in a folder of its own renders."""
    asked = {"samples": SAMPLES, "threads": 2, "pixel_filter": "BOX"} | settings
    with contextlib.closing(trials.Worker(engine)) as worker:
        worker.load(lamps)
        pictures = [worker.render(asked | {"seed": first + k})[0] for k in range(SEEDS)]
    return np.array([picture.mean(axis=(0, 1)) for picture in pictures])


@pytest.fixture(scope="module")
def usual(trials, lamps, tmp_path_factory):
    folder = tmp_path_factory.mktemp("usual")
    trials.edited(folder, None)
    return means(trials, folder, lamps, {}, 1)


@pytest.mark.long  # compiles the engine with an empty cache, for each trial
@pytest.mark.parametrize("name", [
    "a light tree that knows the lobe", "one of four light samples", "two light samples at the first vertex",
    "samples by the errors of neighbours", "spheres sampled by area",
])  # fmt: skip
def test_the_mean_stays(trials, lamps, usual, tmp_path, name):
    (trial,) = trials.chosen([name])
    trials.edited(tmp_path, trial)
    settings = trial.settings | ({"samples": trial.samples} if trial.samples else {})
    other = means(trials, tmp_path, lamps, settings, 1 + SEEDS)
    error = np.hypot(usual.std(axis=0, ddof=1), other.std(axis=0, ddof=1)) / SEEDS**0.5
    assert (error < 0.01 * usual.mean(axis=0)).all()
    assert (np.abs(other.mean(axis=0) - usual.mean(axis=0)) < 4 * error).all()
