"""Rules that combine the masses of independent sources, all sources at once, over arrays of instants.

Let a *product* be one focal element X_i from each source i, with mass pi = m_1(X_1) ... m_n(X_n).

=============  ======================================================================================================
smets          conjunctive, unnormalised: pi to the intersection; conflict stays on the empty set (Smets 1990)
dempster       the same divided by 1 - conflict; undefined, NaN, under total conflict (Shafer 1976)
yager          conflict to Theta (Yager 1987)
dubois-prade   pi to the intersection, or to the union of all X_i where that is empty (Dubois & Prade 1988)
disjunctive    pi to the union
pcr6           pi to the intersection; where that is empty, X_i gets pi m_i(X_i) / sum_k m_k(X_k) (Martin & Osswald
               2006: all sources at once, which two by two is another rule)
pcr6+          the same, but shared only among the X_i that make the conflict: an element counts for nothing where it
               and all that are as large contain all smaller ones (binary keeping index; Dezert, Dezert &
               Smarandache, JAIF 2021, eq. 23 and 26). Theta counts for nothing, so a vacuous source changes nothing
pcr5           where the intersection is empty, each different set A among the X_i gets pi w(A) / sum_B w(B), w(A) the
               product of m_i(A) over the sources that say A (Smarandache & Dezert 2006, general PCR5). Of two
               sources the same as pcr6
=============  ======================================================================================================

Sources may carry mass on the empty set. It is conflict: it stays there (smets), is divided away (dempster) or goes to
Theta (yager); in a union it adds nothing; in the PCR rules it takes no share (Smarandache & Dezert 2004, 9.1). Where
all of a product is empty there is nothing to share it among, and it stays on the empty set.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from core.compiled import compiled
from core.errors import InvalidInputError
from core.measurements import FloatArray
from core.risk.belief import EMPTY, N_SETS, THETA

RULES: Final = ("pcr6", "pcr6+", "pcr5", "dempster", "yager", "dubois-prade", "smets", "disjunctive")
_PCR6, _PCR6_PLUS, _PCR5, _DEMPSTER, _YAGER, _DUBOIS_PRADE, _SMETS, _DISJUNCTIVE = range(len(RULES))
_N: Final = N_SETS

IntArray = npt.NDArray[np.int64]

MAX_PRODUCTS: Final = 1 << 26
"""Most products of one instant in the rules that need them singly: some seconds. Eight sources with all eight
propositions are 2^24."""


def _kept(present: int) -> int:
    """Which of a product's elements get a share in PCR6+: bit masks over propositions.

    Eq. 23: X is dropped if every element at least as large as X contains every other that is no larger than it.
    """
    elements = [x for x in range(1, _N) if present >> x & 1]

    def dropped(x: int) -> bool:
        larger = [y for y in elements if y.bit_count() >= x.bit_count()]
        return all(z & ~y == 0 for y in larger for z in elements if z.bit_count() <= y.bit_count())

    return sum(1 << x for x in elements if not dropped(x))


_KEPT: Final = np.array([_kept(present) for present in range(1 << _N)])


def combine(masses: FloatArray, rule: str = "pcr6") -> tuple[FloatArray, FloatArray]:
    """Combine sources at each instant.

    Parameters
    ----------
    masses : (n, k, 8), k sources at n instants, or (k, 8)
    rule : one of ``RULES``

    Returns
    -------
    fused : (n, 8) or (8,); NaN where the rule is undefined
    conflict : (n,) or a scalar array; the mass on the empty set before the rule deals with it

    Raises
    ------
    InvalidInputError
        If the rule is unknown, there is no source, or the sources have more focal elements than can be gone through.
    """
    if rule not in RULES:
        raise InvalidInputError(f"unknown rule '{rule}': expected one of {', '.join(RULES)}")
    if masses.ndim not in (2, 3) or masses.shape[-1] != _N or masses.shape[-2] < 1:
        raise InvalidInputError(f"masses of shape {masses.shape}: expected (instants, sources, 8), 1 source or more")
    batch = np.ascontiguousarray(masses if masses.ndim == 3 else masses[None])
    n, k, _ = batch.shape
    code = RULES.index(rule)
    if code in (_PCR6, _PCR6_PLUS, _PCR5) and k > 8:
        most = float((batch > 0.0).sum(axis=2).astype(float).prod(axis=1).max(initial=0.0))
        if most > MAX_PRODUCTS:
            raise InvalidInputError(
                f"{k} sources with {most:.3g} combinations of propositions: expected at most {MAX_PRODUCTS}"
                f" for {rule}; combine fewer sources at once"
            )
    fused, conflict = np.empty((n, _N)), np.empty(n)
    if code in (_PCR6, _PCR6_PLUS, _PCR5):
        numbers, places = np.empty((k, _N + 3)), np.empty((k, _N + 3), np.int64)
        _redistributed(batch, code, _KEPT, fused, conflict, numbers, places, np.empty(_N))
    else:
        _by_pairs(batch, code, fused, conflict, np.empty((2, _N, _N)), np.empty(_N))
    return (fused, conflict) if masses.ndim == 3 else (fused[0], conflict[0])


@compiled()
def _by_pairs(
    masses: FloatArray, rule: int, fused: FloatArray, conflict: FloatArray, joint: FloatArray, total: FloatArray
) -> None:
    """Rules that need of a product its intersection and union only: their joint mass, source by source."""
    n, k, _ = masses.shape
    for t in range(n):
        joint[0] = 0.0
        for x in range(_N):
            joint[0, x, x] = masses[t, 0, x]
        for i in range(1, k):
            now, after = joint[(i - 1) & 1], joint[i & 1]
            after[:] = 0.0
            for both in range(_N):
                for either in range(_N):
                    share = now[both, either]
                    if share != 0.0:
                        for x in range(_N):
                            after[both & x, either | x] += share * masses[t, i, x]
        now = joint[(k - 1) & 1]
        total[:] = 0.0
        k_conflict = 0.0
        for both in range(_N):
            for either in range(_N):
                share = now[both, either]
                if both == EMPTY:
                    k_conflict += share
                if rule == _DISJUNCTIVE or (rule == _DUBOIS_PRADE and both == EMPTY):
                    total[either] += share
                else:
                    total[both] += share
        conflict[t] = k_conflict
        if rule == _DEMPSTER:
            rest = 0.0
            for x in range(1, _N):
                rest += total[x]
            for x in range(_N):
                fused[t, x] = total[x] / rest if rest > 0.0 else np.nan
            if rest > 0.0:
                fused[t, EMPTY] = 0.0
        else:
            if rule == _YAGER:
                total[THETA] += total[EMPTY]
                total[EMPTY] = 0.0
            for x in range(_N):
                fused[t, x] = total[x]


@compiled()
def _redistributed(
    masses: FloatArray,
    rule: int,
    kept: IntArray,
    fused: FloatArray,
    conflict: FloatArray,
    numbers: FloatArray,
    places: IntArray,
    weights: FloatArray,
) -> None:
    """The PCR rules: go through all products of focal elements, the last source innermost.

    A product's mass, intersection and sum of masses are those of the sources before, and one more. Of pcr6 what the
    sources before get is gathered on the way back, so a product costs one division and nothing a source.
    """
    n, k, _ = masses.shape
    value, focal = numbers[:, :_N], places[:, :_N]
    product, total, share = numbers[:, _N], numbers[:, _N + 1], numbers[:, _N + 2]
    count, at, both = places[:, _N], places[:, _N + 1], places[:, _N + 2]
    last = k - 1
    for t in range(n):
        for i in range(k):
            count[i] = 0
            for x in range(_N):
                if masses[t, i, x] > 0.0:
                    focal[i, count[i]], value[i, count[i]] = x, masses[t, i, x]
                    count[i] += 1
        out = fused[t]
        out[:] = 0.0
        against = 0.0
        product[0], total[0], both[0], share[0], at[0] = 1.0, 0.0, THETA, 0.0, 0
        level = 0
        while True:
            if level < last and at[level] < count[level]:
                x, v = focal[level, at[level]], value[level, at[level]]
                product[level + 1] = product[level] * v
                total[level + 1] = total[level] + (v if x != EMPTY else 0.0)
                both[level + 1] = both[level] & x
                level += 1
                share[level], at[level] = 0.0, 0
                continue
            if level == last:
                for j in range(count[last]):
                    x, v = focal[last, j], value[last, j]
                    mass = product[last] * v
                    if both[last] & x != EMPTY:
                        out[both[last] & x] += mass
                        continue
                    against += mass
                    at[last] = j
                    if rule == _PCR6:
                        among = total[last] + (v if x != EMPTY else 0.0)
                        if among > 0.0:
                            share[last] += mass / among
                            out[x] += mass / among * v if x != EMPTY else 0.0
                        else:
                            out[EMPTY] += mass
                    else:
                        _share(rule, mass, focal, value, at, kept, weights, out)
            if level == 0:
                break
            level -= 1
            x, v = focal[level, at[level]], value[level, at[level]]
            if x != EMPTY:
                out[x] += share[level + 1] * v
            share[level] += share[level + 1]
            at[level] += 1
        conflict[t] = against


@compiled()
def _share(
    rule: int,
    mass: float,
    focal: IntArray,
    value: FloatArray,
    at: IntArray,
    kept: IntArray,
    weights: FloatArray,
    out: FloatArray,
) -> None:
    """Share one conflicting product among its elements by pcr6+ or pcr5."""
    weights[:] = 0.0
    present = 0
    for i in range(len(at)):
        x, v = focal[i, at[i]], value[i, at[i]]
        if x == EMPTY:
            continue
        if rule == _PCR5:
            weights[x] = weights[x] * v if present >> x & 1 else v
        else:
            weights[x] += v
        present |= 1 << x
    among = 0.0
    shared = kept[present] if rule == _PCR6_PLUS else present
    for x in range(1, _N):
        if shared >> x & 1:
            among += weights[x]
    if among == 0.0:
        out[EMPTY] += mass
        return
    for x in range(1, _N):
        if shared >> x & 1:
            out[x] += mass / among * weights[x]
