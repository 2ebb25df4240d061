"""The package with wheels, as far as it goes without downloading any."""

from __future__ import annotations

import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

from tools import package
from tools.lobe_blender import SetupError, validate
from tools.package import PACKED, PLATFORMS, PYTHONS, pins, this_platform, with_wheels


def test_pins_are_exact() -> None:
    for python in PYTHONS:
        assert [pin.partition("==")[0] for pin in pins(python)] == list(PACKED)
        assert all(pin.count("==") == 1 and pin.partition("==")[2] for pin in pins(python))


def test_this_platform_can_be_packed() -> None:
    assert this_platform() in PLATFORMS


def test_the_manifest_gets_its_wheels(repository: Path) -> None:
    before = (repository / "blender_manifest.toml").read_text()
    after = with_wheels(before, ["a-1-py3-none-any.whl", "b-2-py3-none-any.whl"], ["linux-x64"])
    manifest = tomllib.loads(after)
    assert manifest["wheels"] == ["./wheels/a-1-py3-none-any.whl", "./wheels/b-2-py3-none-any.whl"]
    assert manifest["platforms"] == ["linux-x64"]
    del manifest["wheels"], manifest["platforms"]
    assert manifest == tomllib.loads(before)


def test_what_lobe_does_outside_of_blender_is_declared(repository: Path) -> None:
    """It reads images and writes a cache and pages by itself. Blender's site wants 64 characters and no full stop."""
    permissions = tomllib.loads((repository / "blender_manifest.toml").read_text())["permissions"]
    assert set(permissions) == {"files"}
    assert len(permissions["files"]) <= 64 and not permissions["files"].endswith(".")


@pytest.fixture
def empty_wheels(monkeypatch):
    """Instead of a download: files of the right names."""

    def download(target: str, python: str, folder: Path) -> list[Path]:
        tag = f"cp{python.replace('.', '')}"
        paths = [folder / f"{name}-1.0-{tag}-{tag}-{PLATFORMS[target][0]}.whl" for name in PACKED]
        for path in paths:
            path.write_bytes(b"")
        return paths

    monkeypatch.setattr(package, "download", download)


@pytest.mark.parametrize("target", PLATFORMS)
def test_a_platforms_zip(target, empty_wheels, tmp_path) -> None:
    """Holds the product, and the wheels of all of Blender's Pythons for this platform alone; as its manifest says."""
    path = package.build_package(tmp_path / "out", target, wheels=tmp_path / "wheels")
    assert path.name.endswith(f"-{target.replace('-', '_')}.zip")
    with zipfile.ZipFile(path) as file:
        names = file.namelist()
        manifest = tomllib.loads(file.read("blender_manifest.toml").decode())
    wheels = sorted(name for name in names if name.startswith("wheels/"))
    assert len(wheels) == len(PACKED) * len(PYTHONS)
    assert manifest["platforms"] == [target] and sorted(manifest["wheels"]) == [f"./{name}" for name in wheels]
    assert {"__init__.py", "addon/__init__.py", "engine/__init__.py", "LICENSE"} <= set(names)
    assert "README.md" not in names  # its pictures and links lead to what isn't there
    assert not any(name.startswith(("tests/", "tools/", "docs/", ".")) or "__pycache__" in name for name in names)


def test_the_command_says_what_it_is_at(monkeypatch, capsys, tmp_path) -> None:
    """A platform's wheels take minutes to fetch."""
    said_before = []

    def build_package(output: Path, target: str, *_) -> Path:
        said_before.append(capsys.readouterr().out)
        output.write_bytes(b"")
        return output

    monkeypatch.setattr(package, "build_package", build_package)
    monkeypatch.setattr(sys, "argv", ["package.py", "-o", str(tmp_path / "a.zip"), "--platform", *PLATFORMS])
    package.main()
    assert [said.splitlines()[-1].partition(":")[0] for said in said_before] == list(PLATFORMS)


def test_a_folder_that_cannot_be_made_is_said_before_the_work(monkeypatch, tmp_path) -> None:
    file = tmp_path / "file"
    file.write_text("in the way")
    monkeypatch.setattr(package, "build_package", lambda *_: pytest.fail("it has begun"))
    monkeypatch.setattr(sys, "argv", ["package.py", "-o", str(file / "x")])
    with pytest.raises(SystemExit) as stopped:
        package.main()
    assert stopped.value.code == f"package.py: {str(file)!r} is not a folder"


def test_blenders_tool_refuses_what_is_wrong(empty_wheels, tmp_path, monkeypatch) -> None:
    wrong = with_wheels
    monkeypatch.setattr(package, "with_wheels", lambda *parts: wrong(*parts).replace('["Render"]', '["Rendering"]'))
    with pytest.raises(SetupError, match="Rendering"):
        package.build_package(tmp_path / "out", this_platform(), wheels=tmp_path / "wheels")
    not_a_zip = tmp_path / "lobe.zip"
    not_a_zip.write_bytes(b"")
    with pytest.raises(SetupError):
        validate(not_a_zip)
