"""The scene description: everything that a picture depends on, in plain dataclasses over numpy arrays.

Made by `addon/export` (or by hand, see `tests/`), read by `engine/pack` (compiled road) and
`engine/reference` (numpy road). Nothing in here knows Blender, Embree or Numba. `Scene.validate` is the border:
what passes it is safe for the kernels, which check nothing.

Conventions: metres, radians, W/(m2 sr); right-handed world space, z up; colours are linear RGB.
A transform is the upper (3, 4) part of a matrix that maps local to world space (columns x, y, z, origin).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntFlag

import numpy as np

from .errors import SceneError

RGB = tuple[float, float, float]
BLACK: RGB = (0.0, 0.0, 0.0)
IDENTITY = np.eye(3, 4)


class Visibility(IntFlag):
    """Which rays meet an object, a lamp or the world. `SHADOW`: whether it blocks shadow rays."""

    CAMERA = 1
    DIFFUSE = 2
    GLOSSY = 4
    SHADOW = 8
    ALL = 15


@dataclass
class Mesh:
    """Triangles in object space, shared by any number of instances.

    vertices        (V, 3) float32, metres, object space
    triangles       (T, 3) uint32, indices into `vertices`
    normals         (N, 3) float32, unit shading normals, object space; None: every face is flat
    normal_indices  (T, 3) uint32, indices into `normals`; None: the same as `triangles`
    material_slots  (T,) int32, slot of each triangle, see `Instances.material_offset`; None: all slot 0
    uvs             (T, 3, 2) float32, texture coordinates of each triangle's corners, for the pass; None: it has none
    """

    name: str
    vertices: np.ndarray
    triangles: np.ndarray
    normals: np.ndarray | None = None
    normal_indices: np.ndarray | None = None
    material_slots: np.ndarray | None = None
    uvs: np.ndarray | None = None

    def bounds(self) -> np.ndarray:
        """(2, 3) float32, the lowest and the highest coordinates; zeros without vertices."""
        if not len(self.vertices):
            return np.zeros((2, 3), np.float32)
        # Axis by axis: over the short axis of such an array numpy takes twenty times as long.
        axes = self.vertices.T
        return np.array([[axis.min() for axis in axes], [axis.max() for axis in axes]])


@dataclass
class Instances:
    """Every placed mesh, as a structure of arrays: a scene may hold a million of them.

    mesh             (I,) int32, index into `Scene.meshes`
    transforms       (I, 3, 4) float64, object to world
    material_offset  (I,) int32: slot s of instance i has material `material_table[material_offset[i] + s]`
    slot_count       (I,) int32: the number of its slots (at least 1); a triangle's slot is clamped below it
    material_table   (S,) int32, indices into `Scene.materials`
    visibility       (I,) uint8, `Visibility` bits
    object           (I,) int32, index into `object_names`, for messages and passes
    pass_index       (O,) int32, what the pass shows of each object; None: 0
    """

    mesh: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int32))
    transforms: np.ndarray = field(default_factory=lambda: np.zeros((0, 3, 4)))
    material_offset: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int32))
    slot_count: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int32))
    material_table: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int32))
    visibility: np.ndarray = field(default_factory=lambda: np.zeros(0, np.uint8))
    object: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int32))
    object_names: list[str] = field(default_factory=list)
    pass_index: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.mesh)


@dataclass(frozen=True)
class Material:
    """A surface: a diffuse and a Phong lobe, plus light that it emits and light that it lets through straight.

    kd            diffuse reflectance, per channel
    ks            Phong reflectance, per channel; kd + ks <= 1 conserves energy
    exponent      Phong exponent, >= 0; the compiled road takes 1e8 for any above, which no eye tells apart
    emission      radiance, W/(m2 sr), leaving both sides
    transparency  the fraction of a ray's radiance that passes unbent
    holdout       True: where the camera sees it, the picture has a hole, without light and without alpha, as far as it
                  isn't transparent; all other rays see it as it is
    pass_index    what the pass shows
    """

    name: str
    kd: RGB = BLACK
    ks: RGB = BLACK
    exponent: float = 0.0
    emission: RGB = BLACK
    transparency: RGB = BLACK
    holdout: bool = False
    pass_index: int = 0


# What objects without any material get: Blender's default surface.
DEFAULT_MATERIAL = Material("default grey", kd=(0.8, 0.8, 0.8))


@dataclass(frozen=True, eq=False)
class Lamp:
    """What all lamps share. A lamp shines along its local -z and is not an obstacle to any ray.

    cast_shadow  False: its light reaches every surface, whatever stands between
    """

    name: str
    transform: np.ndarray = field(default_factory=lambda: IDENTITY.copy())
    visibility: Visibility = Visibility.ALL
    cast_shadow: bool = True


@dataclass(frozen=True, eq=False)
class PointLight(Lamp):
    """A sphere, or with `soft_falloff` a disk that always faces the shading point, at the transform's origin.

    intensity  W/sr seen from afar; the radiance of the sphere or disk is intensity / (pi radius^2)
    radius     metres, world space; 0 makes it a point, and the compiled road takes less than 1e-15 for 0
    """

    intensity: RGB = BLACK
    radius: float = 0.0
    soft_falloff: bool = False


@dataclass(frozen=True, eq=False)
class SpotLight(PointLight):
    """A point light within a cone about its local -z, in the light's own (possibly scaled) space.

    half_angle  radians, (0, pi/2]
    blend       softness of the rim, [0, 1]: the factor is smoothstep(0, 1, s) with
                s = (cos(angle) - cos(half_angle)) / ((1 - cos(half_angle)) blend)
    """

    half_angle: float = np.pi / 8
    blend: float = 0.15


@dataclass(frozen=True, eq=False)
class AreaLight(Lamp):
    """A rectangle or an ellipse in its local xy plane, emitting on its local -z side only.

    The transform's scale applies to the size.
    radiance  W/(m2 sr) with the full spread of pi
    spread    radians, (0, pi]: with h = spread / 2 and theta the angle off the axis the radiance is
              radiance * max(tan h - tan theta, 0) / (tan h - h)
    """

    radiance: RGB = BLACK
    size_x: float = 1.0
    size_y: float = 1.0
    ellipse: bool = False
    spread: float = np.pi


@dataclass(frozen=True, eq=False)
class SunLight(Lamp):
    """Parallel light along the local -z, or a uniform cone of directions about it.

    irradiance  W/m2 on a plane that faces it
    angle       radians, the full angle of the cone; 0 makes it a direction, and the compiled road takes less than
                1e-15 for 0
    """

    irradiance: RGB = BLACK
    angle: float = 0.0


@dataclass(frozen=True, eq=False)
class World:
    """Light from infinitely far away.

    color     radiance, multiplies the image if there is one
    image     (H, W, 3) float32, equirectangular radiance, row 0 at the bottom (straight down); None: constant.
              Lookups interpolate bilinearly and wrap around in u. A direction d in environment space has
              u = (1 - atan2(d.y, d.x) / pi) / 2 and v = acos(-d.z) / pi, as in Blender
    rotation  (3, 3) float64, orthogonal, takes a world direction into environment space
    """

    color: RGB = BLACK
    image: np.ndarray | None = None
    rotation: np.ndarray = field(default_factory=lambda: np.eye(3))
    visibility: Visibility = Visibility.ALL


@dataclass(frozen=True)
class Aperture:
    """A thin lens.

    radius          metres
    focus_distance  metres from the camera along its axis
    blades          0 or fewer than 3: a disk; else a regular polygon
    rotation        radians, counterclockwise from the camera's local x: there lies the middle of a side
    ratio           of height to width: > 1 squeezes the width (anamorphic bokeh)
    """

    radius: float
    focus_distance: float
    blades: int = 0
    rotation: float = 0.0
    ratio: float = 1.0


@dataclass(frozen=True, eq=False)
class Camera:
    """A camera at the transform's origin, looking along local -z with local y up. The scale is ignored.

    window      (left, right, bottom, top) of the whole picture: perspective, on the plane z = -1;
                orthographic, metres
    clip_start, clip_end  metres along the axis, clip_start not below 0
    """

    transform: np.ndarray = field(default_factory=lambda: IDENTITY.copy())
    window: tuple[float, float, float, float] = (-0.5, 0.5, -0.5, 0.5)
    orthographic: bool = False
    clip_start: float = 0.1
    clip_end: float = 1000.0
    aperture: Aperture | None = None


@dataclass(frozen=True)
class Mist:
    """What the pass shows: 0 up to `start`, metres from the camera, and 1 from `depth` metres farther on.

    falloff  exponent of the way between: 1, 2 or 0.5
    """

    start: float = 0.0
    depth: float = 100.0
    falloff: float = 1.0


@dataclass
class Scene:
    """All of it. Pixels run over the whole picture; `region` (x0, y0, x1, y1), rows from the bottom, is the part
    that is rendered, None for all of it.

    occlusion_distance  metres, as far as the ambient occlusion pass looks
    alpha_threshold     0 to 1: passes of one value show the first surface that covers so much of what lies behind
    """

    camera: Camera | None = None
    width: int = 512
    height: int = 512
    region: tuple[int, int, int, int] | None = None
    meshes: list[Mesh] = field(default_factory=list)
    instances: Instances = field(default_factory=Instances)
    materials: list[Material] = field(default_factory=lambda: [DEFAULT_MATERIAL])
    lights: list[Lamp] = field(default_factory=list)
    world: World = field(default_factory=World)
    exposure: float = 1.0
    transparent_film: bool = False
    mist: Mist = field(default_factory=Mist)
    occlusion_distance: float = 10.0
    alpha_threshold: float = 0.5
    skipped: list[str] = field(default_factory=list)  # left out because nothing needs it
    warnings: list[str] = field(default_factory=list)  # what the picture will not show as asked

    @property
    def render_region(self) -> tuple[int, int, int, int]:
        return self.region or (0, 0, self.width, self.height)

    def add_instance(
        self,
        mesh: Mesh,
        transform=IDENTITY,
        materials=(0,),
        visibility: Visibility = Visibility.ALL,
        name: str | None = None,
    ) -> None:
        """Place `mesh` once. For scenes made by hand: each call copies the arrays, so it is slow for thousands."""
        index = next((i for i, m in enumerate(self.meshes) if m is mesh), len(self.meshes))
        if index == len(self.meshes):
            self.meshes.append(mesh)
        old = self.instances
        self.instances = Instances(
            mesh=np.append(old.mesh, np.int32(index)),
            transforms=np.append(old.transforms, np.asarray(transform, np.float64)[None, :3, :4], axis=0),
            material_offset=np.append(old.material_offset, np.int32(len(old.material_table))),
            slot_count=np.append(old.slot_count, np.int32(len(materials))),
            material_table=np.append(old.material_table, np.asarray(materials, np.int32)),
            visibility=np.append(old.visibility, np.uint8(visibility)),
            object=np.append(old.object, np.int32(len(old.object_names))),
            object_names=[*old.object_names, name or mesh.name],
        )

    def validate(self) -> None:
        """Check all that the kernels take for granted. Raises SceneError with the name of the object at fault."""
        from .validate import validate_scene

        validate_scene(self)


def scene_error(kind: str, name: str, problem: str) -> SceneError:
    """The one form that messages about scene content take."""
    return SceneError(f"{kind} {name!r}: {problem}")
