"""What the tests of the tools and benchmarks share."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from types import ModuleType

import pytest


@pytest.fixture(scope="session")
def script(repository) -> Callable[[str], ModuleType]:
    """`script(name)` is benchmarks/NAME.py as a module, its folder on the path as when it runs as a script.

    Under a name of its own: a checkout in a folder `scale` is a package of that name to pytest.
    """
    loaded: dict[str, ModuleType] = {}

    def load(name: str) -> ModuleType:
        if name not in loaded:
            spec = importlib.util.spec_from_file_location(
                f"benchmarks_{name}", repository / "benchmarks" / f"{name}.py"
            )
            loaded[name] = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
            with pytest.MonkeyPatch.context() as patch:
                patch.syspath_prepend(str(repository / "benchmarks"))
                spec.loader.exec_module(loaded[name])
        return loaded[name]

    return load
