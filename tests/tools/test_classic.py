"""The curves of the classic pictures."""

from __future__ import annotations

import importlib

import numpy as np
import pytest


@pytest.fixture(scope="module")
def classic(repository):
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(repository / "benchmarks"))
        yield importlib.import_module("classic")


def test_levels_end_at_the_most(classic):
    assert [classic.levels(most) for most in (1, 16, 20)] == [[1], [1, 4, 16], [1, 4, 16, 20]]


@pytest.mark.parametrize(("error", "seconds"), [(0.25, 2.0), (0.125, 4.0), (2.0, 0.5), (0.01, np.nan)])
def test_time_to_an_error_lies_on_the_line(classic, error, seconds):
    """NaN where the curve doesn't get there."""
    halving = classic.Curve(np.array([1.0, 4.0, 16.0]), np.array([0.5, 2.0, 8.0]), np.array([1.0, 0.25, 0.0625]))
    assert halving.seconds_to(error) == pytest.approx(seconds, nan_ok=True)
