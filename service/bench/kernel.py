"""The filter alone: one call a packet of 200 samples, GNSS at 1 Hz, constraints on, rows at 10 Hz; then all aids."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from core.measurements import GNSS, GNSS_COLUMNS, FloatArray, TimeArray
from core.navigation import kernel
from core.navigation.aids import Aids
from core.navigation.filter import FilterConfig, NavigationFilter
from core.navigation.nodes import NODE_WIDTH
from core.navigation.pending import Pending, pending
from core.navigation.records import RECORD_COLUMNS
from core.navigation.state import K_BARO, K_GNSS, K_MAGNETIC, K_SPEED
from core.navigation.track import TRACK_COLUMNS
from core.navigation.tuning import Tuning

RATE_HZ: Final = 200
WARM_UP_PACKETS: Final = 20
ROUNDS: Final = 7
SPEED_MPS, YAW_RATE_RADPS, LAT_RAD = 12.0, 0.05, 0.8
HEIGHT_M, FIELD_N_UT = 100.0, (20.0, 0.0, 45.0)
EARTH_RADIUS_M: Final = 6.37e6
START_NS: Final = 1_700_000_000_000_000_000
SECOND_NS: Final = 1_000_000_000
SAMPLES_A_SECOND: Final = {K_GNSS: 1, K_SPEED: 5, K_MAGNETIC: 1, K_BARO: 1}
"""Of each aid, as the filter thins faster ones."""

ALL_AIDS: Final = (K_GNSS, K_SPEED, K_MAGNETIC, K_BARO)
CONTRACT_AIDS: Final = (K_GNSS,)


@dataclass(frozen=True, slots=True, eq=False)
class _Packet:
    """A second of a drive: samples, and the aids that wait for them."""

    t_ns: TimeArray
    f_b: FloatArray
    omega_b: FloatArray
    saturated: FloatArray
    aids: Pending


@dataclass(frozen=True, slots=True)
class _Setting:
    """What is on: kinds of aids, and the filter's own settings."""

    kinds: Sequence[int]
    config: FilterConfig
    records: bool = True


def _gnss(yaw: npt.NDArray[np.floating[Any]]) -> FloatArray:
    radius_m = SPEED_MPS / YAW_RATE_RADPS
    gnss = np.full((len(yaw), len(GNSS_COLUMNS)), np.nan)
    values = {
        "lat_rad": LAT_RAD + radius_m * np.sin(yaw) / EARTH_RADIUS_M,
        "lon_rad": radius_m * (1 - np.cos(yaw)) / (EARTH_RADIUS_M * np.cos(LAT_RAD)),
        "alt_m": HEIGHT_M,
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
    return gnss


def _circle(packets: int, kinds: Sequence[int]) -> list[_Packet]:
    """A noisy drive in a circle: realistic values, so that no branch is spared."""
    rng = np.random.default_rng(1)
    n = packets * RATE_HZ
    omega_b = rng.normal(0.0, 5e-3, (n, 3))
    omega_b[:, 2] += YAW_RATE_RADPS
    f_b = np.array([0.0, SPEED_MPS * YAW_RATE_RADPS, -9.81]) + rng.normal(0.0, 0.1, (n, 3))
    t_ns = START_NS + np.arange(n) * (SECOND_NS // RATE_HZ)
    parts = []
    for kind in kinds:
        every_ns = SECOND_NS // SAMPLES_A_SECOND[kind]
        times = np.arange(START_NS, START_NS + packets * SECOND_NS, every_ns)
        yaw = YAW_RATE_RADPS * (times - START_NS) * 1e-9
        if kind == K_GNSS:
            values = _gnss(yaw)
        elif kind == K_SPEED:
            values = SPEED_MPS + rng.normal(0.0, 0.1, len(times))
        elif kind == K_MAGNETIC:
            north, _, down = FIELD_N_UT
            field = np.column_stack([north * np.cos(yaw), -north * np.sin(yaw), np.full(len(yaw), down)])
            values = field + rng.normal(0.0, 0.5, field.shape)
        else:
            values = HEIGHT_M + rng.normal(0.0, 0.3, len(times))
        parts.append(pending(kind, times, times, values))
    aids = reduce(Pending.join, parts, Pending())
    bounds = np.searchsorted(aids.t_ns, START_NS + np.arange(packets + 1) * SECOND_NS)
    return [
        _Packet(
            t_ns[k * RATE_HZ : (k + 1) * RATE_HZ],
            f_b[k * RATE_HZ : (k + 1) * RATE_HZ],
            omega_b[k * RATE_HZ : (k + 1) * RATE_HZ],
            np.zeros(RATE_HZ),
            aids.take(slice(int(bounds[k]), int(bounds[k + 1]))),
        )
        for k in range(packets)
    ]


class _Bench:
    """A filter under way, with somewhere to write to; each round starts from the same state."""

    def __init__(self, setting: _Setting, packets: int) -> None:
        self._filter = NavigationFilter(setting.config)
        self._packets = _circle(WARM_UP_PACKETS, (K_GNSS,))
        for packet in self._packets:
            aids = Aids(packet.aids.of(K_GNSS))
            self._filter.step(packet.t_ns, packet.f_b, packet.omega_b, packet.saturated, aids)
        if not self._filter.aligned:
            raise RuntimeError("the benchmark's drive did not align")
        self._start = [a.copy() for a in (self._filter.x, self._filter.ti, self._filter.p)]
        self._packets = _circle(WARM_UP_PACKETS + packets, setting.kinds)[WARM_UP_PACKETS:]
        n_log = 64 if setting.records else 0
        self._outputs: tuple[npt.NDArray[Any], ...] = (
            np.empty((RATE_HZ, 4)), np.empty(16, np.int64), np.empty((16, len(TRACK_COLUMNS))),
            np.empty(n_log, np.int64), np.empty((n_log, len(RECORD_COLUMNS))),
            np.empty(0, np.int64), np.empty((0, NODE_WIDTH)),
        )  # fmt: skip

    def round(self) -> FloatArray:
        """Nanoseconds of each packet."""
        for array, start in zip((self._filter.x, self._filter.ti, self._filter.p), self._start, strict=True):
            array[:] = start
        return np.array([self._call(packet, RATE_HZ) for packet in self._packets])

    def empty_call_ns(self) -> float:
        """What a call without samples takes."""
        return float(np.median([self._call(packet, 0) for packet in self._packets]))

    def _call(self, packet: _Packet, samples: int) -> int:
        arguments = self._filter.kernel_arguments(
            packet.t_ns[:samples], packet.f_b[:samples], packet.omega_b[:samples], packet.saturated[:samples],
            packet.aids.t_ns, packet.aids.rows, *self._outputs,
        )  # fmt: skip
        begin = time.perf_counter_ns()
        used, _, _, stopped = kernel.run(*arguments)
        spent = time.perf_counter_ns() - begin
        if used != samples:
            raise RuntimeError(f"the benchmark's drive did not last: {stopped}")
        return spent


def _quietest(settings: Mapping[str, _Setting], packets: int, rounds: int) -> tuple[dict[str, FloatArray], float]:
    """Nanoseconds a sample of the packets of each setting's quietest round, and of a call without samples.

    Whatever else the machine does can only add to a round. The settings take turns.
    """
    benches = {name: _Bench(setting, packets) for name, setting in settings.items()}
    best: dict[str, FloatArray] = {}
    for _ in range(rounds):
        for name, bench in benches.items():
            spent = bench.round() / RATE_HZ
            if name not in best or np.median(spent) < np.median(best[name]):
                best[name] = spent
    return best, min(bench.empty_call_ns() for bench in benches.values())


def _settings() -> dict[str, _Setting]:
    default = FilterConfig()
    return {"contract": _Setting(CONTRACT_AIDS, default), "all": _Setting(ALL_AIDS, default)}


def measure(packets: int = 1000) -> dict[str, Any]:
    """Nanoseconds a sample: median and quartiles over packets, single-threaded, and the call's own share."""
    best, call_ns = _quietest(_settings(), packets, ROUNDS)
    low, median, high = (float(v) for v in np.percentile(best["contract"], [25, 50, 75]))
    return {
        "ns_per_epoch": median,
        "ns_per_epoch_quartiles": [low, high],
        "ns_per_epoch_all_aids": float(np.median(best["all"])),
        "call_ns": call_ns,
        "parts_ns": _parts(),
        "packets": packets,
        "rounds": ROUNDS,
        "rate_hz": RATE_HZ,
    }


def _parts(packets: int = 60) -> dict[str, float]:
    """What each part adds, ns a sample: the difference that leaving it out makes, beginning with all aids on.

    ``samples`` is what stays without any: mechanisation, blocks, and once a second covariance and kept state.
    Without any aid the state holds for two minutes.
    """
    slow = Tuning(covariance_interval_s=1.0, output_interval_s=60.0)
    rows = FilterConfig()
    silent = FilterConfig(tuning=replace(rows.tuning, output_interval_s=60.0))
    free = replace(silent, non_holonomic=False)
    bare = FilterConfig(tuning=slow, non_holonomic=False)
    settings = {
        "records": _Setting(ALL_AIDS, rows),
        "barometer": _Setting(ALL_AIDS, rows, records=False),
        "magnetometer": _Setting(ALL_AIDS[:3], rows, records=False),
        "wheel speed": _Setting(ALL_AIDS[:2], rows, records=False),
        "GNSS": _Setting(CONTRACT_AIDS, rows, records=False),
        "rows": _Setting((), rows, records=False),
        "constraints": _Setting((), silent, records=False),
        "covariance": _Setting((), free, records=False),
        "samples": _Setting((), bare, records=False),
    }
    best, call_ns = _quietest(settings, packets, 5 * ROUNDS)
    spent = [float(np.median(best[name])) for name in settings] + [call_ns / RATE_HZ]
    parts = {name: more - less for name, more, less in zip(settings, spent, spent[1:], strict=False)}
    return {**parts, "call": call_ns / RATE_HZ}
