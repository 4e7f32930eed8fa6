"""The ops of programs, a file for each family of Blender's nodes."""

from .closures import aov, facets, hair, layers, plain, soft, volume_ops  # noqa: F401
from .inputs import (  # noqa: F401
    attributes,
    bump,
    coordinates,
    curve_inputs,
    displacement,
    geometry_inputs,
    grids,
    ies,
    object_inputs,
    ray_inputs,
    view_inputs,
)
from .textures import (  # noqa: F401
    brick,
    checker,
    environment,
    gabor,
    gradient,
    image,
    image_levels,
    magic,
    noise,
    radial_tiling,
    sky,
    tiled_images,
    wave,
    white_noise,
)
from .textures.voronoi import ops as voronoi_ops  # noqa: F401
from .values import affine, color, convert, curves, map_range, math, mixing, ramp, rotate, spaces, spectrum, vector_math  # noqa: F401
