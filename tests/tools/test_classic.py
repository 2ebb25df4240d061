"""The curves of the classic pictures."""

from __future__ import annotations

import numpy as np
import pytest


@pytest.fixture(scope="module")
def classic(script):
    return script("classic")


def test_levels_end_at_the_most(classic):
    assert [classic.levels(most, 4) for most in (1, 16, 20)] == [[1], [1, 4, 16], [1, 5, 20]]


@pytest.mark.parametrize(("error", "seconds"), [(0.25, 2.0), (0.125, 4.0), (2.0, 0.5), (0.01, np.nan)])
def test_time_to_an_error_lies_on_the_line(classic, error, seconds):
    """NaN where the curve doesn't get there."""
    halving = classic.Curve(np.array([1.0, 4.0, 16.0]), np.array([0.5, 2.0, 8.0]), np.array([1.0, 0.25, 0.0625]))
    assert halving.seconds_to(error) == pytest.approx(seconds, nan_ok=True)


def test_curves_of_several_seeds(classic):
    curves = [classic.Curve(np.array([1.0, 4.0]), np.array([0.5, t]), np.array([1.0, e])) for t, e in
              ((2.0, 0.1), (3.0, 0.2), (9.0, 0.6))]  # fmt: skip
    found = classic.typical(curves)
    assert list(found.seconds) == [0.5, 3.0]
    assert list(found.error) == pytest.approx([1.0, 0.3])
    rows = classic.rows_of("a", "8x8", "Lobe", curves)
    assert [(row["seed"], row["samples"], row["relMSE"]) for row in rows[::2]] == [
        (seed, "1", "1.0000e+00") for seed in (1, 2, 3)
    ]
    assert len(rows) == 6
