"""Ctrl-C on tools/render.py: one line, exit code 130, and the picture that was there before."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tools import render

if os.name != "posix":
    pytest.skip("signals are sent as POSIX has them", allow_module_level=True)

FOREVER = ("--samples", "10000000", "--resolution", "16x16", "--threads", "1")
STARTED = r"\d/10000000 "  # the progress bar, once the engine has told how many samples it has


def listen_to_interrupts() -> None:
    """A shell starts jobs in the background with SIGINT ignored, and the tests may be part of one."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


def interrupted(repository: Path, until: str, environment: dict[str, str], *words: str | Path):
    """(exit code, standard output, standard error) of a render that gets SIGINT once it has said `until`."""
    command = [sys.executable, "tools/render.py", *map(str, words)]
    process = subprocess.Popen(
        command, cwd=repository, env={**os.environ, **environment}, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        preexec_fn=listen_to_interrupts,
    )  # fmt: skip
    said = b""
    try:
        while not re.search(until, said.decode(errors="replace")):
            piece = os.read(process.stderr.fileno(), 4096)
            assert piece, f"it ended before it said {until!r}: {said.decode()}"
            said += piece
        process.send_signal(signal.SIGINT)
        out, rest = process.communicate(timeout=60)
    finally:
        process.kill()
        process.wait()
    return process.returncode, out.decode(), (said + rest).decode()


@pytest.mark.parametrize(
    ("file", "until", "words"),
    [
        ("cornell_diffuse", STARTED, ()),
        ("cornell_diffuse", STARTED, ("--set", "scene.lobe.road=REFERENCE")),
        ("cornell_diffuse", "Writing constant memory", ("--engine", "CYCLES")),
        ("instances", "Exporting", ()),
        ("instances", "Building", ()),
        ("cornell_diffuse", "Compiling", ()),
    ],
    ids=["render", "reference", "cycles", "export", "build", "compile"],
)
def test_ends_at_once_with_one_line(repository, tmp_path, file, until, words):
    pictures = [tmp_path / "a.png", tmp_path / "a.exr"]
    for picture in pictures:
        picture.write_text("from before")
    outputs = [word for picture in pictures for word in ("-o", picture)]
    environment = {"LOBE_CACHE_DIR": str(tmp_path / "cache")} if until == "Compiling" else {}
    code, out, err = interrupted(
        repository, until, environment, f"sample_blends/{file}.blend", *FOREVER, *words, *outputs
    )
    assert code == 130
    assert out == ""
    lines = err.splitlines()
    assert lines[-1] == "render.py: cancelled"
    assert sum(line.startswith("render.py: ") for line in lines) == 1
    assert "Traceback" not in err and "Error" not in err and "100%" not in err
    left = {path.name: path for path in tmp_path.iterdir() if path.name != "cache"}
    assert set(left) == {"a.png", "a.exr"}
    assert all(path.read_text() == "from before" for path in left.values())


def test_pictures_get_their_names_together(tmp_path):
    paths = [tmp_path / "a.png", tmp_path / "b.exr"]
    with render.whole_files(paths) as unfinished:
        assert [path.suffix for path in unfinished] == [".png", ".exr"]
        for path in unfinished:
            path.write_text("whole")
        assert not any(path.exists() for path in paths)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.png", "b.exr"]


def test_what_fails_leaves_the_pictures_from_before(tmp_path):
    paths = [tmp_path / "a.png", tmp_path / "b.exr"]
    paths[0].write_text("from before")
    with pytest.raises(OSError, match="disk"), render.whole_files(paths) as unfinished:
        unfinished[0].write_text("half of it")
        raise OSError("the disk is full")
    assert [path.name for path in tmp_path.iterdir()] == ["a.png"]
    assert paths[0].read_text() == "from before"


def test_a_link_to_a_picture_stays_one(tmp_path):
    real, link = tmp_path / "real.png", tmp_path / "link.png"
    real.write_text("from before")
    link.symlink_to(real)
    with render.whole_files([link]) as (unfinished,):
        unfinished.write_text("whole")
    assert link.is_symlink() and real.read_text() == "whole"
