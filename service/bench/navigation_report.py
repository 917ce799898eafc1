"""The navigation's figures as tables for people."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from service.bench.tables import aligned, verdicts


def tables(found: Mapping[str, Any]) -> str:
    """One table a part, and at the end what is asked against what was measured."""
    makers: Mapping[str, Callable[[Any], Iterable[str]]] = {
        "synthetic": _simulated,
        "road": _simulated,
        "real": _real,
        "consistency": _consistency,
        "calibration": _calibration,
        "seed3": _mobile_mapping,
        "targets": verdicts,
    }
    return "\n\n".join("\n".join(make(found[name])) for name, make in makers.items() if found.get(name))


def _simulated(found: Mapping[str, Any]) -> Iterable[str]:
    yield f"outages: {found['scenario']}, {found['drives']} seeds, {len(found['outages'])} of them; error in m:"
    rows = [("aided by", "after", "RMS", "stated", "median", "max", "which is in")]
    for aiding in found["aidings"].values():
        for name, one in aiding.items():
            if name == "text":
                continue
            worst = found["outages"][one["errors_m"].index(one["max_m"])]
            figures = (_m(one[key]) for key in ("rms_m", "stated_rms_m", "median_m", "max_m"))
            instant = name.removeprefix("at_").replace("_", " ")
            where = f"seed {worst['seed']} at {worst['start_s']:.0f} s"
            rows.append((aiding["text"], instant, *figures, where))
    yield from aligned(rows, left=(0, 6))


def _real(found: Mapping[str, Any]) -> Iterable[str]:
    yield "recorded drives; error in m:"
    rows = [("drive", "outage", "method", "figure", "error", "of each outage")]
    for name, drive in found.items():
        if (one := drive.get("outage")) is not None:
            span = f"{one['start_s']:g}:{one['duration_s']:g}"
            after = f"{one['fixes_after']} fixes after it"
            rows += [(name, span, method, "RMS", _m(one[method]["rms_m"]), after) for method in _methods(one)]
        if (sweep := drive.get("sweep")) is not None:
            span = f"{sweep['duration_s']:g} s every {sweep['every_s']:g} s"
            for method in _methods(sweep):
                ends = " ".join(_m(run["end_m"], 1) for run in sweep[method]["outages"])
                rows.append((name, span, method, "median end", _m(sweep[method]["median_end_m"]), ends))
    yield from aligned(rows, left=(0, 1, 2, 3, 5))


def _consistency(found: Mapping[str, Any]) -> Iterable[str]:
    yield f"errors against what is stated: {found['scenario']}, {found['drives']} seeds:"
    tables = {"nees": "NEES, usual settings", "nees_stated": "NEES, as stated", "nis_stated": "NIS, as stated"}
    for settings, text in tables.items():
        drawn = ("the fixes' own",) if settings == "nis_stated" else ()
        rows = [(text, "mean", "expected", "95 % band", "", *drawn)]
        for name, one in found[settings].items():
            low, high = one["band"]
            verdict = "inside" if one["inside"] else "outside"
            own = (_m(one["drawn"]),) if drawn else ()
            rows.append((name, _m(one["mean"]), _m(one["expected"]), f"{low:.2f} to {high:.2f}", verdict, *own))
        yield from aligned(rows)
    rows = [("within 3 sd", *next(iter(found["within_3_sd"].values())))]
    for where, shares in found["within_3_sd"].items():
        rows.append((where.replace("_", " "), *(f"{100 * share:.2f} %" for share in shares.values())))
    yield from aligned(rows)


def _calibration(found: Mapping[str, Any]) -> Iterable[str]:
    yield f"calibration: {found['scenario']}, {found['drives']} drives; RMS over a box's, and largest error, in m:"
    names = list(found["solutions"])
    rows = [("seed", "outage", *names)]
    for one in found["outages"]:
        cells = (f"{_m(one[name]['rms_m'], 1)} / {_m(one[name]['max_m'], 1)}" for name in names)
        rows.append((str(one["seed"]), f"{one['start_s']:.0f} s", *cells))
    cells = (f"{_m(one['rms_m'], 1)} / {_m(one['max_m'], 1)}" for one in found["solutions"].values())
    rows.append(("all", "", *cells))
    yield from aligned(rows)
    yield (
        f"calibrated by its true parameters it is not better in {found['calibrated_not_better']} outages, and in "
        f"{found['calibrated_worse_beyond_chance']} of them worse by more than luck explains"
    )


def _mobile_mapping(found: Mapping[str, Any]) -> Iterable[str]:
    yield "mobile mapping; RMS in m inside each gap:"
    rows = [("drive", "gap", *found["filters"].values())]
    for gap in found["gaps"]:
        cells = (_m(gap[f"{name}_rms_m"]) for name in found["filters"])
        rows.append((gap["drive"], f"{gap['start_s']:g}:{gap['duration_s']:g}", *cells))
    yield from aligned(rows, left=(0, 1))


def _methods(found: Mapping[str, Any]) -> list[str]:
    return [name for name, value in found.items() if isinstance(value, dict)]


def _m(value: float | None, digits: int = 2) -> str:
    return "none" if value is None else f"{value:.{digits}f}"
