"""Lobe's engine: a path tracer for diffuse and Phong surfaces. It knows nothing of Blender.

    from engine import Camera, Mesh, Scene, Settings, render
    result = render(scene, Settings(samples=64))

Importing it is cheap: Numba and Embree are loaded by the first render.
"""

from __future__ import annotations

from collections.abc import Callable

from .errors import LobeError, SceneError, SettingsError
from .result import Progress, Result
from .scene import (
    DEFAULT_MATERIAL,
    Aperture,
    AreaLight,
    Camera,
    Instances,
    Lamp,
    Material,
    Mesh,
    PointLight,
    Scene,
    SpotLight,
    SunLight,
    Visibility,
    World,
)
from .settings import CHOICES, RANGES, Settings

__all__ = [
    "CHOICES",
    "DEFAULT_MATERIAL",
    "RANGES",
    "Aperture",
    "AreaLight",
    "Camera",
    "Instances",
    "Lamp",
    "LobeError",
    "Material",
    "Mesh",
    "PointLight",
    "Progress",
    "Result",
    "Scene",
    "SceneError",
    "Settings",
    "SettingsError",
    "SpotLight",
    "SunLight",
    "Visibility",
    "World",
    "precompile",
    "render",
]


def render(
    scene: Scene,
    settings: Settings,
    *,
    progress: Callable[[Progress], None] | None = None,
    stop: Callable[[], bool] | None = None,
) -> Result:
    """Render a scene by the road that the settings name.

    progress  called several times a second, on the caller's thread
    stop      asked at least ten times a second; True ends the render and keeps what was done

    Raises SceneError or SettingsError for what cannot be rendered.
    """
    settings.validate()
    scene.validate()
    if settings.road == "REFERENCE":
        from .reference import render_reference

        return render_reference(scene, settings, progress=progress, stop=stop)
    from .schedule import render_compiled

    return render_compiled(scene, settings, progress=progress, stop=stop)


def precompile() -> None:
    """Fill the cache with the kernels that scenes most often need. Takes long, so call it in a process of its own."""
    from .schedule import precompile_common

    precompile_common()
