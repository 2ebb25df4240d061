"""benchmarks/denoise.py: its figures on made-up renders."""

from __future__ import annotations

import itertools
from types import SimpleNamespace

import numpy as np
import pytest

from tools import metrics
from tools.blender_render import ToolError


@pytest.fixture(scope="module")
def denoise(script):
    return script("denoise")


def rounds(*pairs: tuple[float, float]) -> list[dict]:
    """Half a second of each is spent before and after the samples."""
    return [{"seconds": {"total": total, "render": total - 0.5}, "relMSE": error} for total, error in pairs]


@pytest.fixture
def found(denoise):
    return {
        denoise.NOISY: rounds((1.0, 0.3), (2.0, 0.1)),
        denoise.DENOISED: rounds((1.5, 0.03), (3.0, 0.01)),
        denoise.GUIDED: rounds((2.0, 0.015), (4.0, 0.025)),
        denoise.MORE: rounds((1.4, 0.2), (3.2, 0.1)),
    }


def test_as_many_samples_as_take_as_long(denoise, found):
    """0.75 s longer at 1 s for 16 samples; what a render takes besides isn't paid again for more of them."""
    assert denoise.samples_for(found, 16) == 28
    quicker = found | {denoise.DENOISED: rounds((0.9, 0.0), (0.9, 0.0))}
    assert denoise.samples_for(quicker, 16) == 16


def test_a_row_is_beside_the_noisy_picture(denoise, found):
    row = denoise.row("lamps", found, 24, 1e-4, denoise.parse(["--runs", "2"]))
    assert (row["relMSE"], row["denoising, s"], row["samples in that time"]) == ("2.00e-01", "0.75", 24)
    assert row["denoised: relMSE / noisy"] == "0.100"
    assert row["denoised: time / noisy"] == "1.50 (1.50 to 1.50)"
    assert row["with Denoising Data: time / noisy"] == "2.00 (2.00 to 2.00)"
    assert row["more samples: relMSE / noisy"] == "0.750"
    line = denoise.short([{key: str(value) for key, value in row.items()}]).splitlines()[2]
    assert line == "| lamps | 16 | 0.100 (1.50) | 0.100 (2.00) | 0.750 (1.50) |"
    assert denoise.short([]) == ""


@pytest.mark.parametrize(
    ("way", "ticked"),
    [("noisy", (False, False)), ("denoised", (True, False)), ("with Denoising Data", (True, True)),
     ("more samples", (False, False))],
)  # fmt: skip
def test_each_way_ticks_its_boxes(denoise, monkeypatch, way, ticked):
    scene = SimpleNamespace(lobe=SimpleNamespace(), view_layers=[SimpleNamespace(lobe=SimpleNamespace())])
    seen = []

    def render(scene, engine, samples, seed):
        seen.append((scene.lobe.use_denoising, scene.view_layers[0].lobe.denoising_data, samples, seed))
        return np.ones((2, 2, 3)), {"warnings": []}

    monkeypatch.setattr(denoise.common, "render", render)
    seeds = itertools.count(1)
    for _ in range(2):
        assert denoise.shoot(scene, way, 7, seeds, np.ones((2, 2, 3)), 0.0)["relMSE"] == 0.0
    assert seen == [(*ticked, 7, 1), (*ticked, 7, 2)]


def test_the_noise_of_the_reference_is_taken_off(denoise, monkeypatch):
    """Pictures and halves of a reference of known noise around a truth of 1: what is left is the pictures' own."""
    rng = np.random.default_rng(1)
    scene = SimpleNamespace(lobe=SimpleNamespace(), view_layers=[SimpleNamespace(lobe=SimpleNamespace())])
    reference, noise = metrics.joined([rng.normal(1.0, 0.02, (256, 256, 3)) for _ in range(2)])
    picture = rng.normal(1.0, 0.03, (256, 256, 3))
    monkeypatch.setattr(denoise.common, "render", lambda *_: (picture, {"warnings": []}))
    found = denoise.shoot(scene, denoise.NOISY, 1, itertools.count(1), reference, noise)["relMSE"]
    assert found == pytest.approx(0.03**2, rel=0.02) and noise == pytest.approx(0.02**2 / 2, rel=0.02)


def test_a_picture_that_stays_noisy_is_no_measure(denoise, monkeypatch):
    scene = SimpleNamespace(lobe=SimpleNamespace(), view_layers=[SimpleNamespace(lobe=SimpleNamespace())])
    report = {"warnings": ["the picture is not denoised: this Blender has no OpenImageDenoise library"]}
    monkeypatch.setattr(denoise.common, "render", lambda *_: (np.ones((2, 2, 3)), report))
    with pytest.raises(ToolError, match="not denoised"):
        denoise.shoot(scene, denoise.DENOISED, 1, itertools.count(1), np.ones((2, 2, 3)), 0.0)


def test_the_settings_page_quotes_the_table(denoise):
    quoted = denoise.PAGE.read_text(encoding="utf-8").split(denoise.MARKS[0])[1].split(denoise.MARKS[1])[0]
    kept = denoise.common.read_table("denoise", denoise.common.RESULTS)
    assert kept and quoted == denoise.short(kept), "write it anew: python benchmarks/denoise.py"
