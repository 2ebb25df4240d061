"""The sample scenes on both roads, from the file to the picture.

Indirect light is compared by itself, too: on some of these scenes it is so small a part that a picture without any
passes. It is the difference of pictures with and without bounces. Both take the same random numbers for direct light,
on either road, so the difference has the noise of indirect light alone.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from agreement import assert_agree, pictures
from sample_scenes import SCENES, sample_scene

CHOSEN = {"samples": 64, "max_bounces": 2}


@cache
def whole_and_indirect(name: str, road: str) -> tuple[np.ndarray, np.ndarray]:
    """(SEEDS, pixels, 3) each."""
    scene = sample_scene(name, width=16)
    whole = pictures(scene, road=road, **CHOSEN)
    return whole, whole - pictures(scene, road=road, **{**CHOSEN, "max_bounces": 0})


@pytest.mark.parametrize("name", SCENES)
def test_compiled_agrees_with_reference(name):
    compiled, reference = whole_and_indirect(name, "COMPILED"), whole_and_indirect(name, "REFERENCE")
    assert_agree(compiled[0], reference[0])
    assert_agree(compiled[1], reference[1])


@pytest.mark.parametrize("name", SCENES)
def test_lack_of_indirect_light_is_noticed(name):
    (_, compiled), (_, reference) = whole_and_indirect(name, "COMPILED"), whole_and_indirect(name, "REFERENCE")
    with pytest.raises(AssertionError, match="differ"):
        assert_agree(0.0 * compiled, reference)


def test_matrices_with_rows_and_columns_confused_are_noticed():
    scene = sample_scene("instances", width=16)
    matrices = scene.instances.transforms
    confused = np.ascontiguousarray(np.swapaxes(matrices, 1, 2)).reshape(matrices.shape)
    other = replace(scene, instances=replace(scene.instances, transforms=confused))
    with pytest.raises(AssertionError, match="differ"):
        assert_agree(pictures(scene, **CHOSEN), pictures(other, **CHOSEN))
