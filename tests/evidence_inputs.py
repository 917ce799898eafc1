"""A small bundle with known numbers in it, for tests of what is made of one."""

from __future__ import annotations

import numpy as np

from core.navigation import state
from core.navigation.records import RECORD_COLUMNS
from core.navigation.track import TRACK_COLUMNS, Mode
from service.evidence.bundle import Bundle, pack
from service.evidence.tape import AID_TABLES, SAMPLE_COLUMNS, Table

NS = 1_000_000_000
G = 9.80665
LAT_DEG, LON_DEG = 40.4, -3.7
M_PER_DEG = 111_000.0


def small_bundle(
    accident_id: str, vehicle_id: str, t_ns: int, *, rate_hz: int = 50, hole_s: tuple[float, float] | None = None
) -> Bundle:
    """A car at 15 m/s that is struck from the front and stands: 60 s before to 30 s after, but for a hole."""
    t_s = np.arange(-60 * rate_hz, 30 * rate_hz + 1) / rate_hz
    if hole_s is not None:
        t_s = t_s[(t_s < hole_s[0]) | (t_s > hole_s[1])]
    moving = np.where(t_s < 0.0, 15.0, np.maximum(15.0 - 150.0 * t_s, 0.0))
    force = np.where((t_s >= 0.0) & (t_s <= 0.1), -150.0, 0.0)
    samples = _table(t_ns, t_s, SAMPLE_COLUMNS, ax_s_mps2=force, ax_b_mps2=force, az_s_mps2=-G, az_b_mps2=-G)
    samples["down_z"], samples["speed_mps"], samples["clipped"] = 1.0, moving, force < 0.0
    gone_m = np.where(t_s < 0.0, 15.0 * t_s, 0.75)
    states = _table(
        t_ns,
        t_s,
        TRACK_COLUMNS,
        lat_rad=np.radians(LAT_DEG + gone_m / M_PER_DEG),
        lon_rad=np.radians(LON_DEG),
        alt_m=600.0,
        vn_mps=moving,
        sd_n_m=1.0,
        sd_e_m=2.0,
        mode=float(Mode.AIDED),
    )
    fix_s = np.arange(-60.0, 31.0)
    innovations = _table(
        t_ns, fix_s, RECORD_COLUMNS, aid=float(state.A_POSITION), innovation=0.5, variance=1.0, ratio=0.25
    )
    gnss = _table(t_ns, fix_s, AID_TABLES["gnss"], lat_rad=np.radians(LAT_DEG), lon_rad=np.radians(LON_DEG), fix=3.0)
    tables = {"samples": samples, "states": states, "innovations": innovations, "gnss": gnss}
    tables |= {name: _table(t_ns, np.empty(0), columns) for name, columns in AID_TABLES.items() if name != "gnss"}
    gaps = [] if hole_s is None else [[t_ns + round(one * NS) for one in hole_s]]
    covered = {"from_ns": t_ns - 60 * NS, "to_ns": t_ns + 30 * NS, "rate_hz": float(rate_hz)}
    said = {
        "accident": {
            "id": accident_id,
            "tenant_id": "default",
            "vehicle_id": vehicle_id,
            "t_ns": t_ns,
            "time": "",
            "revisions": [],
        },
        "covered": {**covered, "asked_ns": [t_ns - 60 * NS, t_ns + 30 * NS], "gaps": gaps, "whole": not gaps},
        "replay": {"from": "checkpoint", "same": True, "differences": [], "positions_compared": 90},
        "settings": {"gnss_time_offset_s": 0.0},
        "instruments": None,
        "names": {"aid": list(state.AIDS), "outcome": list(state.OUTCOMES)},
        "packets": [],
        "versions": {"telefuse": "0"},
    }
    return pack(tables, [], b"", said)


def _table(t_ns: int, t_s: np.ndarray, columns: tuple[str, ...], **values: np.ndarray | float) -> Table:
    table = np.zeros(len(t_s), [("t_ns", "<i8"), *((name, "<f8") for name in columns)])
    table["t_ns"] = t_ns + np.rint(t_s * NS).astype(np.int64)
    for name, value in values.items():
        table[name] = value
    return table
