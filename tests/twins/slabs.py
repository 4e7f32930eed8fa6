"""Light that a plane layer scatters evenly in all directions, in float64.

Radiance is found at the nodes of a quadrature of the cosines, where the equation of transfer is one of matrices
(Chandrasekhar, "Radiative Transfer", 1950, chapters 2 and 3). A direction that is looked at is one more node, whose
weight is 0.
"""

import numpy as np

_NODES = 48


def _half_nodes() -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights of an integral from 0 to 1, shape [n]."""
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    return 0.5 * (nodes + 1), 0.5 * weights


def layer(albedo: float, depth: float, cosine: float) -> tuple[float, float]:
    """What leaves a layer of optical `depth`, whose upper side gets light of radiance 1 from all directions: radiance
    at the upper and at the lower side, both at `cosine` to their normal. `albedo` of a single scattering is below 1.
    """
    nodes, weights = _half_nodes()
    half, weight = np.append(nodes, cosine), np.append(weights, 0.0)
    mu, w = np.concatenate([half, -half]), np.concatenate([weight, weight])
    matrix = (0.5 * albedo * w[None, :] - np.eye(len(mu))) / mu[:, None]
    decay, modes = (part.real for part in np.linalg.eig(matrix))
    # each mode is 1 where it is largest
    above, below = (np.exp(decay * at - np.maximum(decay * depth, 0)) for at in (0.0, depth))
    enters = np.where(mu[:, None] > 0, modes * above, modes * below)
    shares = np.linalg.solve(enters, (mu > 0).astype(float))
    count = len(half)
    return float(((modes * above) @ shares)[-1]), float(((modes * below) @ shares)[count - 1])


def h_function(albedo: float, cosines: np.ndarray) -> np.ndarray:
    """Chandrasekhar's H for even scattering at `cosines`, shape [n] (section 38, in the form that converges fast)."""
    nodes, weights = _half_nodes()

    def next_h(at: np.ndarray, h: np.ndarray) -> np.ndarray:
        inner = (weights * nodes * h / (at[:, None] + nodes)).sum(1)
        return 1 / (np.sqrt(1 - albedo) + 0.5 * albedo * inner)

    h = np.ones(_NODES)
    for _ in range(200):
        h = next_h(nodes, h)
    return next_h(np.asarray(cosines, float), h)
