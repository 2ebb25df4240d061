"""Where the tools keep Blender's user folder, and what they run in other versions of Blender."""

from __future__ import annotations

import os
import tempfile
import tomllib

import pytest

from tools import lobe_blender, other_blender
from tools.package import BY_PYTHON

needs_owners = pytest.mark.skipif(not hasattr(os, "getuid"), reason="no owners on this system")


@pytest.fixture
def temporary(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


@needs_owners
def test_folder_is_the_users_alone(temporary):
    folder = lobe_blender.private_folder("a")
    assert folder.parent == temporary and folder.stat().st_mode & 0o777 == 0o700
    folder.chmod(0o777)
    assert lobe_blender.private_folder("a").stat().st_mode & 0o777 == 0o700


@needs_owners
def test_another_users_folder_is_refused(temporary, monkeypatch):
    us = os.getuid()
    monkeypatch.setattr(os, "getuid", lambda: us + 1)
    (temporary / f"lobe-a-{us + 1}").mkdir()
    with pytest.raises(lobe_blender.SetupError, match="is not a folder of yours"):
        lobe_blender.private_folder("a")


def test_cleaning_leaves_other_checkouts_alone(temporary, capsys):
    """Of this one it takes those of all versions of Blender, and the wheels."""
    own = [lobe_blender.private_folder(f"blender-{v}-{lobe_blender._checkout()}") for v in ("4.2.23", "5.0.1")]
    wheels, other = lobe_blender.private_folder("wheels"), lobe_blender.private_folder("blender-5.0.1-01234567")
    (wheels / "a.whl").write_bytes(b"")
    lobe_blender.clean()
    assert list(temporary.iterdir()) == [other]
    assert set(capsys.readouterr().out.splitlines()) == {f"Removing {folder}" for folder in (*own, wheels)}


@needs_owners
def test_a_link_is_refused(temporary):
    (temporary / "elsewhere").mkdir()
    (temporary / f"lobe-a-{os.getuid()}").symlink_to(temporary / "elsewhere")
    with pytest.raises(lobe_blender.SetupError, match="is not a folder of yours"):
        lobe_blender.private_folder("a")


@pytest.mark.parametrize(
    ("version", "numpy", "scipy", "images", "python"),
    [
        ("4.2.23", "1.24.3", "1.13.1", "3.0.21.0", (3, 11)),
        ("4.5.15", "1.26.4", "1.17.1", "3.0.21.0", (3, 11)),
        ("5.0.1", "1.26.4", "1.17.1", "3.0.21.0", (3, 11)),
        ("5.2.3", "2.3.4", "1.17.1", BY_PYTHON["3.13"]["OpenImageIO"], (3, 13)),
    ],
)
def test_packages_of_another_blender(version, numpy, scipy, images, python):
    lines = ["# pins", "bpy==5.0.1", "numpy==1.26.4", "OpenImageIO==3.0.21.0", "tqdm==4.70.1", "scipy==1.17.1"]
    expected = [f"bpy=={version}", f"numpy=={numpy}", f"OpenImageIO=={images}", "tqdm==4.70.1", f"scipy=={scipy}"]
    assert other_blender.requirements(version, lines) == expected
    assert other_blender.since(version, other_blender.PYTHON) == python


def test_the_oldest_blender_is_the_manifests(repository):
    manifest = tomllib.loads((repository / "blender_manifest.toml").read_text())
    oldest = tuple(int(part) for part in manifest["blender_version_min"].split(".")[:2])
    assert min(other_blender.NUMPY) == min(other_blender.PYTHON) == oldest
