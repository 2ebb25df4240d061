"""The sample scenes on both roads, from the file to the picture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from agreement import assert_agree, pictures
from sample_scenes import SCENES, sample_scene

CHOSEN = {"samples": 32, "max_bounces": 2}


@pytest.mark.parametrize("name", SCENES)
def test_compiled_agrees_with_reference(name):
    scene = sample_scene(name, width=16)
    assert_agree(pictures(scene, road="COMPILED", **CHOSEN), pictures(scene, road="REFERENCE", **CHOSEN))


def test_matrices_with_rows_and_columns_confused_are_noticed():
    scene = sample_scene("instances", width=16)
    matrices = scene.instances.transforms
    confused = np.ascontiguousarray(np.swapaxes(matrices, 1, 2)).reshape(matrices.shape)
    other = replace(scene, instances=replace(scene.instances, transforms=confused))
    with pytest.raises(AssertionError, match="differ"):
        assert_agree(pictures(scene, **CHOSEN), pictures(other, **CHOSEN))
