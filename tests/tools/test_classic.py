"""The curves of the classic pictures."""

from __future__ import annotations

import numpy as np
import pytest
import scenes

from engine import Settings, render
from tools.lobe_blender import enable_lobe


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


def test_the_plain_road_finds_the_same_light_by_rays_alone(classic):
    """The same mean in far more samples, no shadow ray: at most one ray for the camera and each bounce."""
    box, seeds = scenes.cornell(16), range(1, 9)

    def rendered(samples: int):
        found = [render(box, Settings(samples=samples, seed=seed, max_bounces=3, threads=1)) for seed in seeds]
        pictures = np.array([result.pixels[..., :3] for result in found], float)
        return pictures.mean(), pictures.mean(axis=(1, 2, 3)).std(ddof=1) / len(seeds) ** 0.5, pictures.var(
            axis=0, ddof=1
        ).mean() * samples, max(result.rays for result in found) / (samples * 16 * 16)  # fmt: skip

    lit, lit_error, lit_variance, lit_rays = rendered(64)
    with classic.plain_road():
        plain, plain_error, plain_variance, plain_rays = rendered(1024)
    assert abs(plain - lit) < 4 * np.hypot(plain_error, lit_error) < 0.05 * lit
    assert plain_variance > 4 * lit_variance
    assert plain_rays <= 1 + 3 and lit_rays > 1.3 * plain_rays


@pytest.mark.long  # compiles the scene's kernels
def test_a_small_picture_is_measured_whole(classic, tmp_path):
    enable_lobe()
    words = ["--resolution", "16x16", "--samples", "16", "--plain-samples", "256", "--reference-samples", "256"]
    options = classic.parse([*words, "--seeds", "2", "--results", str(tmp_path)])
    row, lobe, plain = classic.measure("cornell_diffuse", options)
    assert [list(one.samples) for one in (*lobe, plain)] == [[1, 4, 16], [1, 4, 16], [1, 16, 256]]
    assert all(one.error[0] > one.error[-1] > 0 for one in (*lobe, plain))
    assert float(row["their relMSE"]) == pytest.approx(plain.error[-1], rel=0.01)
    assert abs(float(row["plain mean"].rstrip("%"))) < 20
    classic.plot("cornell_diffuse", classic.typical(lobe), plain, tmp_path / "curves.png")
    assert (tmp_path / "curves.png").stat().st_size > 0


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
