"""Enabling and disabling the add-on: quick, complete, and without a trace afterwards."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import addon_utils
import bpy
import pytest

from engine import CHOICES, RANGES, Settings
from tests.blender.left_behind import snapshot
from tools.lobe_blender import MODULE, build, product_files

HEAVY = ("numba", "llvmlite", "embreex", "OpenImageIO", "scipy")

# Run in a Python of its own: what enabling imports.
ENABLE = f"""
import json, os, sys
sys.path.insert(0, {str(Path(__file__).resolve().parents[2])!r})
from tools.lobe_blender import enable_lobe, install
os.environ["BLENDER_USER_RESOURCES"] = str(install())
import bpy
enable_lobe()
bpy.context.scene.render.engine = "LOBE"
print(json.dumps([[name for name in {HEAVY!r} if name in sys.modules], bpy.context.scene.lobe.samples]))
"""


@pytest.fixture
def disabled():
    addon_utils.disable(MODULE)
    yield
    addon_utils.enable(MODULE, default_set=True)


def test_enabling_loads_no_compiler() -> None:
    done = subprocess.run([sys.executable, "-c", ENABLE], capture_output=True, text=True, check=True)
    heavy, samples = json.loads(done.stdout.splitlines()[-1])
    assert heavy == []
    assert samples == Settings().samples


def test_enabling_twenty_times_leaves_nothing_behind(disabled) -> None:
    before = snapshot()
    assert not before["types"] and not before["property"] and not before["panels"] and not before["engine"]
    assert not before["presets"] and not before["process"] and not before["image planes"]
    for _ in range(20):
        assert addon_utils.enable(MODULE) is not None
        enabled = snapshot()
        assert enabled["property"] and enabled["engine"] and "LOBE_RENDER_PT_sampling" in enabled["types"]
        assert "EEVEE_MATERIAL_PT_context_material" in enabled["panels"]
        assert len(enabled["presets"]) == 1 and enabled["image planes"]
        addon_utils.disable(MODULE)
    assert snapshot() == before


def test_a_failing_registration_is_undone(disabled, monkeypatch) -> None:
    addon = sys.modules[f"{MODULE}.addon"]
    before = snapshot()

    def fail() -> None:
        raise RuntimeError("on purpose")

    monkeypatch.setattr(addon.ui, "register", fail)
    with pytest.raises(RuntimeError, match="on purpose"):
        addon.register()
    assert snapshot() == before


def test_settings_mirror_the_engine() -> None:
    properties = bpy.types.Scene.bl_rna.properties["lobe"].fixed_type.properties
    shown = {rna.identifier for rna in properties if rna.identifier not in ("rna_type", "name")}
    assert shown == {*Settings.__dataclass_fields__, "viewport_samples", "use_denoising"} - {"threads", "passes"}
    for key in shown:
        rna = properties[key]
        assert rna.description and not rna.description.endswith("."), key
        if key in CHOICES:
            assert tuple(rna.enum_items.keys()) == CHOICES[key]
            assert all(item.description for item in rna.enum_items)
        if key == "use_denoising":  # the add-on's own
            continue
        if key == "viewport_samples":  # this too: the samples of a viewport
            key = "samples"
        else:
            assert getattr(bpy.context.scene.lobe, key) == pytest.approx(getattr(Settings(), key))
        if key in RANGES:
            low, high = RANGES[key]
            assert rna.hard_min >= low or rna.hard_min == pytest.approx(low), key  # float32 rounds
            assert rna.hard_max <= high or rna.hard_max == pytest.approx(high), key


def test_package_holds_the_product_and_nothing_else(tmp_path: Path, repository: Path) -> None:
    import zipfile

    package = tmp_path / "lobe.zip"
    build(package)
    names = set(zipfile.ZipFile(package).namelist())
    product = {path.relative_to(repository).as_posix() for path in product_files()}
    assert product <= names
    assert names - product <= {"README.md", "LICENSE"}
    assert not any(name.startswith(("tests", "tools", "benchmarks", "sample_blends", ".")) for name in names)
