"""tools/bench.py as a command: what it refuses, and one real run of both engines at 16 x 16 pixels."""

from __future__ import annotations

import csv
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tools import bench

SMALL = ("--resolution", "16x16", "--seeds", "2", "--budget", "2")


def command(repository: Path, folder: Path, *arguments: str) -> subprocess.CompletedProcess:
    words = [sys.executable, "tools/bench.py", *arguments, "--results", str(folder), "--store", str(folder / "store")]
    return subprocess.run(words, cwd=repository, capture_output=True, text=True)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["no.blend"], "bench.py: 'no.blend' does not exist: expected a .blend file, all, or one of cornell_diffuse"),
        (["lamps", "--engines", "LOBE,EEVEE"], "'LOBE,EEVEE': choose from LOBE, CYCLES"),
        (["lamps", "--budget", "soon"], "'soon' is not a number of seconds"),
        (["lamps", "--budget", "nan"], "nan s does not lie between"),
        (["lamps", "--seeds", "1"], "1 does not lie between 2 and 1000"),
    ],
)
def test_what_cannot_be_done_is_said_in_a_line(repository, tmp_path, arguments, message):
    done = command(repository, tmp_path, *arguments)
    assert done.returncode == 2
    assert message in done.stderr
    assert "Traceback" not in done.stderr
    assert done.stdout == ""
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("words", "kept"),
    [
        (["all"], True),
        (["lamps", "--seeds", "9"], True),
        (["lamps", "--resolution", "16x16"], False),
        (["lamps", "--threads", "1"], False),
        (["lamps", "--seeds", "2"], False),
        (["lamps", "--seeds", "2", "--ceiling"], False),
        (["lamps", "--budget", "959"], False),
        (["lamps", "--budget", "1000"], True),
        (["lamps", "--budget", "60", "--ceiling"], True),  # it has none
        (["lamps", "other.blend"], False),
    ],
)
def test_only_the_samples_as_they_are_go_to_the_tables_kept_with_the_code(words, kept):
    options = bench.parse([*words, "--store", "store"])
    names = bench.common.SCENES if words[0] == "all" else [word for word in words[:2] if not word.startswith("-")]
    paths = [bench.common.scene_path(name) for name in names if not name.isdigit()]
    assert bench.results_folder(options, paths) == (bench.common.RESULTS if kept else Path("store", "results"))
    there = bench.parse([*words, "--results", "there"])
    assert bench.results_folder(there, paths) == Path("there")
    assert bench.quotes(options, paths) == kept and not bench.quotes(there, paths)
    to_results = bench.parse([*words, "--results", str(bench.common.RESULTS)])
    assert bench.quotes(to_results, paths) == kept  # the pages' tables are of whole runs, wherever these leave theirs


@pytest.mark.parametrize("option", ["--results", "--store"])
def test_a_place_that_cannot_be_written_is_refused_before_the_work(repository, tmp_path, option):
    (tmp_path / "file").touch()
    place = {"--results": tmp_path / "results", "--store": tmp_path / "store"} | {option: tmp_path / "file" / "there"}
    words = [sys.executable, "tools/bench.py", "lamps", *(str(word) for pair in place.items() for word in pair)]
    done = subprocess.run(words, cwd=repository, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == f"bench.py: {str(tmp_path / 'file')!r} is not a folder\n"
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_a_scene_is_measured_once_by_whichever_way_it_is_named(repository, monkeypatch):
    monkeypatch.chdir(repository / "sample_blends")
    lamps = repository / "sample_blends" / "lamps.blend"
    assert bench.scene_paths(["lamps", "lamps.blend", "../sample_blends/lamps.blend", str(lamps)]) == [lamps]


def test_ctrl_c_waits_for_the_end_of_the_render():
    before = signal.getsignal(signal.SIGINT)
    try:
        ctrl_c = bench.CtrlC()
        ctrl_c.check()
        os.kill(os.getpid(), signal.SIGINT)  # raises nothing here
        with pytest.raises(KeyboardInterrupt):
            ctrl_c.check()
    finally:
        signal.signal(signal.SIGINT, before)


def test_a_run_of_both_engines_and_the_same_again(repository, tmp_path):
    done = command(repository, tmp_path, "cornell_diffuse", *SMALL)
    assert done.returncode in (0, 1), done.stderr  # at so few samples the engines' long renders may differ by chance
    assert done.stdout.startswith("| scene | time to equal error, Cycles / Lobe |")
    with (tmp_path / "convergence.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["engine"] for row in rows} == {"Lobe", "Cycles"}
    for row in rows:
        assert float(row["total, s"]) > 0.0
        assert bool(row["build, s"]) == (row["engine"] == "Lobe")  # Cycles doesn't tell
    most = max(rows, key=lambda row: int(row["samples"]))
    assert float(most["relMSE"]) < float(rows[0]["relMSE"])
    for name in ("convergence.md", "convergence.html", "convergence_cornell_diffuse.png", "equal_error.md"):
        assert (tmp_path / name).stat().st_size
    # Every variant of Cycles makes a picture of its own: its settings have really been set.
    for first, variants in ((1020001, 4), (1020004, 2)):
        pilot = [np.load(path)["picture"].tobytes() for path in tmp_path.glob(f"store/*/*/pilot-*/*-seed{first}.npz")]
        assert (len(pilot), len(set(pilot))) == (variants, variants)
    again = command(repository, tmp_path, "cornell_diffuse", *SMALL)
    assert (again.returncode, again.stdout) == (done.returncode, done.stdout)
    assert " 0 renders, " in again.stderr
