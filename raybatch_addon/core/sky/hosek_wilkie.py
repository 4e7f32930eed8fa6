"""Coefficients of the sky of Hosek and Wilkie, "An Analytic Model for Full Spectral Sky-Dome Radiance" (SIGGRAPH 2012).

`hosek_wilkie.npz` holds the numbers that its authors published for CIE XYZ (version 1.4a of February 2013): `shape`,
float64, [channel, albedo 0 and 1, turbidity 1 to 10, knot 0 to 5, coefficient 0 to 8], and `radiance`, the same without
coefficients. Their terms:

Copyright (c) 2012 - 2013, Lukas Hosek and Alexander Wilkie. All rights reserved.

Redistribution and use in source and binary forms, with or without modification, are permitted provided that the
following conditions are met: (1) Redistributions of source code must retain the above copyright notice, this list of
conditions and the following disclaimer. (2) Redistributions in binary form must reproduce the above copyright notice,
this list of conditions and the following disclaimer in the documentation and/or other materials provided with the
distribution. (3) None of the names of the contributors may be used to endorse or promote products derived from this
software without specific prior written permission.

This software is provided by the copyright holders and contributors "as is" and any express or implied warranties,
including, but not limited to, the implied warranties of merchantability and fitness for a particular purpose are
disclaimed. In no event shall the copyright holders be liable for any direct, indirect, incidental, special, exemplary,
or consequential damages (including, but not limited to, procurement of substitute goods or services; loss of use, data,
or profits; or business interruption) however caused and on any theory of liability, whether in contract, strict
liability, or tort (including negligence or otherwise) arising in any way out of the use of this software, even if
advised of the possibility of such damage.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from .preetham import sun_angles

TURBIDITY_RANGE = (1.0, 10.0)


@functools.cache
def _published() -> tuple[np.ndarray, np.ndarray]:
    with np.load(Path(__file__).with_name("hosek_wilkie.npz")) as data:
        return data["shape"], data["radiance"]


def hosek_wilkie_table(sun: Sequence[float], turbidity: float, albedo: float) -> list[float]:
    """The 32 numbers that the op `sky_hosek_wilkie` takes, for a sun in the direction `sun` over ground of `albedo`.

    A sun below the horizon counts as on it.
    """
    phi, theta = sun_angles(sun)
    theta = min(theta, 0.5 * math.pi)
    shape, radiance = _published()
    # Bezier curves of degree 5 over the cube root of the elevation
    t = (1.0 - theta / (0.5 * math.pi)) ** (1.0 / 3.0)
    curve = np.array([math.comb(5, k) * (1.0 - t) ** (5 - k) * t**k for k in range(6)])
    turbidity = min(max(turbidity, TURBIDITY_RANGE[0]), TURBIDITY_RANGE[1])
    low = min(int(turbidity), 9)
    between = np.zeros(10)
    between[low - 1], between[low] = low + 1 - turbidity, turbidity - low
    over = np.array([1.0 - albedo, albedo])
    shapes = np.einsum("a,t,k,catkn->cn", over, between, curve, shape)
    radiances = np.einsum("a,t,k,catk->c", over, between, curve, radiance)
    return [phi, theta, *(float(r) for r in radiances), *(float(c) for c in shapes.ravel())]
