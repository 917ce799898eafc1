"""``telefuse calibrate``: parameters that hold the truth, recordings in every form, what it says of bad ones."""

from __future__ import annotations

import gzip
import json
import math

import numpy as np
import pytest

from core.sensors import TriadCalibration
from core.simulation.calibration_recording import Iron, Warming, simulate_recording
from schemas.calibration import Calibration
from service.calibrating import CalibrationOptions, calibrate
from service.cli.drives import read_settings
from service.recordings.calibration_recording import ReadRecording
from tests.commands import call
from tests.recordings import recording

ACCELEROMETER = TriadCalibration((1.02, 0.98, 1.01), (0.01, -0.02, 0.015), (0.3, -0.2, 0.4))
GYROSCOPE = TriadCalibration((1.01, 0.99, 1.02), (0.01, -0.005, 0.01), (0.02, -0.01, 0.015), (0.01, -0.02, 0.005))
IRON = Iron(hard_iron_ut=(30.0, -20.0, 12.0), soft_iron=((1.1, 0.05, 0.0), (0.03, 0.95, 0.02), (0.0, 0.04, 1.02)))
GRAVITY = ("--gravity", "9.80665")
HEADER = "t_s,ax_mps2,ay_mps2,az_mps2,gx_radps,gy_radps,gz_radps"


def simulated(**changes):
    given = {
        "accelerometer": ACCELEROMETER,
        "gyroscope": GYROSCOPE,
        "positions": 18,
        "hold_s": 3.0,
        "initial_rest_s": 10.0,
        "rate_hz": 100.0,
    }
    return simulate_recording(np.random.default_rng(11), **(given | changes))


def write(path, header, *columns):
    """A CSV file of these columns, empty where there is no value."""
    lines = [",".join("" if math.isnan(v) else f"{v:.9g}" for v in row) for row in np.column_stack(columns)]
    text = "\n".join([header, *lines]) + "\n"
    path.write_bytes(gzip.compress(text.encode()) if path.suffix == ".gz" else text.encode())
    return path


@pytest.fixture(scope="module")
def box():
    return simulated(magnetometer=IRON)


@pytest.fixture(scope="module")
def file(tmp_path_factory, box):
    one = box.recording
    columns = (one.t_s, one.accelerometer, one.gyroscope, one.magnetometer)
    return write(tmp_path_factory.mktemp("calibrate") / "box.csv", f"{HEADER},mx_ut,my_ut,mz_ut", *columns)


def calibrated(capsys, *words):
    status, out, err = call(capsys, "calibrate", *words, "--json")
    assert status == 0, err
    return json.loads(out), err


def refused(capsys, *words):
    """The one line on stderr of a command that exits 2."""
    status, out, err = call(capsys, "calibrate", *words)
    assert (status, out) == (2, "")
    assert err.count("\n") == 1
    return err


def test_the_truth_lies_within_what_is_stated_and_the_service_takes_the_file(capsys, file, tmp_path):
    out = tmp_path / "calibration.json"
    found, err = calibrated(capsys, file, *GRAVITY, "--out", out)
    assert err == ""
    assert list(found) == ["accelerometer", "gyroscope", "magnetometer", "warnings"]
    for sensor, truth in (("accelerometer", ACCELEROMETER), ("gyroscope", GYROSCOPE)):
        for name in ("scale", "misalignment", "bias"):
            off = np.abs(np.array(found[sensor][name]) - getattr(truth, name))
            # 18 values of this unit: beyond 4 sd with a probability of 0.1 %.
            assert (off <= 4.0 * np.array(found[sensor]["sd"][name])).all(), (sensor, name, off)
        assert found[sensor]["positions"] == 18
        assert found[sensor]["observability"]["weak"] == []
        assert found[sensor]["gravity"] == 9.80665
    assert found["gyroscope"]["alignment"] == pytest.approx(GYROSCOPE.alignment, abs=2e-3)
    assert found["magnetometer"]["hard_iron"] == pytest.approx(IRON.hard_iron_ut, abs=0.2)
    assert json.loads(out.read_text()) == found
    # As 'fuse --calibration' reads it, and as a vehicle's calibration is put.
    assert read_settings(out, Calibration, "") == Calibration.model_validate(found)


def test_one_sensor_alone_can_be_asked_for(capsys, file):
    found, _ = calibrated(capsys, file, *GRAVITY, "--sensor", "gyroscope")
    assert list(found) == ["gyroscope", "warnings"]
    assert found["gyroscope"]["scale"] == pytest.approx(GYROSCOPE.scale, abs=2e-3)


def test_a_report_holds_what_each_sensor_tells(capsys, file, tmp_path):
    status, out, _ = call(capsys, "calibrate", file, *GRAVITY, "--report", tmp_path / "report.html")
    assert status == 0
    assert "accelerometer: 18 positions, gravity 9.80665 m/s² missed by" in out
    text = (tmp_path / "report.html").read_text()
    for title in ("Static positions", "|a| before and after", "Correlations of the parameters", "The magnetic field"):
        assert title in text


def test_gravity_comes_from_the_place(capsys, file, tmp_path, box):
    at_pole, _ = calibrated(capsys, file, "--latitude", "90", "--sensor", "accelerometer")
    assert at_pole["accelerometer"]["gravity"] == pytest.approx(9.832185, abs=1e-5)
    unknown, err = calibrated(capsys, file, "--sensor", "accelerometer")
    assert unknown["accelerometer"]["gravity"] == 9.80665
    assert "give --gravity, or --latitude and --height" in err
    drive = tmp_path / "drive"
    drive.mkdir()
    one = box.recording
    write(drive / "imu.csv", HEADER, one.t_s, one.accelerometer, one.gyroscope)
    write(drive / "gnss.csv", "t_s,lat_deg,lon_deg,alt_ellipsoid_m", [1.0], [90.0], [5.0], [0.0])
    known = np.isfinite(one.magnetometer[:, 0])
    write(drive / "magnetometer.csv", "t_s,mx_ut,my_ut,mz_ut", one.t_s[known] + 0.001, one.magnetometer[known])
    folder, _ = calibrated(capsys, drive)
    assert folder["accelerometer"] == at_pole["accelerometer"]
    assert folder["magnetometer"]["hard_iron"] == pytest.approx(IRON.hard_iron_ut, abs=0.2)


def test_given_sections_are_used_instead_of_found_ones(capsys, file, tmp_path, box):
    t_s = box.recording.t_s
    sections = write(tmp_path / "sections.csv", "start_s,end_s", t_s[box.starts + 20], t_s[box.ends - 20])
    found, _ = calibrated(capsys, file, *GRAVITY, "--sensor", "accelerometer", "--sections", sections)
    assert found["accelerometer"]["positions"] == 18
    assert found["accelerometer"]["scale"] == pytest.approx(ACCELEROMETER.scale, abs=1e-3)
    wrong = write(tmp_path / "wrong.csv", "start_s,end_s", [1.0, 9.0], [2.0, 8.0])
    assert "section 2 is 9 s to 8 s" in refused(capsys, file, "--sections", wrong, "--json")


def test_too_few_orientations_are_told_and_flagged_in_what_is_written(capsys, tmp_path):
    ups = np.vstack([np.eye(3), -np.eye(3)])
    flat = simulated(orientations=np.array([facing(up) for up in ups]), hold_s=5.0)
    one = flat.recording
    path = write(tmp_path / "faces.csv", HEADER, one.t_s, one.accelerometer, one.gyroscope)
    out = tmp_path / "calibration.json"
    found, err = calibrated(capsys, path, *GRAVITY, "--sensor", "accelerometer", "--out", out)
    seen = found["accelerometer"]["observability"]
    assert {"Mx", "My", "Mz"} <= set(seen["weak"])
    assert seen["add"]
    assert "record again and hold it also with" in seen["advice"]
    assert seen["advice"] in err
    assert json.loads(out.read_text()) == found
    told, _ = calibrated(
        capsys, path, *GRAVITY, "--sensor", "accelerometer", "--prior", "accelerometer.misalignment_sd_rad=0.001"
    )
    assert max(told["accelerometer"]["sd"]["misalignment"]) <= 0.001


def facing(up):
    """C_n_from_a in which this axis is up."""
    down = -np.asarray(up, dtype=float)
    east = np.roll(down, 1)
    return np.vstack([np.cross(east, down), east, down])


def bad(change):
    """A file of the box after ``change`` of (t_s, force, rate)."""

    def make(box, path):
        one = box.recording
        rows = change(one.t_s.copy(), one.accelerometer.copy(), one.gyroscope.copy(), box)
        return write(path, HEADER, *rows)

    return make


def clipped(t_s, force, rate, box):
    return t_s, np.clip(force, -8.0, 8.0), rate


def never_still(t_s, force, rate, box):
    sway = np.column_stack([np.sin(2.0 * t_s), np.cos(2.3 * t_s), np.sin(1.7 * t_s)])
    return t_s, force + 2.0 * sway, rate + sway


def dead_rate(t_s, force, rate, box):
    rate[:, 1] = 0.0
    return t_s, force, rate


def few(t_s, force, rate, box):
    rows = slice(0, box.ends[2])
    return t_s[rows], force[rows], rate[rows]


def with_nan(t_s, force, rate, box):
    force[500] = math.nan
    return t_s, force, rate


CASES = {
    "g": (lambda t, f, r, _: (t, f / 9.80665, r), "it looks like g (name the columns ax_g …)"),
    "counts": (lambda t, f, r, _: (t, f * 1670, r), "it looks like raw counts (say --counts)"),
    "deg/s": (lambda t, f, r, _: (t, f, np.degrees(r)), "they look like degrees a second"),
    "dead axis": (lambda t, f, r, _: (t, f * [1, 0, 1] * 1.2, r), "the accelerometer's y axis shows 0 throughout"),
    "dead gyroscope": (dead_rate, "the gyroscope's y axis shows 0 throughout: it is dead"),
    "saturated": (clipped, "saturated"),
    "never still": (never_still, "lie"),
    "few positions": (few, "lay the box on each of its six"),
    "short": (lambda t, f, r, _: (t[:100], f[:100], r[:100]), "the recording lasts 1.0 s"),
    "backwards": (lambda t, f, r, _: (t[::-1], f, r), "expected time to increase"),
    "nan": (with_nan, "accelerometer in row 501 of"),
    "milliseconds": (lambda t, f, r, _: (1e3 * t, f, r), "is the time in seconds, not in milliseconds?"),
    "stuck axis": (lambda t, f, r, _: (t, f * [1, 1e-3, 1] + [0, 9.8, 0], r), "an axis is stuck"),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_what_cannot_be_calibrated_is_refused_and_nothing_written(capsys, tmp_path, box, case):
    change, expected = CASES[case]
    path = bad(change)(box, tmp_path / "bad.csv")
    files = ("--out", tmp_path / "calibration.json", "--report", tmp_path / "report.html")
    assert expected in refused(capsys, path, *GRAVITY, *files)
    assert [one.name for one in tmp_path.iterdir()] == ["bad.csv"]


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", "is empty; expected a header and samples"),
        (f"{HEADER}\n".encode(), "has a header and no rows"),
        (HEADER.replace(",", ";").encode() + b"\n0;0;0;9,8;0;0;0\n", "line 1: cells are parted by semicolons"),
        (HEADER.replace(",", "\t").encode() + b"\n", "cells are parted by tabs"),
        (b"\x00\xff\xfe", "expected a CSV file in UTF-8"),
    ],
)
def test_a_file_that_is_no_recording_is_refused_for_what_it_is(capsys, tmp_path, content, expected):
    path = tmp_path / "bad.csv"
    path.write_bytes(content)
    assert expected in refused(capsys, path, "--json")


@pytest.mark.parametrize("damage", [lambda b: b[: len(b) // 2], lambda b: b[:40] + b"\xff" * 40 + b[80:]])
def test_a_damaged_gzip_file_is_refused(capsys, tmp_path, damage):
    path = tmp_path / "bad.csv.gz"
    path.write_bytes(damage(gzip.compress((HEADER + "\n" + "0,0,0,9.8,0,0,0\n" * 999).encode())))
    assert "cannot be read" in refused(capsys, path, "--json")


def test_a_left_handed_triad_is_told(capsys, tmp_path, box):
    """Gravity's length does not tell it, and the gyroscope's axes come out half a turn aside."""
    one = box.recording
    path = write(tmp_path / "swapped.csv", HEADER, one.t_s, one.accelerometer[:, [1, 0, 2]], one.gyroscope)
    found, err = calibrated(capsys, path, *GRAVITY)
    assert "axes are swapped or reversed in one of the two" in err
    assert any("axes are swapped" in one for one in found["gyroscope"]["warnings"])


def test_a_calibration_of_counts_is_not_applied_to_a_drive(tmp_path):
    with pytest.raises(ValueError, match="gyroscope: its scale is 6550, 1, 1, as of raw counts"):
        Calibration.model_validate({"gyroscope": {"scale": [6550.0, 1.0, 1.0]}}).check_units()
    Calibration.model_validate({"gyroscope": {"scale": [1.1, 0.9, 1.0]}}).check_units()


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ((), "nothing asked for; expected --out CALIBRATION.json"),
        (("--json", "--height", "3"), "--height needs --latitude"),
        (("--json", "--gravity", "9.8", "--latitude", "50"), "both say how strong gravity is"),
        (("--json", "--latitude", "91"), "--latitude 91 is beyond the Earth"),
        (("--json", "--gravity", "0"), "'0' is not gravity in m/s²"),
        (("--json", "--gravity", "8"), "gravity is 8 m/s2; expected 9.7 to 9.9"),
        (("--json", "--prior", "scale=2"), "expected SENSOR.NAME=VALUE"),
        (("--json", "--prior", "gyroscope.colour=2"), "'colour' is none; the gyroscope has scale_sd"),
        (("--json", "--prior", "gyroscope.scale_sd=much"), "'much' is no number"),
        (("--json", "--prior", "gyroscope.scale_sd=-1"), "GyroscopePrior.scale_sd is -1.0: expected"),
        (("--json", "--sensor", "barometer"), "invalid choice: 'barometer'"),
    ],
)
def test_bad_usage_is_one_line(capsys, file, words, expected):
    assert expected in refused(capsys, file, *words)


def test_a_sensor_that_is_not_there_is_asked_for_in_vain(capsys, tmp_path, box):
    one = box.recording
    path = write(tmp_path / "force.csv", "t_s,ax_mps2,ay_mps2,az_mps2", one.t_s, one.accelerometer)
    assert "has no gyroscope" in refused(capsys, path, "--json", "--sensor", "gyroscope")
    found, _ = calibrated(capsys, path, *GRAVITY)
    assert list(found) == ["accelerometer", "warnings"]


def test_circles_on_level_ground_calibrate_a_vehicles_magnetometer(capsys, tmp_path):
    rng, rate_hz = np.random.default_rng(4), 50.0
    t_s = np.arange(int(80 * rate_hz)) / rate_hz
    heading = 2 * np.pi * t_s / 40.0
    field = np.column_stack([20.0 * np.cos(heading), -20.0 * np.sin(heading), np.full(t_s.size, 44.0)])
    shown = field @ np.array([[1.05, 0.02, 0.0], [0.02, 0.95, 0.0], [0.0, 0.0, 1.0]]) + [15.0, -8.0, 0.0]
    force = rng.normal([0.0, 0.0, -9.81], 0.05, (t_s.size, 3))
    rate = rng.normal([0.0, 0.0, 2 * np.pi / 40.0], 0.002, (t_s.size, 3))
    path = write(
        tmp_path / "circles.csv",
        f"{HEADER},mx_ut,my_ut,mz_ut",
        t_s,
        force,
        rate,
        shown + rng.normal(0.0, 0.4, shown.shape),
    )
    found, _ = calibrated(capsys, path, "--level")
    assert list(found) == ["magnetometer", "warnings"]
    # The vertical part stays unknown on level ground.
    assert found["magnetometer"]["hard_iron"][:2] == pytest.approx([15.0, -8.0], abs=0.3)
    assert found["magnetometer"]["observability"]["weak"]


def test_a_box_that_warms_up_is_told_by_how_much_its_bias_follows(capsys, tmp_path):
    warm = Warming(start_c=20.0, end_c=40.0, warming_s=60.0, accelerometer_per_k=(0.0, 0.0, 0.0))
    one = simulated(warming=warm, hold_s=4.0).recording
    header = f"{HEADER},temperature_c"
    path = write(tmp_path / "warm.csv", header, one.t_s, one.accelerometer, one.gyroscope, one.temperature_c)
    found, err = calibrated(capsys, path, *GRAVITY, "--report", tmp_path / "report.html")
    slope = found["gyroscope"]["temperature"]
    off = np.abs(np.array(slope["slope_per_k"]) - warm.gyroscope_per_k)
    assert (off <= 4.0 * np.array(slope["sd"])).all()
    assert 15.0 < slope["high_c"] - slope["low_c"] < 21.0
    assert "gyroscope: its bias follows temperature on x, y, z" in err
    assert "Bias and temperature" in (tmp_path / "report.html").read_text()
    noise = call(capsys, "noise", path)
    assert noise[0] == 2  # it was moved


def test_the_papers_mode_tells_the_bias_and_says_what_it_cannot(capsys, file, tmp_path):
    words = (*GRAVITY, "--sensor", "gyroscope", "--earth-rate", "--report", tmp_path / "report.html")
    found, err = calibrated(capsys, file, *words)
    # The Earth's rate itself, 7e-5 rad/s, is within the spread of a bias.
    assert found["gyroscope"]["bias"] == pytest.approx(GYROSCOPE.bias, abs=5e-4)
    assert {"Mx", "My", "Mz"} <= set(found["gyroscope"]["observability"]["weak"])
    assert "the Earth's rate is below this triad's noise" in err
    assert "by the Earth's rate" in (tmp_path / "report.html").read_text().replace("&#x27;", "'")


def test_progress_reaches_the_end(box):
    told = []
    read = ReadRecording("box", box.recording, counts=False, rate_hz=100.0)
    calibrate(read, CalibrationOptions(gravity_mps2=9.80665), told.append)
    assert told == sorted(told)
    assert told[-1] == 1.0


def test_a_real_recording_in_counts_agrees_with_the_factory(capsys):
    path = recording("data", "calib_xsens_imu_tk", "imu_raw.csv.gz")
    found, err = calibrated(capsys, path, "--counts", "--gravity", "9.81744")
    # Gains by the factory's calibration sheet, counts per m/s2 and per rad/s, rounded to whole counts: 0.7 %.
    assert found["accelerometer"]["scale"] == pytest.approx([415.0, 413.0, 415.0], rel=0.007)
    assert found["gyroscope"]["scale"] == pytest.approx([4778.0, 4758.0, 4766.0], rel=0.007)
    assert found["accelerometer"]["residual_rms"] <= 1.0e-3
    assert found["accelerometer"]["positions"] == 38
    assert found["accelerometer"]["observability"]["weak"] == found["gyroscope"]["observability"]["weak"] == []
    assert "this calibration is of raw counts" in err


def test_ten_positions_of_a_real_box_are_called_too_few(capsys):
    path = recording("data", "calib_mpu6050_arduino", "calibration.csv.gz")
    found, err = calibrated(capsys, path, "--counts", "--gravity", "9.80665", "--sensor", "accelerometer")
    assert found["accelerometer"]["observability"]["weak"]
    assert "record again" in err
