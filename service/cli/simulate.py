"""``telefuse simulate``: write a simulated drive folder with its reference and truth."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Final

import numpy as np

from core.simulation.faults import FAULTS
from core.simulation.scenarios import SCENARIOS, SimulatedDrive, simulate
from service.errors import UsageError
from service.recordings.drive_folder import is_drive_folder, write_drive
from service.recordings.simulated import drive_of, parse_fault, with_faults
from service.roads import extra

DEFAULT: Final = "city"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("out_dir", metavar="OUT_DIR", type=Path, nargs="?", help="drive folder to write")
    parser.add_argument("--scenario", metavar="NAME", help=f"which drive (default {DEFAULT}; see --list)")
    parser.add_argument(
        "--roads",
        type=Path,
        metavar="ROADS",
        help="drive on the streets of a folder that 'telefuse roads build' made, instead of a scenario, with two GNSS"
        " outages of 60 s; the truth holds the way, class, limit and district of each second",
    )
    parser.add_argument("--seed", type=int, default=1, help="of the sensors' errors and random streets (default 1)")
    parser.add_argument("--duration", type=float, metavar="S", help="length in seconds (default: the scenario's own)")
    parser.add_argument(
        "--rate", type=float, default=200.0, metavar="HZ", help="inertial samples a second (default 200)"
    )
    parser.add_argument(
        "--fault",
        action="append",
        default=[],
        metavar="NAME[:START[:DURATION[:SIZE]]]",
        help="damage the recording, such as jump:100:20:60; several are laid one upon the other (see --list)",
    )
    parser.add_argument("--list", action="store_true", help="name the scenarios and faults and end")
    parser.add_argument("--json", action="store_true", help="print what was written as one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Simulate, write, and say what is in the folder."""
    if arguments.list:
        _list(as_json=arguments.json)
        return 0
    out: Path | None = arguments.out_dir
    if out is None:
        raise UsageError("OUT_DIR is missing; expected the folder to write, or --list to name the scenarios")
    if out.exists() and not (out.is_dir() and (is_drive_folder(out) or not any(out.iterdir()))):
        raise UsageError(f"{out}: is there and no drive folder; choose a new or an empty folder")
    progress = sys.stderr.isatty()
    if progress:
        sys.stderr.write(f"simulating {arguments.scenario or DEFAULT} …")
        sys.stderr.flush()
    simulated = _simulated(arguments)
    drive_s = float(simulated.trajectory.t_s[-1])
    if arguments.fault:
        simulated = with_faults(simulated, [parse_fault(text, drive_s) for text in arguments.fault])
    if progress:
        sys.stderr.write(f"\rwriting {out} …            ")
        sys.stderr.flush()
    write_drive(out, drive_of(simulated))
    if progress:
        sys.stderr.write("\r\x1b[K")
    truth, trajectory = simulated.truth, simulated.trajectory
    duration_s = float(trajectory.t_s[-1])
    distance_m = float(np.sum(trajectory.speed_mps[1:] * np.diff(trajectory.t_s)))
    if arguments.json:
        figures = {
            "folder": str(out),
            "scenario": simulated.scenario,
            "seed": arguments.seed,
            "duration_s": duration_s,
            "distance_m": round(distance_m, 1),
            "imu_samples": int(simulated.measurements.imu_t_ns.size),
            "gnss_fixes": int(simulated.measurements.gnss_t_ns.size),
            "accidents": truth["accidents"],
            "outages": truth["outages"],
            "faults": truth.get("faults", []),
        }
        print(json.dumps(figures))
        return 0
    print(f"{out}: {simulated.scenario}, {duration_s:.0f} s, {distance_m / 1000:.2f} km")
    for outage in truth["outages"]:
        print(f"  {outage['start_s']:8.1f} s  no GNSS for {outage['duration_s']:.0f} s")
    for fault in truth.get("faults", []):
        size = f", {fault['size']:g} {fault['unit']}" if fault["size"] else ""
        print(f"  {fault['start_s']:8.1f} s  fault: {fault['kind']} for {fault['duration_s']:g} s{size}")
    for accident in truth["accidents"]:
        where = f"{accident['lat_deg']:.6f}, {accident['lon_deg']:.6f}"
        clipped = ", clipped" if accident["clipped"] else ""
        print(
            f"  {accident['t_s']:8.1f} s  {accident['severity']} crash at {where}: "
            f"{accident['delta_v_mps']:.1f} m/s from {accident['pdof_deg']:.0f} deg{clipped}"
        )
    return 0


def _simulated(arguments: argparse.Namespace) -> SimulatedDrive:
    if arguments.roads is None:
        return simulate(arguments.scenario or DEFAULT, arguments.seed, arguments.duration, arguments.rate)
    if arguments.scenario is not None:
        raise UsageError("--roads and --scenario are two different drives; expected one of them")
    extra.require()
    from service.roads.simulated import simulate_on_roads

    return simulate_on_roads(arguments.roads, arguments.seed, arguments.duration, arguments.rate)


def _list(as_json: bool) -> None:
    if as_json:
        print(json.dumps({name: {"text": one.text, "duration_s": one.duration_s} for name, one in SCENARIOS.items()}))
        return
    faults = {name: one for name, one in FAULTS.items() if one.in_folder}
    width = max(map(len, [*SCENARIOS, *faults]))
    for name, one in SCENARIOS.items():
        print(f"{name:{width}}  {one.duration_s:5.0f} s  {one.text}")
    print("\nfaults, for --fault NAME[:START[:DURATION[:SIZE]]]:")
    for name, kind in faults.items():
        size = f"; size {kind.size:g} {kind.unit}" if kind.low < kind.high else ""
        print(f"{name:{width}}  {kind.duration_s:5.0f} s  {kind.text}{size}")
