"""`tools/bench.py --ceiling`: the rays of a render, recorded and traced again."""

from __future__ import annotations

import csv
import subprocess
import sys
from pathlib import Path


def test_rays_are_recorded_whole_and_replayed(repository: Path, tmp_path: Path) -> None:
    """The tool itself refuses a recording that isn't as long as the render says. `lamps` has rays that note lamps."""
    words = ["cornell_diffuse", "lamps", "--ceiling", "--resolution", "16x16", "--seeds", "2"]
    command = [sys.executable, "tools/bench.py", *words, "--results", str(tmp_path)]
    done = subprocess.run(command, cwd=repository, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    with (tmp_path / "ceiling.csv").open(newline="") as file:
        rows = {row["scene"]: row for row in csv.DictReader(file)}
    assert set(rows) == {"cornell_diffuse", "lamps"}
    for row in rows.values():
        assert float(row["M rays"]) >= 0.01  # of the camera alone 16 * 16 * 16 samples
        assert 10 < int(row["shadow rays"].rstrip("%")) < 60
        assert float(row["rays that end otherwise"]) < 1e-3
        assert 0.1 < float(row["render / replay"].split()[0]) < 100.0
        assert row["wanted: at most"] == "1.25"
