"""Viewports beside a final render: they rest, and say so, for as long as one traces. And they end before Lobe does."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable, Iterator
from types import SimpleNamespace

import addon_utils
import pytest

from tools.lobe_blender import MODULE

pytest.importorskip("gpu")
PATIENCE = 120.0  # seconds: the first test of a fresh checkout compiles


class Engine:
    """What Blender keeps for a 3D viewport; counts the redraws that it is asked for."""

    def __init__(self) -> None:
        self.viewport = self.ends_viewport = None
        self.redraws = 0

    def tag_redraw(self) -> None:
        self.redraws += 1


def wait_for(condition) -> None:
    deadline = time.perf_counter() + PATIENCE
    while not condition():
        assert time.perf_counter() < deadline
        time.sleep(0.01)


@pytest.fixture
def engine() -> Engine:
    return Engine()


@pytest.fixture
def viewport(engine) -> Iterator:
    viewport = importlib.import_module(f"{MODULE}.addon.viewport").Viewport(engine)
    yield viewport
    viewport.close()


def test_a_viewport_says_that_it_waits_where_it_does(engine, viewport) -> None:
    """Blender draws it again whenever that changes, though there is no new picture."""
    lobe = importlib.import_module(f"{MODULE}.engine")
    settings = lobe.Settings(samples=4, threads=1)

    def scene() -> lobe.Scene:
        return lobe.Scene(width=8, height=8, camera=lobe.Camera(), world=lobe.World(color=(0.5, 0.5, 0.5)))

    def said() -> str:
        return viewport._status(viewport._renderer.picture, None)[1]

    viewport._renderer.show(scene(), settings)
    wait_for(lambda: said() == "Sample 4/4")
    time.sleep(0.1)
    drawn = engine.redraws
    viewport.pause()
    assert said() == "Sample 4/4" and engine.redraws > drawn
    viewport._renderer.show(scene(), settings)
    assert said() == "Waiting for the render"
    drawn, before = engine.redraws, viewport._renderer.picture
    viewport.resume()
    assert engine.redraws > drawn
    wait_for(lambda: viewport._renderer.picture is not before and said() == "Sample 4/4")


class Rests:
    """A viewport that notes what it is told."""

    is_closed = False

    def __init__(self, engine=None) -> None:
        self.told: list[str] = []

    def pause(self) -> None:
        self.told.append("pause")

    def resume(self) -> None:
        self.told.append("resume")

    def close(self) -> None:
        self.told.append("close")

    @property
    def is_paused(self) -> bool:
        return self.told[-1:] == ["pause"]


@pytest.fixture
def module():
    return importlib.import_module(f"{MODULE}.addon.render_engine")


@pytest.fixture
def shown(module) -> Iterator[Rests]:
    viewport = Rests()
    module._viewports.add(viewport)
    yield viewport
    module._viewports.discard(viewport)


def render(module, trace: Callable[[], None], is_preview: bool = False) -> SimpleNamespace:
    """As Blender calls an engine; `trace` in place of the tracing. Gives back the engine."""
    said: list[str] = []
    engine = SimpleNamespace(
        session=SimpleNamespace(render=lambda _report: trace()), frame_report=None, failed=False, said=said,
        is_preview=is_preview, report=lambda _kind, message: said.append(message),
    )  # fmt: skip
    module.LobeRenderEngine.render(engine, None)
    return engine


@pytest.mark.parametrize("is_preview", [True, False])
@pytest.mark.parametrize("fails", [True, False])
def test_viewports_wait_for_a_render_but_not_for_an_icon(module, shown, is_preview: bool, fails: bool) -> None:
    def trace() -> None:
        shown.told.append("render")
        if fails:
            raise ZeroDivisionError("on purpose")

    engine = render(module, trace, is_preview)
    assert shown.told == (["render"] if is_preview else ["pause", "render", "resume"])
    assert engine.failed == bool(engine.said) == fails


def test_a_viewport_that_is_opened_during_a_render_waits_too(module, monkeypatch) -> None:
    monkeypatch.setattr(importlib.import_module(f"{MODULE}.addon.viewport"), "Viewport", Rests)
    opened, early = Engine(), Engine()
    assert not module.LobeRenderEngine._viewport(early).is_paused

    def trace() -> None:
        assert module.LobeRenderEngine._viewport(opened).is_paused and early.viewport.is_paused

    assert render(module, trace).said == []
    assert opened.viewport.told == early.viewport.told == ["pause", "resume"]


def test_viewports_wait_for_the_last_of_two_renders(module, shown) -> None:
    def trace() -> None:
        assert render(module, lambda: None).said == []
        assert shown.is_paused

    assert render(module, trace).said == []
    assert shown.told[-1] == "resume"


def test_viewports_end_before_what_compiles_for_them(shown, monkeypatch) -> None:
    """Else they would begin to compile in Blender's process, which can't be interrupted."""
    precompile = importlib.import_module(f"{MODULE}.addon.precompile")
    unregister = precompile.unregister
    monkeypatch.setattr(precompile, "unregister", lambda: shown.told.append("unregister") or unregister())
    try:
        addon_utils.disable(MODULE)
        assert shown.told == ["close", "unregister"]
    finally:
        addon_utils.enable(MODULE, default_set=True)
