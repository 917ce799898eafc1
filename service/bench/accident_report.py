"""The accident engine's figures as tables for people."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from service.bench.accident_scoring import DETECTORS, OURS
from service.bench.tables import aligned, verdicts


def tables(found: Mapping[str, Any]) -> str:
    """One block a part, and at the end what is asked against what was measured."""
    makers: Mapping[str, Callable[[Any], Iterable[str]]] = {
        "seed1": _seed1,
        "corpus": _corpus,
        "errors": _errors,
        "long": _long,
        "classes": _classes,
        "reliability": _reliability,
        "recordings": _recordings,
        "left_out": _left_out,
        "targets": verdicts,
    }
    return "\n\n".join("\n".join(make(found[name])) for name, make in makers.items() if found.get(name))


def _seed1(found: Mapping[str, Any]) -> Iterable[str]:
    drives = found[OURS]["drives"]
    yield f"seed 1's scenario, {len(drives)} drives, {found[OURS]['km']:.0f} km, through the whole session:"
    rows = [("drive", *(f"{name}: {what}" for name in DETECTORS for what in ("found", "false", "withdrawn")))]
    for at, drive in enumerate(drives):
        cells = []
        for name in DETECTORS:
            one = found[name]["drives"][at]
            cells += [f"{one['found']}/{one['accidents']}", str(one["false_alarms"]), str(one["withdrawn"])]
        rows.append((str(drive["seed"]), *cells))
    yield from aligned(rows)
    for name in DETECTORS:
        places = found[name]["place_error_m"]
        told = "; ".join(
            f"{_number(one['max'], 1)} m at most {where}, median {_number(one['median'], 1)} of {one['count']}"
            for where, one in (("under open sky", places["open"]), ("in outages", places["outage"]))
        )
        yield f"  {name}: places off by {told}"
        yield from _described(name, found[name])
    yield from _named(found[OURS]["quiet"])


def _corpus(found: Mapping[str, Any]) -> Iterable[str]:
    ours = found[OURS]
    yield f"corpus: {ours['accidents']} accidents and {ours['quiet']['count']} non-accidents; share found:"
    rows = [("accidents", "count", *DETECTORS)]
    for key, text in (
        ("all", "all"),
        ("from_8_kmh", "change of velocity from 8 km/h"),
        ("low_speed", "low-speed class, below 6.5 m/s"),
        ("below_8_kmh", "below 8 km/h"),
        ("severe", "from 6.5 m/s"),
    ):
        cells = (_share(found[name]["recall"][key]) for name in DETECTORS)
        rows.append((text, str(ours["recall"][key]["count"]), *cells))
    for key, one in ours["recall_by_class"].items():
        rows.append(
            (f"  {key}", str(one["count"]), *(_share(found[name]["recall_by_class"][key]) for name in DETECTORS))
        )
    yield from aligned(rows)
    for name in DETECTORS:
        quiet = found[name]["quiet"]
        yield (
            f"  {name}: told elsewhere {found[name]['told_elsewhere']}, told for a non-accident {quiet['false_alarms']}"
            f" of {quiet['count']}, withdrawn {quiet['withdrawn']}"
        )
        yield from _described(name, found[name])
    yield from _reliable(ours["reliability"])
    yield from _named(ours["quiet"])


def _described(name: str, one: Mapping[str, Any]) -> Iterable[str]:
    whole, clipped, direction, delay = (
        one[key] for key in ("delta_v_unclipped", "delta_v_clipped", "direction", "delay")
    )
    yield (
        f"  {name}: change of velocity, {whole['count']} unclipped: off by {_three(whole['abs_error_mps'], 2)} m/s"
        f" (median, 95 %, most), {_percent(whole['outside_10_percent_and_1_kmh'])} by more than 10 % and 1 km/h,"
        f" 95 % interval covers {_percent(whole['interval_coverage'])}"
    )
    yield (
        f"  {name}: {clipped['count']} clipped: off by {_three(clipped['relative_error'], 2)} of it,"
        f" interval covers {_percent(clipped['interval_coverage'])}"
    )
    yield (
        f"  {name}: direction off by {_three(direction['error_deg'], 1)} deg, {_percent(direction['beyond_15_deg'])}"
        f" by more than 15 ({_percent(direction['unclipped_beyond_15_deg'])} of the unclipped,"
        f" {_percent(direction['clipped_beyond_15_deg'])} of the clipped); told after {_three(delay['delay_s'], 3)} s,"
        f" {_percent(delay['beyond_150_ms'])} later than 150 ms; the direction's 95 % interval covers"
        f" {_percent(direction['interval_coverage'])}"
    )
    each = one["each_impact"]
    for part in ("unclipped", "clipped"):
        if each[part]["count"]:
            yield (
                f"  {name}: {each['accidents']} accidents of several impacts, {each['told']['share']:.1%} of whose"
                f" {each['count']} were told, {each[part]['count']} {part}: change of velocity off by"
                f" {_three(each[part]['relative_error'], 2)} of it, interval covers"
                f" {_percent(each[part]['interval_coverage'])}, direction of {_percent(each[part]['beyond_15_deg'])}"
                " off by more than 15 deg"
            )
    if (late := delay.get("late")) is not None:
        yield (
            f"  {name}: {late['count']} later than 150 ms: by then the true motion exceeded what tyres and brakes can"
            f" by {_three(late['excess_mps'], 2)} m/s; by less than is suspected in {late['within_margin']}, by less"
            f" than speaks for an accident ({late['likely_mps']:.2f}) in {late['below_likely']}"
        )


def _reliable(found: Mapping[str, Any]) -> Iterable[str]:
    for key, text in (("first", "as told at once"), ("last", "as it stands in the end")):
        one = found[key]
        if not one["bins"]:
            continue
        yield f"probability said against share that were accidents, {text} (Brier score {_number(one['brier'], 3)}):"
        rows = [("said", "count", "mean", "were accidents")]
        for part in one["bins"]:
            edges = f"{part['from']:g} to {part['to']:g}"
            rows.append((edges, str(part["count"]), f"{part['said']:.3f}", _share(part["accidents"])))
        yield from aligned(rows)


def _reliability(found: Mapping[str, Any]) -> Iterable[str]:
    counts = ", ".join(f"{count} of {form}" for form, count in found["from"].items())
    yield f"what was told of cases in which little is plain ({counts}): fitted on even seeds, shown on odd ones"
    for key, text in (("first", "at once"), ("last", "in the end")):
        one = found[key]
        fit = one["fit"]
        yield (
            f"  {text}: {one['count']} shown, {one['middling']} between 0.1 and 0.9; Brier score"
            f" {one['brier']:.4f}, expected calibration error {one['ece']:.4f}; the other half asks for a slope of"
            f" {fit['slope']:.2f} and a shift of {fit['shift']:.2f}"
        )
    yield from _reliable(found)


def _named(quiet: Mapping[str, Any]) -> Iterable[str]:
    yield f"what non-accidents were taken for by {OURS} (nothing: not even suspected):"
    rows = [("non-accident", "count", "named rightly", "taken for")]
    for kind, one in quiet["kinds"].items():
        taken = ", ".join(f"{name} {count}" for name, count in one["taken_for"].items())
        rows.append((kind, str(one["count"]), _percent(one["named_right"]["share"]), taken))
    yield from aligned(rows, left=(0, 3))


def _long(found: Mapping[str, Any]) -> Iterable[str]:
    yield (
        f"{found['km']:.0f} km in {found['hours']:.0f} h of driving with {found['non_accidents']} non-accidents,"
        f" {found['wall_s']:.0f} s on this machine; false alarms per 100 000 km with their exact 95 % interval:"
    )
    rows: list[Sequence[str]] = [("detector", "told", "per 100 000 km", "interval", "withdrawn", "per 100 000 km")]
    for name in DETECTORS:
        told, back = found[name]["false_alarms"], found[name]["withdrawn"]
        interval = f"{told['low']:.2f} to {told['high']:.2f}"
        rows.append(
            (
                name,
                str(told["count"]),
                f"{told['per_100000_km']:.2f}",
                interval,
                str(back["count"]),
                f"{back['per_100000_km']:.2f}",
            )
        )
    yield from aligned(rows)
    for alarm in found[OURS]["shown"]:
        during = ", ".join(alarm["during"]) or "nothing"
        yield f"  piece {alarm['seed']}, {alarm['t_ns']}: {alarm['delta_v_mps']:.2f} m/s during {during}"
    yield from _named(found[OURS]["quiet"])


def _classes(found: Mapping[str, Any]) -> Iterable[str]:
    yield f"each class of vehicle with its own profile ({OURS}); share found, and what is told of it:"
    rows: list[Sequence[str]] = [
        ("class", "accidents", "from 8 km/h", "low-speed class", "falls", "over 10 % and 1 km/h, unclipped",
         "clipped off by", "over 15 deg", "told after, s", "later than 150 ms")
    ]  # fmt: skip
    for name, one in found.items():
        delta_v, clipped, delay = one["delta_v_unclipped"], one["delta_v_clipped"], one["delay"]
        rows.append(
            (
                name,
                str(one["accidents"] + one["falls"]["count"]),
                _share(one["recall"]["from_8_kmh"]),
                _share(one["recall"]["low_speed"]),
                _share(one["falls"]),
                _share(delta_v["outside"]),
                f"{_three(clipped['relative_error'], 2)} of {clipped['count']}",
                _share(one["direction"]["outside"]),
                _three(delay["delay_s"], 3),
                _share(delay["late_share"]),
            )
        )
    yield from aligned(rows)
    rows = [
        ("class", "non-accidents", "told", "withdrawn", "named rightly", "km", "false alarms, 100 000 km", "withdrawn")
    ]
    for name, one in found.items():
        told, back, quiet = one["false_alarms"], one["withdrawn"], one["quiet"]
        rows.append(
            (
                name,
                str(quiet["count"]),
                str(quiet["false_alarms"]),
                str(quiet["withdrawn"]),
                _share(quiet["named_right"]),
                f"{one['km']:.0f}",
                f"{told['count']}: {told['per_100000_km']:.0f} ({told['low']:.1f} to {told['high']:.0f})",
                str(back["count"]),
            )
        )
    yield from aligned(rows)
    for name, one in found.items():
        yield f"{name}: missed {', '.join(f'{kind} {seed} ({dv} m/s)' for kind, seed, dv in one['missed']) or 'none'}"
        wrong = [f"{kind} {seed}" for kind, seed in one["wrong"]] + [
            f"piece {seed}, {t_ns}" for seed, t_ns in one["shown"]
        ]
        yield f"  false alarms: {', '.join(wrong) or 'none'}"
        yield from _named(one["quiet"])


def _errors(found: Mapping[str, Any]) -> Iterable[str]:
    yield "errors of attitude and speed, the real filter's on whole drives and those of the fast ones:"
    rows: list[Sequence[str]] = [("", "tilt RMS, deg", "99 %, deg", "lasts, s", "speed RMS, m/s", "lasts, s")]
    for name, one in found.items():
        cells = (f"{one[key]:.3g}" for key in ("tilt_rms_deg", "tilt_p99_deg", "tilt_s", "speed_rms_mps", "speed_s"))
        rows.append((name, *cells))
    yield from aligned(rows)


def _recordings(found: Mapping[str, Any]) -> Iterable[str]:
    yield "NHTSA barrier test 10146 at the end of a simulated drive (64.6 to 66.2 km/h; 29.1 to 29.8 at rest):"
    rows: list[Sequence[str]] = [
        ("placed", "sensor", "range, g", "rate, Hz", "told, km/h", "95 % interval", "covers", "from, deg", "after, s")
    ]
    for one in found["barrier"]:
        if not one["found"]:
            cells: Sequence[str] = ("not found", "", "", "", "")
        else:
            interval = one["interval_kmh"]
            cells = (
                f"{one['delta_v_kmh']:.1f}",
                "none" if interval is None else f"{interval[0]:.1f} to {interval[1]:.1f}",
                "yes" if one["covered"] else "no",
                f"{one['pdof_deg']:.0f}",
                f"{one['delay_s']:.3f}",
            )
        rows.append((one["placement"], one["sensor"], f"{one['full_scale_g']:g}", f"{one['rate_hz']:g}", *cells))
    yield from aligned(rows)
    drives = found["drives"]
    for part, text in (
        ("shocks", f"{found['shocks']['count']} times a road shock (500, three attitudes each)"),
        ("trips", "two trips of harsh manoeuvres"),
        ("drives", f"real drives ({', '.join(drives['names']) or 'none there'}), {drives['hours']:.2f} h"),
    ):
        told = ", ".join(f"{name} {found[part][name]['false_alarms']}" for name in DETECTORS)
        yield f"  {text}: accidents told: {told}"


def _left_out(found: Mapping[str, str]) -> Iterable[str]:
    for part, name in found.items():
        yield f"{part}: left out, as there is no '{name}'; say by --recordings where the recordings are"


def _share(one: Mapping[str, Any]) -> str:
    if one["share"] is None:
        return "none"
    return f"{100 * one['share']:.1f} % ({100 * one['low']:.1f} to {100 * one['high']:.1f})"


def _percent(value: float | None) -> str:
    return "none" if value is None else f"{100 * value:.1f} %"


def _number(value: float | None, digits: int) -> str:
    return "none" if value is None else f"{value:.{digits}f}"


def _three(one: Mapping[str, Any], digits: int) -> str:
    return ", ".join(_number(one[key], digits) for key in ("median", "p95", "max"))
