"""The documentation against the project: commands exist, links resolve, pages that list things list all of them."""

from __future__ import annotations

import re
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from benchmarks import common
from benchmarks.convergence import plan
from benchmarks.convergence import tables as bench_tables
from engine import CHOICES, PASSES, Settings

REPOSITORY = Path(__file__).resolve().parent.parent
README = REPOSITORY / "README.md"
PAGES = [README, *sorted((REPOSITORY / "docs").glob("*.md")), REPOSITORY / "benchmarks" / "README.md"]
LINK = re.compile(r"\]\(([^)#\s]+)[^)]*\)")
LARGEST_PICTURE = 150_000  # bytes


def identify(path: Path) -> str:
    return path.relative_to(REPOSITORY).as_posix()


def read(path: Path) -> str:
    return path.read_text(encoding="utf-8")


@pytest.mark.parametrize("page", PAGES, ids=identify)
def test_links_resolve(page: Path) -> None:
    """Those to tables of results too: what nobody has measured is named by its command alone."""
    targets = [target for target in LINK.findall(read(page)) if "://" not in target]
    assert [target for target in targets if not (page.parent / target).exists()] == []


def test_tables_that_are_there_are_linked() -> None:
    """In the list of them, where those that aren't stand without a link."""
    unlinked = re.findall(r"^\| (\w+\.md) \|", read(REPOSITORY / "docs" / "performance.md"), re.MULTILINE)
    assert [name for name in unlinked if (common.RESULTS / name).exists()] == []


def test_commands_are_make_targets() -> None:
    targets = set(re.findall(r"^(\w+):", read(REPOSITORY / "Makefile"), re.MULTILINE))
    commands = set(re.findall(r"^ {4}make (\w+)", read(README), re.MULTILINE))
    assert {"render", "test", "package"} <= commands <= targets


@pytest.mark.parametrize("page", PAGES, ids=identify)
def test_files_named_exist(page: Path) -> None:
    """Except NAME in capitals, which the reader chooses, and the results, which the benchmarks write."""
    named = re.findall(r"`((?:addon|benchmarks|docs|engine|sample_blends|tests|tools)/[\w./-]+)`", read(page))
    checked = [name for name in named if "NAME" not in name and not name.startswith("benchmarks/results/")]
    assert [name for name in checked if not (REPOSITORY / name).exists()] == []


def test_scripts_in_commands_exist() -> None:
    scripts = {script for page in PAGES for script in re.findall(r"python ([\w/]+\.py)", read(page))}
    assert scripts
    assert sorted(script for script in scripts if not (REPOSITORY / script).is_file()) == []


def test_the_readme_quotes_the_benchmark() -> None:
    rows = [row for row in common.read_table("equal_error", common.RESULTS) if bench_tables.is_headline(row)]
    begin, end = bench_tables.QUOTED
    assert rows and f"{begin}{common.markdown(bench_tables.short(rows))}{end}" in read(README)


# Of confidence, of tests' levels, of trimming, and what tests and settings tolerate: they are chosen.
CHOSEN = {"0.1 %", "95 %", "99 %", "99.9 %", "99.75 %", "0.2 %", "1 %", "2 %", "5 %"}


@pytest.mark.parametrize("page", PAGES, ids=identify)
def test_measured_percentages_stand_in_tables(page: Path) -> None:
    """In those of benchmarks/results/, which a page quotes between two marks or links to: a figure in the text would
    stay as it is when the table is renewed."""
    text = re.sub(r"<!-- .*?<!-- its end -->", "", read(page), flags=re.DOTALL)
    found = re.findall(r"[\d.,]*\d ?%", text) + re.findall(r"\w+ per cents?", text)
    assert sorted(set(found) - CHOSEN - {"a per cent"}) == []


def test_the_settings_page_lists_every_setting() -> None:
    rows = dict(re.findall(r"^\| `(\w+)` \| ([^|]+) \|", read(REPOSITORY / "docs" / "settings.md"), re.MULTILINE))
    assert rows.pop("viewport_samples") and rows.pop("use_denoising")  # of the add-on alone
    assert set(rows) == {field.name for field in fields(Settings)}
    for field in fields(Settings):
        shown = rows[field.name].strip().strip("`")
        expected = {True: "on", False: "off"}[field.default] if field.type == "bool" else field.default
        assert shown == f"{expected:g}" if isinstance(expected, float) else shown == str(expected)


def test_the_settings_page_names_every_choice() -> None:
    page = read(REPOSITORY / "docs" / "settings.md")
    assert [choice for choices in CHOICES.values() for choice in choices if f"`{choice}`" not in page] == []


def test_the_materials_page_names_every_node() -> None:
    folder = REPOSITORY / "addon" / "export"
    sources = [*(folder / "materials").glob("*.py"), folder / "world.py"]
    nodes = {node for path in sources for node in re.findall(r'"(ShaderNode\w+)"', read(path))}
    nodes -= {"ShaderNodeOutput", "ShaderNodeOutputMaterial", "ShaderNodeOutputWorld"}
    page = read(REPOSITORY / "docs" / "materials.md")
    assert sorted(node for node in nodes if f"`{node}`" not in page) == []


def examples(page: Path) -> list[str]:
    """The Python of a page."""
    return re.findall(r"^```python\n(.*?)^```", read(page), re.MULTILINE | re.DOTALL)


def test_the_engines_example_makes_a_picture() -> None:
    (example,) = examples(REPOSITORY / "docs" / "design.md")
    names: dict = {}
    exec(example, names)
    picture = names["picture"]
    assert picture.shape == (64, 64, 4) and not names["result"].warnings
    row, column = np.unravel_index(picture[..., 0].argmax(), (64, 64))
    assert row > 32 and column > 32  # below the lamp, up and to the right
    red, green, blue = picture[row, column, :3]
    assert (green / red, blue / red) == pytest.approx((5 / 8, 3 / 8), rel=1e-3)


def test_the_table_of_the_readme_is_of_the_size_that_it_says() -> None:
    usual = plan.Settings(Path())
    assert "Pictures of {}x{} pixels on two threads".format(*usual.resolution) in read(README) and usual.threads == 2


def test_pictures_are_small() -> None:
    pictures = sorted((REPOSITORY / "docs" / "images").iterdir())
    assert pictures
    assert [p.name for p in pictures if p.suffix != ".png" or p.stat().st_size >= LARGEST_PICTURE] == []


def test_the_licence_is_there() -> None:
    assert "GNU GENERAL PUBLIC LICENSE" in read(REPOSITORY / "LICENSE")[:200]
    assert "GPL-3.0-or-later" in read(REPOSITORY / "blender_manifest.toml")


def test_the_settings_page_lists_every_pass() -> None:
    """By what Blender's boxes say."""
    page = read(REPOSITORY / "docs" / "settings.md").partition("## Passes")[2].partition("\n## ")[0]
    boxes = " ".join(re.findall(r"^\| ([^|]+) \|", page, re.MULTILINE))
    words = {word.capitalize() for name in PASSES for word in name.split("_")} - {"Albedo"}
    assert sorted(word for word in words - {"Uv"} if word not in boxes) == [] and "UV" in boxes
