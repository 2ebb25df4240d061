"""Rendering jobs inside Blender, in processes of their own, and the store that keeps every finished render.

A render's file lies under everything that it depends on: scene file, resolution, threads, engine, variant, samples,
seed and code. So a run that was interrupted finds what it has done, and a change of the engine is noticed. Times are
those of the machine and the minute in which they were taken: what is timed in turn is kept and forgotten together.
"""

from __future__ import annotations

import hashlib
import inspect
import json
import os
import pickle
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tools import lobe_blender

from .. import common
from ..common import br
from .plan import Job, Settings, Variant

WORKER = sys.executable, "-m", f"{__package__}.worker"


@dataclass(frozen=True)
class Render:
    """picture: (h, w, 3) float32, scene-linear, row 0 at the top. report: as tools/render.py prints it, and more."""

    picture: np.ndarray
    report: dict

    @property
    def total(self) -> float:
        """Seconds, from pressing F12 to the end."""
        return self.report["seconds"]["total"]

    @property
    def sampling(self) -> float:
        """Seconds; of Cycles in hundredths."""
        return self.report["seconds"]["render"] or 0.0

    @property
    def start(self) -> float:
        """Seconds that no phase accounts for: Blender's own preparations, and taking the picture over."""
        named = (value for phase, value in self.report["seconds"].items() if phase != "total")
        return max(self.total - sum(value or 0.0 for value in named), 0.0)


class BlenderRenderer:
    """Renders jobs of one scene file. Opens it at the first, and warms up each engine and variant that it meets."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.scene: Any = None  # Blender's
        self.file_samples = 0
        self.warm: set[tuple[str, Variant | None]] = set()

    def __call__(self, job: Job) -> Render:
        if self.scene is None:
            self.scene = common.prepare(self.settings.scene, self.settings.resolution, self.settings.threads)
            self.file_samples = self.scene.lobe.samples
        if (job.engine, job.variant) not in self.warm:  # compilation, caches, pages
            self._render(job, samples=1, seed=0)
            self.warm.add((job.engine, job.variant))
        return self._render(job, job.samples, job.seed)

    def _render(self, job: Job, samples: int, seed: int) -> Render:
        scene = self.scene
        scene.lobe.samples, scene.lobe.seed, scene.lobe.road = samples, seed, "COMPILED"
        br.set_engine(scene, job.engine)
        if job.variant is not None:  # after the fair settings, which turn guiding off
            scene.cycles.use_light_tree = job.variant.light_tree
            scene.cycles.use_guiding = scene.cycles.use_surface_guiding = job.variant.guiding
            scene.cycles.sampling_pattern = "TABULATED_SOBOL" if job.variant.tabulated else "AUTOMATIC"
            if has_textured_world(scene):
                set_world_map(scene.world, job.variant.world_map)
        report = br.render(scene)
        picture = br.picture(scene, report)[..., :3]
        report["exposure"] = scene.view_settings.exposure
        report["osl"] = job.engine == "CYCLES" and bool(scene.cycles.shading_system)
        report["textured_world"] = has_textured_world(scene)
        report["file_samples"] = self.file_samples
        return Render(picture, report)


def has_textured_world(scene) -> bool:
    """Whether there is a texture node in the world, in groups too: then Cycles samples it by a map."""

    def textured(tree) -> bool:
        return tree is not None and any(
            textured(node.node_tree) if node.type == "GROUP" else re.match("TEX_(?!COORD)", node.type)
            for node in tree.nodes
        )

    return scene.world is not None and textured(scene.world.node_tree)


def set_world_map(world, width: int) -> None:
    """0: as wide as Cycles chooses."""
    world.cycles.sampling_method = "MANUAL" if width else "AUTOMATIC"
    if width:
        world.cycles.sample_map_resolution = width


class Processes:
    """Renders jobs of one scene file in processes of their own: each round of levels in another, one at a time. To be
    closed."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.round: int | None = None  # of the process that is there
        self.process: subprocess.Popen | None = None

    def __call__(self, job: Job) -> Render:
        if self.process is None or (job.round is not None and job.round != self.round):
            self.close()
            self.start(job.round)
        assert self.process is not None and self.process.stdin is not None and self.process.stdout is not None
        try:
            pickle.dump(job, self.process.stdin)
            self.process.stdin.flush()
            answer = pickle.load(self.process.stdout)
        except (EOFError, BrokenPipeError):
            raise br.ToolError("the process that renders has ended; what it said stands above") from None
        if isinstance(answer, Exception):
            raise answer
        return answer

    def start(self, round: int | None) -> None:
        """In a session of its own, so that Ctrl-C in the terminal doesn't reach it."""
        self.round = round
        self.process = subprocess.Popen(
            WORKER, cwd=common.ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True
        )
        assert self.process.stdin is not None
        pickle.dump(replace(self.settings, scene=self.settings.scene.absolute()), self.process.stdin)

    def close(self) -> None:
        if self.process is not None:
            self.process.communicate()  # the end of its input is its own
            self.process = None


class Store:
    """Gives the render of a job: the one on the disk, or else a new one, which it keeps.

    spent: seconds of all renders given, new or kept, so that a run that resumes has the budget of one that didn't stop
    """

    def __init__(
        self, folder: Path, settings: Settings, renderer: Callable[[Job], Render], codes: dict[str, str]
    ) -> None:
        self.renderer = renderer
        self.codes = codes  # see `fingerprints`
        self.folder = scene_folder(folder, settings.scene) / "{}x{}-threads{}".format(
            *settings.resolution, settings.threads
        )
        self.spent = 0.0
        self.rendered = self.found = 0

    def path(self, job: Job) -> Path:
        code = digest("".join(self.codes[engine] for engine in job.beside or (job.engine,)))
        kind = "-".join(filter(None, (job.purpose, job.engine.lower(), job.variant.slug if job.variant else "", code)))
        return self.folder / kind / f"{job.samples:08d}-seed{job.seed}.npz"

    def __call__(self, job: Job) -> Render:
        path = self.path(job)
        if path.is_file():
            render = load(path)
            self.found += 1
        else:
            render = self.renderer(job)
            save(path, render)
            self.rendered += 1
        self.spent += render.total
        return render


def save(path: Path, render: Render) -> None:
    """Under another name first: a file with the right name is whole."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(f".{os.getpid()}.partial")
    with partial.open("wb") as file:
        np.savez_compressed(file, picture=render.picture, report=np.array(json.dumps(render.report)))
    partial.replace(path)


def load(path: Path) -> Render:
    with np.load(path) as data:
        return Render(data["picture"], json.loads(str(data["report"])))


def scene_folder(folder: Path, scene: Path) -> Path:
    """Where the store keeps the renders of a scene file with these very contents."""
    if not scene.is_file():
        raise br.ToolError(
            f"{str(scene)!r} does not exist: expected a .blend file, or one of {', '.join(common.SCENES)}"
        )
    return folder / f"{scene.stem}-{digest(scene.read_bytes())}"


def forget(folder: Path, scene: Path) -> None:
    shutil.rmtree(scene_folder(folder, scene), ignore_errors=True)


# What sets a scene up for a render, besides tools/cycles_peer.py.
TOOLS = common.prepare, common.leave_out, br.set_engine, BlenderRenderer, has_textured_world, set_world_map


def fingerprints() -> dict[str, str]:
    """What an engine's renders depend on besides the job: what the tools set in the scene, for Lobe its code, for
    Cycles what makes it a peer."""
    lobe = b"".join(path.read_bytes() for path in lobe_blender.product_files())
    peer = b"".join(path.read_bytes() for path in br.cycles_peer.SOURCES)
    tools = "\n".join(
        [lobe_blender.blender_version()]
        + [inspect.getsource(what) for what in TOOLS]
        + [repr(common.LOBES_OFF), repr(common.BLENDERS_OFF)]
    ).encode()
    return {"LOBE": digest(tools + lobe), "CYCLES": digest(tools + peer)}


def digest(content: str | bytes) -> str:
    return hashlib.sha256(content.encode() if isinstance(content, str) else content).hexdigest()[:10]
