"""Valhalla: how it is configured, how its tiles are built, and an actor that works on them."""

from __future__ import annotations

import json
import subprocess
import tempfile
from pathlib import Path
from typing import Any, Final

import numpy as np
import valhalla

from service.errors import UsageError
from service.roads.protocol import FloatArray

FARTHEST_M: Final = 200.0
"""How far from a position its road is looked for at most."""
NOT_FOUND: Final = RuntimeError
"""What an actor raises where it finds no road or no way; newer versions raise a kind of it."""
_BINARIES: Final = Path(valhalla.__file__).parent / "bin"


def configuration(tiles: Path, sigma_m: float = 4.07, **mjolnir: object) -> dict[str, Any]:
    """A configuration for tiles in a folder; ``sigma_m`` is the spread of positions about their road."""
    config: dict[str, Any] = valhalla.get_config(tile_extract="", tile_dir=tiles)
    config["mjolnir"].update(traffic_extract="", timezone="", admin="", landmarks="", concurrency=1, **mjolnir)
    for part in ("mjolnir", "loki", "thor", "odin", "meili"):
        config[part]["logging"] = {"type": ""}
    config["meili"]["default"].update(sigma_z=sigma_m, max_search_radius=FARTHEST_M)
    config["service_limits"]["trace"].update(max_search_radius=FARTHEST_M, max_gps_accuracy=FARTHEST_M)
    return config


def actor(tiles: Path, sigma_m: float) -> Any:
    """What matches and routes on tiles."""
    with tempfile.TemporaryDirectory(prefix="telefuse-roads-") as directory:
        path = Path(directory) / "valhalla.json"  # given the figures themselves, it would leave a file behind
        path.write_text(json.dumps(configuration(tiles, sigma_m)))
        return valhalla.Actor(path)


def version() -> str:
    """Of the package that builds and matches."""
    return str(valhalla.__version__)


def build_tiles(extract: Path, tiles: Path, scratch: Path) -> None:
    """Build the tiles of an extract; ``scratch`` is a folder for what is needed on the way only."""
    tiles.mkdir()
    admin = str(scratch / "admins.sqlite")
    config = configuration(tiles, include_pedestrian=False, include_bicycle=False)
    config["mjolnir"].update(admin=admin, logging={"type": "std_err", "color": False})
    path = scratch / "valhalla.json"
    path.write_text(json.dumps(config))
    for program in ("valhalla_build_admins", "valhalla_build_tiles"):
        done = subprocess.run(
            [str(_BINARIES / program), "-c", str(path), str(extract.resolve())],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            check=False,
            cwd=scratch,  # it leaves lists of what it found odd where it runs
        )
        if done.returncode != 0:
            lines = [line for line in (done.stderr or done.stdout).splitlines() if line.strip()]
            said = next(
                (line for line in reversed(lines) if "ERROR" in line), lines[-1] if lines else "it said nothing"
            )
            raise UsageError(f"{extract}: {program} ended with {done.returncode}: {said.strip()}")
    if next(tiles.rglob("*.gph"), None) is None:
        raise UsageError(f"{extract}: no road tiles came of it; expected an extract with roads for cars")


def decoded(polyline: str) -> FloatArray:
    """Points (n, 2), longitude and latitude, of Google's polyline with six decimals, as Valhalla writes it."""
    numbers, value, shift = [], 0, 0
    for character in polyline:
        bits = ord(character) - 63
        value |= (bits & 0x1F) << shift
        shift += 5
        if bits < 0x20:
            numbers.append(~(value >> 1) if value & 1 else value >> 1)
            value, shift = 0, 0
    return np.cumsum(np.array(numbers, np.int64).reshape(-1, 2), axis=0)[:, ::-1] / 1e6
