"""Form factors: shares of the light that a surface gets from a shape of uniform radiance (Howell, "A Catalog of Radiation Heat Transfer
Configuration Factors")."""

import math


def square_form_factor(half: float, height: float) -> float:
    """Of a square of `half` the width, parallel to the surface and `height` above the point (B-3, four corners)."""
    a = half / height
    root = math.sqrt(1 + a * a)
    return 4 * a / root * math.atan(a / root) / math.pi


def sphere_form_factor(radius: float, height: float, aside: float) -> float:
    """Of a sphere whose centre is `height` above the surface, and `aside` of the point (B-43); all of it is above the surface."""
    square = height * height + aside * aside
    return height / math.sqrt(square) * radius**2 / square
