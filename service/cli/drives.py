"""What the commands that work on a drive folder share: arguments, reading, what is known of the box, settings."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

import pydantic

from core.session import SessionConfig
from schemas.calibration import Calibration
from schemas.model import Model
from schemas.vehicles import SensorNoise
from service.cli.progress import Progress
from service.errors import UsageError
from service.recordings.drive_folder import Drive, read_drive
from service.recordings.fusing import Fused, Outage, fuse, fuse_config, vehicle_config
from service.recordings.fusing_ecef import fuse_ecef

_Settings = TypeVar("_Settings", bound=Model)


def add_drive(parser: argparse.ArgumentParser) -> None:
    """Declare the drive folder and the calibration."""
    parser.add_argument("drive", metavar="DRIVE", type=Path, help="drive folder")
    parser.add_argument(
        "--calibration", type=Path, metavar="FILE", help="calibration of the box, as JSON (default: as measured)"
    )
    parser.add_argument(
        "--noise",
        type=Path,
        metavar="FILE",
        help="noise of its sensors, as JSON (default: as drive.toml says, if it does)",
    )


def read_settings(path: Path | None, form: type[_Settings], expected: str) -> _Settings | None:
    """Read a JSON file of a part of a vehicle's settings; raises UsageError that names what is wrong in it."""
    if path is None:
        return None
    try:
        return form.model_validate_json(path.read_bytes())
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror}") from error
    except pydantic.ValidationError as error:
        first: Any = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"]) or "the document"
        raise UsageError(f"{path}: {where}: {first['msg']}; expected {expected}") from error


def open_drive(arguments: argparse.Namespace, **switches: Any) -> tuple[Drive, SessionConfig]:
    """The drive and the settings of its session; ``switches`` as of ``fuse_config``."""
    drive = read_with_progress(arguments.drive)
    calibration = read_settings(arguments.calibration, Calibration, "a calibration as PUT …/calibration takes")
    if calibration is not None:
        try:
            calibration.check_units()
        except ValueError as error:
            raise UsageError(f"{arguments.calibration}: {error}") from None
    noise = read_settings(arguments.noise, SensorNoise, "what 'telefuse noise --json' prints: SI units")
    return drive, fuse_config(vehicle_config(drive, noise), calibration, **switches)


def check_outages(outages: Sequence[Outage], drive: Drive) -> None:
    """Raise UsageError for an outage outside the drive."""
    first_s, last_s = (float(t_s) for t_s in drive.t_s(drive.measurements.imu_t_ns[[0, -1]]))
    for outage in outages:
        span = f"outage {outage.start_s:g}:{outage.duration_s:g}"
        if outage.start_s >= last_s:
            raise UsageError(f"{span} begins after the drive's end at {last_s:g} s")
        if outage.end_s <= first_s:
            raise UsageError(f"{span} ends before the drive's first sample at {first_s:g} s")


def read_with_progress(folder: Path) -> Drive:
    """Read a drive folder, with a bar on a terminal."""
    with Progress("reading", 100) as progress:
        return read_drive(folder, lambda share: progress.update(int(100 * share)))


def fuse_ecef_with_progress(drive: Drive, config: SessionConfig, outages: list[Outage]) -> Fused:
    """Run the mobile-mapping paper's filter, with a bar; without attitude.csv our own filter goes before it."""
    ours = None if drive.attitude is not None else fuse_with_progress(drive, config, outages, keep=True)
    with Progress("fusing in ECEF", 100) as progress:
        return fuse_ecef(drive, config, outages, ours, lambda share: progress.update(int(100 * share)))


def fuse_with_progress(
    drive: Drive, config: SessionConfig, outages: list[Outage], *, keep: bool = False, smooth: bool = False
) -> Fused:
    """Fuse, with a bar on a terminal; ``keep`` and ``smooth`` as of ``fuse``."""
    with Progress("fusing", 100) as progress:
        return fuse(drive, config, outages, lambda share: progress.update(int(100 * share)), keep=keep, smooth=smooth)
