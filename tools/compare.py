"""The same scene by Lobe and by Cycles, side by side: `python tools/compare.py FILE.blend -o FOLDER`.

What the button "Compare with Cycles" does, without a Blender program: two renders of each engine, with settings as
equal as they come, at equal samples (Lobe's) or for equal seconds. FOLDER gets comparison.html, one file with a slider
between the pictures, the same pictures as PNG, and comparison.json. Standard output has what it comes to, the figures,
what can't be matched, settings that were changed, and the files that were written; its last line is the JSON. How the
figures are made: addon/compare/figures.py. Exit code 0; 2 for what the user can mend, 130 after Ctrl-C.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import json
import math
import os
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

from tools import blender_render as br  # noqa: E402
from tools.interrupt import at_interrupt, end_on_interrupt  # noqa: E402
from tools.lobe_blender import SetupError, enable_lobe  # noqa: E402
from tools.render import (  # noqa: E402
    Parser,
    add_scene_arguments,
    check_file,
    check_output,
    prepare,
    seconds,
    whole_files,
)

PAGE, DATA = "comparison.html", "comparison.json"
# What a comparison sets anew for each render, and so doesn't list among what it has changed.
OF_EACH_RENDER = {
    "scene.render.engine": "a comparison renders with both engines",
    "scene.cycles.seed": "a comparison gives Cycles seeds of its own, which follow --seed",
}


def parse(arguments: list[str] | None = None) -> argparse.Namespace:
    parser = Parser(prog="compare.py", description=(__doc__ or "").splitlines()[0])
    add_scene_arguments(parser)
    parser.add_argument("--seconds", type=seconds(0.1), default=0.0, metavar="S",
                        help="equal time: each render samples for so long; default: equal samples")  # fmt: skip
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FOLDER", help="is made if there is none")
    options = parser.parse_args(arguments)
    if options.seconds and options.samples is not None:
        parser.error("--seconds and --samples: what is equal is one of the two")
    for assignment in options.assignments:
        if why := OF_EACH_RENDER.get(assignment.partition("=")[0].strip()):
            parser.error(f"--set {assignment!r}: {why}")
    return argparse.Namespace(**vars(options), engine="LOBE", as_is=False, check=False)


def compare(options: argparse.Namespace):
    """Render, with a bar for each render; gives back the Outcome."""
    import bpy
    from bl_ext.user_default.lobe.addon.compare import CompareError, Comparison, Stopped
    from bl_ext.user_default.lobe.addon.compare.operators import render_now
    from tqdm import tqdm

    scene = prepare(options)
    comparison = Comparison(scene, bpy.context.view_layer, options.seconds)
    try:
        with contextlib.closing(comparison.steps()) as steps, tqdm(total=4, unit=" renders", file=sys.stderr) as bar:
            at_interrupt.append(lambda: os.write(2, b"\n"))  # the bar's line ends where it is
            for step in steps:
                bar.set_postfix_str(step.text)
                render_now(step)
                bar.update()
    except (CompareError, Stopped) as error:
        raise br.ToolError(str(error) or "a render was stopped") from error
    return comparison.outcome


def data(outcome) -> dict:
    """For JSON: what isn't known is null, and so is a speed-up that means nothing."""
    from bl_ext.user_default.lobe.addon.compare import headline_of

    values = dataclasses.asdict(outcome)
    values.pop("pictures")
    headline = headline_of(outcome)
    figures = values["figures"] | ({} if headline.speedup else {"speedup": math.nan, "speedup_sampling": math.nan})
    values["figures"] = {key: value if math.isfinite(value) else None for key, value in figures.items()}
    values["samples"] = {engine: samples or None for engine, samples in outcome.samples.items()}
    return {"headline": headline.text} | values


def write(folder: Path, outcome) -> list[Path]:
    """The files' paths, the page's last, where it is seen."""
    from bl_ext.user_default.lobe.addon.compare import html

    contents = {f"{name}.png": content for name, content in outcome.pictures.items()}
    contents[DATA] = (json.dumps(data(outcome), indent=1) + "\n").encode()
    contents[PAGE] = html(outcome).encode()
    paths = [folder / name for name in contents]
    with whole_files(paths) as unfinished:
        for path, content in zip(unfinished, contents.values(), strict=True):
            path.write_bytes(content)
    return paths


def text(outcome) -> str:
    from bl_ext.user_default.lobe.addon.compare import difference_rows, engine_rows, headline_of

    rows = [("", "Lobe", "Cycles"), *engine_rows(outcome)]
    lines = [headline_of(outcome).text]
    lines += [f"{what:<34}{lobe:>14}{cycles:>14}" for what, lobe, cycles in rows]
    lines += [f"{what:<34}{value:>28}" for what, value in difference_rows(outcome)]
    lines += ["Not matched:", *(f"  {line}" for line in outcome.unmatched)] if outcome.unmatched else []
    # Also what --set asks for: nothing of a comparison's own settings can be outranked.
    changed = [f"  {what}: {before} -> {during}" for what, before, during in outcome.changed]
    lines += ["Changed for the comparison:", *changed] if changed else []
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    options = parse(arguments)
    with br.quiet_stdout() as say:
        try:
            check_file(options.file)
            check_output(options.output / PAGE)
            enable_lobe()
            at_interrupt.append(br.remove_temporary_files)
            outcome = compare(options)
            paths = write(options.output, outcome)
        except (br.ToolError, SetupError) as error:
            print(f"compare.py: {error}", file=sys.stderr)
            return 2
        say(text(outcome))
        for path in paths:
            say(f"Wrote {path}")
        say(json.dumps(data(outcome)))
    return 0


if __name__ == "__main__":
    end_on_interrupt("compare.py")
    sys.exit(main())
