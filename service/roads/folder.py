"""A folder of built roads: what is in it, and whether this version can read it."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from service.errors import UsageError
from service.recordings.files import write_whole

FORMAT: Final = 1
"""Of the folder; another one is built anew."""
ATTRIBUTION: Final = "© OpenStreetMap contributors, ODbL 1.0"
_MANIFEST: Final = "manifest.json"


@dataclass(frozen=True, slots=True)
class Manifest:
    """What a folder was built from, and what came of it."""

    format: int
    extract: str
    extract_sha256: str
    extract_made: str | None
    box_deg: tuple[float, float, float, float]
    countries: tuple[str, ...]
    ways: int
    ways_with_stated_limit: int
    ways_with_assumed_limit: int
    district_level: int | None
    districts: int
    valhalla: str
    attribution: str = ATTRIBUTION

    def json(self) -> dict[str, Any]:
        """As it is written and printed."""
        return asdict(self)


@dataclass(frozen=True, slots=True)
class RoadFolder:
    """Where the parts of built roads are."""

    path: Path

    @property
    def tiles(self) -> Path:
        """Valhalla's tiles."""
        return self.path / "tiles"

    @property
    def ways(self) -> Path:
        """The columns of the ways."""
        return self.path / "ways"

    @property
    def districts(self) -> Path:
        """The districts' areas."""
        return self.path / "districts.geojson"

    def is_built(self) -> bool:
        """Whether there is a manifest, of whatever version."""
        return (self.path / _MANIFEST).is_file()

    def write_manifest(self, manifest: Manifest) -> None:
        """The last thing to be written: with it, the folder is whole."""
        write_whole(self.path / _MANIFEST, json.dumps(manifest.json(), indent=2, ensure_ascii=False).encode())

    def manifest(self) -> Manifest:
        """What the folder holds; raises UsageError where it is none that this version reads."""
        again = "expected a folder that 'telefuse roads build EXTRACT.osm.pbf OUT' made"
        try:
            told = json.loads((self.path / _MANIFEST).read_text("utf-8"))
            found = told["format"]
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise UsageError(f"{self.path}: no built roads; {again}") from error
        if found != FORMAT:
            raise UsageError(f"{self.path}: built by another version (format {found}, not {FORMAT}); build it again")
        missing = [part.name for part in (self.tiles, self.ways, self.districts) if not part.exists()]
        if missing:
            raise UsageError(f"{self.path}: {', '.join(missing)} missing; {again}")
        return Manifest(**{**told, "box_deg": tuple(told["box_deg"]), "countries": tuple(told["countries"])})
