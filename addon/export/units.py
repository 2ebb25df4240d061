"""Every conversion from Blender's units to the engine's metres, radians and W/(m2 sr), each with its source.

Plain numbers in, plain numbers out: nothing here knows bpy. "Cycles" names the source files of Blender 5's Cycles
(src/scene, src/kernel), which set what Blender's units mean.
"""

from __future__ import annotations

from math import pi, sin

import numpy as np

# A Phong exponent of 1e6 is a lobe 0.08 degrees wide: narrower than a pixel, and still exact in float32.
MAX_EXPONENT = 1e6

MIN_FSTOP = 1e-5  # Cycles' own floor, blender/camera.cpp: keeps the aperture finite.

# Rec. 709 luminance, Blender's scene-linear default.
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def lamp_strength(energy: float, exposure: float = 0.0) -> float:
    """Watts, or W/m2 for a sun, with the photographic exposure of Blender 4.5 and later in stops.

    Cycles, blender/light.cpp: strength = colour * energy * 2^exposure.
    """
    return energy * 2.0**exposure


def point_intensity(strength: float, radius: float, normalize: bool = True) -> float:
    """W/sr of a point or spot lamp (a spot's cone cuts the light of the whole sphere) from its strength.

    Cycles, scene/light.cpp, PointLight::area: the radiance of the sphere is strength / (pi * 4 pi r^2), so that seen
    from afar it has strength / (4 pi) W/sr, and a point of radius 0 has the same. Without `normalize` the strength is
    the radiance times pi, whatever the radius; a point keeps strength / pi W/sr.
    """
    if normalize:
        return strength / (4.0 * pi)
    return strength * radius * radius if radius > 0.0 else strength / pi


def area_radiance(strength: float, area: float, normalize: bool = True) -> float:
    """W/(m2 sr) of an area lamp with the full spread, from its strength and its area in square metres, world space.

    Cycles, scene/light.cpp, AreaLight::copy_to_kernel: strength / (pi * area), or strength / pi without `normalize`.
    """
    return strength / (pi * area) if normalize and area > 0.0 else strength / pi


def area_of_light(size_x: float, size_y: float, ellipse: bool) -> float:
    """Square metres of a rectangle or an ellipse, from its full sizes in world space."""
    return size_x * size_y * (pi / 4.0 if ellipse else 1.0)


def sun_irradiance(strength: float, angle: float, normalize: bool = True) -> float:
    """W/m2 of a sun whose disk is `angle` radians wide, from its strength.

    Cycles, scene/light.cpp, SunLight::area: radiance = strength / (pi sin^2(angle / 2)), whose irradiance is the
    strength. Without `normalize` the strength is the radiance of the disk.
    """
    if normalize or angle <= 0.0:
        return strength
    return strength * pi * sin(angle / 2.0) ** 2


def roughness_to_exponent(roughness: float) -> float:
    """Phong exponent of a microfacet roughness: n = 2 / alpha^2 - 2 with alpha = roughness^2.

    Walter et al. 2007, section 5.2 (the Phong exponent that goes with a Beckmann width alpha). Clamped to
    [0, MAX_EXPONENT]: roughness 1 is exponent 0, roughness 0 a lobe narrower than a pixel.
    """
    squared = max(roughness, 0.0) ** 4
    if squared * (MAX_EXPONENT + 2.0) <= 2.0:
        return MAX_EXPONENT
    return max(2.0 / squared - 2.0, 0.0)


def exponent_to_roughness(exponent: float) -> float:
    """The inverse of `roughness_to_exponent`."""
    return (2.0 / (exponent + 2.0)) ** 0.25


# Microfacet models that leave out light bounced between facets lose energy when they are rough; Blender's default,
# MULTI_GGX, does not. By roughness: what such a lobe reflects under diffuse light, relative to the Phong lobe of the
# same roughness (which loses light too, at grazing angles), both by Monte Carlo with Smith's masking. Where it is
# above 1 there is nothing to take off.
_ROUGH_SHARE = {
    "GGX": ((0.72, 0.8, 0.9, 1.0), (1.0, 0.87, 0.68, 0.49)),
    "BECKMANN": ((0.91, 1.0), (1.0, 0.80)),
    "ASHIKHMIN_SHIRLEY": ((0.91, 1.0), (1.0, 0.80)),
}


def rough_share(distribution: str, roughness: float) -> float:
    """The part of a glossy reflectance that is left for a rough lobe of this distribution, (0, 1]."""
    places, shares = _ROUGH_SHARE.get(distribution, ((0.0,), (1.0,)))
    return float(np.interp(roughness, places, shares))


def mean_fresnel(ior: float) -> float:
    """Reflectance of a smooth dielectric under diffuse light, from its relative index of refraction.

    Kulla & Conty 2017, "Revisiting Physically Based Shading at Imageworks", the fits of F_avg for eta >= 1 and < 1.
    The engine's lobes have no Fresnel term: this is the constant that keeps their energy right on average.
    """
    if ior >= 1.0:
        return (ior - 1.0) / (4.08567 + 1.00071 * ior)
    ior = max(ior, 0.0)
    return min(max(0.997118 + 0.1014 * ior - 0.965241 * ior**2 - 0.130607 * ior**3, 0.0), 1.0)


def ior_with_specular_level(ior: float, level: float) -> float:
    """Principled BSDF: the specular level scales the reflectance at normal incidence; 0.5 leaves it alone.

    Cycles, kernel/svm/closure.h: f0 = f0(ior) * 2 * level, turned back into an index of refraction.
    """
    f0 = ((ior - 1.0) / (ior + 1.0)) ** 2 * 2.0 * max(level, 0.0)
    root = min(f0, 0.99) ** 0.5
    return (1.0 + root) / (1.0 - root)


def aperture_radius(lens_millimetres: float, fstop: float, orthographic: bool) -> float:
    """Metres. Cycles, blender/camera.cpp: lens * 1e-3 / (2 fstop), or 1 / (2 fstop) for an orthographic camera."""
    width = 1.0 if orthographic else lens_millimetres * 1e-3
    return width / (2.0 * max(fstop, MIN_FSTOP))


def spot_lens(spot_size: float, sensor_width: float = 32.0) -> float:
    """Millimetres of the lens that sees what a spot lamp lights, when a lamp is the scene's camera.

    Cycles, blender/camera.cpp: 16 / tan(spot_size / 2) for a sensor of 32 mm.
    """
    return sensor_width / 2.0 / np.tan(spot_size / 2.0)


def srgb_to_linear(values: np.ndarray) -> np.ndarray:
    """IEC 61966-2-1, the transfer curve of sRGB; float32 in, float32 out."""
    low = values / np.float32(12.92)
    high = ((np.maximum(values, 0) + np.float32(0.055)) / np.float32(1.055)) ** np.float32(2.4)
    return np.where(values <= 0.04045, low, high).astype(np.float32)


# Colour of a black body as Blender shows it, as polynomials in 1000 K / temperature between 800 and 12000 K. Fitted
# to `Light.temperature_color` of Blender 5.0.1 (largest difference 0.0013), which the Blackbody node agrees with.
_BLACKBODY = (
    (800.0, (0.6705471, 0.9499205, 12.8804346, -25.8640709, 32.5901862, -26.0019327, 11.512548, -2.136194)),
    (965.0, (0.9555351, 0.8740244, -5.4305294, 6.6642191, -4.054541, 1.0302417)),
    (1900.0, (2.280659, -7.9941977, -18.482446, 175.0980859, -467.8635228, 581.1185422, -284.672265)),
)


def blackbody_rgb(temperature: float) -> np.ndarray:
    """(3,) linear Rec. 709 of luminance 1, from kelvin; held constant outside of 800 to 12000 K as Blender does."""
    x = 1000.0 / min(max(temperature, 800.0), 12000.0)
    channels = [np.polynomial.polynomial.polyval(x, c) if 1000.0 / x >= low else 0.0 for low, c in _BLACKBODY]
    return np.maximum(channels, 0.0)
