"""How soon and how often a viewport has pictures: the engine alone, without Blender's drawing.

    python benchmarks/viewport.py

A smooth ball of 100,000 triangles on a floor under an area lamp, 1280 x 720 pixels. The camera moves a little: once in
a while, which gives the time until the first picture, and sixty times a second, which gives how many pictures are new.
Adds its rows to benchmarks/results/viewport.csv and .md, where `make test-gui` writes those of a window. They are this
machine's own times, not ratios.
"""

from __future__ import annotations

import argparse
import statistics
import threading
import time
from dataclasses import replace

import common
import numpy as np

from engine import AreaLight, Camera, Interactive, Material, Mesh, Scene, Settings

SIZE = 1280, 720
RINGS = 224  # of the ball: 2 x 224 x 224 triangles
MOVES = 40
PATIENCE = 120.0  # seconds: the first picture may compile


def ball(rings: int) -> Mesh:
    """A UV sphere of radius 1 about the origin, smooth."""
    theta, phi = np.linspace(1e-3, np.pi - 1e-3, rings + 1), np.arange(rings) * 2 * np.pi / rings
    t, p = np.meshgrid(theta, phi, indexing="ij")
    points = np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], -1).reshape(-1, 3).astype(np.float32)
    i, j = np.meshgrid(np.arange(rings), np.arange(rings), indexing="ij")
    a, b = (i * rings + j).ravel(), (i * rings + (j + 1) % rings).ravel()
    triangles = np.vstack([np.column_stack([a, a + rings, b]), np.column_stack([b, a + rings, b + rings])])
    return Mesh("ball", points, triangles.astype(np.uint32), normals=points)


def scene_of(rings: int) -> Scene:
    """Seen along +y from 5 m away."""
    floor = np.array([[-9, -9, -1], [9, -9, -1], [9, 9, -1], [-9, 9, -1]], np.float32)
    scene = Scene(width=SIZE[0], height=SIZE[1], materials=[Material("grey", kd=(0.7, 0.7, 0.7))])
    scene.camera = Camera(look(0.0), (-0.5, 0.5, -0.28, 0.28))
    scene.add_instance(ball(rings))
    scene.add_instance(Mesh("floor", floor, np.array([[0, 1, 2], [0, 2, 3]], np.uint32)))
    down = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4]], np.float64)
    scene.lights = [AreaLight("lamp", transform=down, radiance=(20.0, 20.0, 20.0))]
    return scene


def look(x: float) -> np.ndarray:
    """(3, 4): the camera's axes and its place."""
    return np.array([[1, 0, 0, x], [0, 0, -1, -5], [0, 1, 0, 0.5]], np.float64)


class Pictures:
    """Counts them."""

    def __init__(self) -> None:
        self.count = 0
        self._news = threading.Condition()
        self.interactive = Interactive(self._changed)
        self._last = None

    def _changed(self) -> None:
        with self._news:
            if self.interactive.picture is not self._last:
                self._last = self.interactive.picture
                self.count += 1
                self._news.notify()

    def wait(self, count: int) -> None:
        with self._news:
            if not self._news.wait_for(lambda: self.count > count or self.interactive.error, PATIENCE):
                raise TimeoutError
        if self.interactive.error is not None:
            raise self.interactive.error


def measure(scene: Scene, settings: Settings, seconds: float) -> dict[str, float]:
    """What is measured, and its value."""
    pictures = Pictures()

    def move(x: float) -> None:
        camera = replace(scene.camera, transform=look(x))
        pictures.interactive.show(replace(scene, camera=camera), settings)

    move(0.0)
    pictures.wait(0)
    time.sleep(2.0)
    delays = []
    for number in range(MOVES):
        seen, begun = pictures.count, time.perf_counter()
        move(1e-3 * (number + 1))
        pictures.wait(seen)
        delays.append(1e3 * (time.perf_counter() - begun))
        time.sleep(0.1)
    seen, begun, moves = pictures.count, time.perf_counter(), 0
    while time.perf_counter() - begun < seconds:
        moves += 1
        move(1e-4 * moves)
        time.sleep(1 / 60)
    rate = (pictures.count - seen) / seconds
    pictures.interactive.close(PATIENCE)
    return {
        "ms from a camera move to its first picture, median": statistics.median(delays),
        "ms from a camera move to its first picture, longest": max(delays),
        "new pictures a second while moving": rate,
    }


def parse(arguments: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Times of the viewport's engine, see the head of this file.")
    parser.add_argument("--seconds", type=float, default=5.0, help="of the moving camera (default: %(default)g)")
    common.add_results(parser)
    return parser.parse_args(arguments)


def main() -> int:
    options = parse()
    scene = scene_of(RINGS)
    triangles = sum(len(mesh.triangles) for mesh in scene.meshes)
    where = {"Blender": "none", "viewport": f"{SIZE[0]} x {SIZE[1]}", "triangles": f"{triangles:,}"}
    found = measure(scene, Settings(samples=64), options.seconds)
    rows = [{**where, "what": what, "value": f"{value:.3g}"} for what, value in found.items()]
    print(common.update_table("viewport", ("Blender", "what"), rows, folder=options.results))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
