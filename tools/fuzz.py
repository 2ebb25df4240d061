"""Fuzz the engine's border: `python tools/fuzz.py 100000`. Cases are in tests/fuzz/odd_scenes.py.

A child process works through the cases and tells, line by line, which one it begins and what came of it. So a crash of
the child, or a case that never ends, is known by its number; it is noted, and a new child goes on with the next. At
the end stands a table; with -o all findings are written to a file. `--only N` runs one case in this process, for a
debugger. Exit code 1: there are findings.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import selectors
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
CASE_SECONDS = 60.0  # the first case of a child compiles
GOOD = ("picture", "refused")
OUTCOMES = (*GOOD, "unnamed", "escaped", "wrong picture", "slow", "crash", "hang")


@dataclass
class Report:
    """What came of the cases: how many by outcome, and all that are not as they should be."""

    counts: Counter = field(default_factory=Counter)
    findings: list[dict] = field(default_factory=list)
    seconds: float = 0.0

    def add(self, verdict: dict) -> None:
        self.counts[verdict["outcome"]] += 1
        if verdict["outcome"] not in GOOD:
            self.findings.append(verdict)

    def take(self, other: Report) -> None:
        self.counts += other.counts
        self.findings += other.findings

    def table(self) -> str:
        total = sum(self.counts.values())
        rows = [
            f"{name:<15}{self.counts[name]:>9}{100 * self.counts[name] / max(total, 1):>8.2f} %" for name in OUTCOMES
        ]
        return "\n".join([*rows, f"{'all':<15}{total:>9}   in {self.seconds:.0f} s"])


def child_command() -> list[str]:
    return [sys.executable, str(Path(__file__).resolve()), "--child"]


def run(
    first: int,
    count: int,
    command: Sequence[str] | None = None,
    case_seconds: float = CASE_SECONDS,
    processes: int = 1,
) -> Report:
    """Cases first .. first + count, by so many children at a time and as many as it takes. `command` is called with
    first and count."""
    report, begun = Report(), time.perf_counter()
    shares = [(first + count * i // processes, first + count * (i + 1) // processes) for i in range(processes)]
    with ThreadPoolExecutor(processes) as pool:
        for part in pool.map(
            lambda share: _share(share[0], share[1], command or child_command(), case_seconds), shares
        ):
            report.take(part)
    report.seconds = time.perf_counter() - begun
    return report


def _share(at: int, end: int, command: Sequence[str], case_seconds: float) -> Report:
    """Cases at .. end, one child after the other."""
    report = Report()
    while at < end:
        at = _one_child(report, [*command, str(at), str(end - at)], at, case_seconds)
    return report


def _one_child(report: Report, command: list[str], first: int, case_seconds: float) -> int:
    """Let a child work as far as it comes. Returns the number of the next case."""
    environment = {**os.environ, "NUMBA_NUM_THREADS": "1"}
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment) as child:
        at, hangs, changed = first, False, ""
        for line in _lines(child, case_seconds):
            message = json.loads(line) if line else None
            if message is None:
                hangs = True
                child.kill()
            elif "outcome" in message:
                report.add(message)
                at, changed = message["number"] + 1, ""
            else:
                changed = message["changed"]
        said = child.stderr.read().decode(errors="replace") if child.stderr else ""
        code = child.wait()
    if code == 0:
        return sys.maxsize if at == first else max(at, first + int(command[-1]))
    how = "hang" if hangs else "crash"
    text = f"{_signal_name(code)}\n{said[-4000:]}"
    report.add({"number": at, "outcome": how, "changed": changed, "text": text})
    return at + 1


def _lines(child: subprocess.Popen, patience: float) -> Iterator[str]:
    """Of its standard output as they come; an empty one if it is silent for so many seconds."""
    assert child.stdout is not None
    descriptor, rest = child.stdout.fileno(), b""
    with selectors.DefaultSelector() as selector:
        selector.register(descriptor, selectors.EVENT_READ)
        while True:
            if not selector.select(patience):
                yield ""
                return
            chunk = os.read(descriptor, 1 << 16)
            if not chunk:
                return
            *whole, rest = (rest + chunk).split(b"\n")
            yield from (line.decode() for line in whole)


def _signal_name(code: int) -> str:
    with contextlib.suppress(ValueError):
        return f"signal {signal.Signals(-code).name}"
    return f"exit code {code}"


def work(first: int, count: int) -> None:
    """The child: one line before each case and one after it."""
    import faulthandler

    faulthandler.enable()
    odd_scenes = _odd_scenes()
    for case in odd_scenes.cases(first, count):
        print(json.dumps({"number": case.number, "changed": "; ".join(case.changed)}), flush=True)
        print(json.dumps(vars(odd_scenes.judge(case))), flush=True)


def _odd_scenes():
    # Not this script's folder: its name would stand for the package of the tests.
    sys.path[:] = [str(ROOT), str(ROOT / "tests"), str(ROOT / "tests" / "fuzz"), *sys.path[1:]]
    import odd_scenes

    return odd_scenes


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", type=int, nargs="?", default=1000)
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--only", type=int, help="run this case alone, here")
    parser.add_argument("-p", "--processes", type=int, default=1, help="so many at a time")
    parser.add_argument("-o", "--output", type=Path, help="JSON file for the findings")
    parser.add_argument("--child", type=int, nargs=2, metavar=("FIRST", "COUNT"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child:
        work(*options.child)
        return 0
    if options.only is not None:
        odd_scenes = _odd_scenes()
        verdict = odd_scenes.judge(odd_scenes.make_case(options.only))
        print(verdict.outcome, verdict.changed, verdict.text, sep="\n")
        return int(verdict.is_finding)
    report = run(options.first, options.cases, processes=options.processes)
    for finding in report.findings[:20]:
        print(
            f"case {finding['number']}: {finding['outcome']}\n  {finding['changed'][:400]}\n  {finding['text'][-600:]}"
        )
    print(report.table())
    if options.output:
        options.output.write_text(json.dumps(report.findings, indent=1))
        print(f"Wrote {options.output}")
    return int(bool(report.findings))


if __name__ == "__main__":
    raise SystemExit(main())
