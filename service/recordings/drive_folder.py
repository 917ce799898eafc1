"""The drive folder: what a box recorded, as CSV files with a drive.toml, read and written as a ``Drive``."""

from __future__ import annotations

import json
import math
import os
import shutil
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from core.atmosphere import PRESSURE_RANGE_PA
from core.measurements import GNSS, GNSS_COLUMNS, FloatArray, Measurements, TimeArray
from service.errors import RecordingError
from service.recordings.csv_tables import (
    NS_PER_S,
    Share,
    find_table,
    format_table,
    gzip_bytes,
    read_table,
    time_column,
    times_ns,
    untold,
)
from service.recordings.drive_toml import DriveHeader, Driver, GnssSetup, ImuSetup, header_text, read_header

IMU_CSV_COLUMNS: Final = ("t_s", "ax_mps2", "ay_mps2", "az_mps2", "gx_radps", "gy_radps", "gz_radps")
MAGNETOMETER_CSV_COLUMNS: Final = ("t_s", "mx_ut", "my_ut", "mz_ut")
BAROMETER_CSV_COLUMNS: Final = ("t_s", "pressure_hpa")
ATTITUDE_CSV_COLUMNS: Final = ("t_s", "qw", "qx", "qy", "qz")
REFERENCE_CSV_COLUMNS: Final = (
    "t_s",
    "lat_deg",
    "lon_deg",
    "alt_ellipsoid_m",
    "vn_mps",
    "ve_mps",
    "vd_mps",
    "roll_deg",
    "pitch_deg",
    "yaw_deg",
)
_PA_PER_HPA: Final = 100.0


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """Where the vehicle really was: ``t_ns`` (n,); angles rad; ``v_n_mps`` and ``rpy_rad`` (n, 3)."""

    t_ns: TimeArray
    lat_rad: FloatArray
    lon_rad: FloatArray
    alt_m: FloatArray
    v_n_mps: FloatArray
    rpy_rad: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class AttitudeSeries:
    """The sensor's own attitude: ``t_ns`` (n,) and ``q_n_from_b`` (n, 4), scalar first."""

    t_ns: TimeArray
    q_n_from_b: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """One recorded drive. Heights in ``measurements.gnss`` are above mean sea level if ``gnss_alt_is_msl``."""

    name: str
    start_t_ns: int
    vehicle_id: str
    measurements: Measurements
    imu: ImuSetup = field(default_factory=ImuSetup)
    gnss: GnssSetup = field(default_factory=GnssSetup)
    driver: Driver = field(default_factory=Driver)
    gnss_alt_is_msl: bool = False
    reference: Reference | None = None
    attitude: AttitudeSeries | None = None
    truth: Mapping[str, Any] | None = None

    def t_s(self, t_ns: TimeArray) -> FloatArray:
        """Times of this drive as seconds from its zero."""
        return (t_ns - self.start_t_ns) / NS_PER_S


def read_drive(folder: Path | str, progress: Share = untold) -> Drive:
    """Read a drive folder; raises RecordingError with file, line, column and what was expected.

    ``progress`` follows the two long tables, those of the inertial samples and the reference.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise RecordingError(f"{folder}: no such folder; expected a drive folder with drive.toml and imu.csv")
    header = read_header(folder / "drive.toml")
    start_t_ns = header.start_t_ns
    gnss_t_ns, gnss_rows, is_msl = _read_gnss(folder, start_t_ns)
    if find_table(folder, "imu.csv") is None:
        raise RecordingError(f"{folder}: imu.csv is missing (or imu.csv.gz); a drive folder needs it")
    imu_share = _imu_share(folder)
    imu_t_ns, imu = _series(folder, "imu.csv", IMU_CSV_COLUMNS, start_t_ns, lambda share: progress(imu_share * share))
    if not imu_t_ns.size:
        raise RecordingError(f"{folder}: imu.csv has a header and no rows; expected at least one sample")
    magnetometer_t_ns, magnetic_s_ut = _series(folder, "magnetometer.csv", MAGNETOMETER_CSV_COLUMNS, start_t_ns)
    speed_t_ns, speed = _series(folder, "speed.csv", ("t_s", "speed_mps"), start_t_ns)
    barometer_t_ns, pressure_pa = _read_barometer(folder, start_t_ns)
    measurements = Measurements(
        imu_t_ns=imu_t_ns,
        f_s=np.ascontiguousarray(imu[:, :3]),
        omega_s=np.ascontiguousarray(imu[:, 3:]),
        gnss_t_ns=gnss_t_ns,
        gnss=gnss_rows,
        magnetometer_t_ns=magnetometer_t_ns,
        magnetic_s_ut=magnetic_s_ut,
        speed_t_ns=speed_t_ns,
        speed_mps=np.ascontiguousarray(speed[:, 0]),
        barometer_t_ns=barometer_t_ns,
        pressure_pa=pressure_pa,
        accel_full_scale_mps2=header.imu.accel_full_scale_mps2 or math.nan,
    )
    return Drive(
        name=header.name,
        start_t_ns=start_t_ns,
        vehicle_id=header.vehicle_id,
        measurements=measurements,
        imu=header.imu,
        gnss=header.gnss,
        driver=header.driver,
        gnss_alt_is_msl=is_msl,
        reference=_read_reference(folder, start_t_ns, lambda share: progress(imu_share + (1.0 - imu_share) * share)),
        attitude=_read_attitude(folder, start_t_ns),
        truth=_read_truth(folder / "truth.json"),
    )


def is_drive_folder(folder: Path) -> bool:
    """Whether a folder looks like a drive folder (and so may be written over by another drive)."""
    return (folder / "drive.toml").is_file() and find_table(folder, "imu.csv") is not None


def write_drive(folder: Path | str, drive: Drive) -> None:
    """Write a drive folder, whole or not at all: an empty or a drive folder of that name is replaced."""
    folder = Path(folder)
    if folder.exists() and not (folder.is_dir() and (is_drive_folder(folder) or not any(folder.iterdir()))):
        raise RecordingError(f"{folder}: is there and no drive folder; choose a new or an empty folder")
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
    except OSError as error:
        raise RecordingError(f"{folder}: cannot be written: {error.strerror}") from error
    try:
        temporary.chmod(0o755)
        for name, content in _files(drive).items():
            (temporary / name).write_bytes(content)
        if folder.exists():
            old = temporary.with_name(f"{temporary.name}.old")
            os.rename(folder, old)
            os.rename(temporary, folder)
            shutil.rmtree(old)
        else:
            os.rename(temporary, folder)
    except OSError as error:
        raise RecordingError(f"{folder}: cannot be written: {error.strerror}") from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _files(drive: Drive) -> dict[str, bytes]:
    m = drive.measurements

    def table(t_ns: TimeArray, columns: Mapping[str, tuple[npt.ArrayLike, str]]) -> bytes:
        return gzip_bytes(format_table({"t_s": time_column(t_ns, drive.start_t_ns), **columns}))

    header = DriveHeader(drive.name, drive.start_t_ns, drive.vehicle_id, drive.imu, drive.gnss, drive.driver)
    imu = np.hstack([m.f_s, m.omega_s])
    files = {
        "drive.toml": header_text(header).encode(),
        "imu.csv.gz": table(m.imu_t_ns, {n: (imu[:, i], "%.9g") for i, n in enumerate(IMU_CSV_COLUMNS[1:])}),
    }
    if m.gnss_t_ns.size:
        files["gnss.csv.gz"] = table(m.gnss_t_ns, _gnss_columns(drive))
    if m.magnetometer_t_ns.size:
        columns = {name: (m.magnetic_s_ut[:, i], "%.9g") for i, name in enumerate(MAGNETOMETER_CSV_COLUMNS[1:])}
        files["magnetometer.csv.gz"] = table(m.magnetometer_t_ns, columns)
    if m.speed_t_ns.size:
        files["speed.csv.gz"] = table(m.speed_t_ns, {"speed_mps": (m.speed_mps, "%.6g")})
    if m.barometer_t_ns.size:
        files["barometer.csv.gz"] = table(m.barometer_t_ns, {"pressure_hpa": (m.pressure_pa / _PA_PER_HPA, "%.9g")})
    if drive.attitude is not None:
        q = drive.attitude.q_n_from_b
        files["attitude.csv.gz"] = table(
            drive.attitude.t_ns, {name: (q[:, i], "%.9f") for i, name in enumerate(ATTITUDE_CSV_COLUMNS[1:])}
        )
    if drive.reference is not None:
        files["reference.csv.gz"] = table(drive.reference.t_ns, _reference_columns(drive.reference))
    if drive.truth is not None:
        files["truth.json"] = (json.dumps(drive.truth, indent=2, allow_nan=False) + "\n").encode()
    return files


def _gnss_columns(drive: Drive) -> dict[str, tuple[npt.ArrayLike, str]]:
    rows = drive.measurements.gnss
    columns: dict[str, tuple[npt.ArrayLike, str]] = {}
    for index, name in enumerate(GNSS_COLUMNS):
        values = rows[:, index]
        if name == "alt_m":
            columns["alt_msl_m" if drive.gnss_alt_is_msl else "alt_ellipsoid_m"] = (values, "%.4f")
        elif name in ("lat_rad", "lon_rad"):
            columns[name.replace("_rad", "_deg")] = (np.degrees(values), "%.10f")
        elif not np.isnan(values).all():
            is_angle = name.endswith("_rad")
            columns[name.replace("_rad", "_deg")] = (np.degrees(values) if is_angle else values, "%.7g")
    return columns


def _reference_columns(reference: Reference) -> dict[str, tuple[npt.ArrayLike, str]]:
    rpy_deg = np.degrees(reference.rpy_rad)
    return {
        "lat_deg": (np.degrees(reference.lat_rad), "%.10f"),
        "lon_deg": (np.degrees(reference.lon_rad), "%.10f"),
        "alt_ellipsoid_m": (reference.alt_m, "%.4f"),
        **{name: (reference.v_n_mps[:, i], "%.5f") for i, name in enumerate(("vn_mps", "ve_mps", "vd_mps"))},
        **{name: (rpy_deg[:, i], "%.5f") for i, name in enumerate(("roll_deg", "pitch_deg", "yaw_deg"))},
    }


def _imu_share(folder: Path) -> float:
    """What the inertial table is of both long tables, by their bytes."""
    paths = (find_table(folder, name) for name in ("imu.csv", "reference.csv"))
    imu, reference = (0 if path is None else path.stat().st_size for path in paths)
    return imu / max(imu + reference, 1)


def _series(
    folder: Path, name: str, columns: tuple[str, ...], start_t_ns: int, progress: Share = untold
) -> tuple[TimeArray, FloatArray]:
    """Times and the other columns of a table; no rows if the folder has no such table."""
    path = find_table(folder, name)
    if path is None:
        return np.empty(0, dtype=np.int64), np.empty((0, len(columns) - 1))
    table = read_table(path, columns, progress=progress)
    return times_ns(table["t_s"], start_t_ns), np.column_stack([table[column] for column in columns[1:]])


def _read_gnss(folder: Path, start_t_ns: int) -> tuple[TimeArray, FloatArray, bool]:
    path = find_table(folder, "gnss.csv")
    if path is None:
        return np.empty(0, dtype=np.int64), np.empty((0, len(GNSS_COLUMNS))), False
    others = {
        name: name.replace("_rad", "_deg") for name in GNSS_COLUMNS if name not in ("lat_rad", "lon_rad", "alt_m")
    }
    optional = ("alt_ellipsoid_m", "alt_msl_m", *others.values())
    table = read_table(path, ("t_s", "lat_deg", "lon_deg"), optional)
    is_msl = "alt_ellipsoid_m" not in table
    if is_msl and "alt_msl_m" not in table:
        raise RecordingError(f"{path}: line 1: no height; expected a column 'alt_ellipsoid_m' or 'alt_msl_m'")
    for some, missing in (
        ("vn_mps", "ve_mps"),
        ("ve_mps", "vd_mps"),
        ("vd_mps", "vn_mps"),
        ("course_deg", "speed_mps"),
    ):
        if some in table and missing not in table:
            raise RecordingError(f"{path}: line 1: column '{some}' needs '{missing}' beside it")
    rows = np.full((table["t_s"].size, len(GNSS_COLUMNS)), np.nan)
    rows[:, GNSS["lat_rad"]] = np.radians(table["lat_deg"])
    rows[:, GNSS["lon_rad"]] = np.radians(table["lon_deg"])
    rows[:, GNSS["alt_m"]] = table["alt_msl_m" if is_msl else "alt_ellipsoid_m"]
    for name, written in others.items():
        if written in table:
            rows[:, GNSS[name]] = np.radians(table[written]) if name.endswith("_rad") else table[written]
    return times_ns(table["t_s"], start_t_ns), rows, is_msl


def _read_barometer(folder: Path, start_t_ns: int) -> tuple[TimeArray, FloatArray]:
    """Times and pressures, Pa; a row without a pressure is no sample, and a column in another unit is refused."""
    t_ns, rows = _series(folder, "barometer.csv", BAROMETER_CSV_COLUMNS, start_t_ns)
    there = np.isfinite(rows[:, 0])
    pressure_pa = rows[there, 0] * _PA_PER_HPA
    low, high = PRESSURE_RANGE_PA
    if pressure_pa.size and not low <= np.median(pressure_pa) <= high:
        raise RecordingError(
            f"{folder}: barometer.csv: column 'pressure_hpa' is {np.median(rows[there, 0]):g} in the middle; expected "
            f"{low / _PA_PER_HPA:g} to {high / _PA_PER_HPA:g} hPa at the box, not reduced to the sea and not in Pa"
        )
    return t_ns[there], pressure_pa


def _read_reference(folder: Path, start_t_ns: int, progress: Share) -> Reference | None:
    if find_table(folder, "reference.csv") is None:
        return None
    t_ns, rows = _series(folder, "reference.csv", REFERENCE_CSV_COLUMNS, start_t_ns, progress)
    return Reference(
        t_ns=t_ns,
        lat_rad=np.radians(rows[:, 0]),
        lon_rad=np.radians(rows[:, 1]),
        alt_m=rows[:, 2].copy(),
        v_n_mps=rows[:, 3:6].copy(),
        rpy_rad=np.radians(rows[:, 6:9]),
    )


def _read_attitude(folder: Path, start_t_ns: int) -> AttitudeSeries | None:
    if find_table(folder, "attitude.csv") is None:
        return None
    return AttitudeSeries(*_series(folder, "attitude.csv", ATTITUDE_CSV_COLUMNS, start_t_ns))


def _read_truth(path: Path) -> Mapping[str, Any] | None:
    if not path.is_file():
        return None
    try:
        truth = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise RecordingError(f"{path}: is no JSON: {error}") from error
    if not isinstance(truth, dict):
        raise RecordingError(f"{path}: holds no JSON object; expected one with 'accidents' and 'outages'")
    return truth
