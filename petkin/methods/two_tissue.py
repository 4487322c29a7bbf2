"""Two tissue compartments integrated twice: an equation that is linear in four coefficients, and what they mean.

    C = a int int C_P + b int C_P - c int int C - d int C,
    a = K1 (k3 + k4),  b = K1,  c = k2 k4,  d = k2 + k3 + k4.

References: Evans AC. J Cereb Blood Flow Metab 1987;7:214-226, doi:10.1038/jcbfm.1987.46 (linearisation).
Ichise M et al. J Cereb Blood Flow Metab 2002;22:1271-1281, doi:10.1097/01.WCB.0000038000.34930.4E.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def two_tissue_values(a: Array, b: Array, c: Array, d: Array) -> dict[str, tuple[Array, Array]]:
    """Values (n,) of K1, k2, k3, k4, VT, VND and VS, and their derivatives by a, b, c, d (4, n)."""
    by_a, by_b, by_c, by_d = np.broadcast_to(np.eye(4)[:, :, None], (4, 4, len(a)))
    ratio, by_ratio = a / b, by_a / b - by_b * a / b**2  # k3 + k4
    k2, by_k2 = d - ratio, by_d - by_ratio
    k4, by_k4 = c / k2, by_c / k2 - by_k2 * c / k2**2
    VT, by_VT = a / c, by_a / c - by_c * a / c**2
    VND, by_VND = b / k2, by_b / k2 - by_k2 * b / k2**2
    return {
        "K1": (b, by_b),
        "k2": (k2, by_k2),
        "k3": (ratio - k4, by_ratio - by_k4),
        "k4": (k4, by_k4),
        "VT": (VT, by_VT),
        "VND": (VND, by_VND),
        "VS": (VT - VND, by_VT - by_VND),
    }
