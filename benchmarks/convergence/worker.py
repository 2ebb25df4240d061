"""A process that renders for `runs.Processes`: `python -m benchmarks.convergence.worker`, from the repository's root.

On standard input come pickles: the settings, then jobs. For each job one goes to standard output: its render, or what
the user can mend. It ends with its input, in the middle of a render if need be: then nobody waits for that any more.
"""

from __future__ import annotations

import os
import pickle
import queue
import sys
import threading
from typing import Any

from tools import blender_render as br
from tools.lobe_blender import SetupError, enable_lobe


def main() -> None:
    replies = os.fdopen(os.dup(1), "wb")
    with open(os.devnull, "w") as nowhere:  # Blender talks on standard output
        os.dup2(nowhere.fileno(), 1)
    asked: queue.SimpleQueue[Any] = queue.SimpleQueue()
    threading.Thread(target=read, args=(asked,), daemon=True).start()
    renderer = None
    while True:
        what = asked.get()
        try:
            if renderer is None:
                settings, what = what, asked.get()
                enable_lobe()
                from .runs import BlenderRenderer

                renderer = BlenderRenderer(settings)
            answer: object = renderer(what)
        except (br.ToolError, SetupError) as error:
            answer = error
        pickle.dump(answer, replies)
        replies.flush()


def read(asked: queue.SimpleQueue[Any]) -> None:
    while True:
        try:
            asked.put(pickle.load(sys.stdin.buffer))
        except EOFError:
            os._exit(0)


if __name__ == "__main__":
    main()
