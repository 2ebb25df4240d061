"""Error against time: Lobe beside Cycles on the sample scenes or any other, `python tools/bench.py SCENE... | all`.

Renders both engines in turn at 1, 4, 16, ... samples from several seeds, measures their errors against a reference of
both, and says how many times longer Cycles takes to the same error. `--ceiling` compares Lobe's time with its rays'
alone, `--features` with that of a kernel that skips less, `--osl` Cycles with Open Shading Language and without. Every
finished render is kept in out/bench/: after an interruption the same command goes on where it was. The work is done by
benchmarks/convergence/; tables, plots and the page go to benchmarks/results/, the table for the README to standard
output. Other scenes than the samples, another resolution or number of threads, fewer seeds or a smaller budget are no
part of those tables: what is measured so goes to out/bench/results/. Exit code 0; 1 when the engines' long renders of
a scene differ, 2 for what the user can mend, 130 after Ctrl-C.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

from benchmarks import common  # noqa: E402
from benchmarks.convergence import plan  # noqa: E402
from tools import blender_render as br  # noqa: E402
from tools.lobe_blender import SetupError, check_folder  # noqa: E402
from tools.render import resolution, seconds, whole_number  # noqa: E402


def engine_list(text: str) -> tuple[str, ...]:
    names = {name.strip().upper() for name in text.split(",")}
    if not names or not names <= set(plan.ENGINES):
        raise argparse.ArgumentTypeError(f"{text!r}: choose from {', '.join(plan.ENGINES)}, or both with a comma")
    return tuple(engine for engine in plan.ENGINES if engine in names)


def parse(arguments: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="bench.py", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("scenes", nargs="*", default=["all"], metavar="SCENE",
                        help="sample scenes by name, .blend files, or 'all', the default")  # fmt: skip
    parser.add_argument("--engines", type=engine_list, default=plan.ENGINES, metavar="LOBE,CYCLES",
                        help="whose levels are rendered; the reference is always of both")  # fmt: skip
    parser.add_argument(
        "--budget",
        type=seconds(1.0),
        default=plan.Settings.budget,
        metavar="SECONDS",
        help="of rendering for each scene at most, reference and pilot included; default: "
        f"{plan.Settings.budget:.0f}. Levels of 1, 4, 16, ... samples go on to the largest of these that is at most "
        "the file's own number of samples, or further where the errors that both engines reach would span less than a "
        f"factor of {plan.WANTED_OVERLAP:.0f}, unless the budget ends before",
    )
    parser.add_argument("--resolution", type=resolution, default=(384, 256), metavar="WxH", help="default: 384x256")
    parser.add_argument("--seeds", type=whole_number(2, 1000), default=8, metavar="N", help="renders of each level")
    parser.add_argument("--threads", type=whole_number(1, 1024), default=2, metavar="N")
    parser.add_argument("--fresh", action="store_true", help="forget the renders of these scenes that are kept")
    parser.add_argument(
        "--results",
        type=Path,
        metavar="FOLDER",
        help="for tables, plots and page; default: benchmarks/results for the samples as they are measured there, "
        "out/bench/results for all else",
    )
    parser.add_argument(
        "--store",
        type=Path,
        default=ROOT / "out" / "bench",
        metavar="FOLDER",
        help="for finished renders; default: out/bench",
    )
    parser.add_argument("--ceiling", action="store_const", dest="question", const=ceiling,
                        help="another question: how near is a render's time to that of its rays alone?")  # fmt: skip
    parser.add_argument("--features", action="store_const", dest="question", const=features,
                        help="another question: what does it save to skip what a scene doesn't need?")  # fmt: skip
    parser.add_argument("--osl", action="store_const", dest="question", const=osl,
                        help="another question: what does Open Shading Language cost Cycles by itself?")  # fmt: skip
    parser.set_defaults(question=convergence)
    return parser.parse_args(arguments)


class CtrlC:
    """Ctrl-C lets the render end that is running: inside of it Blender would swallow Python's exception and leave half
    a picture. A second one ends the process where it stands; files in the store are whole or not there."""

    def __init__(self) -> None:
        self.pressed = False
        signal.signal(signal.SIGINT, self.press)

    def press(self, *_: object) -> None:
        if self.pressed:
            os._exit(130)
        self.pressed = True
        print("\nbench.py: stops after this render; Ctrl-C again: at once", file=sys.stderr)

    def check(self) -> None:
        if self.pressed:
            raise KeyboardInterrupt


def scene_paths(names: list[str]) -> list[Path]:
    """Each named scene once, in the order given."""
    expanded = [n for name in names for n in (common.SCENES if name == "all" else (name,))]
    paths = list(dict.fromkeys(common.scene_path(name) for name in expanded))
    for path in paths:
        if not path.is_file():
            raise br.ToolError(f"{str(path)!r} does not exist: expected a .blend file, all, or one of "
                               f"{', '.join(common.SCENES)}")  # fmt: skip
    return paths


def results_folder(options: argparse.Namespace, paths: list[Path]) -> Path:
    """Where tables go: to those that are kept with the code only what they are of."""
    return options.results or (common.RESULTS if is_usual(options, paths) else options.store / "results")


def is_usual(options: argparse.Namespace, paths: list[Path]) -> bool:
    """Whether a run measures what the tables kept with the code are of, and no less thoroughly."""
    usual = plan.Settings(Path())
    samples = {common.scene_path(name) for name in common.SCENES}
    alike = (options.resolution, options.threads) == (usual.resolution, usual.threads) and samples >= set(paths)
    enough = options.seeds >= usual.seeds and (options.budget >= usual.budget or options.question is not convergence)
    return alike and enough


def quotes(options: argparse.Namespace, paths: list[Path]) -> bool:
    """Whether pages quote the run's tables: not those of another, which `--results` sends to the same place."""
    return is_usual(options, paths) and results_folder(options, paths).resolve() == common.RESULTS


def check_folders(options: argparse.Namespace) -> None:
    """Before the time that a run takes: see that its files can be written. Raises SetupError."""
    for folder in {results_folder(options, scene_paths(options.scenes)), options.store}:
        check_folder(folder)


def convergence(options: argparse.Namespace, say) -> int:
    """Measure the scenes one after the other, and write what is known after each."""
    from benchmarks import goals
    from benchmarks.convergence import page, reference, runs, tables

    paths = scene_paths(options.scenes)
    folder = results_folder(options, paths)
    # The page's, of each set of tables apart.
    sections = (options.store if folder == common.RESULTS else folder) / "sections"
    outcomes = []
    for path in paths:
        if options.fresh:
            runs.forget(options.store, path)
    ctrl_c = CtrlC()
    common.enable_lobe()
    codes = runs.fingerprints()  # once, of the code that has just been installed
    for path in paths:
        outcomes.append(measure(path, options, codes, ctrl_c.check))
        rows = tables.write(outcomes, folder)
        page.write(folder / "convergence.html", sections, outcomes, tables.short(rows))
    both = options.engines == plan.ENGINES
    if quotes(options, paths):
        goals.write()
    if both and quotes(options, paths):
        tables.quote(ROOT / "README.md", common.markdown(tables.short([r for r in rows if tables.is_headline(r)])))
    say(common.markdown(tables.short(rows) if both else [row for o in outcomes for row in tables.level_rows(o)]))
    differing = [outcome.settings.scene.stem for outcome in outcomes if outcome.reference.verdict == reference.DIFFER]
    if differing:
        print(f"bench.py: the engines' long renders differ: {', '.join(differing)}", file=sys.stderr)
    return int(bool(differing))


def ceiling(options: argparse.Namespace, say) -> int:
    """Renders beside their rays, replayed; as many pairs as there are seeds."""
    from benchmarks import ceiling, goals

    paths = scene_paths(options.scenes)
    folder = results_folder(options, paths)
    common.enable_lobe()
    say(ceiling.table([str(path) for path in paths], options.resolution, options.threads, options.seeds, folder))
    if quotes(options, paths):
        goals.write()
    return 0


def features(options: argparse.Namespace, say) -> int:
    """Renders with and without each feature; as many pairs as there are seeds."""
    from benchmarks import features

    paths = scene_paths(options.scenes)
    common.enable_lobe()
    folder = results_folder(options, paths)
    say(features.table(paths, options.resolution, options.threads, options.seeds, folder))
    return 0


def osl(options: argparse.Namespace, say) -> int:
    """Cycles with Open Shading Language and without; as many pairs as there are seeds."""
    from benchmarks import osl

    paths = scene_paths(options.scenes)
    common.enable_lobe()
    say(osl.table(paths, options.resolution, options.threads, options.seeds, results_folder(options, paths)))
    return 0


def measure(path: Path, options: argparse.Namespace, codes: dict[str, str], check: Callable[[], None]):
    """One scene, with a bar of the seconds of the budget that are spent. Gives back its Outcome.

    check: called between renders; raises to stop.
    """
    from tqdm import tqdm

    from benchmarks.convergence import campaign, runs

    settings = plan.Settings(path, options.engines, options.budget, options.resolution, options.seeds, options.threads)
    form = "{desc}: {percentage:3.0f}% |{bar}| {n:.0f}/{total:.0f} s{postfix}"
    with (
        contextlib.closing(runs.Processes(settings)) as renderer,
        tqdm(total=options.budget, desc=path.stem, bar_format=form, file=sys.stderr) as bar,
    ):
        store = runs.Store(options.store, settings, renderer, codes)

        def progress(what: str, spent: float) -> None:
            bar.set_postfix_str(what, refresh=False)
            bar.n = min(spent, options.budget)
            bar.refresh()
            check()

        outcome = campaign.Campaign(settings, store, progress).measure()
        bar.set_postfix_str(f"{store.rendered} renders, {store.found} kept from before")
    return outcome


def main(arguments: list[str] | None = None) -> int:
    options = parse(arguments)
    with br.quiet_stdout() as say:
        try:
            check_folders(options)
            code = options.question(options, say)
            folder = results_folder(options, scene_paths(options.scenes))
            print(f"bench.py: the tables are in {folder}", file=sys.stderr)
            return code
        except (br.ToolError, SetupError) as error:
            print(f"bench.py: {error}", file=sys.stderr)
            return 2
        except KeyboardInterrupt:
            print("bench.py: interrupted; the same command goes on from here", file=sys.stderr)
            return 130


if __name__ == "__main__":
    sys.exit(main())
