"""One vehicle's session: a pure fold over its measurements. The order of stages is ``Session.step``."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Final, Literal, Protocol

import numpy as np
import numpy.typing as npt

from core.accident.detector import ImpactDetector
from core.accident.events import Candidate, Findings, Impact, VehicleMotion
from core.accident.paper_rule import PaperRule
from core.accident.placing import RECENT_S, Accident, Place, Suppressed, newest, place_at, told_until
from core.accident.thresholds import DetectorThresholds
from core.box_clock import ANEW, LET_GO, STEPPED, BoxClock
from core.calibration.drift import Biases, BiasUpdate
from core.calibration.in_force import BoxCalibration, CalibrationInForce, parts_at
from core.driving.manoeuvres import Episode, ManoeuvreThresholds, ManoeuvreTracker
from core.driving.trips import Trip, TripThresholds, TripTracker
from core.earth import STANDARD_GRAVITY_MPS2
from core.held_axes import HeldAxes
from core.measurements import Measurements
from core.navigation import state
from core.navigation.aids import Aids
from core.navigation.filter import FilterConfig, FilterOutput, NavigationFilter
from core.navigation.kernel import CLIPPED, HELD
from core.navigation.recalibration import biases
from core.navigation.track import Track
from core.navigation.warming import Warming
from core.past import BodySamples
from core.preparation import FoundMounting, Mounting, Preparation, with_valid_samples
from core.rotation import matrix_from_rpy, rpy_from_matrix
from core.sensors import MagnetometerCalibration, TriadCalibration
from core.snapshot import pack, unpack

SNAPSHOT_VERSION: Final = 7
KNOWN_MOUNTING_SD_RAD: Final = 0.01
"""Spread of a mounting that was measured: half a degree, by hand."""
AXES_SD_RAD: Final = 0.014
"""How far the axes of a box are from square, and from those it is judged by: soldering and die, 0.8 deg; a choice."""

_CLOCK_COUNTS: Final = {STEPPED: "clock.stepped_back", LET_GO: "clock.caught_up", ANEW: "clock.begun_anew"}

Arrays = dict[str, npt.NDArray[np.generic]]


@dataclass(frozen=True, slots=True)
class MountingEstimate:
    """How the box sits as far as is known: C_b_from_s as roll, pitch, yaw, rad, and sd about the body's axes, rad.

    ``given`` is whether the settings say it, ``found`` whether the session found another than the nominal one.
    """

    given: bool
    found: bool
    rpy_rad: tuple[float, float, float]
    sd_rad: tuple[float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Outputs:
    """What one step brought: track rows every 100 ms, accidents, trips begun or changed, counts, and biases.

    ``biases`` are what a trip that has ended made of the calibration's, ``suppressed`` what felt like an accident
    and was none, ``episodes`` the manoeuvres that are over.

    ``counts`` names what the step met, such as ``gnss_position.fused``, ``gnss_position.rejected_gate``,
    ``imu.rejected_time``, ``imu.reset``, ``mounting.found``, ``mounting.contradicted``, ``clock.stepped_back``; only
    non-zero ones.
    """

    track: Track
    accidents: tuple[Accident, ...]
    trips: tuple[Trip, ...]
    counts: Mapping[str, int]
    biases: tuple[BiasUpdate, ...] = ()
    suppressed: tuple[Suppressed, ...] = ()
    episodes: tuple[Episode, ...] = ()


@dataclass(frozen=True, slots=True)
class SessionConfig:
    """What is set for a vehicle and does not change while its session runs.

    ``accelerometer``, ``gyroscope`` and ``magnetometer`` hold until the first of ``calibrations``, which come by their
    ``valid_from_ns``.
    ``fold_back`` is whether biases that were followed on a trip are kept for the next.
    """

    accelerometer: TriadCalibration = field(default_factory=TriadCalibration)
    gyroscope: TriadCalibration = field(default_factory=TriadCalibration)
    magnetometer: MagnetometerCalibration = field(default_factory=MagnetometerCalibration)
    calibrations: tuple[BoxCalibration, ...] = ()
    fold_back: bool = True
    mounting: Mounting = field(default_factory=Mounting)
    accel_full_scale_mps2: float = math.nan
    filter: FilterConfig = field(default_factory=FilterConfig)
    detector: Literal["telefuse", "paper"] = "telefuse"
    impact: DetectorThresholds = field(default_factory=DetectorThresholds)
    manoeuvres: ManoeuvreThresholds = field(default_factory=ManoeuvreThresholds)
    trips: TripThresholds = field(default_factory=TripThresholds)


class Tape(Protocol):
    """Takes down what a session works with, for evidence; it changes nothing."""

    def measured(self, measurements: Measurements) -> None:
        """Valid measurements in sensor axes, by the session's time."""

    def fused(self, samples: BodySamples, output: FilterOutput) -> None:
        """Calibrated samples of these, part by part, with what the filter made of them."""


class Detector(Protocol):
    """What finds impacts in calibrated samples."""

    def step(self, motion: VehicleMotion) -> Findings:
        """What these samples decided."""

    def turn(self, C_new_from_old: npt.NDArray[np.float64]) -> None:
        """Take samples in other body axes from now on."""

    def state(self) -> Arrays:
        """Its whole state by name."""

    def load(self, arrays: Arrays) -> None:
        """Take over what ``state`` gave."""


class Session:
    """Folds ``Measurements`` of one vehicle, in order, into ``Outputs``."""

    def __init__(self, config: SessionConfig) -> None:
        self.config = config
        self.tape: Tape | None = None
        self._clock = BoxClock()
        given = BoxCalibration(
            accelerometer=config.accelerometer, gyroscope=config.gyroscope, magnetometer=config.magnetometer
        )
        self._in_force = CalibrationInForce((given, *config.calibrations))
        self._begin()

    def _begin(self) -> None:
        config = self.config
        filter_config = config.filter
        if config.mounting.known and filter_config.mount_angle_sd_rad is None:
            filter_config = replace(filter_config, mount_angle_sd_rad=KNOWN_MOUNTING_SD_RAD)
        self._preparation = self._prepared(self._in_force.calibration)
        self._warming = Warming()
        self._filter = NavigationFilter(filter_config)
        self._mounting = (
            None
            if config.mounting.known
            else FoundMounting(filter_config.tuning.as_array(), filter_config.gnss_time_offset_s)
        )
        self._detector: Detector = (
            PaperRule(config.impact.paper) if config.detector == "paper" else ImpactDetector(config.impact)
        )
        self._detector_stage = f"detector.{config.detector}"
        self._manoeuvres = ManoeuvreTracker(config.manoeuvres)
        self._trips = TripTracker(config.trips)
        self._recent = Track.joined([])
        self._placed: tuple[int, Place] | None = None

    def step(self, measurements: Measurements) -> Outputs:
        """Take the next measurements. Never raises for what they hold."""
        counts: dict[str, int] = {}
        measurements, happened = self._clock.step(measurements)
        trips: list[Trip] = []
        if happened:
            counts[_CLOCK_COUNTS[happened]] = 1
        if happened == ANEW:
            trips = self._trips.end()
            self._begin()
        if len(measurements.imu_t_ns):
            self._warming.step(int(measurements.imu_t_ns[-1]), measurements.temperature_c)
            self._filter.warm(self._warming.rate_kps)
        before = self._filter.counts
        valid = with_valid_samples(measurements, self._filter.t_ns, counts)
        if self.tape is not None:
            self.tape.measured(valid)
        tracks: list[Track] = []
        impacts: list[Impact] = []
        candidates: list[Candidate] = []
        episodes: list[Episode] = []
        updates: list[BiasUpdate] = []
        cuts = self._in_force.cut(valid.imu_t_ns)
        for same in parts_at(valid, cuts) if cuts else (valid,):
            updates += self._calibrate(same)
            for part, aids in self._in_body_axes(self._preparation.step(same), self._aids(same), counts):
                fused = self._filter.step(part.t_ns, part.f_b, part.omega_b, _unsound(part), aids)
                if self.tape is not None:
                    self.tape.fused(part, fused)
                # A constant, so that packets do not matter: gravity differs from it by 0.03 m/s2 at most, and upwards.
                motion = VehicleMotion(
                    t_ns=part.t_ns,
                    f_b=part.f_b,
                    omega_b=part.omega_b,
                    down_b=fused.epochs[:, :3],
                    speed_mps=fused.epochs[:, 3],
                    saturated=part.saturated,
                    gravity_mps2=STANDARD_GRAVITY_MPS2,
                    ignition=measurements.ignition,
                    flags=measurements.flags,
                )
                found = self._detector.step(motion)
                episodes += self._manoeuvres.step(motion)
                impacts += found.impacts
                candidates += found.candidates
                tracks.append(fused.track)
                for trip in self._trips.step(fused.track, measurements.ignition):
                    trips.append(trip)
                    if trip.ended:
                        self._in_force.follower.trip_ended(trip.end_t_ns)
        track = Track.joined(tracks)
        rows = Track.joined([self._recent, track])
        accidents = tuple(Accident(impact, self._place(impact, rows)) for impact in impacts)
        suppressed = tuple(Suppressed(one, _seen_place(one.t_ns, one.decided_t_ns, rows)) for one in candidates)
        self._recent = newest(rows, RECENT_S)
        self._add_counts(self._filter.counts - before, counts)
        return Outputs(track, accidents, tuple(trips), counts, tuple(updates), suppressed, tuple(episodes))

    def _place(self, impact: Impact, rows: Track) -> Place:
        """Where an accident was, as it was known when it was told first."""
        if self._placed is None or self._placed[0] != impact.t_ns:
            self._placed = impact.t_ns, _seen_place(impact.t_ns, impact.decided_t_ns, rows)
        return self._placed[1]

    def _calibrate(self, measured: Measurements) -> Iterator[BiasUpdate]:
        """Put in force what holds from the first of these samples on; the update where a trip's end brings one."""
        in_force, has_samples = self._in_force, len(measured.imu_t_ns) > 0
        # Before the first sample there may be fields already, of which the box's iron is to be taken.
        times_ns = measured.imu_t_ns if has_samples or in_force.version >= 0 else measured.magnetometer_t_ns
        if not len(times_ns):
            return
        first_ns = int(times_ns[0])
        if has_samples and self.config.fold_back and in_force.is_look_due(first_ns):
            update = in_force.look(first_ns, self._seen_biases(), may_fold=self._filter.aligned)
            if update is not None:
                before = self._preparation
                self._preparation = after = self._prepared(in_force.calibration, before.held)
                f_b, omega_b = after.accel_map[1] - before.accel_map[1], after.gyro_map[1] - before.gyro_map[1]
                if self._mounting is not None:
                    f_b, omega_b = (self._mounting.finder.C_b_from_m @ change for change in (f_b, omega_b))
                self._filter.shift_biases(f_b, omega_b, *in_force.follower.loosening(update))
                yield update
        was = in_force.version
        if in_force.change(first_ns):
            self._preparation = self._prepared(in_force.calibration, self._preparation.held)
            if was >= 0:
                self._filter.forget_biases()

    def _prepared(self, calibration: BoxCalibration, held: HeldAxes | None = None) -> Preparation:
        config = self.config
        return Preparation(
            calibration.accelerometer,
            calibration.gyroscope,
            config.mounting,
            config.accel_full_scale_mps2,
            calibration.magnetometer,
            held,
        )

    def _seen_biases(self) -> Biases | None:
        """What the filter says of the biases, as the sensors show them; None unless the vehicle is at rest."""
        nav = self._filter
        if not (nav.aligned and nav.ti[state.I_STATIONARY]):
            return None
        bias_b, covariance = biases(nav.x, nav.p)
        if self._mounting is not None:
            C = np.kron(np.eye(2), self._mounting.finder.C_b_from_m)
            bias_b, covariance = C.T @ bias_b, C.T @ covariance @ C
        return Biases(nav.t_ns, *self._preparation.sensed(bias_b, covariance))

    @property
    def calibration_version(self) -> int:
        """The version of the calibration in force; -1 before the first sample."""
        return self._in_force.version

    def _in_body_axes(
        self, samples: BodySamples, aids: Aids, counts: dict[str, int]
    ) -> Iterator[tuple[BodySamples, Aids]]:
        """The samples in body axes as known by then; where the mounting is given, just as they are."""
        if self._mounting is None:
            yield samples, aids
            return
        finder = self._mounting.finder
        for turn, part, aids_of_part in self._mounting.step(samples, aids):
            self._filter.start = self._mounting.start
            if finder.found:
                self._filter.mount_angle_sd_rad = math.hypot(*finder.found_sd_rad)
            if turn is not None:
                if turn.past is None:
                    self._filter.turn(turn.C_new_from_old, turn.t_ns, turn.imu, turn.gnss)
                else:
                    past, past_aids = turn.past
                    self._filter.retrace(past.t_ns, past.f_b, past.omega_b, _unsound(past), past_aids)
                self._detector.turn(turn.C_new_from_old)
                self._manoeuvres.turn(turn.C_new_from_old)
                name = "mounting.contradicted" if finder.contradicted else "mounting.found"
                counts[name] = counts.get(name, 0) + 1
            yield part, aids_of_part

    @property
    def calibration(self) -> BoxCalibration:
        """The calibration in force, with its biases as followed."""
        return self._in_force.calibration

    @property
    def clock_offset_ns(self) -> int:
        """By how much what is told now is ahead of the box's clock, since that stepped back."""
        return self._clock.offset_ns

    @property
    def filter(self) -> NavigationFilter:
        """The navigation filter, to be read."""
        return self._filter

    @property
    def mounting(self) -> MountingEstimate:
        """The mounting given or found, refined by what the filter has learnt of its pitch and yaw since."""
        nav, C_b_from_s = self._filter, self._preparation.C_b_from_s
        pitch_sd = yaw_sd = nav.mount_angle_sd_rad
        roll_sd, found = pitch_sd, False
        if self._mounting is not None:
            finder, found = self._mounting.finder, self._mounting.finder.found
            C_b_from_s = finder.C_b_from_m @ C_b_from_s
            evidence = finder.evidence()
            if finder.agreed:  # the roll is no state of the filter: it changes nothing there
                roll_rad, _, _ = rpy_from_matrix(evidence.C_b_from_m @ finder.C_b_from_m.T)
                C_b_from_s = matrix_from_rpy(roll_rad, 0.0, 0.0) @ C_b_from_s
                roll_sd = evidence.tilt_sd_rad
        if nav.aligned:
            variance = np.diag(nav.covariance())
            pitch_sd, yaw_sd = (
                math.hypot(math.sqrt(max(variance[i], 0.0)), AXES_SD_RAD) for i in (state.MOUNT_PITCH, state.MOUNT_YAW)
            )
            C_b_from_v = matrix_from_rpy(0.0, float(nav.x[state.X_MOUNT_PITCH]), float(nav.x[state.X_MOUNT_YAW]))
            C_b_from_s = C_b_from_v.T @ C_b_from_s
        return MountingEstimate(
            self.config.mounting.known, found, rpy_from_matrix(C_b_from_s), (roll_sd, pitch_sd, yaw_sd)
        )

    def snapshot(self) -> bytes:
        """The whole state as bytes: restored, it goes on to the bit."""
        arrays: Arrays = {"recent.t": self._recent.t_ns, "recent.rows": self._recent.values}
        if self._placed is not None:
            arrays |= {"placed.t": np.array([self._placed[0]]), "placed.row": self._placed[1].as_array()}
        for stage, values in self._stages():
            arrays.update({f"{stage}/{name}": value for name, value in values.items()})
        return pack(arrays, SNAPSHOT_VERSION)

    @classmethod
    def restore(cls, config: SessionConfig, data: bytes) -> Session:
        """A session that goes on where ``snapshot`` was taken; raises SnapshotError."""
        arrays = unpack(data, SNAPSHOT_VERSION)
        session = cls(config)
        session._recent = Track(arrays.pop("recent.t"), arrays.pop("recent.rows"))  # type: ignore[arg-type]
        if "placed.t" in arrays:
            at_ns, place = arrays.pop("placed.t"), arrays.pop("placed.row")
            session._placed = int(at_ns[0]), Place.from_array(place)  # type: ignore[arg-type]
        parts: dict[str, Arrays] = {}
        for key, value in arrays.items():
            stage, name = key.split("/", 1)
            parts.setdefault(stage, {})[name] = value
        session._filter.load(parts["filter"])
        if session._detector_stage in parts:  # else the vehicle's detector was changed: it starts anew
            session._detector.load(parts[session._detector_stage])
        session._manoeuvres.load(parts["manoeuvres"])
        session._trips.load(parts["trips"])
        session._in_force.load(parts["calibration"])
        session._preparation = session._prepared(session._in_force.calibration)
        session._clock.load(parts["clock"])
        session._preparation.held.load(parts["held"])
        session._warming.load(parts["warming"])
        if session._mounting is not None and "mounting" in parts:
            session._mounting.load(parts["mounting"])
        return session

    def _stages(self) -> list[tuple[str, Arrays]]:
        found = [] if self._mounting is None else [("mounting", self._mounting.arrays())]
        return [
            ("clock", self._clock.arrays()),
            ("held", self._preparation.held.arrays()),
            ("warming", self._warming.arrays()),
            ("filter", self._filter.arrays()),
            (self._detector_stage, self._detector.state()),
            ("manoeuvres", self._manoeuvres.state()),
            ("trips", self._trips.state()),
            ("calibration", self._in_force.arrays()),
            *found,
        ]

    def _aids(self, m: Measurements) -> Aids:
        magnetic = self._preparation.magnetic_b_ut(m.magnetic_s_ut)
        return Aids(
            (m.gnss_t_ns, m.gnss),
            (m.magnetometer_t_ns, magnetic),
            (m.speed_t_ns, m.speed_mps),
            (m.barometer_t_ns, m.pressure_pa),
        )

    @staticmethod
    def _add_counts(table: npt.NDArray[np.int64], counts: dict[str, int]) -> None:
        # An aid that came late is judged with all that followed it anew: what others then lose is not taken back.
        for aid, outcome in zip(*np.nonzero(table > 0), strict=True):
            name = f"{state.AIDS[aid]}.{state.OUTCOMES[outcome]}"
            counts[name] = counts.get(name, 0) + int(table[aid, outcome])


def _seen_place(t_ns: int, decided_t_ns: int, rows: Track) -> Place:
    """Where the vehicle was, by the rows of the last ``RECENT_S`` that were there at the decision: all that a session
    keeps of them, however samples come in packets."""
    return place_at(t_ns, newest(told_until(rows, decided_t_ns), RECENT_S))


def _unsound(samples: BodySamples) -> npt.NDArray[np.float64]:
    return CLIPPED * samples.saturated + HELD * samples.held
