"""``telefuse noise``: Allan deviation of a box at rest, and the noises behind it, for the filter's settings."""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path
from typing import Final

from core.calibration.allan_fit import NoiseTerm
from core.sensors import AXES
from schemas.calibration import Calibration
from service.cli.drives import read_settings
from service.cli.progress import Progress
from service.cli.recordings import add_recording, read_with_bar
from service.noise import NoiseOutcome, measure_noise, told
from service.reports.customary import CUSTOMARY

_CELL: Final = 25
"""Width of a figure with its interval."""


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    add_recording(parser)
    parser.add_argument(
        "--calibration", type=Path, metavar="FILE", help="applied first; with --counts it makes m/s² and rad/s of them"
    )
    parser.add_argument("--report", type=Path, metavar="FILE.html", help="write the Allan curves and fits as a page")
    parser.add_argument(
        "--json",
        action="store_true",
        help="print the figures as JSON, SI units: as 'fuse --noise FILE' and the vehicle's settings take them",
    )


def run(arguments: argparse.Namespace) -> int:
    """Measure, print, and write the report."""
    calibration = read_settings(arguments.calibration, Calibration, "what 'telefuse calibrate' writes")
    read = read_with_bar(arguments)
    with Progress("measuring noise", 100) as progress:
        outcome = measure_noise(read, calibration, lambda share: progress.update(int(100 * share)))
    settings = outcome.settings()
    if arguments.report is not None:
        # Here, not above: only a report needs it.
        from service.recordings.files import write_whole
        from service.reports.noise import noise_report

        write_whole(arguments.report, noise_report(outcome).encode())
    if arguments.json:
        unknown = {sensor: {"turn_on_bias_sd"} for sensor in outcome.fits}
        sys.stdout.write(settings.model_dump_json(indent=2, exclude=unknown) + "\n")
    else:
        sys.stdout.write("\n".join(noise_lines(outcome)) + "\n")
    for warning in outcome.warnings:
        sys.stderr.write(f"telefuse noise: {warning}\n")
    return 0


def noise_lines(outcome: NoiseOutcome) -> list[str]:
    """The figures with their 95 % intervals, in the units of data sheets."""
    lines = [
        f"{outcome.name}: {outcome.duration_s:.1f} s at rest from {outcome.start_s:.1f} s, {outcome.rate_hz:.4g} Hz; "
        "95 % intervals in brackets"
    ]
    for sensor, fits in outcome.fits.items():
        lines += ["", f"{sensor:29}" + "".join(f"{axis:<{_CELL}}" for axis in AXES) + "rms"]
        for name, (unit, factor) in CUSTOMARY[sensor].items():
            terms = [getattr(fit, name) for fit in fits]
            label = f"  {name.replace('_', ' ')}, {unit}"
            lines.append(
                f"{label:29}" + "".join(f"{told(term, factor):<{_CELL}}" for term in terms) + _together(terms, factor)
            )
    return lines


def _together(terms: list[NoiseTerm | None], factor: float) -> str:
    """Root mean square of the axes, as one figure for the sensor; a dash where an axis does not show it."""
    values = [term.value for term in terms if term is not None and term.resolved]
    return f"{factor * math.sqrt(sum(v * v for v in values) / len(terms)):.4g}" if len(values) == len(terms) else "–"
