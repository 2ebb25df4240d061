"""benchmarks/materials.py: its figures on made-up pictures whose truth is known, and what its scenes show."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from tools.lobe_blender import enable_lobe

enable_lobe()  # before anything imports bpy


@pytest.fixture(scope="module")
def materials(script):
    return script("materials")


def pictures(seed: int, low: float = 1.0) -> np.ndarray:
    """(4, 32, 32, 3): the upper half of brightness 1, the lower of `low`, with a little noise."""
    made = np.random.default_rng(seed).normal(1.0, 0.01, (4, 32, 32, 3))
    made[:, 16:] *= low
    return made


def test_how_much_brighter(materials):
    everywhere = np.ones((32, 32), bool)
    found = materials.brighter(pictures(1, 0.5), pictures(2), everywhere)
    assert found.mean == pytest.approx(-0.25, abs=0.01) and 0.0 < found.half_width < 0.02
    assert found.low == pytest.approx(-0.5, abs=0.02) and found.high == pytest.approx(0.0, abs=0.02)


def test_blocks_are_as_noisy_as_they_are(materials):
    """Of 64 pixels and 3 channels in 4 seeds, of both engines: a hundredth of a pixel's 0.01 sqrt(2) / sqrt(768)."""
    everywhere = np.ones((32, 32), bool)
    calm = materials.brighter(pictures(1), pictures(2), everywhere)
    assert calm.noise == pytest.approx(0.01 * 2**0.5 / 768**0.5, rel=1.0)
    assert calm.settled  # below what is told
    figures = materials.Brighter(0.0, 0.0, -0.5, 0.5, 0.09)
    assert figures.settled and not figures._replace(noise=0.11).settled


@pytest.mark.parametrize(
    ("deviation", "options", "seeds"),
    [(0.01, [], 4), (1.0, [], 64), (1.0, ["--seeds", "3", "--most-seeds", "8"], 8)],
)
def test_seeds_are_added_until_the_range_of_blocks_is_not_noise(materials, monkeypatch, deviation, options, seeds):
    rng = np.random.default_rng(1)
    rendered = []

    def render(scene, engine, samples, seed):
        rendered.append((engine, seed))
        return rng.normal(1.0, deviation, (64, 64, 3)), {}

    monkeypatch.setattr(materials.common, "render", render)
    row = materials.measure(materials.CASES[-1], materials.WORLD, materials.parse(options))
    assert row["seeds"] == seeds and len(set(rendered)) == len(rendered) == 2 * seeds
    assert ("±" in row["blocks"]) == (seeds > 4)  # still noisy


def test_only_what_is_asked_about_counts(materials):
    """Neither pixels that show something else, nor blocks that are next to black."""
    upper = np.arange(32)[:, None] + np.zeros((1, 32)) < 12
    found = materials.brighter(pictures(1, 0.5), pictures(2), upper)
    assert found.mean == pytest.approx(0.0, abs=0.01) and found.low == pytest.approx(0.0, abs=0.02)
    everywhere = np.ones((32, 32), bool)
    assert materials.brighter(pictures(1, 1.0), pictures(2, 0.02), everywhere).high > 40.0
    assert materials.brighter(pictures(1, 1.0), pictures(2, 0.002), everywhere).high == pytest.approx(0.0, abs=0.02)


def test_the_balls_pixels_lie_within_its_circle(materials):
    where = materials.inside("ball", (64, 64))
    assert where.mean() == pytest.approx(np.pi / 4, abs=0.05) and where.mean() < np.pi / 4
    assert (where == where[::-1]).all() and (where == where.T).all() and not where[0, 0]
    assert materials.inside("floor", (48, 32)).shape == (32, 48) and materials.inside("floor", (48, 32)).all()


@pytest.mark.parametrize("shape", ["ball", "floor"])
def test_the_scenes_show_what_is_measured(materials, shape):
    """By a camera without a lens: each ray from a pixel that counts meets the thing, and nothing else is there."""
    case = materials.Case(shape, "Principled BSDF", materials.PRINCIPLED, 0.5)
    scene = materials.build(case, materials.LAMP)
    materials.br.set_resolution(scene, 16, 16)
    materials.br.set_threads(scene, 1)
    scene.lobe.pixel_filter = "BOX"
    picture, _ = materials.common.render(scene, "LOBE", 16, 1)
    where = materials.inside(shape, (16, 16))
    seen = picture.max(axis=2) > 0.0
    if shape == "floor":
        assert seen.all()
    else:  # the lower right is in the shade
        assert not seen[[0, 0, -1, -1], [0, -1, 0, -1]].any() and seen[where].mean() > 0.6


def test_every_case_is_built_as_it_says(materials):
    for case, light in zip(materials.CASES, itertools.cycle(materials.LIGHTS), strict=False):
        scene = materials.build(case, light)
        (thing,) = [obj for obj in scene.objects if obj.type == "MESH"]
        kinds = sorted(obj.type for obj in scene.objects)
        assert kinds == (["CAMERA", "LIGHT", "MESH"] if light == materials.LAMP else ["CAMERA", "MESH"])
        shaders = [node for slot in thing.material_slots for node in slot.material.node_tree.nodes if node.inputs]
        found = [node for node in shaders if node.bl_idname == case.node]
        assert len(found) == (case.node is not None)
        for node in found:
            assert node.inputs["Roughness"].default_value == pytest.approx(case.roughness)
            assert case.node == materials.GLOSSY or node.inputs["Metallic"].default_value == case.metallic


def test_the_short_table_puts_both_lights_in_a_row(materials):
    options = materials.parse([])
    case, plain = materials.CASES[0], materials.CASES[-1]
    figures = materials.Brighter(-0.25, 0.001, -0.5, 0.125, 0.01)
    rows = [materials.row(each, light, figures, 8, options) for each in (case, plain) for light in materials.LIGHTS]
    assert rows[0]["mean"] == "-25.0% ± 0.1%" and rows[0]["blocks"] == "-50% to +12%"
    assert rows[0]["seeds"] == 8 and rows[0]["noise of a block"] == "1.0%"
    noisy = materials.row(case, materials.LAMP, figures._replace(noise=0.1), 64, options)
    assert noisy["blocks"] == "-50% to +12%, each ± 10%"
    lines = materials.short([{key: str(value) for key, value in row.items()} for row in rows]).splitlines()
    assert lines[0] == "| shape | surface | roughness | white world | area lamp |"
    assert lines[2] == "| ball | Glossy BSDF | 0.1 | -25.0% (-50% to +12%) | -25.0% (-50% to +12%) |"
    assert len(lines) == 4 and materials.short([]) == ""


def test_the_materials_page_quotes_the_table(materials):
    quoted = materials.PAGE.read_text(encoding="utf-8").split(materials.MARKS[0])[1].split(materials.MARKS[1])[0]
    kept = materials.common.read_table("materials", materials.common.RESULTS)
    assert kept and quoted == materials.short(kept), "write it anew: python benchmarks/materials.py"
