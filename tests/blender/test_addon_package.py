"""The package with wheels, as far as it goes without downloading any."""

from __future__ import annotations

import tomllib
from pathlib import Path

from tools.package import PACKED, PLATFORMS, pins, this_platform, with_wheels


def test_pins_are_exact() -> None:
    assert [pin.partition("==")[0] for pin in pins()] == list(PACKED)
    assert all(pin.count("==") == 1 and pin.partition("==")[2] for pin in pins())


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
