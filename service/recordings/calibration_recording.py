"""Recordings for calibration and noise: a CSV file in SI, other units or raw counts, or a drive folder."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Literal

import numpy as np

from core.calibration.recording import CalibrationRecording
from core.earth import STANDARD_GRAVITY_MPS2
from core.errors import InvalidInputError
from core.measurements import FloatArray
from service.errors import RecordingError
from service.recordings.csv_tables import Share, find_table, header_cells, read_table, read_text, table_of, untold
from service.recordings.drive_folder import MAGNETOMETER_CSV_COLUMNS

COUNTS: Final = "raw"
"""Suffix of a column of raw converter counts."""
UNITS: Final[Mapping[str, Mapping[str, float]]] = {
    "accelerometer": {"mps2": 1.0, "g": STANDARD_GRAVITY_MPS2, "mg": 1e-3 * STANDARD_GRAVITY_MPS2},
    "gyroscope": {
        "radps": 1.0,
        "dps": math.radians(1.0),
        "degps": math.radians(1.0),
        "mdps": 1e-3 * math.radians(1.0),
    },
    "magnetometer": {"ut": 1.0, "nt": 1e-3, "gauss": 100.0, "mgauss": 0.1},
}
"""Suffixes of columns with what makes m/s2, rad/s or microtesla of them."""
_PREFIX: Final = {
    "accelerometer": r"(?:a|acc_|accel_)",
    "gyroscope": r"(?:g|gyr_|gyro_)",
    "magnetometer": r"(?:m|mag_)",
}
_OTHER_MARKS: Final[Mapping[str, str]] = {";": "semicolons", "\t": "tabs", "|": "bars"}
_HEADER_WITHIN: Final = 20
"""Lines in which the header is looked for, after what a logger writes before it."""
_AT_REST: Final = (0.8, 1.2)
"""Norm of the specific force at rest over standard gravity, before calibration; data sheets allow 0.9 to 1.1."""

_RATES_HZ: Final = (1.0, 20_000.0)
"""Samples a second that a calibration can have: slower, a turn is lost between two; faster, no converter is."""

AccelUnit = Literal["mps2", "g", "mg"]
GyroUnit = Literal["radps", "dps", "mdps"]


@dataclass(frozen=True, slots=True, eq=False)
class ReadRecording:
    """A recording with what its file says of it: in counts or in m/s2, rad/s and microtesla, and its rate.

    ``place`` is the latitude (rad) and the height (m) of a folder's fixes.
    """

    name: str
    recording: CalibrationRecording
    counts: bool
    rate_hz: float
    place: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class ReadingOptions:
    """What the caller knows of a recording that its file does not say.

    ``counts`` is for columns with no unit or ``_raw``; ``rate_hz`` for files with no ``t_s``; the units are for
    columns that name none.
    """

    counts: bool = False
    rate_hz: float | None = None
    accel_unit: AccelUnit | None = None
    gyro_unit: GyroUnit | None = None


@dataclass(frozen=True, slots=True)
class _Axes:
    """The three columns of a sensor in a header, and their unit: "" where they name none."""

    columns: tuple[str, str, str]
    unit: str


def read_recording(path: Path | str, options: ReadingOptions | None = None, progress: Share = untold) -> ReadRecording:
    """Read a CSV file or a drive folder; raises RecordingError with file, line, column and what was expected."""
    path, options = Path(path), ReadingOptions() if options is None else options
    if path.is_dir():
        found = find_table(path, "imu.csv")
        if found is None:
            raise RecordingError(
                f"{path}: is a folder with no imu.csv or imu.csv.gz; expected a drive folder or a file"
            )
        read = replace(_read_file(found, options, progress), place=_place(path))
        magnetic = find_table(path, "magnetometer.csv")
        return read if magnetic is None else _with_magnetometer(read, magnetic)
    return _read_file(path, options, progress)


def _read_file(path: Path, options: ReadingOptions, progress: Share) -> ReadRecording:
    text = read_text(path)
    lines = text.split("\n", _HEADER_WITHIN)[:_HEADER_WITHIN]
    found = [(number, axes) for number, line in enumerate(lines) if (axes := _sensors(header_cells(line)))]
    if not found:
        if not text.strip():
            raise RecordingError(f"{path}: is empty; expected a header and samples")
        for number, line in enumerate(lines, start=1):
            other = next((name for mark, name in _OTHER_MARKS.items() if _sensors(header_cells(line, mark))), None)
            if other is not None:
                raise RecordingError(
                    f"{path}: line {number}: cells are parted by {other}; expected commas, and points in numbers"
                )
        raise RecordingError(
            f"{path}: no header with ax_mps2, ay_mps2, az_mps2 (or ax_g …, ax_raw …) in its first lines; expected the "
            "columns of a drive folder's imu.csv"
        )
    at, sensors = found[0]
    header = header_cells(lines[at])
    if "accelerometer" not in sensors:
        raise RecordingError(f"{path}: line {at + 1}: no accelerometer; expected columns ax_mps2, ay_mps2, az_mps2")
    factors = {name: _factor(path, at + 1, name, axes, options) for name, axes in sensors.items()}
    extras = [name for name in ("t_s", "temperature_c") if name in header]
    wanted = [*extras, *(column for axes in sensors.values() for column in axes.columns)]
    # Blank lines in place of what comes before the header keep the numbers of the lines.
    table = table_of(path, "\n" * at + text.split("\n", at)[at], wanted, progress)
    rows = len(table[wanted[-1]])
    if not rows:
        raise RecordingError(f"{path}: has a header and no rows; expected samples")
    t_s = table["t_s"] if "t_s" in table else np.arange(rows) / _rate(path, lines[:at], options)
    triads = {
        name: factors[name] * np.column_stack([table[column] for column in axes.columns])
        for name, axes in sensors.items()
    }
    try:
        recording = CalibrationRecording(
            t_s=t_s,
            accelerometer=triads["accelerometer"],
            gyroscope=triads.get("gyroscope"),
            magnetometer=triads.get("magnetometer"),
            temperature_c=table.get("temperature_c"),
        )
    except InvalidInputError as error:
        raise RecordingError(f"{path}: {error}") from error
    if rows < 2:
        raise RecordingError(f"{path}: one row; expected a recording")
    rate_hz = 1.0 / float(np.median(np.diff(t_s)))
    if not _RATES_HZ[0] <= rate_hz <= _RATES_HZ[1]:
        low, high = _RATES_HZ
        raise RecordingError(
            f"{path}: {rate_hz:.3g} samples a second; expected {low:g} to {high:g}: is the time in seconds, "
            "not in milliseconds?"
        )
    read = ReadRecording(path.name, recording, options.counts, rate_hz)
    _check_norm(path, read)
    return read


def _sensors(header: list[str]) -> dict[str, _Axes]:
    """Sensors of which a header has all three axes, in the unit that stands first; empty where it is no header."""
    found: dict[str, _Axes] = {}
    for sensor, prefix in _PREFIX.items():
        suffixes = (*UNITS[sensor], COUNTS)
        for x in header:
            match = re.fullmatch(rf"({prefix})x(?:_({'|'.join(suffixes)}))?", x)
            if match is None:
                continue
            end = "" if match[2] is None else f"_{match[2]}"
            columns = (x, f"{match[1]}y{end}", f"{match[1]}z{end}")
            if all(header.count(column) == 1 for column in columns):
                found[sensor] = _Axes(columns, match[2] or "")
                break
    return found


def _factor(path: Path, line: int, sensor: str, axes: _Axes, options: ReadingOptions) -> float:
    """What makes SI of the columns; 1 for counts."""
    column, units = axes.columns[0], UNITS[sensor]
    if options.counts:
        if axes.unit in units:
            raise RecordingError(
                f"{path}: line {line}: column '{column}' has a unit; with --counts expected columns like ax_raw"
            )
        return 1.0
    if axes.unit == COUNTS:
        raise RecordingError(f"{path}: line {line}: column '{column}' is in counts; say so with --counts")
    given = {"accelerometer": options.accel_unit, "gyroscope": options.gyro_unit}.get(sensor)
    unit = axes.unit or given
    if not unit:
        flag = {"accelerometer": ", or say --accel-unit", "gyroscope": ", or say --gyro-unit"}.get(sensor, "")
        names = ", ".join(f"{column}_{name}" for name in units)
        raise RecordingError(f"{path}: line {line}: column '{column}' says no unit; name it {names}{flag} or --counts")
    return units[unit]


def _rate(path: Path, before: list[str], options: ReadingOptions) -> float:
    """Samples a second of a file with no times: as the caller says, or a line ``Fs,100`` before the header."""
    if options.rate_hz is not None:
        return options.rate_hz
    for number, line in enumerate(before, start=1):
        match = re.fullmatch(r"\s*fs\s*[,:=;]\s*([0-9.eE+-]+)\s*", line, re.IGNORECASE)
        if match:
            try:
                rate_hz = float(match[1])
            except ValueError:
                rate_hz = math.nan
            if rate_hz > 0.0 and math.isfinite(rate_hz):
                return rate_hz
            raise RecordingError(f"{path}: line {number}: Fs is '{match[1]}'; expected samples a second")
    raise RecordingError(f"{path}: no column 't_s' and no line 'Fs,HZ' before the header; say the rate with --rate HZ")


def _check_norm(path: Path, read: ReadRecording) -> None:
    """Refuse a unit that cannot be: a box that mostly rests feels gravity."""
    norm = float(np.median(np.sqrt(np.square(read.recording.accelerometer).sum(axis=1))))
    if read.counts:
        return
    g = STANDARD_GRAVITY_MPS2
    low, high = _AT_REST
    if low * g <= norm <= high * g:
        return
    guesses = {"g (name the columns ax_g …)": 1.0, "mg (ax_mg …)": 1000.0, "ft/s²": g / 0.3048}
    looks = next((name for name, rest in guesses.items() if low * rest <= norm <= high * rest), None)
    if looks is None and norm > 100.0:
        looks = "raw counts (say --counts)"
    told = f"it looks like {looks}" if looks else "the unit is another, an axis is stuck, or the box was never at rest"
    raise RecordingError(f"{path}: the median of |a| is {norm:.4g}, at rest 9.8 m/s² ± 20 % is expected: {told}")


def _with_magnetometer(read: ReadRecording, path: Path) -> ReadRecording:
    """The recording with a folder's magnetometer, each of its samples in the inertial row nearest in time."""
    table = read_table(path, MAGNETOMETER_CSV_COLUMNS)
    recording = read.recording
    t_s = recording.t_s
    if not table["t_s"].size or read.counts:
        return read
    nearest = np.clip(np.searchsorted(t_s, table["t_s"]), 1, t_s.size - 1)
    nearest -= table["t_s"] - t_s[nearest - 1] < t_s[nearest] - table["t_s"]
    near = np.abs(t_s[nearest] - table["t_s"]) <= 1.0 / read.rate_hz
    field: FloatArray = np.full((t_s.size, 3), np.nan)
    field[nearest[near]] = np.column_stack([table[name] for name in MAGNETOMETER_CSV_COLUMNS[1:]])[near]
    return replace(read, recording=replace(recording, magnetometer=field))


def _place(folder: Path) -> tuple[float, float] | None:
    """Where a folder's fixes are, for gravity; a height above the sea is off by less than 0.0003 m/s2 in it."""
    path = find_table(folder, "gnss.csv")
    if path is None:
        return None
    table = read_table(path, ("t_s", "lat_deg"), ("alt_ellipsoid_m", "alt_msl_m"))
    height = table.get("alt_ellipsoid_m", table.get("alt_msl_m"))
    if height is None or not np.isfinite(table["lat_deg"]).any():
        return None
    alt_m = float(np.nanmedian(height)) if np.isfinite(height).any() else 0.0
    return math.radians(float(np.nanmedian(table["lat_deg"]))), alt_m
