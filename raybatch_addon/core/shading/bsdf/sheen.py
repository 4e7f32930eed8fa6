"""Cloth: a layer of fibres that stand up (SHEEN), and Ashikhmin's velvet (VELVET).

The fibres' reflection is a cosine lobe stretched and tilted by a linear transform, fitted to a simulation (Zeltner,
Burley and Chiang, "Practical Multiple-Scattering Sheen Using Linearly Transformed Cosines", 2022).
scripts/precompute/sheen_table.py makes `sheen.npz`, which holds the fit that Cycles has. Rows have even steps of the
roughness, columns of the cosine of wo.
"""

import functools
from pathlib import Path

import numpy as np
import warp as wp

from ..sampling import sample_cosine_hemisphere

_FILE = Path(__file__).with_name("sheen.npz")
SHEEN_ROUGHNESS_LEAST = 1e-3
_SHARPNESS_LEAST = 1e-5  # the transform of a sharpness below this has hardly a lobe


@functools.cache
def load_sheen() -> np.ndarray:
    """Albedo, scale and tilt of the lobe, float32, shape [3, roughness, cosine]."""
    with np.load(_FILE) as file:
        return np.stack([file[name] for name in ("albedo", "scale", "tilt")]).astype(np.float32)


@wp.func
def sheen_lobe(table: wp.array3d(dtype=float), roughness: float, cosine: float) -> wp.vec3:
    """Albedo, scale and tilt at a cosine of wo; the albedo is 0 where there is no lobe."""
    rows = table.shape[1] - 1
    columns = table.shape[2] - 1
    y = wp.clamp(roughness, wp.static(SHEEN_ROUGHNESS_LEAST), 1.0) * float(rows)
    x = wp.clamp(cosine, 0.0, 1.0) * float(columns)
    i = wp.min(int(y), rows - 1)
    j = wp.min(int(x), columns - 1)
    fy = y - float(i)
    fx = x - float(j)
    found = wp.vec3(0.0)
    for k in range(3):
        near = wp.lerp(table[k, i, j], table[k, i, j + 1], fx)
        far = wp.lerp(table[k, i + 1, j], table[k, i + 1, j + 1], fx)
        found[k] = wp.lerp(near, far, fy)
    if found[1] < wp.static(_SHARPNESS_LEAST) or found[0] < wp.static(_SHARPNESS_LEAST):
        found[0] = 0.0
    return found


@wp.func
def sheen_tangent(normal: wp.vec3, wo: wp.vec3, otherwise: wp.vec3) -> wp.vec3:
    """The unit vector along the surface towards wo; `otherwise` where wo is along the normal."""
    along = wo - wp.dot(wo, normal) * normal
    length = wp.length(along)
    if length > 1.0e-6:
        return along / length
    return otherwise


@wp.func
def sheen_density(lobe: wp.vec3, local: wp.vec3) -> float:
    """Density of the lobe [1/sr], the cosine included.

    `local` is a direction (along `sheen_tangent`, across it, along the normal).
    """
    if local[2] <= 0.0:
        return 0.0
    a = lobe[1]
    x = a * local[0] + lobe[2] * local[2]
    y = a * local[1]
    q = a / (x * x + y * y + local[2] * local[2])
    return local[2] * q * q / wp.PI


@wp.func
def sample_sheen(lobe: wp.vec3, u: wp.vec2) -> wp.vec3:
    """A unit direction of density `sheen_density`, in the frame of that function."""
    disk = sample_cosine_hemisphere(u)
    return wp.normalize(wp.vec3(disk[0] - disk[2] * lobe[2], disk[1], disk[2] * lobe[1]))


@wp.func
def velvet_bsdf(sigma: float, wo: wp.vec3, wi: wp.vec3, normal: wp.vec3) -> float:
    """BSDF times the cosine of wi, over the weight [1/sr], of facets that stand up with V-shaped shadows between them.

    Ashikhmin, Premoze and Shirley, "A Microfacet-based BRDF Generator", 2000, section 6; `sigma` is the facets' spread
    about the surface.
    """
    cos_o = wp.dot(normal, wo)
    cos_i = wp.dot(normal, wi)
    if cos_o <= 0.0 or cos_i <= 0.0:
        return 0.0
    half = wp.normalize(wo + wi)
    cos_h = wp.dot(normal, half)
    cos_d = wp.dot(wo, half)
    across = wp.cross(normal, half)
    sine2 = wp.dot(across, across)
    if sine2 <= 2.0e-5 or cos_d <= 1.0e-5:
        return 0.0
    ratio = 2.0 * wp.max(cos_h / cos_d, 1.0e-5)
    shadow = wp.min(1.0, ratio * wp.min(cos_o, cos_i))
    narrow = 1.0 / (wp.max(sigma, 0.01) * wp.max(sigma, 0.01))
    d = wp.exp(-(cos_h * cos_h / sine2) * narrow) * narrow / (wp.PI * sine2 * sine2)
    return 0.25 * d * shadow / cos_o
