"""A drive cut into packets: nothing lost or changed, numbered without a hole, accepted by the service's checks."""

from __future__ import annotations

import math
import time
from dataclasses import replace

import numpy as np
import pytest

from core.measurements import GNSS, Measurements
from core.simulation.scenarios import simulate
from schemas.packet import decode, measurements_from_packet
from service.errors import RecordingError
from service.ingest.validation import check_content, check_identity
from service.recordings.drive_folder import Drive, read_drive
from service.recordings.packets import drive_packets
from service.recordings.simulated import drive_of
from tests.recordings import recording


def _received(drive: Drive, **options: float) -> list[Measurements]:
    received = []
    for sequence, packet in enumerate(drive_packets(drive, "boot-1", **options), start=1):
        sent = decode(packet.SerializeToString())
        check_identity(sent, drive.vehicle_id)
        check_content(sent, time.time_ns())
        assert sent.sequence == sequence
        received.append(measurements_from_packet(sent))
    return received


@pytest.fixture(scope="module")
def simulated() -> Drive:
    return drive_of(simulate("highway", seed=2, duration_s=60.0))


def _all(parts: list[Measurements], name: str) -> np.ndarray:
    return np.concatenate([getattr(part, name) for part in parts])


def test_a_simulated_drive_arrives_whole_in_packets_of_a_second(simulated: Drive) -> None:
    parts = _received(simulated)
    m = simulated.measurements
    assert len(parts) == 61
    assert {part.imu_t_ns.size for part in parts[:-1]} == {200}
    for name in ("imu_t_ns", "gnss_t_ns", "magnetometer_t_ns", "speed_t_ns", "barometer_t_ns"):
        assert np.array_equal(_all(parts, name), getattr(m, name)), name
    assert _all(parts, "pressure_pa").size == 601
    assert _all(parts, "pressure_pa") == pytest.approx(m.pressure_pa, abs=0.004)  # float32 near 1e5
    # The box's counts go over the wire as they are; the folder holds nine digits of them.
    assert _all(parts, "f_s") == pytest.approx(m.f_s, abs=1e-6)
    assert _all(parts, "omega_s") == pytest.approx(m.omega_s, abs=1e-6)
    gnss = _all(parts, "gnss")
    assert gnss[:, GNSS["lat_rad"]] == pytest.approx(m.gnss[:, GNSS["lat_rad"]], abs=math.radians(1e-9))
    assert gnss[:, GNSS["vn_mps"]] == pytest.approx(m.gnss[:, GNSS["vn_mps"]], abs=1e-3)
    assert parts[0].accel_full_scale_mps2 == pytest.approx(2 * 9.80665)


def test_the_wide_form_keeps_what_counts_would_clip(simulated: Drive) -> None:
    loud = replace(simulated, measurements=replace(simulated.measurements, f_s=simulated.measurements.f_s * 50))
    parts = _received(loud, wide=True)
    assert _all(parts, "f_s") == pytest.approx(loud.measurements.f_s, rel=1e-6)


@pytest.mark.parametrize("name", ["kth_stockholm", "comma2k19_segment", "boston_vn100"])
def test_a_real_recording_arrives_whole_with_its_own_times(name: str) -> None:
    drive = read_drive(recording("drives", name))
    parts = _received(drive)
    for series in ("imu_t_ns", "gnss_t_ns", "magnetometer_t_ns", "speed_t_ns"):
        assert np.array_equal(_all(parts, series), getattr(drive.measurements, series)), series
    # Half a count of a 2 g and a 250 deg/s converter.
    assert np.abs(_all(parts, "f_s") - drive.measurements.f_s).max() <= 2 * 9.80665 / 65536 * 1.001
    assert np.abs(_all(parts, "omega_s") - drive.measurements.omega_s).max() <= math.radians(250) / 65536 * 1.001


def test_a_pause_ends_a_packet_and_missing_samples_are_left_out(simulated: Drive) -> None:
    m = simulated.measurements
    f_s = m.f_s.copy()
    f_s[10] = np.nan
    keep = np.ones(m.imu_t_ns.size, dtype=bool)
    keep[1050:5000] = False  # nearly 20 s without inertial samples; fixes go on
    holed = replace(m, imu_t_ns=m.imu_t_ns[keep], f_s=f_s[keep], omega_s=m.omega_s[keep])
    parts = _received(replace(simulated, measurements=holed))
    inertial = _all(parts, "imu_t_ns")
    assert inertial.size == keep.sum() - 1
    assert m.imu_t_ns[10] not in inertial
    assert all(np.diff(part.imu_t_ns).max(initial=0) < 20_000_000 for part in parts)
    assert _all(parts, "gnss_t_ns").size == m.gnss_t_ns.size


def test_a_packet_length_that_no_service_takes_is_refused(simulated: Drive) -> None:
    with pytest.raises(RecordingError, match="at most 60 s"):
        next(drive_packets(simulated, "boot-1", packet_s=90.0))
