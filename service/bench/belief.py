"""The fusion of beliefs alone: both levels of an instant, as the assessment has them, and each rule by its sources."""

from __future__ import annotations

import time
from typing import Any, Final

import numpy as np

from core.measurements import FloatArray
from core.risk.belief import N_SETS, vacuous
from core.risk.combination import RULES, combine
from core.risk.lookup import crossfade

INSTANTS: Final = 2000
ROUNDS: Final = 50
"""Many short rounds: on a busy machine some fall between what else it does."""
LIMIT_US: Final = 2.0
"""What both levels may take an instant, in batch on one thread."""
SOURCES: Final = {"driver": 2, "environment": 6, "vehicle": 1}
"""Sources of each entity; two neighbouring propositions each, as tables of rates give them."""
SHAPES: Final = ((3, 2), (3, 3), (6, 2), (3, 7))
"""Numbers of sources and of propositions of each, for the rules one by one."""


def measure() -> dict[str, Any]:
    """Microseconds an instant, single-threaded, of the quietest of some rounds."""
    rng = np.random.default_rng(1)
    entities = [_faded(rng, count) for count in SOURCES.values()]

    def both_levels() -> FloatArray:
        local = [combine(sources)[0] if sources.shape[1] > 1 else sources[:, 0] for sources in entities]
        return combine(np.stack(local, axis=1))[0]

    rules: dict[str, dict[str, float]] = {}
    for count, propositions in SHAPES:
        masses = _random(rng, count, propositions)
        rules[f"{count}x{propositions}"] = {
            rule: _quietest(lambda rule=rule, masses=masses: combine(masses, rule)[0]) for rule in RULES
        }
    return {
        "both_levels_us": _quietest(both_levels),
        "at_most_us": LIMIT_US,
        "sources": dict(SOURCES),
        "instants": INSTANTS,
        "rounds": ROUNDS,
        "rules_us": rules,
    }


def _quietest(work: Any) -> float:
    """Microseconds an instant in the quietest round: whatever else the machine does can only add to one."""
    work()
    spent = []
    for _ in range(ROUNDS):
        begin = time.perf_counter()
        work()
        spent.append(time.perf_counter() - begin)
    return 1e6 * min(spent) / INSTANTS


def _faded(rng: np.random.Generator, sources: int) -> FloatArray:
    nodes = (0.8, 1.1, 1.5, 2.0, 2.6)
    return np.stack([crossfade(rng.uniform(0.8, 2.6, INSTANTS), nodes) for _ in range(sources)], axis=1)


def _random(rng: np.random.Generator, sources: int, propositions: int) -> FloatArray:
    """Masses on that many propositions each, drawn for each source of each instant."""
    chosen = np.argsort(rng.random((INSTANTS, sources, N_SETS - 1)), axis=2)[..., :propositions] + 1
    masses = np.zeros_like(vacuous(INSTANTS, sources))
    np.put_along_axis(masses, chosen, rng.dirichlet(np.ones(propositions), (INSTANTS, sources)), axis=2)
    return masses


def lines(found: dict[str, Any]) -> str:
    """The figures for people."""
    sources = ", ".join(f"{count} {name}" for name, count in found["sources"].items())
    met = "met" if found["both_levels_us"] <= found["at_most_us"] else "missed"
    text = [
        f"both levels {found['both_levels_us']:.2f} us an instant, at most {found['at_most_us']:g} asked: {met}"
        f" ({sources} sources; quietest of {found['rounds']} rounds of {found['instants']} instants)",
        "each rule, us an instant, by sources x propositions of each:",
        "  " + " " * 13 + "".join(f"{shape:>8}" for shape in found["rules_us"]),
    ]
    shapes = found["rules_us"].values()
    rows = [f"  {rule:13}" + "".join(f"{by_rule[rule]:8.2f}" for by_rule in shapes) for rule in RULES]
    return "\n".join([*text, *rows])
