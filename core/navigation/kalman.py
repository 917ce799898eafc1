"""Filter algebra on a flat, row-major covariance: scalar and paired measurement updates and housekeeping.

A row H is given by the states that it touches and its factors there. Two habits let the compiler make vector code:
loops end at ``n`` = N_STATES as it comes at run time, as of a constant it unrolls them; and a projection is compiled
where it is used, so that the rows it reads lie at known places and cannot overlap what it writes.
"""

from __future__ import annotations

from core.compiled import compiled
from core.measurements import FloatArray
from core.navigation.state import N_STATES

Six = tuple[float, float, float, float, float, float]
Nine = tuple[float, float, float, float, float, float, float, float, float]
SixStates = tuple[int, int, int, int, int, int]
NineStates = tuple[int, int, int, int, int, int, int, int, int]


@compiled()
def project_axis(p: FloatArray, n: int, i: int, ph: FloatArray) -> float:
    """P H' for H that picks state ``i`` alone into ``ph`` (n,); returns H P H'."""
    row = i * n
    for j in range(n):
        ph[j] = p[row + j]
    return float(p[row + i])


@compiled(forceinline=True)
def project_six(p: FloatArray, n: int, at: SixStates, h: Six, ph: FloatArray) -> float:
    """P H' into ``ph`` (n,) for a row H with the factors ``h`` at the states ``at``; returns H P H'."""
    h0, h1, h2, h3, h4, h5 = h
    a, b, c = at[0] * N_STATES, at[1] * N_STATES, at[2] * N_STATES
    d, e, f = at[3] * N_STATES, at[4] * N_STATES, at[5] * N_STATES
    for j in range(n):
        ph[j] = (h0 * p[a + j] + h1 * p[b + j] + h2 * p[c + j]) + (h3 * p[d + j] + h4 * p[e + j] + h5 * p[f + j])
    return float(along_six(at, h, ph))


@compiled()
def along_six(at: SixStates, h: Six, v: FloatArray) -> float:
    """H v for a row H as in ``project_six`` and a vector (n,)."""
    return float(
        (h[0] * v[at[0]] + h[1] * v[at[1]] + h[2] * v[at[2]]) + (h[3] * v[at[3]] + h[4] * v[at[4]] + h[5] * v[at[5]])
    )


@compiled(forceinline=True)
def project_nine(p: FloatArray, n: int, at: NineStates, h: Nine, ph: FloatArray) -> float:
    """As ``project_six``, for nine states."""
    h0, h1, h2, h3, h4, h5, h6, h7, h8 = h
    a, b, c = at[0] * N_STATES, at[1] * N_STATES, at[2] * N_STATES
    d, e, f = at[3] * N_STATES, at[4] * N_STATES, at[5] * N_STATES
    g, i, k = at[6] * N_STATES, at[7] * N_STATES, at[8] * N_STATES
    for j in range(n):
        ph[j] = (
            (h0 * p[a + j] + h1 * p[b + j] + h2 * p[c + j])
            + (h3 * p[d + j] + h4 * p[e + j] + h5 * p[f + j])
            + (h6 * p[g + j] + h7 * p[i + j] + h8 * p[k + j])
        )
    return float(along_nine(at, h, ph))


@compiled()
def along_nine(at: NineStates, h: Nine, v: FloatArray) -> float:
    """H v for a row H as in ``project_nine`` and a vector (n,)."""
    return float(
        (h[0] * v[at[0]] + h[1] * v[at[1]] + h[2] * v[at[2]])
        + (h[3] * v[at[3]] + h[4] * v[at[4]] + h[5] * v[at[5]])
        + (h[6] * v[at[6]] + h[7] * v[at[7]] + h[8] * v[at[8]])
    )


@compiled(fastmath={"contract"})
def update(p: FloatArray, n: int, ph: FloatArray, s: float, innovation: float, dx: FloatArray) -> None:
    """Fuse a scalar: ``ph`` = P H', ``s`` = H P H' + R, innovation = z - h(x) - H dx; ``dx`` (n,) takes it on."""
    gain = innovation / s
    inverse = 1.0 / s
    for j in range(n):
        dx[j] += gain * ph[j]
    for i in range(n):
        k = ph[i] * inverse
        row = i * n
        for j in range(n):
            p[row + j] -= k * ph[j]


@compiled()
def decorrelate(n: int, first: FloatArray, second: FloatArray, share: float) -> None:
    """Take from ``second`` = P H2' what an update by ``first`` = P H1' removes: share = H2 P H1' / s1."""
    for j in range(n):
        second[j] -= share * first[j]


@compiled(fastmath={"contract"})
def update_pair(
    p: FloatArray,
    n: int,
    first: FloatArray,
    inverse_first: float,
    innovation_first: float,
    second: FloatArray,
    inverse_second: float,
    innovation_second: float,
    dx: FloatArray,
) -> None:
    """Two scalar updates in one pass over P; ``second`` and its innovation are free of the first (``decorrelate``).

    ``inverse_first``, ``inverse_second`` are 1 / s, or 0 for one that is left out.
    """
    gain_first, gain_second = innovation_first * inverse_first, innovation_second * inverse_second
    for j in range(n):
        dx[j] += gain_first * first[j] + gain_second * second[j]
    for i in range(n):
        k1, k2 = first[i] * inverse_first, second[i] * inverse_second
        row = i * n
        for j in range(n):
            p[row + j] -= k1 * first[j] + k2 * second[j]


@compiled()
def symmetrise(p: FloatArray, n: int) -> None:
    """Remove what rounding has put between P and its transpose."""
    for i in range(n):
        for j in range(i):
            mean = 0.5 * (p[i * n + j] + p[j * n + i])
            p[i * n + j] = mean
            p[j * n + i] = mean
