"""Ctrl-C for the command line: one line on standard error, exit code 130, at once.

Python runs a signal's handler on its main thread, between two instructions: inside Blender, in a compilation, or in
Cycles, that may be half a minute from now, and Blender swallows the KeyboardInterrupt. So a thread of its own waits for
the signal and ends the process, without the tidying up that Python and Blender would do: what needs it is named in
`at_interrupt`. Numba writes each file of its cache under another name first, so that one stays sound.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable

EXIT_CODE = 130  # what a shell reports of a program that SIGINT has ended

# Called before the end, in this order, on another thread than the main one: quick things that can't fail.
at_interrupt: list[Callable[[], object]] = []


def end_on_interrupt(name: str) -> None:
    """From now on SIGINT ends this process with the line "`name`: cancelled". For the main thread of a script.

    Where SIGINT is ignored, as in a job that a shell started in the background, it stays so.
    """
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        return
    receiver, sender = os.pipe()
    os.set_blocking(sender, False)
    signal.set_wakeup_fd(sender, warn_on_full_buffer=False)  # written by the signal itself, whatever Python is doing
    signal.signal(signal.SIGINT, lambda *_: None)  # no KeyboardInterrupt
    threading.Thread(target=_wait, args=(receiver, name), name="interrupt", daemon=True).start()


def _wait(receiver: int, name: str) -> None:
    while os.read(receiver, 1) != bytes([signal.SIGINT]):
        pass
    for call in at_interrupt:
        call()
    os.write(2, f"{name}: cancelled\n".encode())
    os._exit(EXIT_CODE)
