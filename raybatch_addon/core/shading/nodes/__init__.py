"""Programs of shader graphs: their ops, a file a family, and the interpreter that runs them."""

from . import closure_ops, convert, coordinates, geometry_inputs, object_inputs, view_inputs, environment, gabor, image, sky, voronoi  # noqa: F401  (files of ops register what they hold)
from . import colour, curves, map_range, math, mixing, radial_tiling, ramp, rotate, spaces, spectrum, vector_math  # noqa: E402, F401
from . import affine, brick, checker, gradient, ies, magic, noise, wave, white_noise  # noqa: E402, F401
from . import closure_ops_facets, closure_ops_soft, layers  # noqa: E402, F401
from . import attributes, bump  # noqa: E402, F401
