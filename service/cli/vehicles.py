"""``telefuse vehicles import``: register a fleet from a CSV file, all of it or none."""

from __future__ import annotations

import argparse
import csv
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from pydantic import ValidationError

from schemas.keys import MAX_TENANT_ID, MAX_VEHICLE_ID, NAME_RULE, is_name, zenoh_prefix
from schemas.vehicles import VehicleConfig
from service import settings
from service.cli import OneLineParser
from service.cli.keys import database
from service.errors import UsageError
from service.storage import tenants, vehicles
from service.storage.database import write
from service.storage.tenants import DEFAULT_TENANT

TRIPLES: Final = {
    "mounting_rpy_deg": ("mounting_roll_deg", "mounting_pitch_deg", "mounting_yaw_deg"),
    "imu_lever_arm_m": ("imu_forward_m", "imu_right_m", "imu_down_m"),
    "gnss_lever_arm_m": ("gnss_forward_m", "gnss_right_m", "gnss_down_m"),
}
"""Settings of three numbers with their columns, which stand together or not at all."""

SINGLES: Final = ("gnss_time_offset_s", "accel_full_scale_mps2", "vehicle_class", "detector", "time_zone")

COLUMNS: Final = ("vehicle_id", *(column for triple in TRIPLES.values() for column in triple), *SINGLES)


def configure(parser: argparse.ArgumentParser) -> None:
    """import FILE."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True, parser_class=OneLineParser)
    text = (
        "register the vehicles of a CSV file with a header row, or give registered ones its settings; an empty cell "
        "leaves a setting at its default. A running service knows new vehicles at once, changed ones when restarted"
    )
    action = actions.add_parser("import", help="register the vehicles of a CSV file", description=text)
    action.add_argument("file", type=Path, metavar="FILE.csv", help=f"columns: {', '.join(COLUMNS)}")
    action.add_argument("--tenant", default=DEFAULT_TENANT, help=f"whose they are (default {DEFAULT_TENANT})")
    settings.add_arguments(action, ["database_url", "data_dir"])


def run(arguments: argparse.Namespace) -> int:
    """Import in one transaction, and print each vehicle with its Zenoh prefix."""
    tenant_id: str = arguments.tenant
    if not is_name(tenant_id, MAX_TENANT_ID):
        raise UsageError(f"--tenant '{tenant_id}': expected {NAME_RULE}, at most {MAX_TENANT_ID} characters")
    fleet = read_fleet(arguments.file)
    with database(settings.from_arguments(arguments).settings.database_url) as engine, write(engine) as connection:
        tenants.ensure(connection, tenant_id)
        for vehicle_id, config in fleet.items():
            vehicles.put(connection, tenant_id, vehicle_id, config)
    for vehicle_id in fleet:
        print(f"{vehicle_id}\t{zenoh_prefix(tenant_id, vehicle_id)}")
    return 0


def read_fleet(path: Path) -> dict[str, VehicleConfig]:
    """Vehicles and their settings, in the file's order; UsageError names the line of what is wrong."""
    fleet: dict[str, VehicleConfig] = {}
    lines: dict[str, int] = {}
    for line, row in _rows(path):
        where = f"{path}, line {line}"
        vehicle_id = row["vehicle_id"]
        if not is_name(vehicle_id, MAX_VEHICLE_ID):
            raise UsageError(
                f"{where}: vehicle_id '{vehicle_id}': expected {NAME_RULE}, at most {MAX_VEHICLE_ID} characters"
            )
        if vehicle_id in fleet:
            raise UsageError(f"{where}: vehicle_id '{vehicle_id}' is in line {lines[vehicle_id]} already")
        fleet[vehicle_id] = _config(where, row)
        lines[vehicle_id] = line
    return fleet


def _rows(path: Path) -> Iterator[tuple[int, dict[str, str]]]:
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.reader(file, strict=True)
            header = [name.strip() for name in next(reader, [])]
            _check_header(path, header)
            for cells in reader:
                if not any(cell.strip() for cell in cells):
                    continue
                if len(cells) != len(header):
                    raise UsageError(
                        f"{path}, line {reader.line_num}: {len(cells)} cells, expected {len(header)} as in the header"
                    )
                yield reader.line_num, dict(zip(header, (cell.strip() for cell in cells), strict=True))
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror or error}; expected a CSV file of vehicles") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise UsageError(f"{path}: not a CSV file in UTF-8: {error}") from error


def _check_header(path: Path, header: list[str]) -> None:
    for name in header:
        if name not in COLUMNS:
            raise UsageError(f"{path}, line 1: unknown column '{name}'; expected some of {', '.join(COLUMNS)}")
        if header.count(name) > 1:
            raise UsageError(f"{path}, line 1: column '{name}' is there twice")
    if "vehicle_id" not in header:
        raise UsageError(f"{path}, line 1: there is no column 'vehicle_id'")
    for triple in TRIPLES.values():
        given = [name for name in triple if name in header]
        if given and len(given) < 3:
            raise UsageError(f"{path}, line 1: {', '.join(triple)} stand together; found {', '.join(given)} only")


def _config(where: str, row: dict[str, str]) -> VehicleConfig:
    values: dict[str, Any] = {name: row[name] for name in SINGLES if row.get(name)}
    for name, triple in TRIPLES.items():
        cells = [row.get(column, "") for column in triple]
        if any(cells):
            if not all(cells):
                missing = next(column for column, cell in zip(triple, cells, strict=True) if not cell)
                raise UsageError(f"{where}: {missing} is empty while others of {', '.join(triple)} are given")
            values[name] = cells
    try:
        return VehicleConfig.model_validate(values)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        setting, *index = first["loc"]
        column = TRIPLES[str(setting)][int(index[0])] if index else str(setting)
        raise UsageError(f"{where}: {column} '{first['input']}': {first['msg']}") from error
