"""The rules of combination as their papers write them, in exact rationals: slow, literal, independent of the product.

A mass is a dict from frozensets of 'L', 'M', 'H' to Fractions. Nothing here is shared with ``core.risk``.
"""

from __future__ import annotations

from fractions import Fraction
from itertools import product as cartesian
from math import prod

NOTHING = frozenset()
ALL = frozenset("LMH")
SETS = [frozenset(letter for letter, bit in zip("LMH", (1, 2, 4), strict=True) if index & bit) for index in range(8)]


def exact(array):
    """A mass of 8 floats as the rationals that they are."""
    return {SETS[index]: Fraction(float(value)) for index, value in enumerate(array) if value}


def listed(mass):
    return [float(mass.get(one, 0)) for one in SETS]


def products(sources):
    """Each combination of focal elements, one a source, with its masses."""
    for combination in cartesian(*(source.items() for source in sources)):
        sets = [one for one, _ in combination]
        yield sets, [mass for _, mass in combination], frozenset.intersection(*sets), frozenset.union(*sets)


def add(mass, proposition, amount):
    mass[proposition] = mass.get(proposition, Fraction(0)) + amount


def conflict(sources):
    return sum((prod(values) for _, values, both, _ in products(sources) if not both), Fraction(0))


def smets(sources):
    fused = {}
    for _, values, both, _ in products(sources):
        add(fused, both, prod(values))
    return fused


def dempster(sources):
    fused = smets(sources)
    fused.pop(NOTHING, None)
    total = sum(fused.values())
    return {one: mass / total for one, mass in fused.items()} if total else None


def yager(sources):
    fused = smets(sources)
    add(fused, ALL, fused.pop(NOTHING, Fraction(0)))
    return fused


def disjunctive(sources):
    fused = {}
    for _, values, _, either in products(sources):
        add(fused, either, prod(values))
    return fused


def dubois_prade(sources):
    fused = {}
    for _, values, both, either in products(sources):
        add(fused, both or either, prod(values))
    return fused


def pcr6(sources):
    """Martin & Osswald: X_i gets m_i(X_i)^2 prod_{others} m / sum of the masses, of each conflict."""
    fused = {}
    for sets, values, both, _ in products(sources):
        if both:
            add(fused, both, prod(values))
            continue
        involved = [(one, value) for one, value in zip(sets, values, strict=True) if one]
        if not involved:
            add(fused, NOTHING, prod(values))
        for one, value in involved:
            add(fused, one, value * prod(values) / sum(v for _, v in involved))
    return fused


def keeping(sets):
    """Binary keeping indices, Dezert, Dezert & Smarandache 2021, eq. 23, over the different sets of a product."""
    different = list(dict.fromkeys(sets))
    index = {}
    for one in different:
        contained = 1
        for large in different:
            for small in different:
                if small != large and len(one) <= len(large) and len(small) <= len(large):
                    contained *= int(small & large == small)
        index[one] = 1 - contained
    return index


def pcr6_plus(sources):
    fused = {}
    for sets, values, both, _ in products(sources):
        if both:
            add(fused, both, prod(values))
            continue
        involved = [(one, value) for one, value in zip(sets, values, strict=True) if one]
        index = keeping([one for one, _ in involved])
        shared = [(one, value) for one, value in involved if index[one]]
        if not shared:
            add(fused, NOTHING, prod(values))
        for one, value in shared:
            add(fused, one, value * prod(values) / sum(v for _, v in shared))
    return fused


def pcr5(sources):
    """General PCR5 (Smarandache & Dezert 2006): equal sets of a product count as the product of their masses."""
    fused = {}
    for sets, values, both, _ in products(sources):
        if both:
            add(fused, both, prod(values))
            continue
        weight = {}
        for one, value in zip(sets, values, strict=True):
            if one:
                weight[one] = weight.get(one, Fraction(1)) * value
        if not weight:
            add(fused, NOTHING, prod(values))
        for one, value in weight.items():
            add(fused, one, value * prod(values) / sum(weight.values()))
    return fused


RULES = {
    "pcr6": pcr6,
    "pcr6+": pcr6_plus,
    "pcr5": pcr5,
    "dempster": dempster,
    "yager": yager,
    "dubois-prade": dubois_prade,
    "smets": smets,
    "disjunctive": disjunctive,
}
