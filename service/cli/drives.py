"""What the commands that work on a drive folder share: arguments, reading, calibration, a session's settings."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import pydantic

from core.session import SessionConfig
from schemas.vehicles import Calibration
from service.cli.progress import Progress
from service.errors import UsageError
from service.recordings.drive_folder import Drive, read_drive
from service.recordings.fusing import Fused, Outage, fuse, fuse_config, vehicle_config


def add_drive(parser: argparse.ArgumentParser) -> None:
    """Declare the drive folder and the calibration."""
    parser.add_argument("drive", metavar="DRIVE", type=Path, help="drive folder")
    parser.add_argument(
        "--calibration", type=Path, metavar="FILE", help="calibration of the box, as JSON (default: as measured)"
    )


def read_calibration(path: Path | None) -> Calibration | None:
    """Read a calibration file; raises UsageError that names what is wrong in it."""
    if path is None:
        return None
    try:
        return Calibration.model_validate_json(path.read_bytes())
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror}") from error
    except pydantic.ValidationError as error:
        first: Any = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"]) or "the document"
        raise UsageError(
            f"{path}: {where}: {first['msg']}; expected a calibration as PUT …/calibration takes"
        ) from error


def open_drive(arguments: argparse.Namespace, **switches: Any) -> tuple[Drive, SessionConfig]:
    """The drive and the settings of its session; ``switches`` as of ``fuse_config``."""
    drive = read_drive(arguments.drive)
    return drive, fuse_config(vehicle_config(drive, read_calibration(arguments.calibration)), **switches)


def fuse_with_progress(drive: Drive, config: SessionConfig, outages: list[Outage]) -> Fused:
    """Fuse, with a bar on a terminal."""
    with Progress("fusing", 100) as progress:
        return fuse(drive, config, outages, lambda share: progress.update(int(100 * share)))
