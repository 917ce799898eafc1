"""Drives with injected faults through a session in packets, and what came of it in figures."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, field, replace

import numpy as np

from core.earth import ned_offset_m
from core.measurements import Measurements
from core.navigation.track import TRACK, Mode
from core.session import Session
from core.simulation.faults import FAULTS, Fault, inject
from core.simulation.scenarios import simulate
from core.simulation.stream import Stream
from service.engine.sessions import session_config
from service.recordings.drive_folder import read_drive
from service.recordings.fusing import vehicle_config
from service.recordings.simulated import drive_of
from tests.recordings import recording

ROWS_HZ = 10.0
RECOVERY_S = 10.0
"""Within this of good fixes the navigation has to be back (issue: robustness)."""
STEADY_S = 5.0
"""Back means inside three sd and aided for so long."""
SETTLED_S = 20.0
"""After the alignment: what it left open has faded."""
FAULT_SEED = 11


@dataclass(frozen=True)
class Subject:
    """A drive with what it is compared with: positions (n, 3) in n from ``origin``, at true times."""

    name: str
    measurements: Measurements
    config: object
    truth_t_ns: np.ndarray
    truth_n_m: np.ndarray
    origin: tuple
    fault_s: float
    """When a fault begins: the vehicle moves, fixes are good for a minute about."""
    longest_s: float
    """No fault lasts longer, so that there is a drive after it."""
    settled_s: float = 0.0
    undisturbed: object = None


@dataclass(frozen=True)
class Ridden:
    """What a session made of a stream: rows in true time, and the soundness of its state after every packet."""

    t_s: np.ndarray
    rows: np.ndarray
    error_n_m: np.ndarray
    duration_s: float
    finite: bool
    asymmetry: float
    least_eigenvalue: float
    counts: dict
    fixes_s: np.ndarray = field(default_factory=lambda: np.empty(0))

    @functools.cached_property
    def navigating(self):
        return self.rows[:, TRACK["mode"]] != Mode.ALIGNING

    @functools.cached_property
    def within(self):
        """(n, 3) whether each axis is inside three sd; False while aligning."""
        sd = self.rows[:, TRACK["sd_n_m"] : TRACK["sd_d_m"] + 1]
        return (np.abs(self.error_n_m) <= 3.0 * sd) & self.navigating[:, None]


@dataclass(frozen=True)
class Figures:
    """Of one drive with faults. Shares are per axis north, east, down, of all instants at 10 Hz."""

    drive: str
    fault: str
    finite: bool
    asymmetry: float
    least_eigenvalue: float
    share_outside: tuple
    share_inside: tuple
    instants_outside: int
    recovery_s: float
    max_outside_m: float
    max_inside_m: float
    position_resets: int
    restarts: int
    counts: dict
    refused: dict

    def __str__(self):
        outside = " ".join(f"{100 * s:5.1f}" for s in self.share_outside)
        inside = " ".join(f"{100 * s:5.1f}" for s in self.share_inside)
        return (
            f"{self.fault:24} {self.drive:12} inside 3 sd: outside the fault {outside} %, in it {inside} %; "
            f"recovery {self.recovery_s:5.1f} s; error at most {self.max_outside_m:6.1f} m outside, "
            f"{self.max_inside_m:7.1f} m in it; {self.position_resets} position resets, {self.restarts} new starts; "
            f"least eigenvalue {self.least_eigenvalue:.1e}, more refused: {self.refused}"
        )


def ride(subject, stream, packet_s=1.0):
    """Fold a stream through a new session, packet by packet."""
    session = Session(session_config(subject.config))
    t_ns, rows, counts = [], [], {}
    finite, asymmetry, least = True, 0.0, 1.0
    for packet in stream.packets(packet_s):
        outputs = session.step(packet.measurements)
        # Told in times that go on where the box's step back.
        t_ns.append(outputs.track.t_ns - packet.clock_ahead_ns - session.clock_offset_ns)
        rows.append(outputs.track.values)
        for name, count in outputs.counts.items():
            counts[name] = counts.get(name, 0) + count
        if session.filter.aligned:
            p = session.filter.covariance()
            finite &= bool(np.isfinite(p).all() and np.isfinite(session.filter.x).all())
            if finite:
                variance = np.diag(p)
                known = variance == 0.0  # a state without spread, such as a delay that was set: its row is zero too
                sd = np.sqrt(np.where(variance > 0.0, variance, 1.0))
                normalised = p / np.outer(sd, sd)
                asymmetry = max(asymmetry, float(np.abs(normalised - normalised.T).max()))
                if known.any() and np.abs(normalised[known]).max() > 0.0:
                    least = -1.0
                unknown = normalised[np.ix_(~known, ~known)]
                least = min(least, float(np.linalg.eigvalsh(0.5 * (unknown + unknown.T))[0]))
    t_ns, rows = np.concatenate(t_ns), np.concatenate(rows)
    zero_ns = int(stream.comes_ns["imu"][0])
    placed = np.isfinite(rows[:, TRACK["lat_rad"]])
    finite &= bool(np.isfinite(rows[rows[:, TRACK["mode"]] != Mode.ALIGNING]).all())
    t_ns, rows = t_ns[placed], rows[placed]
    known = (t_ns >= subject.truth_t_ns[0]) & (t_ns <= subject.truth_t_ns[-1])
    t_ns, rows = t_ns[known], rows[known]
    place = ned_offset_m(*rows[:, :3].T, subject.origin)
    base = int(subject.truth_t_ns[0])
    true = [
        np.interp((t_ns - base) * 1e-9, (subject.truth_t_ns - base) * 1e-9, subject.truth_n_m[:, i]) for i in range(3)
    ]
    end_ns = min(int(stream.comes_ns["imu"][-1]), int(subject.truth_t_ns[-1]))
    return Ridden(
        t_s=(t_ns - zero_ns) * 1e-9,
        rows=rows,
        error_n_m=place - np.column_stack(true),
        duration_s=(end_ns - zero_ns) * 1e-9,
        finite=finite,
        asymmetry=asymmetry,
        least_eigenvalue=least,
        counts=counts,
        fixes_s=(subject.measurements.gnss_t_ns - zero_ns) * 1e-9,
    )


def figures(subject, faults, label=None, packet_s=1.0):
    """Ride a drive with these faults and measure."""
    stream = inject(Stream.of(subject.measurements), faults, np.random.default_rng(FAULT_SEED))
    if label == "temperature unsaid":  # by a box without a thermometer
        stream = replace(stream, temperature_c=None)
    ridden = ride(subject, stream, packet_s)
    spans = [(f.start_s, min(f.end_s, ridden.duration_s)) for f in faults]
    after = ridden.t_s >= subject.settled_s
    inside, excluded = np.zeros(len(ridden.t_s), bool), np.zeros(len(ridden.t_s), bool)
    grid = np.arange(subject.settled_s, ridden.duration_s, 1.0 / ROWS_HZ)
    grid_excluded = np.zeros(len(grid), bool)
    for start_s, end_s in spans:
        inside |= (ridden.t_s >= max(start_s, subject.settled_s)) & (ridden.t_s < end_s)
        excluded |= (ridden.t_s >= start_s) & (ridden.t_s < end_s + RECOVERY_S)
        grid_excluded |= (grid >= start_s) & (grid < end_s + RECOVERY_S)
    outside = after & ~excluded
    horizontal_m = np.hypot(ridden.error_n_m[:, 0], ridden.error_n_m[:, 1])
    # An instant without a row, as while aligning, is none inside three sd; in the fault it may be for want of samples.
    n_outside = max(int((~grid_excluded).sum()), int(outside.sum()), 1)
    n_inside = max(int((inside & after).sum()), 1)
    before = {} if subject.undisturbed is None else subject.undisturbed.counts
    refused = {
        name: count - before.get(name, 0)
        for name, count in sorted(ridden.counts.items())
        if not name.endswith("fused") and name.split(".")[0] != "nhc" and count != before.get(name, 0)
    }
    return Figures(
        drive=subject.name,
        fault=label or " + ".join(f.kind for f in faults) or "none",
        finite=ridden.finite,
        asymmetry=ridden.asymmetry,
        least_eigenvalue=ridden.least_eigenvalue,
        share_outside=tuple(ridden.within[outside].sum(axis=0) / n_outside),
        share_inside=tuple(ridden.within[inside].sum(axis=0) / n_inside),
        instants_outside=n_outside,
        recovery_s=max((_recovery_s(ridden, end_s) for _, end_s in spans), default=0.0),
        max_outside_m=float(horizontal_m[outside & ridden.navigating].max(initial=0.0)),
        max_inside_m=float(horizontal_m[inside & ridden.navigating].max(initial=0.0)),
        position_resets=ridden.counts.get("gnss_position.reset", 0),
        restarts=ridden.counts.get("imu.reset", 0),
        counts=ridden.counts,
        refused=refused,
    )


def _recovery_s(ridden, end_s):
    """From the first good fix after a fault until inside three sd and aided for ``STEADY_S``; inf if never."""
    coming = ridden.fixes_s[ridden.fixes_s >= end_s]
    if not coming.size:
        return 0.0
    good = ridden.within.all(axis=1) & (ridden.rows[:, TRACK["mode"]] == Mode.AIDED)
    since_s = float(coming[0])
    if end_s + STEADY_S > ridden.duration_s:
        return 0.0
    for start_s in np.arange(since_s, ridden.duration_s - STEADY_S, 0.1):
        span = (ridden.t_s >= start_s) & (ridden.t_s < start_s + STEADY_S)
        if span.sum() >= 0.9 * STEADY_S * ROWS_HZ and good[span].all():
            return float(start_s - since_s)
    return math.inf


def fault_on(subject, kind, size=None, duration_s=None):
    """A fault where this drive has its own, not longer than leaves some drive after it."""
    usual = FAULTS[kind].duration_s if duration_s is None else duration_s
    if kind == "temperature":  # all along
        return Fault.of(kind, 0.0, usual, size)
    return Fault.of(kind, subject.fault_s, min(usual, subject.longest_s), size)


def _with_baseline(subject):
    ridden = ride(subject, Stream.of(subject.measurements))
    first_s = float(ridden.t_s[ridden.navigating][0])
    return replace(subject, undisturbed=ridden, settled_s=first_s + SETTLED_S)


@functools.cache
def simulated(scenario, seed, fault_s):
    """300 s of a simulated drive at 100 Hz, against its truth."""
    drive = drive_of(simulate(scenario, seed, 300.0, 100.0))
    reference = drive.reference
    origin = (float(reference.lat_rad[0]), float(reference.lon_rad[0]), float(reference.alt_m[0]))
    return _with_baseline(
        Subject(
            name=f"{scenario} {seed}",
            measurements=drive.measurements,
            config=vehicle_config(drive),
            truth_t_ns=reference.t_ns,
            truth_n_m=ned_offset_m(reference.lat_rad, reference.lon_rad, reference.alt_m, origin),
            origin=origin,
            fault_s=fault_s,
            longest_s=60.0,
        )
    )


@functools.cache
def real(name, first_s, last_s, fault_s, longest_s):
    """A stretch of a recording, against its reference, else against its own solution without faults."""
    drive = read_drive(recording("drives", name))
    zero_ns = int(drive.measurements.imu_t_ns[0])
    m = drive.measurements.between(zero_ns + round(first_s * 1e9), zero_ns + round(last_s * 1e9))
    gnss = m.gnss[np.isfinite(m.gnss[:, 0])]
    origin = (float(gnss[0, 0]), float(gnss[0, 1]), 0.0)
    subject = Subject(
        name.split("_")[0],
        m,
        vehicle_config(drive),
        m.imu_t_ns,
        np.zeros((len(m.imu_t_ns), 3)),
        origin,
        fault_s,
        longest_s,
    )
    reference = drive.reference
    if reference is not None:
        place = ned_offset_m(reference.lat_rad, reference.lon_rad, reference.alt_m, origin)
        against = replace(subject, truth_t_ns=reference.t_ns, truth_n_m=place)
        ridden = ride(against, Stream.of(m))
        # The reference sits elsewhere on the car: what stays is that offset.
        settled = ridden.t_s > ridden.t_s[ridden.navigating][0] + SETTLED_S
        offset_n_m = np.median(ridden.error_n_m[settled], axis=0)
        return _with_baseline(replace(against, truth_n_m=place + offset_n_m))
    ridden = ride(subject, Stream.of(m))
    place = ridden.error_n_m[ridden.navigating]
    own = replace(
        subject,
        truth_t_ns=zero_ns + round(first_s * 1e9) + np.rint(ridden.t_s[ridden.navigating] * 1e9).astype(np.int64),
        truth_n_m=place,
    )
    return _with_baseline(own)


SIMULATED = {
    "city 1": lambda: simulated("city", 1, 80.0),
    "city 2": lambda: simulated("city", 2, 120.0),  # a canyon until 104 s
    "highway 1": lambda: simulated("highway", 1, 80.0),
    "outages 1": lambda: simulated("outages", 1, 80.0),  # without GNSS from 150 s to 210 s, after the faults
    "outages 2": lambda: simulated("outages", 2, 80.0),
}
REAL = {
    "comma": lambda: real("comma2k19_segment", 0.0, 60.0, 25.0, 10.0),
    "kth": lambda: real("kth_stockholm", 0.0, 290.0, 185.0, 40.0),
    "boston": lambda: real("boston_vn100", 150.0, 400.0, 150.0, 40.0),
}
DRIVES = SIMULATED | REAL
OWN_SOLUTION = ("kth", "boston")
"""Drives without a truth, compared with what the session makes of them undisturbed."""

CASES = {
    # Kind, size and duration where not the kind's own.
    "outliers": ("outliers", None, None),
    "short jump": ("jump", None, 4.0),
    "jump": ("jump", None, None),
    "multipath ramp": ("multipath_ramp", None, None),
    "spoof": ("spoof", None, None),
    "slow spoof": ("spoof", 20.0, None),
    "frozen": ("frozen", None, None),
    "frozen for long": ("frozen", None, 40.0),
    "frozen at rest": ("frozen_at_rest", None, None),
    "receiver clock ahead": ("receiver_clock", 1.0, None),
    "receiver clock behind": ("receiver_clock", -1.0, None),
    "late": ("late", None, None),
    "clock 3 s ahead": ("box_clock", 3.0, None),
    "clock 3 s back": ("box_clock", -3.0, None),
    "clock 30 s ahead": ("box_clock", 30.0, None),
    "clock 30 s back": ("box_clock", -30.0, None),
    "drops": ("drops", None, None),
    "gaps": ("gaps", None, None),
    "long gaps": ("gaps", 3.0, None),
    "duplicates": ("duplicates", None, None),
    "saturation": ("saturation", None, None),
    "temperature": ("temperature", None, None),
    "temperature unsaid": ("temperature", None, None),
    "stuck gyroscope": ("stuck_gyroscope", None, None),
    "stuck accelerometer": ("stuck_accelerometer", None, None),
    "not a number": ("not_a_number", None, None),
    "frozen speed": ("frozen_speed", None, None),
}
LATE_PACKET_S = 0.2
"""Packets so short that a late fix is late indeed: in one of a second it meets samples before it came."""


@functools.cache
def measured(case, drive):
    """Figures of a case of ``CASES``, or of ``undisturbed``, on one of ``DRIVES``."""
    subject = DRIVES[drive]()
    if case == "undisturbed":
        return figures(subject, [], case)
    kind, size, duration_s = CASES[case]
    fault = fault_on(subject, kind, size, duration_s)
    return figures(subject, [fault], case, LATE_PACKET_S if kind == "late" else 1.0)
