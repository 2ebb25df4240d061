"""What settings mean on this computer."""

from __future__ import annotations

import os

import pytest

from engine import Settings
from engine.settings import usable_processors


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="this system binds no process to processors")
def test_processors_that_this_process_may_not_use_do_not_count():
    allowed = os.sched_getaffinity(0)
    assert usable_processors() == len(allowed) == Settings().thread_count
    try:
        os.sched_setaffinity(0, {min(allowed)})
        assert usable_processors() == 1 == Settings().thread_count
    finally:
        os.sched_setaffinity(0, allowed)
    assert Settings(threads=5).thread_count == 5
