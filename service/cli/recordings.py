"""What the commands on calibration recordings share: their arguments, reading with a bar."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from pathlib import Path

from service.cli.progress import Progress
from service.recordings.calibration_recording import ReadingOptions, ReadRecording, read_recording


def add_recording(parser: argparse.ArgumentParser) -> None:
    """Declare the recording and what is known of it."""
    parser.add_argument(
        "recording",
        type=Path,
        metavar="RECORDING",
        help="CSV file, plain or .gz, with the columns of a drive folder's imu.csv (t_s, ax_mps2 …, gx_radps …; mx_ut …"
        " and temperature_c where there are), other units by their suffix (_g, _mg, _dps), or a drive folder",
    )
    parser.add_argument("--counts", action="store_true", help="the input is raw converter counts (ax_raw … or ax …)")
    parser.add_argument(
        "--rate",
        type=number_above(0.0, "samples a second, above 0"),
        metavar="HZ",
        help="samples a second of a file with no t_s (default: its line Fs,HZ)",
    )
    parser.add_argument("--accel-unit", choices=("mps2", "g", "mg"), help="of accelerometer columns that name none")
    parser.add_argument("--gyro-unit", choices=("radps", "dps", "mdps"), help="of gyroscope columns that name none")


def read_with_bar(arguments: argparse.Namespace) -> ReadRecording:
    """Read the recording, with a bar on a terminal."""
    options = ReadingOptions(arguments.counts, arguments.rate, arguments.accel_unit, arguments.gyro_unit)
    with Progress("reading", 100) as progress:
        return read_recording(arguments.recording, options, lambda share: progress.update(int(100 * share)))


def number_above(low: float, expected: str) -> Callable[[str], float]:
    """An argument's type: a finite number above ``low``."""

    def read(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not (math.isfinite(value) and value > low):
            raise argparse.ArgumentTypeError(f"'{text}' is not {expected}")
        return value

    return read
