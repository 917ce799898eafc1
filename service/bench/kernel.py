"""The filter alone: one call a packet of 200 samples, GNSS at 1 Hz, constraints on, rows at 10 Hz."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from core.measurements import GNSS, GNSS_COLUMNS, FloatArray, TimeArray
from core.navigation import kernel
from core.navigation.filter import Aids, FilterConfig, NavigationFilter
from core.navigation.nodes import NODE_WIDTH
from core.navigation.pending import pending
from core.navigation.records import RECORD_COLUMNS
from core.navigation.state import K_GNSS
from core.navigation.track import TRACK_COLUMNS

RATE_HZ: Final = 200
WARM_UP_PACKETS: Final = 20
ROUNDS: Final = 7
SPEED_MPS, YAW_RATE_RADPS, LAT_RAD = 12.0, 0.05, 0.8
EARTH_RADIUS_M: Final = 6.37e6
START_NS: Final = 1_700_000_000_000_000_000


@dataclass(frozen=True, slots=True, eq=False)
class _Circle:
    """A noisy drive in a circle: realistic values, so that no branch is spared."""

    t_ns: TimeArray
    f_b: FloatArray
    omega_b: FloatArray
    gnss: FloatArray

    def packet(self, index: int) -> tuple[slice, slice]:
        return slice(index * RATE_HZ, (index + 1) * RATE_HZ), slice(index, index + 1)


def _circle(packets: int) -> _Circle:
    rng = np.random.default_rng(1)
    n = packets * RATE_HZ
    omega_b = rng.normal(0.0, 5e-3, (n, 3))
    omega_b[:, 2] += YAW_RATE_RADPS
    f_b = np.array([0.0, SPEED_MPS * YAW_RATE_RADPS, -9.81]) + rng.normal(0.0, 0.1, (n, 3))
    yaw = YAW_RATE_RADPS * np.arange(packets)
    radius_m = SPEED_MPS / YAW_RATE_RADPS
    gnss = np.full((packets, len(GNSS_COLUMNS)), np.nan)
    values = {
        "lat_rad": LAT_RAD + radius_m * np.sin(yaw) / EARTH_RADIUS_M,
        "lon_rad": radius_m * (1 - np.cos(yaw)) / (EARTH_RADIUS_M * np.cos(LAT_RAD)),
        "alt_m": 100.0,
        "vn_mps": SPEED_MPS * np.cos(yaw),
        "ve_mps": SPEED_MPS * np.sin(yaw),
        "vd_mps": 0.0,
        "sd_h_m": 1.5,
        "sd_v_m": 3.0,
        "sd_v_mps": 0.1,
        "satellites": 9.0,
        "fix": 3.0,
    }
    for name, value in values.items():
        gnss[:, GNSS[name]] = value
    return _Circle(START_NS + np.arange(n) * (1_000_000_000 // RATE_HZ), f_b, omega_b, gnss)


def measure(packets: int = 1000) -> dict[str, Any]:
    """Nanoseconds a sample: median and quartiles over packets, single-threaded, and the call's own share.

    Of ``ROUNDS`` rounds the quietest counts, as whatever else the machine does can only add to a round.
    """
    drive = _circle(ROUNDS * packets + WARM_UP_PACKETS)
    fused = NavigationFilter(FilterConfig())
    no_speed = (np.empty(0, np.int64), np.empty(0))
    no_field = (np.empty(0, np.int64), np.empty((0, 3)))
    unclipped = np.zeros(RATE_HZ)
    for index in range(WARM_UP_PACKETS):
        samples, fixes = drive.packet(index)
        aids = Aids((drive.t_ns[::RATE_HZ][fixes], drive.gnss[fixes]), no_field, no_speed)
        fused.step(drive.t_ns[samples], drive.f_b[samples], drive.omega_b[samples], unclipped, aids)
    if not fused.aligned:
        raise RuntimeError("the benchmark's drive did not align")

    epochs, rows = np.empty((RATE_HZ, 4)), np.empty((16, len(TRACK_COLUMNS)))
    row_t = np.empty(16, np.int64)
    log = np.empty(64, np.int64), np.empty((64, len(RECORD_COLUMNS)))
    no_nodes = np.empty(0, np.int64), np.empty((0, NODE_WIDTH))

    def call(samples: slice, fixes: slice) -> float:
        aids = pending(K_GNSS, drive.t_ns[::RATE_HZ][fixes], drive.t_ns[::RATE_HZ][fixes], drive.gnss[fixes])
        arguments = fused.kernel_arguments(
            drive.t_ns[samples], drive.f_b[samples], drive.omega_b[samples], unclipped,
            aids.t_ns, aids.rows, epochs, row_t, rows, *log, *no_nodes,
        )  # fmt: skip
        begin = time.perf_counter_ns()
        kernel.run(*arguments)
        return time.perf_counter_ns() - begin

    rounds = np.array(
        [
            [call(*drive.packet(WARM_UP_PACKETS + r * packets + index)) for index in range(packets)]
            for r in range(ROUNDS)
        ]
    )
    spent = rounds[np.argmin(np.median(rounds, axis=1))]
    empty = np.array([call(slice(0, 0), slice(0, 0)) for _ in range(packets)])
    low, median, high = (float(v) / RATE_HZ for v in np.percentile(spent, [25, 50, 75]))
    return {
        "ns_per_epoch": median,
        "ns_per_epoch_quartiles": [low, high],
        "call_ns": float(np.median(empty)),
        "packets": packets,
        "rounds": ROUNDS,
        "rate_hz": RATE_HZ,
    }
