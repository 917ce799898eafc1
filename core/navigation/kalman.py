"""Filter algebra on a flat, row-major covariance: scalar measurement update and housekeeping.

Rows are contiguous and the size comes at run time, which lets the compiler vectorise the inner loops.
"""

from __future__ import annotations

from numba import njit

from core.measurements import FloatArray, TimeArray


@njit(cache=True, nogil=True)
def project(p: FloatArray, n: int, index: TimeArray, h: FloatArray, m: int, ph: FloatArray) -> float:
    """Put P H' into ``ph`` (n,) for a row H with ``m`` non-zeros ``h`` at ``index``; returns H P H'."""
    row = index[0] * n
    h0 = h[0]
    for j in range(n):
        ph[j] = h0 * p[row + j]
    for k in range(1, m):
        row = index[k] * n
        hk = h[k]
        for j in range(n):
            ph[j] += hk * p[row + j]
    s = 0.0
    for k in range(m):
        s += h[k] * ph[index[k]]
    return s


@njit(cache=True, nogil=True)
def update(p: FloatArray, n: int, ph: FloatArray, s: float, innovation: float, dx: FloatArray) -> None:
    """Fuse a scalar: ``ph`` = P H', ``s`` = H P H' + R, innovation = z - h(x) - H dx.

    ``dx`` (n,) takes the correction on; P stays symmetric to the bit since k_i ph_j = ph_i ph_j / s.
    """
    gain = innovation / s
    for j in range(n):
        dx[j] += gain * ph[j]
    inverse = 1.0 / s
    for i in range(n):
        a = ph[i]
        if a != 0.0:
            row = i * n
            for j in range(n):
                p[row + j] -= (a * ph[j]) * inverse


@njit(cache=True, nogil=True)
def symmetrise(p: FloatArray, n: int) -> None:
    """Remove what rounding has put between P and its transpose."""
    for i in range(n):
        for j in range(i):
            mean = 0.5 * (p[i * n + j] + p[j * n + i])
            p[i * n + j] = mean
            p[j * n + i] = mean
