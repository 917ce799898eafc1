"""What mobile mapping makes of a solution: poses at given instants, and the road that was driven."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from core.measurements import TimeArray
from core.navigation.poses import PoseStatus, poses_at
from core.navigation.road_profile import LEAST_SPACING_M, MOST_SPACING_M, profile_of
from core.navigation.solution import Solution
from core.session import KNOWN_MOUNTING_SD_RAD, SessionConfig
from service.errors import UsageError
from service.recordings.drive_folder import Drive
from service.recordings.pose_files import poses_path, read_instants, write_poses
from service.recordings.road_files import check_road_ending, write_road


@dataclass(frozen=True, slots=True)
class Mapping:
    """What is asked for, each path None if it is not."""

    times: Path | None
    poses: Path | None
    road: Path | None
    spacing_m: float

    @classmethod
    def asked(cls, times: Path | None, poses: Path | None, road: Path | None, spacing_m: float) -> Mapping:
        """Check what can be checked before a drive is read; raises UsageError."""
        if poses is not None and times is None:
            raise UsageError("--poses-out needs --poses TIMES.csv, the instants of the poses")
        if not LEAST_SPACING_M <= spacing_m <= MOST_SPACING_M:
            raise UsageError(
                f"--profile-spacing {spacing_m:g}: expected {LEAST_SPACING_M:g} to {MOST_SPACING_M:g} m between points"
            )
        if times is not None:
            poses = poses_path(times, poses)
            if not times.is_file():
                raise UsageError(f"{times}: no such file; expected a CSV table with a column t_s, seconds of the drive")
        if road is not None:
            check_road_ending(road)
        return cls(times, poses, road, spacing_m)

    @property
    def wanted(self) -> bool:
        """Whether anything is asked for."""
        return self.times is not None or self.road is not None

    def instants(self, drive: Drive) -> TimeArray | None:
        """The instants asked for; raises RecordingError if their table is none."""
        return None if self.times is None else read_instants(self.times, drive.start_t_ns)

    def write(
        self, drive: Drive, config: SessionConfig, solution: Solution, instants: TimeArray | None
    ) -> dict[str, Any]:
        """Write what is asked for and say what it came to."""
        said: dict[str, Any] = {}
        if instants is not None and self.poses is not None:
            found = poses_at(solution, instants)
            write_poses(self.poses, found, drive.start_t_ns)
            counts = {status.name.lower(): int(np.count_nonzero(found.status == status)) for status in PoseStatus}
            said["poses"] = {"out": str(self.poses)} | counts
        if self.road is not None:
            known = config.mounting.known
            mount_sd_rad = KNOWN_MOUNTING_SD_RAD if known else config.filter.tuning.mount_angle_sd_rad
            lines = profile_of(solution, self.spacing_m, mount_sd_rad)
            write_road(self.road, lines, drive.name)
            again = [int(np.count_nonzero(line.passes > 1)) for line in lines]
            said["profile"] = {
                "out": str(self.road),
                "lines": len(lines),
                "points": sum(len(line.passes) for line in lines),
                "points_passed_again": sum(again),
                "length_m": float(sum(line.chainage_m[-1] for line in lines)),
            }
        return said


def mapping_text(said: dict[str, Any]) -> list[str]:
    """The same in words, a warning where instants have no pose."""
    lines = []
    if "poses" in said:
        poses = said["poses"]
        known, outside, gap = poses["aided"] + poses["coasting"], poses["outside"], poses["gap"]
        lines.append(f"poses: {known} of {known + outside + gap} instants, {poses['coasting']} of them coasting")
        if outside or gap:
            lines.append(f"  warning: no pose at {outside} instants outside of the solution and {gap} in its gaps")
        lines.append(f"written: {poses['out']}")
    if "profile" in said:
        road = said["profile"]
        lines.append(
            f"road: {road['lines']} lines, {road['length_m']:.0f} m, {road['points']} points,"
            f" {road['points_passed_again']} of them passed more than once"
        )
        lines.append(f"written: {road['out']}")
    return lines
