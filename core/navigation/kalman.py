"""Filter algebra on a flat, row-major covariance: scalar measurement update and housekeeping.

Rows are contiguous and the size comes at run time, which lets the compiler vectorise the inner loops.
"""

from __future__ import annotations

from numba import njit

from core.measurements import FloatArray

Groups = tuple[int, int, int]
Row = tuple[float, float, float, float, float, float, float, float, float]


@njit(cache=True, nogil=True)
def project_axis(p: FloatArray, n: int, i: int, ph: FloatArray) -> float:
    """P H' for H that picks state ``i`` alone into ``ph`` (n,); returns H P H'."""
    row = i * n
    for j in range(n):
        ph[j] = p[row + j]
    return float(p[row + i])


@njit(cache=True, nogil=True)
def project(p: FloatArray, n: int, first: Groups, h: Row, ph: FloatArray) -> float:
    """P H' into ``ph`` (n,) for a row H of three groups of three states; returns H P H'.

    Group k starts at state ``first[k]`` and has the factors ``h[3k : 3k + 3]``.
    """
    h0, h1, h2, h3, h4, h5, h6, h7, h8 = h
    a, b, c = first[0] * n, first[1] * n, first[2] * n
    for j in range(n):
        ph[j] = (
            (h0 * p[a + j] + h1 * p[a + n + j] + h2 * p[a + 2 * n + j])
            + (h3 * p[b + j] + h4 * p[b + n + j] + h5 * p[b + 2 * n + j])
            + (h6 * p[c + j] + h7 * p[c + n + j] + h8 * p[c + 2 * n + j])
        )
    return along(first, h, ph)


@njit(cache=True, nogil=True)
def along(first: Groups, h: Row, v: FloatArray) -> float:
    """H v for a row H as in ``project`` and a vector (n,)."""
    i, j, k = first
    return float(
        (h[0] * v[i] + h[1] * v[i + 1] + h[2] * v[i + 2])
        + (h[3] * v[j] + h[4] * v[j + 1] + h[5] * v[j + 2])
        + (h[6] * v[k] + h[7] * v[k + 1] + h[8] * v[k + 2])
    )


@njit(cache=True, nogil=True)
def update(p: FloatArray, n: int, ph: FloatArray, s: float, innovation: float, dx: FloatArray) -> None:
    """Fuse a scalar: ``ph`` = P H', ``s`` = H P H' + R, innovation = z - h(x) - H dx; ``dx`` (n,) takes it on."""
    gain = innovation / s
    for j in range(n):
        dx[j] += gain * ph[j]
    inverse = 1.0 / s
    for i in range(n):
        k = ph[i] * inverse
        row = i * n
        for j in range(n):
            p[row + j] -= k * ph[j]


@njit(cache=True, nogil=True)
def symmetrise(p: FloatArray, n: int) -> None:
    """Remove what rounding has put between P and its transpose."""
    for i in range(n):
        for j in range(i):
            mean = 0.5 * (p[i * n + j] + p[j * n + i])
            p[i * n + j] = mean
            p[j * n + i] = mean
