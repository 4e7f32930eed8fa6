"""Form factors: shares of the light that a surface gets from a shape of uniform radiance.

Howell, "A Catalog of Radiation Heat Transfer Configuration Factors".
"""

import math


def square_form_factor(half: float, height: float) -> float:
    """Form factor of a square of half width `half`, parallel to the surface (B-3, four corners).

    The square is `height` above the point.
    """
    a = half / height
    root = math.sqrt(1 + a * a)
    return 4 * a / root * math.atan(a / root) / math.pi


def sphere_form_factor(radius: float, height: float, aside: float) -> float:
    """Form factor of a sphere whose centre is `height` above the surface and `aside` of the point (B-43).

    All of the sphere is above the surface.
    """
    square = height * height + aside * aside
    return height / math.sqrt(square) * radius**2 / square
