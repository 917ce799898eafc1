"""A drive folder through the mobile-mapping paper's filter (seed 3), with the box's own attitude or ours."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from core.errors import InvalidInputError
from core.navigation.ecef_filter import EcefConfig, GivenAttitude, run
from core.preparation import Preparation, with_valid_samples
from core.session import KNOWN_MOUNTING_SD_RAD, MountingEstimate, SessionConfig
from service.errors import UsageError
from service.recordings.drive_folder import Drive
from service.recordings.fusing import Fused, Outage, withhold


def fuse_ecef(
    drive: Drive,
    config: SessionConfig,
    outages: Sequence[Outage] = (),
    ours: Fused | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> Fused:
    """Filter a drive, without the fixes inside ``outages``; its attitude is ``ours``, or by default attitude.csv."""
    m = withhold(drive, outages)
    settings = EcefConfig(
        tuning=config.filter.tuning,
        imu_lever_b_m=config.filter.imu_lever_b_m,
        antenna_lever_b_m=config.filter.antenna_lever_b_m,
    )
    counts: dict[str, int] = {}
    preparation = Preparation(config.accelerometer, config.gyroscope, config.mounting, config.accel_full_scale_mps2)
    samples = preparation.step(with_valid_samples(m, 0, counts))
    if ours is not None and ours.solution is not None:
        attitude = GivenAttitude.by_solution(ours.solution, settings.tuning)
    elif drive.attitude is not None:
        attitude = GivenAttitude.by_ahrs(drive.attitude.t_ns, drive.attitude.q_n_from_b, settings.own)
    else:
        raise UsageError(f"{drive.name}: has no attitude.csv, and none of our own was given")
    gnss_t_ns = m.gnss_t_ns + round(config.filter.gnss_time_offset_s * 1e9)
    begin = time.perf_counter()
    try:
        solution, found = run(samples, gnss_t_ns, m.gnss, attitude, settings, progress)
    except InvalidInputError as error:
        raise UsageError(f"{drive.name}: {error}") from error
    spent_s = time.perf_counter() - begin
    return Fused(
        solution.track, (), counts | found, len(m.imu_t_ns), spent_s, _mounting(config, ours), solution=solution
    )


def _mounting(config: SessionConfig, ours: Fused | None) -> MountingEstimate:
    """As our filter found it, else as it was set: the paper's filter has no state for it."""
    if ours is not None:
        return ours.mounting
    known = config.mounting.known
    sd_rad = KNOWN_MOUNTING_SD_RAD if known else config.filter.tuning.mount_angle_sd_rad
    return MountingEstimate(known, False, config.mounting.rpy_rad, (sd_rad, sd_rad, sd_rad))
