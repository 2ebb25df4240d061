"""What `make` says where it can't do what it is asked for."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(shutil.which("make") is None, reason="no make")


def test_test_gui_fails_without_a_window(repository: Path) -> None:
    """Where pytest would skip everything and be content. Nothing is installed for it."""
    unset = {"LOBE_BLENDER", "LOBE_BLENDER_WINDOW", "DISPLAY"}
    environment = {key: value for key, value in os.environ.items() if key not in unset}
    done = subprocess.run(
        ["make", "--old-file=.venv/installed", f"RUN={sys.executable}", "test-gui"],
        cwd=repository,
        env=environment,
        capture_output=True,
        text=True,
    )
    assert done.returncode != 0 and "set LOBE_BLENDER_WINDOW" in done.stderr and "pytest" not in done.stdout
