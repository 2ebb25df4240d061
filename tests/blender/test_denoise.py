"""The Denoise checkbox: less error on a real scene, the same bits without it, and a message where it can't be done."""

from __future__ import annotations

import ctypes.util
import importlib
import sys

import bpy
import numpy as np
import pytest

from tools import blender_render as br
from tools import metrics
from tools.lobe_blender import MODULE

denoising = importlib.import_module(f"{MODULE}.addon.denoise")


@pytest.fixture
def available() -> None:
    try:
        denoising._library()
    except denoising.DenoiseError as error:
        pytest.skip(str(error))


@pytest.fixture
def absent(monkeypatch) -> None:
    """A Blender without the library."""
    forget()
    monkeypatch.setattr(denoising, "_candidates", lambda: ["no_such_library.so"])
    yield
    forget()


def forget() -> None:
    """That the library was looked for."""
    denoising._library.cache_clear()
    denoising.is_missing.cache_clear()
    denoising.print_what_was_tried.cache_clear()


@pytest.fixture
def cornell(repository):
    scene = br.open_blend(repository / "sample_blends" / "cornell_diffuse.blend")
    br.set_resolution(scene, 96, 96)
    return scene


def picture(scene, denoise: bool, samples: int = 4, seed: int = 0) -> tuple[np.ndarray, dict]:
    scene.lobe.use_denoising, scene.lobe.samples, scene.lobe.seed = denoise, samples, seed
    report = br.render(scene)
    return br.picture(scene), report


def test_less_error_on_a_sample_scene(available, cornell, figure) -> None:
    reference = picture(cornell, False, samples=2048, seed=1)[0][..., :3]
    noisy, plain = picture(cornell, False)
    smooth, report = picture(cornell, True)
    before, after = (metrics.rel_mse(p[..., :3], reference) for p in (noisy, smooth))
    figure(f"denoising, Cornell box of 4 samples at 96 x 96: relMSE {before:.3f} becomes {after:.3f}")
    assert after < before / 4
    assert np.array_equal(smooth[..., 3], noisy[..., 3])
    assert report["warnings"] == plain["warnings"] == []
    again, _ = picture(cornell, False)
    assert np.array_equal(again, noisy)


def test_denoising_data_guides_it(available, cornell, monkeypatch) -> None:
    session, seen = importlib.import_module(f"{MODULE}.addon.session"), []
    whole = session.denoise
    monkeypatch.setattr(session, "denoise", lambda *args, **named: seen.append(args[1:]) or whole(*args, **named))
    alone = picture(cornell, True)[0]
    cornell.view_layers[0].lobe.denoising_data = True
    guided = picture(cornell, True)[0]
    assert seen[0] == (None, None) and [guide.shape for guide in seen[1]] == [guided[..., :3].shape] * 2
    assert seen[1][0].max() > 0 and seen[1][1].min() < 0 and not np.array_equal(guided, alone)


def test_the_noisy_picture_is_kept_as_a_pass(available, cornell, layers) -> None:
    """Under Cycles' name, and only where the picture is denoised."""
    cornell.render.film_transparent, cornell.lobe.samples, cornell.lobe.use_denoising = True, 4, True
    both = layers(cornell)
    cornell.lobe.use_denoising = False
    plain = layers(cornell)
    assert {name.split(".")[1] for name in both} - {name.split(".")[1] for name in plain} == {"Noisy Image"}
    layer = cornell.view_layers[0].name
    for channel in "RGBA":
        noisy, smooth = both[f"{layer}.Noisy Image.{channel}"], both[f"{layer}.Combined.{channel}"]
        assert np.array_equal(noisy, plain[f"{layer}.Combined.{channel}"])
        assert np.array_equal(noisy, smooth) == (channel == "A")


def test_without_the_library_the_noisy_pass_is_the_picture(absent, simple_scene, layers) -> None:
    simple_scene.lobe.use_denoising = True
    found, layer = layers(simple_scene), simple_scene.view_layers[0].name
    assert np.all(found[f"{layer}.Noisy Image.R"] == 1.0) and np.all(found[f"{layer}.Combined.R"] == 1.0)


def test_alpha_stays(available, cornell) -> None:
    cornell.render.film_transparent = True
    noisy, smooth = picture(cornell, False)[0], picture(cornell, True)[0]
    assert noisy[..., 3].min() < 1.0
    assert np.array_equal(smooth[..., 3], noisy[..., 3]) and not np.array_equal(smooth, noisy)


def test_without_the_library_the_picture_stays_and_it_is_said(absent, simple_scene) -> None:
    noisy, _ = picture(simple_scene, False)
    kept, report = picture(simple_scene, True)
    assert np.array_equal(kept, noisy)
    assert [warning for warning in report["warnings"] if "denois" in warning] == [denoising.MISSING]
    shown = sys.modules[f"{MODULE}.addon.scene_report"].report_of(simple_scene)
    assert [group.what for group in shown.groups if "denois" in group.what] == [denoising.MISSING]


@pytest.mark.parametrize("ticked", [True, False])
def test_without_the_library_a_check_says_so(absent, simple_scene, ticked, capfd) -> None:
    """The console has the details, once."""
    simple_scene.lobe.use_denoising = ticked
    for _ in range(2):
        bpy.ops.lobe.check_scene()
    assert capfd.readouterr().out.count("no_such_library.so (") == ticked
    shown = sys.modules[f"{MODULE}.addon.scene_report"].report_of(simple_scene)
    assert (denoising.MISSING in [group.what for group in shown.of_level("WARNING")]) == ticked


def test_another_library_of_that_name_is_refused(absent, monkeypatch) -> None:
    """One without these functions."""
    name = ctypes.util.find_library("c") or ctypes.util.find_library("msvcrt")
    monkeypatch.setattr(denoising, "_candidates", lambda: [name])
    with pytest.raises(denoising.DenoiseError, match=r"oidn"):
        denoising.denoise(np.ones((8, 8, 3), np.float32))


def test_an_error_inside_the_library_is_said(available, monkeypatch, simple_scene) -> None:
    monkeypatch.setattr(denoising, "FORMAT_FLOAT3", 99)
    noisy, _ = picture(simple_scene, False)
    kept, report = picture(simple_scene, True)
    assert np.array_equal(kept, noisy)
    assert any("not denoised: OpenImageDenoise failed: " in warning for warning in report["warnings"])


def test_escape_keeps_the_noisy_picture(available, monkeypatch, simple_scene) -> None:
    session = importlib.import_module(f"{MODULE}.addon.session")
    noisy, _ = picture(simple_scene, False)
    whole = session.denoise
    monkeypatch.setattr(session, "denoise", lambda *args, **named: whole(*args, **{**named, "stop": lambda: True}))
    kept, report = picture(simple_scene, True)
    assert np.array_equal(kept, noisy) and not any("denoised" in warning for warning in report["warnings"])
    assert sys.modules[f"{MODULE}.addon.report"].last_report["stopped"]


def test_guides_help(available) -> None:
    """A checkerboard that only the albedo shows without noise."""
    y, x = np.mgrid[:64, :64] // 4
    albedo = np.repeat(((x + y) % 2 * 0.6 + 0.2)[..., None], 3, axis=-1).astype(np.float32)
    noisy = (albedo * np.random.default_rng(0).exponential(1.0, albedo.shape)).astype(np.float32)
    normal = np.zeros_like(albedo) + np.float32([0.0, 0.0, 1.0])
    alone, guided, both = (
        metrics.rel_mse(denoising.denoise(noisy, *guides), albedo) for guides in ((), (albedo,), (albedo, normal))
    )
    assert guided < alone / 2 and both < alone / 2
    assert alone < metrics.rel_mse(noisy, albedo)


def test_arguments(available) -> None:
    color = np.ones((60, 90, 3), np.float32)
    before = color.copy()
    result = denoising.denoise(color[:, ::-1], threads=1)
    assert result.shape == color.shape and result.dtype == np.float32 and np.array_equal(color, before)
    assert result == pytest.approx(1.0, abs=0.15) and result.mean() == pytest.approx(1.0, abs=0.01)
    for wrong in ((color[..., :2],), (color, color[:3]), (color, None, color), (color[0],)):
        with pytest.raises(ValueError, match="can't be denoised"):
            denoising.denoise(*wrong)
