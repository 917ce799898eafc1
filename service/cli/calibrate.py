"""``telefuse calibrate``: a box's sensors from a recording in which it is laid in one position after another."""

from __future__ import annotations

import argparse
import dataclasses
import math
import sys
from pathlib import Path
from typing import Any, Final

import numpy as np

from core.calibration.fit import TriadFit
from core.calibration.gyroscope import GyroscopeFit
from core.calibration.magnetometer import MagnetometerFit
from core.errors import InvalidInputError
from service.calibrating import SENSORS, CalibrationOptions, CalibrationOutcome, calibrate
from service.cli.progress import Progress
from service.cli.recordings import add_recording, number_above, read_with_bar
from service.errors import UsageError
from service.recordings.csv_tables import read_table
from service.recordings.files import write_whole

_LATITUDE: Final = (-90.0, 90.0)
_HEIGHT_M: Final = (-500.0, 9000.0)


PROTOCOL: Final = (
    "How to record: let the box lie still for half a minute; then lay it into some twenty other positions, every side "
    "up and on its edges between, 5 s each. From one to the next turn it twice right round about an axis that is "
    "level, another one of the box's each time, slower than its full scale (of 250 degrees a second: 4 s a turn and "
    "more): a gyroscope's scale has an eighth of the variance by it. Turning about an upright axis tells nothing."
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.epilog = PROTOCOL
    add_recording(parser)
    parser.add_argument(
        "--out", type=Path, metavar="CALIBRATION.json", help="write it, as 'fuse --calibration' and the service take it"
    )
    parser.add_argument(
        "--sensor", choices=(*SENSORS, "all"), default="all", help="what to calibrate (default: all that is recorded)"
    )
    parser.add_argument("--gravity", type=number_above(0.0, "gravity in m/s²"), metavar="MPS2", help="where recorded")
    parser.add_argument("--latitude", type=number_above(-math.inf, "degrees"), metavar="DEG", help="for gravity there")
    parser.add_argument(
        "--height", type=number_above(-math.inf, "metres"), metavar="M", help="above the ellipsoid, with --latitude (0)"
    )
    parser.add_argument(
        "--field", type=number_above(0.0, "a strength in µT"), metavar="UT", help="strength of the magnetic field there"
    )
    parser.add_argument(
        "--sections",
        type=Path,
        metavar="FILE.csv",
        help="the static positions, columns start_s and end_s (default: found in the recording)",
    )
    parser.add_argument(
        "--level",
        action="store_true",
        help="the recording is of a vehicle that drove in circles on level ground: calibrates its magnetometer",
    )
    parser.add_argument(
        "--earth-rate",
        action="store_true",
        help="calibrate the gyroscope at rest by the Earth's rate, as the paper does: tells a MEMS triad's bias",
    )
    parser.add_argument(
        "--prior",
        action="append",
        default=[],
        metavar="SENSOR.NAME=VALUE",
        help="what the data sheet says, such as accelerometer.scale_sd=0.02; may be repeated",
    )
    parser.add_argument("--report", type=Path, metavar="FILE.html", help="write what came out as a page")
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Calibrate, write, print; what the recording does not tell is said on stderr, with what to record."""
    if arguments.out is None and not arguments.json and arguments.report is None:
        raise UsageError("nothing asked for; expected --out CALIBRATION.json, --report FILE.html or --json")
    options = _options(arguments)
    read = read_with_bar(arguments)
    with Progress("calibrating", 100) as progress:
        outcome = calibrate(read, options, lambda share: progress.update(int(100 * share)))
    text = outcome.calibration().model_dump_json(indent=2, exclude_none=True) + "\n"
    if arguments.report is not None:
        # Here, not above: only a report needs it.
        from service.reports.calibration import calibration_report

        write_whole(arguments.report, calibration_report(outcome).encode())
    if arguments.out is not None:
        write_whole(arguments.out, text.encode())
    sys.stdout.write(text if arguments.json else "\n".join(calibration_lines(outcome)) + "\n")
    for told in (
        *outcome.warnings,
        *(f"{sensor}: {warning}" for sensor in outcome.fits for warning in outcome.sensor_warnings.get(sensor, ())),
        *outcome.advice,
    ):
        sys.stderr.write(f"telefuse calibrate: {told}\n")
    return 0


def calibration_lines(outcome: CalibrationOutcome) -> list[str]:
    """Parameters with their standard deviations."""
    lines: list[str] = []
    for sensor, fit in outcome.fits.items():
        lines += [""] if lines else []
        if isinstance(fit, MagnetometerFit):
            sd = np.sqrt(np.diag(fit.covariance))
            lines.append(
                f"{sensor}: {fit.residuals.size} samples, field {fit.field_strength:.4g}, missed by "
                f"{fit.residual_rms:.3g} RMS, {100.0 * fit.coverage:.0f} % of all directions seen"
            )
            lines.append(_row("hard iron", np.array(fit.calibration.hard_iron), sd[:3]))
            rows = np.array(fit.calibration.soft_iron)
            lines += [_row(f"soft iron {axis}", rows[i], sd[3 + 3 * i : 6 + 3 * i]) for i, axis in enumerate("xyz")]
        else:
            lines.append(
                f"{sensor}: {fit.positions} positions, {_missed(sensor, fit, outcome.gravity_mps2)} RMS, "
                f"{fit.iterations} iterations ({fit.stop})"
            )
            names = ("scale", "misalignment, rad", "bias")
            values = (fit.calibration.scale, fit.calibration.misalignment, fit.calibration.bias)
            for i, (name, value) in enumerate(zip(names, values, strict=True)):
                lines.append(_row(name, np.array(value), fit.sd[3 * i : 3 * i + 3]))
            if isinstance(fit, GyroscopeFit):
                lines.append(_row("alignment, rad", np.array(fit.alignment_rad), fit.alignment_sd))
        if not fit.observability.observable:
            lines.append(f"  not told by this recording: {', '.join(fit.observability.weak)}")
    return lines


def _missed(sensor: str, fit: TriadFit, gravity_mps2: float) -> str:
    if isinstance(fit, GyroscopeFit):
        return f"gravity missed by {math.degrees(fit.residual_rms):.3g}°"
    if sensor == "gyroscope":
        return f"the Earth's rate missed by {math.degrees(fit.residual_rms):.3g}°/s"
    return f"gravity {gravity_mps2:.5f} m/s² missed by {1e3 * fit.residual_rms:.3g} mm/s²"


def _row(name: str, values: Any, sds: Any) -> str:
    cells = (f"{value:.6g} ± {sd:.1g}" for value, sd in zip(values, sds, strict=True))
    return f"  {name:18}" + "".join(f"{cell:<24}" for cell in cells).rstrip()


def _options(arguments: argparse.Namespace) -> CalibrationOptions:
    priors = CalibrationOptions()
    changes: dict[str, Any] = {
        f"{sensor}_prior": _prior(getattr(priors, f"{sensor}_prior"), sensor, arguments.prior) for sensor in SENSORS
    }
    place = None
    if arguments.latitude is None and arguments.height is not None:
        raise UsageError("--height needs --latitude; expected both, or --gravity")
    if arguments.latitude is not None:
        if arguments.gravity is not None:
            raise UsageError("--gravity and --latitude both say how strong gravity is; expected one of them")
        height_m = 0.0 if arguments.height is None else arguments.height
        for name, value, (low, high) in (("latitude", arguments.latitude, _LATITUDE), ("height", height_m, _HEIGHT_M)):
            if not low <= value <= high:
                raise UsageError(f"--{name} {value:g} is beyond the Earth; expected {low:g} to {high:g}")
        place = (math.radians(arguments.latitude), height_m)
    return CalibrationOptions(
        sensor=arguments.sensor,
        gravity_mps2=arguments.gravity,
        place=place,
        field_ut=arguments.field,
        sections_s=None if arguments.sections is None else _sections(arguments.sections),
        level=arguments.level,
        earth_rate=arguments.earth_rate,
        **changes,
    )


def _prior(prior: Any, sensor: str, given: list[str]) -> Any:
    """A prior with what was given of it; raises UsageError that names what there is."""
    for text in given:
        name, separator, value = text.partition("=")
        whose, dot, key = name.partition(".")
        if not (separator and dot) or whose not in SENSORS:
            raise UsageError(f"--prior {text}: expected SENSOR.NAME=VALUE with one of {', '.join(SENSORS)}")
        if whose != sensor:
            continue
        known = [field.name for field in dataclasses.fields(prior)]
        if key not in known:
            raise UsageError(f"--prior {text}: '{key}' is none; the {sensor} has {', '.join(known)}")
        try:
            prior = dataclasses.replace(prior, **{key: float(value)})
        except ValueError as error:
            raise UsageError(f"--prior {text}: '{value}' is no number") from error
        except InvalidInputError as error:
            raise UsageError(f"--prior {text}: {error}") from error
    return prior


def _sections(path: Path) -> tuple[tuple[float, float], ...]:
    table = read_table(path, ("start_s", "end_s"))
    sections = tuple(zip(table["start_s"].tolist(), table["end_s"].tolist(), strict=True))
    for number, (start_s, end_s) in enumerate(sections, start=1):
        if not start_s < end_s:
            raise UsageError(
                f"{path}: section {number} is {start_s:g} s to {end_s:g} s; expected its end after its start"
            )
    return sections
