"""What gauges would show of estimated pressures: a chamber that holds a void stands at vapour pressure, whatever the
void's size.

The filter's state remembers a void as a pressure below that of vapour. A gauge shows y = max(p, floor); of a p that is
normal with mean m and standard deviation s, y has, with a = (m - floor)/s, the density φ and the distribution Φ of the
standard normal,

    E y = floor + s (a Φ + φ),    var y = s² ((a² + 1) Φ + a φ) - (E y - floor)².
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

#: standard deviations above the floor from which on it is not felt
_FAR = 6.0


def show(mean: np.ndarray, variance: np.ndarray, pressures: slice, floor: float) -> None:
    """Replace means and variances (…, n) of the pressures in states, Pa, by those of what gauges would show, in their
    place.
    """
    m, v = mean[..., pressures], variance[..., pressures]
    s = np.sqrt(np.maximum(v, 1e-300))
    felt = m < floor + _FAR * s
    if not felt.any():
        return
    s, a = s[felt], np.maximum((m[felt] - floor) / s[felt], -_FAR)
    density, share = np.exp(-0.5 * a**2) / np.sqrt(2.0 * np.pi), ndtr(a)
    above = s * np.maximum(a * share + density, 0.0)
    m[felt] = floor + above
    v[felt] = np.maximum(s**2 * ((a**2 + 1.0) * share + a * density) - above**2, 0.0)
