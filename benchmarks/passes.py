"""What passes cost: renders with a box of *View Layer > Passes* ticked beside renders with none.

    python benchmarks/passes.py

Each sample scene is rendered with each box alone, with all of them and with none, in turn, round by round, in one
process. Ratios are of one round, and a column gives their median with the smallest and the largest. "render" is the
phase in which samples are taken, "total" everything from pressing F12 on. Bytes are those that the engine asks for:
its sums, while it renders, and with the pictures made of them and Blender's copies, at the end. Writes passes.csv and
.md to benchmarks/results/, and of each box the scenes with the smallest and the largest ratio into docs/settings.md.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Collection, Hashable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import common
from scale import in_turn, ratio_text, render, seconds

from benchmarks.convergence.tables import quote
from engine.passes import PassFilm, bytes_a_pixel
from tools.render import resolution, whole_number

NONE, ALL = "none", "all of them"
TIME, WHILE, END = "render, with / without", "bytes a pixel while rendering", "bytes a pixel at the end"
PAGE = common.ROOT / "docs" / "settings.md"
MARKS = "<!-- the table of passes.py -->\n", "<!-- its end -->\n"


class Box(NamedTuple):
    """A property of a view layer, or of Lobe's own group there, and the engine's names of the passes that it makes."""

    owner: Any
    key: str
    passes: list[str]


def boxes(layer) -> dict[str, Box]:
    """By what Blender writes beside them."""
    from bl_ext.user_default.lobe.addon.passes import KINDS

    found: dict[str, Box] = {}
    for name, kind in KINDS.items():
        owner = layer if hasattr(layer, kind.box) else layer.lobe
        label = owner.bl_rna.properties[kind.box].name
        found.setdefault(label, Box(owner, kind.box, [])).passes.append(name)
    return found


def tick(layer, wanted: Collection[str]) -> None:
    """These boxes and no others."""
    for label, box in boxes(layer).items():
        setattr(box.owner, box.key, label in wanted)


def bytes_while_rendering(passes: Sequence[str], side: int = 64) -> float:
    """For each pixel, of the sums for these passes."""
    film = PassFilm((side, side), passes)
    return (film.parts.nbytes + film.data.nbytes) / side**2


def measure(name: str, options: argparse.Namespace) -> list[dict]:
    """The rows of a scene."""
    scene = common.prepare(common.scene_path(name), options.resolution, options.threads)
    layer = scene.view_layers[0]
    known = boxes(layer)
    choices = {NONE: [], **{label: [label] for label in known}, ALL: list(known)}

    def with_boxes(wanted: list[str]) -> dict:
        tick(layer, wanted)
        return render(scene, "LOBE", options.resolution, options.samples, options.threads)

    steps: dict[Hashable, Callable[[], dict]] = {label: partial(with_boxes, some) for label, some in choices.items()}
    found = in_turn(steps, options.runs, name)
    return [
        row(name, label, found[label], found[NONE], [p for box in wanted for p in known[box].passes], options)
        for label, wanted in choices.items()
        if wanted
    ]


def row(
    name: str, box: str, ticked: list[dict], none: list[dict], passes: list[str], options: argparse.Namespace
) -> dict:
    return {
        "scene": Path(name).stem,
        "box": box,
        "resolution": "{}x{}".format(*options.resolution),
        "samples": options.samples,
        "threads": options.threads,
        "rounds": options.runs,
        TIME: ratio_text(seconds(ticked, "render"), seconds(none, "render")),
        "total, with / without": ratio_text(seconds(ticked, "total"), seconds(none, "total")),
        WHILE: f"{bytes_while_rendering(passes):.0f}",
        END: f"{bytes_a_pixel(passes)}",
    }


def short(rows: Sequence[Mapping[str, str]]) -> str:
    """What docs/settings.md quotes: of each box the smallest and the largest of the scenes' medians."""
    of_box: dict[str, list[Mapping[str, str]]] = {}
    for one in rows:
        of_box.setdefault(one["box"], []).append(one)
    table = []
    for box, same in of_box.items():
        medians = [float(one[TIME].split()[0]) for one in same]
        spread = f"{min(medians):.2f} to {max(medians):.2f}"
        table.append({"box": box, TIME: spread, WHILE: same[0][WHILE], END: same[0][END]})
    return common.markdown(table) if table else ""


def parse(arguments: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("scenes", nargs="*", default=list(common.SCENES), metavar="SCENE", help="default: the samples")
    parser.add_argument("--runs", type=whole_number(1, 1000), default=5, metavar="N", help="rounds; default: 5")
    parser.add_argument("--threads", type=whole_number(1, 1024), default=2, metavar="N", help="default: 2")
    parser.add_argument("--resolution", type=resolution, default=(256, 256), metavar="WxH", help="default: 256x256")
    parser.add_argument("--samples", type=whole_number(1, 1 << 24), default=32, metavar="N", help="default: 32")
    common.add_results(parser)
    return parser.parse_args(arguments)


def main() -> int:
    return common.run(work, parse())


def work(options: argparse.Namespace, say: Callable[[str], None]) -> None:
    rows: list[dict] = []
    for name in options.scenes:
        rows += measure(name, options)
        table = common.update_table("passes", ("scene",), rows, folder=options.results)
    say(table)
    if options.results == common.RESULTS:
        quote(PAGE, short(common.read_table("passes", common.RESULTS)), MARKS)


if __name__ == "__main__":
    sys.exit(main())
