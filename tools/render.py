"""Render a .blend on the command line, without a Blender program: `python tools/render.py FILE.blend -o OUT.png`.

Standard error carries a progress bar; standard output says which files were written, a line each, and its last line is
one JSON object: {"engine", "samples", "seconds": {"export", "build", "compile", "render", "denoise", "other",
"total"}, "rays", "peak_memory_mb", "skipped", "warnings"}; what Cycles does not tell is null, and "other" is what
Blender does beside the phases. With --check nothing is rendered: standard output lists what Lobe does not draw as
asked, counted, and the exit code is 1 if anything can't be rendered or isn't drawn as asked, and 0 if all is drawn as
asked, or nearly so. What the user can mend is said in one line, with exit code 2. Ctrl-C ends it at once with exit
code 130; pictures are there whole or not at all.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import NoReturn

ROOT = Path(__file__).resolve().parent.parent
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

from tools import blender_render as br  # noqa: E402
from tools.interrupt import at_interrupt, end_on_interrupt  # noqa: E402
from tools.lobe_blender import SetupError, check_folder, enable_lobe, make_folder  # noqa: E402

WRITERS = (".png", ".exr")
NOTHING = "Nothing: Lobe draws all of this scene as asked."


def resolution(text: str) -> tuple[int, int]:
    parts = text.lower().split("x")
    try:
        width, height = (int(part) for part in parts)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not of the form WIDTHxHEIGHT, such as 640x480") from None
    # Blender's own limits: outside of them it would clamp without a word.
    if not (4 <= width <= 65536 and 4 <= height <= 65536):
        raise argparse.ArgumentTypeError(f"{text!r}: Blender renders pictures of 4 to 65536 pixels a side")
    return width, height


def whole_number(low: int, high: int):
    def convert(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"{text!r} is not a whole number") from None
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{value} does not lie between {low} and {high}")
        return value

    return convert


def seconds(least: float):
    """A number of seconds, up to a million."""

    def convert(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"{text!r} is not a number of seconds") from None
        if not least <= value <= 1e6:
            raise argparse.ArgumentTypeError(f"{text} s does not lie between {least:g} s and a million")
        return value

    return convert


def output_path(text: str) -> Path:
    path = Path(text)
    if path.suffix.lower() not in WRITERS:
        raise argparse.ArgumentTypeError(f"{text!r}: the name of a picture ends in {' or '.join(WRITERS)}")
    return path


class Parser(argparse.ArgumentParser):
    """Says what is wrong in one line, without the list of all options."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {message}\n")


def add_scene_arguments(parser: argparse.ArgumentParser) -> None:
    """The file, and what of it is rendered."""
    parser.add_argument("file", type=Path, metavar="FILE.blend")
    parser.add_argument("--samples", type=whole_number(1, 1 << 24), metavar="N", help="per pixel; default: the file's")
    parser.add_argument("--seed", type=whole_number(-(1 << 31), (1 << 31) - 1), metavar="N",
                        help="another seed is another picture of the same noise; default: the file's")  # fmt: skip
    parser.add_argument("--resolution", type=resolution, metavar="WxH", help="the pixels of the picture")
    parser.add_argument("--frame", type=whole_number(-1048574, 1048574), metavar="N",
                        help="of the animation; default: the one that the file was saved at")  # fmt: skip
    parser.add_argument("--threads", type=whole_number(0, 1024), metavar="N", help="0: one for each processor")
    parser.add_argument("--set", action="append", default=[], metavar="scene.lobe.KEY=VALUE", dest="assignments",
                        help="any setting of Lobe, or of Blender as scene.render.KEY or scene.cycles.KEY; "
                        "may be given again")  # fmt: skip
    parser.add_argument("--scene", metavar="NAME", help="a scene of the file other than the active one")


def parse(arguments: list[str] | None = None) -> argparse.Namespace:
    parser = Parser(prog="render.py", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--engine", type=str.upper, choices=br.ENGINES, default="LOBE",
                        help="default: LOBE, whatever engine the file has")  # fmt: skip
    add_scene_arguments(parser)
    parser.add_argument("--as-is", action="store_true",
                        help="with --engine CYCLES: keep the file's Cycles settings and materials, instead of the "
                        "fair settings, Lobe's bounces and filter, and the exact Phong shader")  # fmt: skip
    parser.add_argument("--check", action="store_true",
                        help="render nothing: print what the file holds that Lobe does not draw as asked; exit code 1 "
                        "if there is any, 0 if there is none or all of it is drawn nearly as asked")  # fmt: skip
    parser.add_argument("-o", "--output", action="append", default=[], type=output_path, metavar="OUT.png|OUT.exr",
                        help="may be given again; needed unless --check is. An EXR has the ticked passes too, by the "
                        "names of Blender's multilayer files")  # fmt: skip
    options = parser.parse_args(arguments)
    options.output = list({path.resolve(): path for path in options.output}.values())  # each once
    if options.check and options.engine != "LOBE":
        parser.error("--check says what Lobe does not draw: it goes without --engine CYCLES")
    if options.check and options.output:
        parser.error("--check renders nothing: it goes without -o")
    if not (options.check or options.output):
        parser.error("the following arguments are required: -o/--output")
    if options.as_is and options.engine != "CYCLES":
        parser.error("--as-is keeps Cycles' settings as they are in the file: it needs --engine CYCLES")
    if any(assignment.replace(" ", "").startswith("scene.render.engine=") for assignment in options.assignments):
        parser.error("choose the engine with --engine LOBE or --engine CYCLES, not with --set")
    return options


def prepare(options: argparse.Namespace):
    """Open the file and carry out the options; gives back the scene, which can be rendered unless it is only to be
    checked."""
    scene = br.open_blend(options.file, options.scene)
    if options.frame is not None:
        scene.frame_set(options.frame)
    if options.resolution is not None:
        br.set_resolution(scene, *options.resolution)
    if options.threads is not None:
        br.set_threads(scene, options.threads)
    if options.samples is not None:
        scene.lobe.samples = options.samples
    if options.seed is not None:
        scene.lobe.seed = options.seed
    for assignment in options.assignments:
        br.set_value(scene, assignment)
    br.set_engine(scene, options.engine, options.as_is)
    if options.engine == "CYCLES":
        if options.as_is and options.samples is not None:
            scene.cycles.samples = options.samples
        if options.as_is and options.seed is not None:
            scene.cycles.seed = options.seed
        for assignment in options.assignments:  # once more: what --set names outranks the fair settings
            br.set_value(scene, assignment)
    if not options.check:
        br.check_renderable(scene)
    return scene


def show(bar, done: int, total: int) -> None:
    """So many samples on the bar of tqdm."""
    if not bar.n:  # from here on it samples: what was before says nothing of the time that is left
        bar.unpause()
        bar.initial = done
    bar.total = total
    bar.set_postfix_str("", refresh=False)
    bar.update(max(done - bar.n, 0))


def run(options: argparse.Namespace) -> dict:
    """Render and write the pictures; gives back the report."""
    from tqdm import tqdm

    scene = prepare(options)
    with tqdm(total=1, unit=" samples", desc=options.engine.capitalize(), file=sys.stderr) as bar:
        at_interrupt.append(lambda: os.write(2, b"\n"))  # the bar's line ends where it is

        report = br.render(scene, partial(show, bar), bar.set_postfix_str)
        bar.set_postfix_str("")
        bar.total = max(int(report["samples"]), 1)
        bar.update(bar.total - bar.n)
    pixels = br.picture(scene, report)
    report["seconds"]["other"] = other_seconds(report["seconds"])
    others = br.passes(scene) if any(path.suffix.lower() == ".exr" for path in options.output) else {}
    with whole_files(options.output) as unfinished:
        for path in unfinished:
            if path.suffix.lower() == ".png":
                br.save_png(scene, path)
            else:
                br.save_exr(path, pixels, metadata(options, report), others)
    return report


@contextlib.contextmanager
def whole_files(paths: list[Path]) -> Iterator[list[Path]]:
    """Gives paths to write to, each in the folder of one of `paths`, which is made where there is none; at the end they
    get those names, all together.

    Whatever ends the block before that leaves what was there as it was.
    """
    for path in paths:
        make_folder(path.parent)
    places = [path.resolve() for path in paths]  # a link's target: the link itself stays
    unfinished = [p.with_name(f".{p.stem[:40]}-{os.getpid()}-{i}{p.suffix}") for i, p in enumerate(places)]

    def remove() -> None:
        for path in unfinished:
            with contextlib.suppress(OSError):
                path.unlink(missing_ok=True)

    at_interrupt.append(remove)
    try:
        yield unfinished
        for path, place in zip(unfinished, places, strict=True):
            path.replace(place)
    finally:
        remove()


def other_seconds(seconds: dict[str, float | None]) -> float:
    """What no phase accounts for: Blender evaluates the scene and keeps the picture."""
    told = sum(value or 0.0 for phase, value in seconds.items() if phase != "total")
    return max((seconds["total"] or 0.0) - told, 0.0)


def metadata(options: argparse.Namespace, report: dict) -> dict[str, str | float | int]:
    return {
        "Software": f"Lobe's render.py, engine {report['engine']}",
        "lobe:file": options.file.name,
        "lobe:engine": report["engine"],
        "lobe:samples": float(report["samples"]),
        "lobe:report": json.dumps(report),
    }


def check_file(path: Path) -> None:
    """Before the seconds that Blender takes to start."""
    if not path.is_file():
        what = "is a folder" if path.is_dir() else "does not exist"
        raise br.ToolError(f"{str(path)!r} {what}: expected a .blend file")


def check_output(path: Path) -> None:
    """Before the time that a render takes: see that a file can be written there."""
    try:
        check_folder(path.parent)
    except SetupError as error:
        raise br.ToolError(f"{str(path)!r} cannot be written: {error}") from error
    if path.is_dir():
        raise br.ToolError(f"{str(path)!r} cannot be written: it is a folder")


def main(arguments: list[str] | None = None) -> int:
    options = parse(arguments)
    with br.quiet_stdout() as say:
        try:
            check_file(options.file)
            for path in options.output:
                check_output(path)
            enable_lobe()
            at_interrupt.append(br.remove_temporary_files)
            if options.check:
                checked = br.check(prepare(options))
                head = NOTHING if checked.is_honoured else f"Scene report of {options.file.name}:\n{checked.lines[0]}"
                say("\n".join([head, *checked.lines[1:]]))
                return 0 if checked.is_nearly_honoured else 1
            report = run(options)
        except (br.ToolError, SetupError) as error:
            print(f"render.py: {error}", file=sys.stderr)
            return 2
        for path in options.output:
            say(f"Wrote {path}")
        say(json.dumps(report))
    return 0


if __name__ == "__main__":
    end_on_interrupt("render.py")
    sys.exit(main())
