"""The path tracer: from rays of the camera to their radiance.

A path starts at the camera. Where it meets a surface, it takes up what the surface emits, asks one emitter for its
direct light (light sampling), and goes on in a direction drawn from the surface's lobes (BSDF sampling). Where that
ray meets an emitter, the light is counted too: both ways of finding the same light share it by the power heuristic
(Veach 1997). The rules that both roads follow:

Bounces.  Every path counts its scatterings. After b scatterings it samples lights and scatters again while
    b <= max_bounces, and the number of its diffuse ones <= diffuse_bounces, and that of its glossy ones
    <= glossy_bounces. The first ray beyond a limit is still traced: it takes up the emission of lamps, world and
    surfaces, and ends there. So max_bounces = 0 is direct light, found in both ways, and a closed scene of
    reflectance kd that emits Le shows Le * sum(kd^i, i = 0 .. max_bounces + 1). This is Cycles' rule (its integrator
    adds 1 to each of the three limits), confirmed with renders.
Kinds of rays.  A ray is a camera, a diffuse or a glossy one. After a direction was drawn from the combined density,
    the kind is drawn in proportion to the two lobes' shares of f: the picture then does not depend on how directions
    were drawn. An object is met by the kinds of ray that its visibility names. A lamp or an emitting surface that is
    hidden from diffuse (glossy) rays gives no light to the diffuse (Phong) lobe.
Lamps.  They are seen but are no obstacles. A lamp that casts no shadow is found by light sampling alone: two ways that
    do not see the same things cannot share.
Shadow rays.  Direct light is what they let through. Where objects differ in what shadow rays and other rays see of
    them, a path's own rays therefore count no light that light sampling finds. In their place a second ray goes the
    same way, sees what shadow rays see and takes part in direct light only; an emissive surface that is hidden from
    it is found by light sampling alone. A world of one colour is then found by the path's own rays alone, and so
    shadow rays take nothing from it, as in Cycles, confirmed with renders.
Transparency.  A path goes straight on with a certain probability, and this is no bounce; shadow rays are dimmed.
Clamping.  A contribution counts as direct if it is found after at most one scattering, as in Cycles.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np

from ..scene import Scene, Visibility
from ..settings import Settings
from . import bsdf
from .geometry import Geometry, Surface
from .lights import ConstantWorld, Drawn, Emitter, MeshLight, make_lamp, make_world
from .vectors import dot

CAMERA, DIFFUSE, GLOSSY, SHADOW = (int(v) for v in Visibility.ALL)

# A surface hides a light from which it is farther than this part of the way: so a lamp in the plane of a surface lies
# before it, though hits are only known to some roundings of float32.
GAP = 1e-4


@dataclass
class Paths:
    """n rays on their way.

    sample          (n,) which sample of the batch this is
    origin          (n, 3) where the ray was scattered (or left the camera), `normal` (n, 3) the surface there
    start           (n, 3) where it begins: off the surface, or behind transparent ones that it has passed
    direction       (n, 3)
    limit           (n,) how far from `start` it may go: the camera's clipping
    kind            (n,) `Visibility` bit
    beta            (n, 3) what arrives at the camera of a unit of radiance that the ray finds
    pdf             (n,) density with which the direction was drawn; infinite for camera rays
    bounces, diffuse, glossy  (n,) scatterings so far
    as_shadow       they see what shadow rays see, and find only what light sampling finds too
    """

    sample: np.ndarray
    origin: np.ndarray
    normal: np.ndarray
    start: np.ndarray
    direction: np.ndarray
    limit: np.ndarray
    kind: np.ndarray
    beta: np.ndarray
    pdf: np.ndarray
    bounces: np.ndarray
    diffuse: np.ndarray
    glossy: np.ndarray
    as_shadow: np.ndarray

    def __len__(self) -> int:
        return len(self.sample)

    def __getitem__(self, chosen: np.ndarray) -> Paths:
        return Paths(**{f.name: getattr(self, f.name)[chosen] for f in fields(self)})


def join(parts: list[Paths]) -> Paths:
    return Paths(**{f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Paths)})


class Integrator:
    """`rays` and `rejected` (contributions that are not finite) count over all batches."""

    def __init__(self, scene: Scene, settings: Settings) -> None:
        self.settings = settings
        self.transparent_film = scene.transparent_film
        self.geometry = Geometry(scene)
        self.rejected = 0
        columns = {key: [getattr(m, key) for m in scene.materials] for key in ("kd", "ks", "emission", "transparency")}
        self.kd, self.ks, self.emission, self.transparency = (
            np.array(column, np.float64).reshape(-1, 3) for column in columns.values()
        )
        self.holdout = np.array([m.holdout for m in scene.materials], bool)
        self.exponent = np.array([m.exponent for m in scene.materials], np.float64)

        self.mesh_light = MeshLight(self.geometry, self.emission)
        radius = self.geometry.radius
        self.lamps: list[Emitter] = [make_lamp(lamp, radius) for lamp in scene.lights]
        self.lamps.append(make_world(scene.world, radius))
        self.world = self.lamps[-1]

        scattered = DIFFUSE | GLOSSY
        blocking = self.geometry.visibility & (scattered | int(Visibility.SHADOW))
        self.share_light = bool(np.all((blocking == 0) | (blocking == (scattered | int(Visibility.SHADOW)))))

        # Light sampling: half by power, half evenly, so that a near weak lamp is not forgotten.
        self.emitters = [e for e in [*self.lamps, self.mesh_light] if e.power > 0 and e.visibility & scattered]
        if not self.share_light:
            self.emitters = [e for e in self.emitters if not isinstance(e, ConstantWorld)]
        power = np.array([e.power for e in self.emitters])
        self.chance = 0.5 * power / max(power.sum(), 1e-300) + 0.5 / max(len(power), 1)
        self._chance_of = dict(zip(map(id, self.emitters), self.chance, strict=True))

    def radiance(
        self,
        origin: np.ndarray,
        direction: np.ndarray,
        near: np.ndarray,
        far: np.ndarray,
        rng: np.random.Generator,
        stop: Callable[[], bool] = lambda: False,
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Radiance (n, 3) and alpha (n,) of camera rays that count between the distances `near` and `far`.

        None if `stop`, asked at each bounce, said so.
        """
        n = len(origin)
        self.light, self.alpha = np.zeros((n, 3)), np.ones(n)
        zero = np.zeros(n, int)
        paths = Paths(
            sample=np.arange(n),
            origin=origin,
            normal=direction,
            start=origin + direction * near[:, None],
            direction=direction,
            limit=far - near,
            kind=np.full(n, CAMERA),
            beta=np.ones((n, 3)),
            pdf=np.full(n, np.inf),
            bounces=zero,
            diffuse=zero,
            glossy=zero,
            as_shadow=np.zeros(n, bool),
        )
        while len(paths):
            if stop():
                return None
            triangle, uv = self._intersect(paths)
            self._see_lamps(paths, triangle, uv)
            hit = triangle >= 0
            self._see_background(paths[~hit])
            paths, triangle, uv = paths[hit], triangle[hit], uv[hit]
            if not len(paths):
                break
            surface = self.geometry.surface(triangle, uv, -paths.direction)
            held = (paths.kind == CAMERA) & self.holdout[self.geometry.material[triangle]]
            through = self._hold_out(paths[held], _select(surface, held))
            paths, surface = paths[~held], _select(surface, ~held)
            self._see_emission(paths, surface)
            paths = join([self._go_on(paths, surface, rng), through])
        return self.light, self.alpha

    # What a ray finds by itself

    def _intersect(self, paths: Paths) -> tuple[np.ndarray, np.ndarray]:
        triangle, uv = np.full(len(paths), -1), np.zeros((len(paths), 2))
        sight = np.where(paths.as_shadow, SHADOW, paths.kind)
        for kind in Visibility.ALL:
            now = sight == kind
            triangle[now], uv[now] = self.geometry.intersect(
                kind, paths.start[now], paths.direction[now], paths.limit[now]
            )
        return triangle, uv

    def _see_lamps(self, paths: Paths, triangle: np.ndarray, uv: np.ndarray) -> None:
        """Lamps between the start of each ray and the triangle that it hits; the sun and the world if it hits none."""
        begin = dot(paths.start - paths.origin, paths.direction)
        end = begin + paths.limit
        hit = triangle >= 0
        point = self.geometry.surface(triangle[hit], uv[hit], -paths.direction[hit]).point
        end[hit] = dot(point - paths.origin[hit], paths.direction[hit])
        for lamp in self.lamps:
            reached = (paths.kind & int(lamp.visibility)) != 0
            if lamp.delta or not reached.any():
                continue
            distance, radiance, density = lamp.meet(paths.origin, paths.normal, paths.direction)
            reached &= np.where(np.isinf(distance), ~hit, (distance > begin) & (distance * (1 - GAP) <= end))
            if lamp is self.world and self.transparent_film:
                reached &= paths.kind != CAMERA
            weight = self._found_by_ray(paths, self._chance(lamp) * density, lamp.cast_shadow)
            self._add(paths.sample, paths.beta * radiance * (weight * reached)[:, None], paths.bounces - 1)

    def _see_background(self, paths: Paths) -> None:
        if self.transparent_film:
            camera = paths.kind == CAMERA
            self.alpha[paths.sample[camera]] -= paths.beta[camera].mean(axis=1)

    def _hold_out(self, paths: Paths, surface: Surface) -> Paths:
        """Cut what the camera sees out of the picture. What goes on are the rays through transparent surfaces."""
        through = self.transparency[self.geometry.material[surface.triangle]]
        self.alpha[paths.sample] -= (paths.beta * (1 - through)).mean(axis=1)
        onward = _behind(paths, surface)
        onward.beta = paths.beta * through
        return onward[(onward.limit > 0) & onward.beta.any(axis=1)]

    def _see_emission(self, paths: Paths, surface: Surface) -> None:
        emission = self.emission[self.geometry.material[surface.triangle]]
        if not emission.any():
            return
        distance = dot(surface.point - paths.origin, paths.direction)
        density = self.mesh_light.density(surface.triangle, distance, paths.direction)
        weight = self._found_by_ray(paths, self._chance(self.mesh_light) * density)
        # A path's own ray meets what it sees; one that sees as shadow rays do may meet what rays of its kind don't.
        weight *= (self.geometry.visibility[surface.triangle] & paths.kind) != 0
        self._add(paths.sample, paths.beta * emission * weight[:, None], paths.bounces - 1)

    def _found_by_ray(self, paths: Paths, pdf_light: np.ndarray, cast_shadow: bool = True) -> np.ndarray:
        """Weight of light that a ray of known density ran into, where light sampling finds it with `pdf_light`."""
        alone = np.isinf(paths.pdf) | (pdf_light == 0)
        shared = paths.as_shadow | self.share_light if cast_shadow else np.zeros(len(paths), bool)
        return np.where(alone, ~paths.as_shadow, np.where(shared, power_heuristic(paths.pdf, pdf_light), 0))

    def _found_by_light_sampling(
        self, emitter: Emitter, seen: np.ndarray, pdf_light: np.ndarray, pdf_lobes: np.ndarray
    ) -> np.ndarray:
        """Weight of a light sample of known density, where BSDF sampling finds it with `pdf_lobes`.

        seen  (n,) the emitter's visibility
        """
        alone = np.full(len(pdf_light), emitter.delta or not emitter.cast_shadow)
        if emitter is self.mesh_light and not self.share_light:
            alone |= (seen & SHADOW) == 0
        return np.where(alone, 1, power_heuristic(pdf_light, pdf_lobes))

    def _chance(self, emitter: Emitter) -> float:
        return self._chance_of.get(id(emitter), 0.0)

    def _see_as_shadow(self, paths: Paths) -> None:
        """The light that both light sampling and these scattered rays find, through what shadow rays see."""
        paths = replace(paths, as_shadow=np.ones(len(paths), bool))
        while len(paths):
            triangle, uv = self._intersect(paths)
            self._see_lamps(paths, triangle, uv)
            hit = triangle >= 0
            paths, triangle, uv = paths[hit], triangle[hit], uv[hit]
            surface = self.geometry.surface(triangle, uv, -paths.direction)
            self._see_emission(paths, surface)
            paths = _behind(paths, surface)
            paths.beta = paths.beta * self.transparency[self.geometry.material[triangle]]
            paths = paths[paths.beta.any(axis=1)]

    # What happens at a surface

    def _go_on(self, paths: Paths, surface: Surface, rng: np.random.Generator) -> Paths:
        """Direct light at each surface point, then the rays that leave it."""
        s = self.settings
        material = self.geometry.material[surface.triangle]
        kd, ks, transparency = self.kd[material], self.ks[material], self.transparency[material]
        ended = (
            (paths.bounces > s.max_bounces) | (paths.diffuse > s.diffuse_bounces) | (paths.glossy > s.glossy_bounces)
        )
        opaque = np.where(ended, 0, (kd + ks).mean(axis=1))
        through = transparency.mean(axis=1)
        total = through + opaque
        p_pass = np.divide(through, total, out=np.zeros_like(total), where=total > 0)

        passes = rng.random(len(paths)) < p_pass
        onward = _behind(paths[passes], _select(surface, passes))
        onward.beta = onward.beta * transparency[passes] / p_pass[passes, None]
        onward = onward[onward.limit > 0]

        lit = opaque > 0
        lobes = bsdf.make_lobes(
            kd[lit],
            ks[lit],
            self.exponent[material[lit]],
            surface.normal[lit],
            surface.flat[lit],
            -paths.direction[lit],
            s.lobe_selection,
            s.hemisphere_sampling,
        )
        here, points = paths[lit], _select(surface, lit)
        self._direct_light(here, points, lobes, 1 - p_pass[lit], rng)
        scattered = self._scatter(here, points, lobes, 1 - p_pass[lit], rng)[~passes[lit]]
        if not self.share_light:
            self._see_as_shadow(scattered)
        return join([self._roulette(scattered, rng), onward])

    def _direct_light(
        self, paths: Paths, surface: Surface, lobes: bsdf.Lobes, p_scatter: np.ndarray, rng: np.random.Generator
    ) -> None:
        """One emitter, one direction towards it, one shadow ray for each path."""
        if not self.emitters or not len(paths):
            return
        chosen = np.searchsorted(np.cumsum(self.chance), rng.random(len(paths)) * self.chance.sum(), side="right")
        chosen = np.minimum(chosen, len(self.emitters) - 1)
        for index in np.unique(chosen):
            emitter, now = self.emitters[index], np.flatnonzero(chosen == index)
            here, at, seen = paths[now], _select(surface, now), np.full(len(now), int(emitter.visibility))
            drawn: Drawn
            if emitter is self.mesh_light:
                triangle, drawn = self.mesh_light.sample_triangles(at.point, rng)
                seen = self.geometry.visibility[triangle]
            else:
                drawn = emitter.sample(at.point, at.normal, rng)
            wi, distance, radiance, pdf = drawn
            pdf_light = pdf * self.chance[index]
            f_diffuse, f_phong, pdf_lobes = bsdf.evaluate(_select(lobes, now), -here.direction, wi)
            f = f_diffuse * _has(seen, DIFFUSE) + f_phong * _has(seen, GLOSSY)

            weight = self._found_by_light_sampling(emitter, seen, pdf_light, pdf_lobes * p_scatter[now])
            usable = pdf_light > 0
            scale = np.where(usable, weight * np.maximum(dot(at.normal, wi), 0) / np.where(usable, pdf_light, 1), 0)
            light = here.beta * f * radiance * scale[:, None]
            worth = np.flatnonzero(light.any(axis=1))
            if emitter.cast_shadow:
                light[worth] *= self._visible(_select(at, worth), wi[worth], distance[worth])
            self._add(here.sample[worth], light[worth], here.bounces[worth])

    def _visible(self, at: Surface, wi: np.ndarray, distance: np.ndarray) -> np.ndarray:
        """(n, 3) what arrives. The ray starts a little off the surface and ends a little before the emitter."""
        start = at.point + at.flat * at.offset[:, None]
        finite = np.isfinite(distance)
        reach = np.where(finite, distance * (1 - GAP), 0)
        segment = at.point + wi * reach[:, None] - start
        size = np.sqrt(dot(segment, segment))
        direction = np.where(finite[:, None], segment / np.maximum(size, 1e-300)[:, None], wi)
        return self.geometry.transmittance(start, direction, np.where(finite, size, np.inf))

    def _scatter(
        self, paths: Paths, surface: Surface, lobes: bsdf.Lobes, p_scatter: np.ndarray, rng: np.random.Generator
    ) -> Paths:
        """The same paths after a bounce; those that found no way on have a beta of zero."""
        wo = -paths.direction
        wi = bsdf.sample(lobes, wo, rng)
        f_diffuse, f_phong, pdf = bsdf.evaluate(lobes, wo, wi)
        pdf = pdf * p_scatter

        total = f_diffuse.sum(axis=1) + f_phong.sum(axis=1)
        diffuse_share = np.divide(f_diffuse.sum(axis=1), total, out=np.zeros_like(total), where=total > 0)
        diffuse = rng.random(len(paths)) < diffuse_share
        f = np.where(
            diffuse[:, None],
            f_diffuse / np.maximum(diffuse_share, 1e-300)[:, None],
            f_phong / np.maximum(1 - diffuse_share, 1e-300)[:, None],
        )
        usable = pdf > np.finfo(np.float32).tiny
        cosine = np.maximum(dot(surface.normal, wi), 0)
        scale = np.where(usable, cosine / np.where(usable, pdf, 1), 0)
        return Paths(
            sample=paths.sample,
            origin=surface.point,
            normal=surface.normal,
            start=surface.point + surface.flat * surface.offset[:, None],
            direction=wi,
            limit=np.full(len(paths), np.inf),
            kind=np.where(diffuse, DIFFUSE, GLOSSY),
            beta=paths.beta * f * scale[:, None],
            pdf=pdf,
            bounces=paths.bounces + 1,
            diffuse=paths.diffuse + diffuse,
            glossy=paths.glossy + ~diffuse,
            as_shadow=paths.as_shadow,
        )

    def _roulette(self, paths: Paths, rng: np.random.Generator) -> Paths:
        """Paths that carry little go on seldom, and count the more. From the second bounce on."""
        brightest = paths.beta.max(axis=1)
        survival = np.where(paths.bounces > 1, np.minimum(np.sqrt(np.maximum(brightest, 0)), 1), brightest > 0)
        alive = rng.random(len(paths)) < survival
        left = paths[alive]
        left.beta = left.beta / survival[alive, None]
        return left

    def _add(self, sample: np.ndarray, light: np.ndarray, bounce: np.ndarray) -> None:
        """Add to the picture: bounce <= 0 is direct light. A contribution that is not finite is left out."""
        finite = np.isfinite(light).all(axis=1)
        self.rejected += int(np.count_nonzero(~finite))
        light = np.where(finite[:, None], light, 0)
        limits = np.array([self.settings.clamp_direct, self.settings.clamp_indirect]) * 3
        limit = np.where(limits > 0, limits, np.inf)[(bounce > 0).astype(int)]
        size = light.sum(axis=1)
        light = light * np.minimum(1, limit / np.maximum(size, 1e-300))[:, None]
        np.add.at(self.light, sample, light)


def power_heuristic(pdf: np.ndarray, other: np.ndarray) -> np.ndarray:
    """pdf^2 / (pdf^2 + other^2), written without overflow; 1 for an infinite `pdf`."""
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        weight = 1 / (1 + (other / pdf) ** 2)
    return np.where(pdf > 0, np.where(np.isinf(pdf), 1, weight), 0)


def _behind(paths: Paths, surface: Surface) -> Paths:
    """The rays where they leave the other side of the surfaces that they met."""
    start = surface.point - surface.flat * surface.offset[:, None]
    return replace(paths, start=start, limit=paths.limit - dot(start - paths.start, paths.direction))


def _has(visibility: np.ndarray, kind: int) -> np.ndarray:
    """(n, 1)"""
    return ((visibility & kind) != 0)[:, None]


def _select(record, chosen: np.ndarray):
    """The chosen rows of a dataclass of arrays."""
    values = {f.name: getattr(record, f.name) for f in fields(record)}
    return type(record)(**{k: v[chosen] if isinstance(v, np.ndarray) else v for k, v in values.items()})
