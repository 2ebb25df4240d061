"""The border between Blender's side and the engine: who may import whom."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import engine

REPOSITORY = Path(__file__).resolve().parent.parent
BLENDER = {"bpy", "mathutils", "bmesh", "bpy_extras", "bl_ui", "gpu", "blf", "addon_utils", "bl_ext"}
ENGINE_FILES = sorted((REPOSITORY / "engine").rglob("*.py"))
ADDON_FILES = sorted((REPOSITORY / "addon").rglob("*.py"))


def imports(source: str, package: str) -> Iterator[tuple[str, str | None]]:
    """(module, name) of every import, wherever it stands; relative ones resolved against `package`."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from ((alias.name, None) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            parts = package.split(".")
            base = ".".join(parts[: len(parts) - node.level + 1]) if node.level else ""
            module = ".".join(filter(None, (base, node.module)))
            yield from ((module, alias.name) for alias in node.names)


def file_imports(path: Path) -> list[tuple[str, str | None]]:
    package = ".".join(("lobe", *path.parent.relative_to(REPOSITORY).parts))
    return list(imports(path.read_text(encoding="utf-8"), package))


def identify(path: Path) -> str:
    return path.relative_to(REPOSITORY).as_posix()


def engine_faults(found: list[tuple[str, str | None]]) -> list[str]:
    """What of these imports a file of the engine may not have."""
    return [
        module
        for module, name in found
        if module.split(".")[0] in BLENDER
        or module.startswith("lobe.addon")
        or (module == "lobe" and name == "addon")
        or module.split(".")[0] in ("engine", "addon")  # absolute: does not work inside Blender
    ]


def addon_faults(found: list[tuple[str, str | None]]) -> list[str]:
    """What of these imports a file of the add-on may not have."""
    faults = []
    for module, name in found:
        inside = module == "lobe.engine" or module.startswith("lobe.engine.")
        if inside and (module != "lobe.engine" or name not in engine.__all__):
            faults.append(f"{module}.{name}")
        if module.split(".")[0] in ("engine", "addon", "numba", "llvmlite", "embreex"):
            faults.append(module)
    return faults


@pytest.mark.parametrize("path", ENGINE_FILES, ids=identify)
def test_engine_never_imports_blender(path: Path) -> None:
    assert engine_faults(file_imports(path)) == []


@pytest.mark.parametrize("path", ADDON_FILES, ids=identify)
def test_addon_imports_only_what_the_engine_exports(path: Path) -> None:
    assert addon_faults(file_imports(path)) == []


def test_addon_uses_only_exported_names_of_the_engine_module() -> None:
    """`from .. import engine as lobe` is allowed: then each `lobe.x` must be exported."""
    for path in ADDON_FILES:
        tree = ast.parse(path.read_text(encoding="utf-8"))
        aliases = {
            alias.asname or alias.name
            for node in ast.walk(tree)
            if isinstance(node, ast.ImportFrom) and node.level and not node.module
            for alias in node.names
            if alias.name == "engine"
        }
        used = {
            node.attr
            for node in ast.walk(tree)
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in aliases
        }
        assert used <= set(engine.__all__), path


@pytest.mark.parametrize(
    ("source", "faulty"),
    [
        ("import bpy", True),
        ("def f():\n    from mathutils import Vector", True),
        ("from ..addon import session", True),
        ("from engine import Scene", True),
        ("from .scene import Scene", False),
        ("import numpy", False),
    ],
)
def test_the_engine_check_can_fail(source: str, faulty: bool) -> None:
    assert bool(engine_faults(list(imports(source, "lobe.engine")))) == faulty


@pytest.mark.parametrize(
    ("source", "faulty"),
    [
        ("from ..engine.kernels import jit", True),
        ("from ..engine.kernels.jit import kernel", True),
        ("from ..engine import kernels", True),
        ("import numba", True),
        ("from ..engine import Scene, render", False),
        ("from .export import export_scene", False),
    ],
)
def test_the_addon_check_can_fail(source: str, faulty: bool) -> None:
    assert bool(addon_faults(list(imports(source, "lobe.addon")))) == faulty
