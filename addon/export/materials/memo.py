"""Results that are worked out once, by functions that ask each other for them along chains of any length."""

from __future__ import annotations

from collections.abc import Callable, Hashable

# Steps that are followed by recursion. A step is up to ten of Python's frames, of which it allows a thousand.
MAX_STEPS = 20


class _PutOff(Exception):
    """Asked for beyond MAX_STEPS: to be worked out first, and by itself."""

    def __init__(self, key: Hashable, compute: Callable[[], object]) -> None:
        self.task = key, compute


class Memo:
    """Nodes share what feeds them, so that asking anew each time would cost 2^k for k Mix Shaders in a row of which
    both sides are the one before. A long chain is worked out from its far end, whoever asks again finds it known.

    in_cycle  what stands for a result that would need itself
    check     called before each result is worked out; it may raise, to cancel
    """

    def __init__(self, in_cycle, check: Callable[[], None]) -> None:
        self._in_cycle = in_cycle
        self._check = check
        self._known: dict = {}
        self._steps = 0

    def get(self, key: Hashable, compute: Callable[[], object]):
        """`compute()`, which may itself get other keys; it can be called more than once, if it asks for much."""
        if key in self._known:
            return self._known[key]
        if self._steps >= MAX_STEPS:
            raise _PutOff(key, compute)
        return self._run(key, compute) if self._steps else self._run_from_far_end(key, compute)

    def _run_from_far_end(self, key: Hashable, compute: Callable[[], object]):
        waiting = [(key, compute)]
        while True:
            try:
                result = self._run(*waiting[-1])
            except _PutOff as deeper:
                self._known[waiting[-1][0]] = self._in_cycle
                waiting.append(deeper.task)
                continue
            except BaseException:
                for unfinished, _ in waiting:
                    self._known.pop(unfinished, None)
                raise
            waiting.pop()
            if not waiting:
                return result

    def _run(self, key: Hashable, compute: Callable[[], object]):
        self._check()
        self._known[key] = self._in_cycle
        self._steps += 1
        try:
            self._known[key] = compute()
        except BaseException:
            del self._known[key]
            raise
        finally:
            self._steps -= 1
        return self._known[key]
