"""Where the time until the first sample goes: `python benchmarks/first_sample.py`.

Each scene is rendered again and again at 4 x 4 pixels and one sample, while a thread looks a thousand times a second
which function of Lobe Blender's thread is in, or, where that only waits, one of the render's threads. A look counts for
the time since the one before: while a function of Blender or of a library keeps Python's lock nobody can look. Shares
are of the whole render; "Blender" is what belongs to no function of Lobe. Writes first_sample.csv and .md into
benchmarks/results/.
"""

from __future__ import annotations

import argparse
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial
from types import FrameType

import common
import scale_scenes
from common import br
from tqdm import tqdm

from tools.render import seconds, whole_number

INTERVAL = 0.001  # seconds from one look to the next
SIZE = 4, 4
SCALES = {"triangles": (10**3, 10**4, 10**6), "instances": (500_000,), "lamps": (10**5,)}
# Parts by the start of a file's path in Lobe's folder, the first that fits.
PARTS = {
    "Blender's data to arrays": ("addon/export",),
    "checks": ("engine/validate", "engine/fieldtypes"),
    "light tree": ("engine/lighttree", "engine/pack/emitters"),
    "Embree's structure": ("engine/accel",),
    "tables for the kernel": ("engine/pack", "engine/kernels/light", "engine/memory"),
    "kernel and its threads": ("engine/",),
    "picture and report": ("addon/",),
}
BLENDER = "Blender"
WAITING = "wait_for"  # the function of engine/ in which Blender's thread waits for the others


def lobe_frames(frame: FrameType | None) -> Iterator[tuple[str, str]]:
    """(file in Lobe's folder, function), from the innermost out."""
    while frame is not None:
        _, found, file = frame.f_code.co_filename.partition("/lobe/")
        if found:
            yield file, frame.f_code.co_name
        frame = frame.f_back


def part_of(file: str) -> str:
    return next((part for part, starts in PARTS.items() if file.startswith(starts)), BLENDER)


def working(frames: dict[int, FrameType], main: int) -> str:
    """The part that the process is in."""
    for file, function in lobe_frames(frames[main]):
        if function != WAITING:
            return part_of(file)
        others = [next(lobe_frames(frame), None) for thread, frame in frames.items() if thread != main]
        return next((part_of(other[0]) for other in others if other is not None), part_of(file))
    return BLENDER


class Profile:
    """Seconds of each part, between `with` and its end."""

    def __init__(self) -> None:
        self.spent: Counter[str] = Counter()
        self._main, self._over = threading.get_ident(), threading.Event()
        self._thread = threading.Thread(target=self._look)

    def __enter__(self) -> Profile:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def _look(self) -> None:
        own, before = threading.get_ident(), time.perf_counter()
        while not self._over.wait(INTERVAL):
            frames = sys._current_frames()
            frames.pop(own)
            now = time.perf_counter()
            self.spent[working(frames, self._main)] += now - before
            before = now


def profile(render: Callable[[], dict], duration: float) -> dict[str, str]:
    """Columns of a row: seconds of a render, shares of the parts."""
    render()  # loads the kernel
    renders, begun = 0, time.perf_counter()
    with Profile() as found:
        while time.perf_counter() - begun < duration:
            render()
            renders += 1
        took = (time.perf_counter() - begun) / renders
    total = found.spent.total()
    shares = {part: f"{found.spent[part] / total:.0%}" for part in (*PARTS, BLENDER)}
    return {"s a render": f"{took:.4f}", "renders": str(renders), **shares}


def one(scene, threads: int) -> dict:
    br.set_resolution(scene, *SIZE)
    br.set_threads(scene, threads)
    scene.lobe.samples = 1
    br.set_engine(scene, "LOBE")
    return br.render(scene)


def parse(arguments: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seconds", type=seconds, default=10.0, metavar="S", help="for each scene; default: 10")
    parser.add_argument("--threads", type=whole_number(1, 1024), default=2, metavar="N")
    parser.add_argument("--largest", type=whole_number(100, 10**9), default=10**9, metavar="N",
                        help="no scene with a larger number of triangles, instances or lamps")  # fmt: skip
    common.add_results(parser)
    return parser.parse_args(arguments)


def main() -> int:
    return common.run(work, parse())


def work(options: argparse.Namespace, say: Callable[[str], None]) -> None:
    counted = [(kind, count) for kind, counts in SCALES.items() for count in counts if count <= options.largest]
    rows = []
    with tqdm(total=len(common.SCENES) + len(counted), file=sys.stderr) as bar:
        for name in common.SCENES:
            scene = common.prepare(common.scene_path(name), SIZE, options.threads)
            rows.append({"scene": name, "number": "", **profile(partial(one, scene, options.threads), options.seconds)})
            bar.update()
        for kind, count in counted:
            scale_scenes.empty_file()
            scene = scale_scenes.MAKERS[kind](count)
            number = f"{count:.0e}".replace("e+0", "e")
            rows.append(
                {"scene": kind, "number": number, **profile(partial(one, scene, options.threads), options.seconds)}
            )
            bar.update()
    say(common.update_table("first_sample", ("scene", "number"), rows, folder=options.results))


if __name__ == "__main__":
    sys.exit(main())
