"""Which goals are reached: `python benchmarks/goals.py` reads the tables in benchmarks/results/ and renders nothing.

Each goal is judged by the worst of the rows that it is about, by their medians; time to equal error by the worse of the
ratios at whole and at trimmed errors. It writes the table of goals, and below
it where the time goes, into benchmarks/README.md; `tools/bench.py` does so too when it has written tables there.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

import numpy as np  # noqa: E402

from benchmarks import common  # noqa: E402
from benchmarks.convergence import plan, tables  # noqa: E402
from tools import metrics  # noqa: E402

MARKS = "<!-- the table of goals.py -->\n", "<!-- its end -->\n"
TIME_MARKS = "<!-- goals.py: where the time goes -->\n", "<!-- its end -->\n"
GROWTH_MARKS = "<!-- goals.py: what grows -->\n", "<!-- its end -->\n"
LARGEST = 3  # parts of the kernel that are named
PAGE = ROOT / "benchmarks" / "README.md"
OLDER, PRESENT = "older than the engine", "the present one"
YES, NO, UNKNOWN = "yes", "no", "not measured"
NEAR_LINE = 0.15  # how far, relative, render times may be from a straight line over the logarithm
LINEAR = 1.1  # a power of the count up to which growth is called linear
TWO = {"threads": "2"}
MANY = "1e6", "1e7"  # triangles, where the fixed costs of a render are small

WORSE = "worse of whole and trimmed errors"

Row = dict[str, str]
Judge = Callable[[Sequence[Row]], tuple[str, str]]  # rows of the table to (verdict, what was measured)


@dataclass(frozen=True)
class Goal:
    text: str
    table: str  # in benchmarks/results/, without its ending
    judge: Judge
    only: Row = field(default_factory=dict)  # what rows have to say in other columns to count

    def row(self, folder: Path) -> Row:
        kept = common.read_table(self.table, folder)
        try:
            rows = [row for row in kept if all(row[column] == value for column, value in self.only.items())]
            verdict, measured = self.judge(rows) if rows else (UNKNOWN, "")
        except KeyError as column:
            verdict, measured = UNKNOWN, f"the table has no column {column}"
        where = f"[{self.table}.md](results/{self.table}.md)" if kept else f"{self.table}.md"
        return {
            "goal": self.text,
            "reached": verdict,
            "engine": measured_engine(self.table, kept, folder),
            "measured": measured,
            "where": where,
        }


def measured_engine(table: str, rows: Sequence[Row], folder: Path) -> str:
    """Whether a table's rows are of the engine as it is now; a note beside the verdict. Empty without any."""
    count = sum(not any(cell.startswith(common.SUMMARY) for cell in row.values()) for row in rows)
    engines = {engine for _, engine in common.makers(table, count, folder)}
    if engines - {common.engine_digest(), common.UNRECORDED}:
        return OLDER
    return common.UNRECORDED if common.UNRECORDED in engines else PRESENT if engines else ""


def first_number(text: str) -> float | None:
    """Of "1.23 (1.20 to 1.25)" the median; None where the cell is empty."""
    return float(text.split()[0].replace("%", "")) if text else None


def worst(column: str, names: str, limit: float, at_least: bool, wanted: Sequence[str] = ()) -> Judge:
    """By the row with the worst figure in a column. names: the column that tells rows apart; wanted: rows that have to
    be there, and the only ones that count."""

    def judge(rows: Sequence[Row]) -> tuple[str, str]:
        figures = {row[names]: first_number(row[column]) for row in rows if not wanted or row[names] in wanted}
        missing = [name for name in wanted or figures if figures.get(name) is None]
        found = {name: value for name, value in figures.items() if value is not None}
        if not found:
            return UNKNOWN, ""
        name = (min if at_least else max)(found, key=lambda name: found[name])
        reached = [value >= limit if at_least else value <= limit for value in found.values()]
        text = f"{found[name]:.2f} ({name}); {sum(reached)} of {len(found)} reach it"
        if missing:
            text += f"; not measured: {', '.join(missing)}"
        return NO if not all(reached) else UNKNOWN if missing else YES, text

    return judge


def mean_ratio(rows: Sequence[Row]) -> tuple[str, str]:
    """The geometric means of all the samples, and of those that Cycles renders without Open Shading Language, which
    slows it: reached by both, of whole and of trimmed errors, each sample over errors that span enough."""
    means = [with_worse(row) for row in rows if row["scene"].startswith(common.SUMMARY)]
    if not means:
        return UNKNOWN, ""
    enough = len(with_enough_levels(rows)) == len(common.SCENES)
    of_all = f"{common.SUMMARY} of {len(common.SCENES)}"
    complete = enough and len(means) == 2 and of_all in (row["scene"] for row in means)
    reached = all(float(row[WORSE]) >= 5.0 for row in means)
    texts = [f"{row[WORSE]} ({row[WORSE + tables.INTERVAL]}), {row['scene']}" for row in means]
    text = "; ".join(texts) + ("" if enough else "; some of too few levels")
    return UNKNOWN if not complete else YES if reached else NO, text


def headline(judge: Judge) -> Judge:
    """Of the rows of `equal_error` those of the samples as `make bench` renders them."""
    return lambda rows: judge([with_worse(row) for row in with_enough_levels(rows)])


def with_worse(row: Row) -> Row:
    """With the smaller of the ratios at whole and at trimmed errors, and its interval. Cycles' errors have more in
    bright pixels on some scenes, Lobe's on others; who is judged may not choose."""
    column = min((tables.RATIO, tables.TRIMMED_RATIO), key=lambda name: float(row[name]))
    return row | {WORSE: row[column], WORSE + tables.INTERVAL: row[column + tables.INTERVAL]}


def with_enough_levels(rows: Sequence[Row]) -> list[Row]:
    return [
        row
        for row in rows
        if row["scene"] in common.SCENES
        and tables.is_headline(row)
        and row[tables.RATIO]
        and row[tables.TRIMMED_RATIO]
        and float(row["relMSE, to"]) >= plan.LEAST_OVERLAP * float(row["relMSE, from"])
    ]


def logarithmic(rows: Sequence[Row]) -> tuple[str, str]:
    """Whether render times lie near a straight line over the logarithm of the count."""
    counts = np.array([float(row["triangles"]) for row in rows])
    times = np.array([first_number(row["render / that of 1e3"]) for row in rows], float)
    if len(rows) < 3:
        return UNKNOWN, ""
    apart = metrics.logarithm(counts, times)[2]
    text = f"from {counts.min():.0e} to {counts.max():.0e} {times[counts.argmax()]:.2f} times; "
    return YES if apart <= NEAR_LINE else NO, text.replace("e+0", "e") + f"up to {apart:.0%} from a straight line"


def viewport(figures: str, limit: float, at_least: bool) -> Judge:
    """Of the rows of the viewport whose figures begin so, medians aside: reached is what holds in a window too."""
    worst_of = worst("value", "what", limit, at_least)

    def judge(rows: Sequence[Row]) -> tuple[str, str]:
        rows = [row for row in rows if row["what"].startswith(figures) and not row["what"].endswith("median")]
        in_window = {row["Blender"] for row in rows} - {"none"}
        rows = [row if row["Blender"] == "none" else row | {"what": f"Blender {row['Blender']}, {row['what']}"}
                for row in rows]  # fmt: skip
        verdict, measured = worst_of(rows)
        if not rows or in_window:
            return verdict, measured
        return NO if verdict == NO else UNKNOWN, f"{measured}; not measured: in a window"

    return judge


GOALS = (
    Goal("time to equal relMSE, geometric mean of the samples: Cycles at least 5 times Lobe's, with Open Shading "
         "Language and without, at whole errors and at trimmed", "equal_error", mean_ratio),
    Goal("the same, no sample below 3 times", "equal_error",
         headline(worst(WORSE, "scene", 3.0, True, common.SCENES))),
    Goal("sampling at most 1.25 times its rays alone", "ceiling",
         worst("render / replay", "scene", 1.25, False, common.SCENES), {"resolution": "384x256", "threads": "2"}),
    Goal("classic pictures as good as 16,384 plain samples in at most 10 s", "classic",
         worst("Lobe's seconds to it", "scene", 10.0, False, ("cornell_diffuse", "plates_phong")),
         {"resolution": "768x512", "plain samples": "16384", "threads": "2"}),
    Goal(f"render time grows with the logarithm of the triangles: within {NEAR_LINE:.0%} of a line", "scale_triangles",
         logarithmic, TWO),
    Goal(f"export and build grow linearly: with a power of at most {LINEAR} of the triangles", "scale_triangles",
         worst("Lobe grows with the power", "triangles", LINEAR, False, MANY), TWO),
    Goal("export and build take at most Cycles' time", "scale_triangles",
         worst("Lobe / Cycles", "triangles", 1.0, False, ("1e3", "1e4", "1e5", *MANY)), TWO),
    Goal("memory at most Cycles'", "scale_memory",
         worst("Lobe / Cycles", "number", 1.0, False, ("1e3", "1e4", "1e5", *MANY, "5e5")), TWO),
    Goal("500,000 instances exported in less than 2 s", "scale_instances",
         worst("Lobe: export, s", "instances", 2.0, False, ("5e5",)), TWO),
    Goal("100,000 emitters: at most 1.5 times the time of 100", "scale_emitters",
         worst("render / that of 1e2", "emitters", 1.5, False, ("lamps", "emissive triangles")),
         TWO | {"number": "1e5"}),
    Goal("2 threads at least 1.9 times as fast as one", "scale_threads",
         worst("render, one thread / two", "scene", 1.9, True, common.SCENES)),
    Goal("viewport of 100,000 triangles: each change is seen within 100 ms", "viewport",
         viewport("ms from", 100.0, False)),
    Goal("viewport of 100,000 triangles: at least 10 new pictures a second while it moves", "viewport",
         viewport("new pictures a second", 10.0, True)),
)  # fmt: skip


def table(folder: Path = common.RESULTS) -> str:
    return common.markdown([goal.row(folder) for goal in GOALS])


def where_time_goes(folder: Path = common.RESULTS) -> str:
    """Of the table of `hotspots.py`: Embree's share, and the largest of the kernel's parts."""
    rows = []
    for row in common.read_table("hotspots", folder):
        parts = shares(row)
        embree = parts.pop("Embree")
        rows.append({"scene": row["scene"], "Embree": f"{embree:.0%}", "then": largest(parts)})
    return common.markdown(rows) if rows else ""


def what_grows(folder: Path = common.RESULTS) -> str:
    """Of the table of `hotspots.py --scale`: how much longer a render of many takes than one of few, and which parts
    have the largest shares of what it takes longer."""
    kept = common.read_table("hotspots_scale", folder)
    rows = []
    for scene in sorted({row["scene"] for row in kept}):
        few, *more = sorted((row for row in kept if row["scene"] == scene), key=lambda row: float(row["number"]))
        many = more[-1] if more else few
        before, after = float(few["s a render"]), float(many["s a render"])
        if after <= before:
            continue
        with_few, with_many = shares(few), shares(many)
        longer = {part: (with_many[part] * after - with_few[part] * before) / (after - before) for part in with_many}
        rows.append({
            "scene": f"{scene}, {few['number']} to {many['number']}",
            "a render takes": f"{after / before:.2f} times as long",
            "of what it takes longer": largest(longer),
        })  # fmt: skip
    if not kept:
        return "Not measured yet.\n"
    if not rows:
        return "Nothing.\n"
    return f"{common.markdown(rows)}\nAll parts: [hotspots_scale.md](results/hotspots_scale.md).\n"


def shares(row: Row) -> dict[str, float]:
    """Of a row of `hotspots.py`: each part's share of the time."""
    return {part: float(share.rstrip("%")) / 100 for part, share in row.items() if share.endswith("%")}


def largest(parts: dict[str, float]) -> str:
    """As text, of shares of the whole."""
    first = sorted(parts.items(), key=lambda part: -part[1])[:LARGEST]
    return ", ".join(f"{part} {share:.0%}" for part, share in first)


def write(page: Path = PAGE, folder: Path = common.RESULTS) -> None:
    tables.quote(page, table(folder), MARKS)
    tables.quote(page, where_time_goes(folder), TIME_MARKS)
    tables.quote(page, what_grows(folder), GROWTH_MARKS)


if __name__ == "__main__":
    write()
    print(table(), end="")
