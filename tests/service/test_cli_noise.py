"""``telefuse noise``: figures that the filter takes, recordings in every form, and what is said of bad ones."""

from __future__ import annotations

import gzip
import json
import math
import re

import numpy as np
import pytest

from schemas.vehicles import SensorNoise, VehicleConfig
from service.cli.drives import read_settings
from tests.commands import call
from tests.recordings import recording

RATE_HZ = 50.0
ACCEL, GYRO = 2e-3, 2e-4
"""Densities of the white noise of the recordings here, m/s2/sqrt(Hz) and rad/s/sqrt(Hz)."""
SI = "t_s,ax_mps2,ay_mps2,az_mps2,gx_radps,gy_radps,gz_radps"


def samples(seconds=400.0, seed=1):
    """Time, specific force and rate of a box at rest, with a walk of the gyroscope's bias."""
    rng, rows = np.random.default_rng(seed), int(seconds * RATE_HZ)
    force = rng.normal([0.1, -0.2, -9.8], ACCEL * math.sqrt(RATE_HZ), (rows, 3))
    walk = np.cumsum(rng.normal(0.0, 2e-5 / math.sqrt(RATE_HZ), (rows, 3)), axis=0)
    rate = rng.normal(0.01, GYRO * math.sqrt(RATE_HZ), (rows, 3)) + walk
    return np.arange(rows) / RATE_HZ, force, rate


def write(path, header, *columns, before=""):
    """A CSV file of these columns."""
    lines = [",".join(f"{value:.9g}" for value in row) for row in np.column_stack(columns)]
    text = before + "\n".join([header, *lines]) + "\n"
    path.write_bytes(gzip.compress(text.encode()) if path.suffix == ".gz" else text.encode())
    return path


@pytest.fixture(scope="module")
def still(tmp_path_factory):
    return write(tmp_path_factory.mktemp("noise") / "still.csv", SI, *samples())


def noise_json(capsys, *words):
    status, out, err = call(capsys, "noise", *words, "--json")
    assert status == 0, err
    return json.loads(out), err


def refused(capsys, *words):
    """The one line on stderr of a command that exits 2."""
    status, out, err = call(capsys, "noise", *words)
    assert (status, out) == (2, "")
    assert err.count("\n") == 1
    return err


def test_the_figures_hold_the_truth_and_the_vehicles_settings_take_them(capsys, still, tmp_path):
    found, _ = noise_json(capsys, still)
    for sensor, density in (("accelerometer", ACCEL), ("gyroscope", GYRO)):
        for value, (low, high) in zip(
            found[sensor]["random_walk"], found[sensor]["interval95"]["random_walk"], strict=True
        ):
            assert low <= value <= high
            # 20 000 samples tell white noise to 1 %; six intervals of 95 % need some room.
            assert low * 0.98 <= density <= high * 1.02
    for low, high in found["gyroscope"]["interval95"]["rate_random_walk"]:
        assert low * 0.7 <= 2e-5 <= high * 1.4
    assert found["recording"]["duration_s"] == pytest.approx(400.0)
    settings = tmp_path / "noise.json"
    settings.write_text(json.dumps(found))
    # As 'fuse --noise' reads it, and as the vehicle's settings are.
    noise = read_settings(settings, SensorNoise, "")
    assert VehicleConfig.model_validate({"noise": found}).noise == noise


def test_what_a_recording_is_too_short_for_is_left_to_the_filter_and_said(capsys, tmp_path):
    path = write(tmp_path / "short.csv", SI, *(rows[: int(60 * RATE_HZ)] for rows in samples(seed=3)))
    found, err = noise_json(capsys, path)
    assert found["accelerometer"]["bias_instability"] is None
    assert all(low == 0.0 < high for low, high in found["accelerometer"]["interval95"]["bias_instability"])
    assert "accelerometer x, y, z: 0.017 h are too short to tell bias instability from none" in err
    assert any("too short" in warning for warning in found["recording"]["warnings"])


def test_the_same_recording_in_other_forms_gives_the_same_figures(capsys, still, tmp_path):
    expected, _ = noise_json(capsys, still)
    t_s, force, rate = samples()
    g, degree = 9.80665, math.radians(1.0)
    units = write(
        tmp_path / "units.csv.gz",
        "t_s,acc_x_g,acc_y_g,acc_z_g,gyr_x_dps,gyr_y_dps,gyr_z_dps",
        t_s,
        force / g,
        rate / degree,
    )
    bare = write(tmp_path / "bare.csv", "ax,ay,az,gx,gy,gz", force / g, rate / degree)
    logger = write(
        tmp_path / "logger.csv",
        "n,ax_g,ay_g,az_g,gx_dps,gy_dps,gz_dps",
        t_s,
        force / g,
        rate / degree,
        before="Fs,50\nType,1\n",
    )
    drive = tmp_path / "drive"
    drive.mkdir()
    write(drive / "imu.csv", SI, t_s, force, rate)
    for words in (
        (units,),
        (bare, "--rate", "50", "--accel-unit", "g", "--gyro-unit", "dps"),
        (logger,),
        (drive,),
    ):
        found, _ = noise_json(capsys, *words)
        for sensor in ("accelerometer", "gyroscope"):
            # Nine digits were written, and numbers are compared.
            assert found[sensor]["random_walk"] == pytest.approx(expected[sensor]["random_walk"], rel=1e-4)


def test_counts_are_made_units_by_a_calibration(capsys, still, tmp_path):
    expected, _ = noise_json(capsys, still)
    t_s, force, rate = samples()
    counts = write(
        tmp_path / "counts.csv", "t_s,ax_raw,ay_raw,az_raw,gx_raw,gy_raw,gz_raw",
        t_s, np.rint(force * 20_000 + 300), np.rint(rate * 200_000 - 50),
    )  # fmt: skip
    known = tmp_path / "calibration.json"
    triads = {"accelerometer": (20_000.0, 300.0), "gyroscope": (200_000.0, -50.0)}
    known.write_text(json.dumps({name: {"scale": [s] * 3, "bias": [b] * 3} for name, (s, b) in triads.items()}))
    found, _ = noise_json(capsys, counts, "--counts", "--calibration", known)
    # Rounding adds a twelfth of a squared step: 1e-5 of this noise.
    assert found["gyroscope"]["random_walk"] == pytest.approx(expected["gyroscope"]["random_walk"], rel=1e-3)
    assert "counts need --calibration FILE" in refused(capsys, counts, "--counts")


def test_motion_is_cut_out_and_said(capsys, tmp_path):
    t_s, force, rate = samples(200.0)
    rate[int(50 * RATE_HZ) : int(55 * RATE_HZ)] += 0.3
    found, err = noise_json(capsys, write(tmp_path / "moved.csv", SI, t_s, force, rate))
    assert "only the longest rest is used" in err
    assert 140.0 <= found["recording"]["duration_s"] <= 145.0


def test_a_report_is_written_and_text_is_printed(capsys, still, tmp_path):
    status, out, _ = call(capsys, "noise", still, "--report", tmp_path / "noise.html")
    assert status == 0
    assert "random walk, °/√h" in out
    assert re.search(r"random walk, °/√h +0\.6[89]\d+ \(0\.6", out)  # 2e-4 rad/sqrt(s) is 0.688
    text = (tmp_path / "noise.html").read_text()
    assert "Noise report: still.csv" in text
    assert text.count('class="plot"') == 8


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda t, f, r: (t, f / 9.80665, r), "at rest 9.8 m/s² ± 20 % is expected: it looks like g (name"),
        (lambda t, f, r: (t, f * 100, r), "it looks like mg"),
        (lambda t, f, r: (t, f * 3000, r), "it looks like raw counts (say --counts)"),
        (lambda t, f, r: (t, f, r * 57.3), "random walk of the gyroscope, axis x is 0.01"),
        (lambda t, f, r: (t[:200], f[:200], r[:200]), "lasts 4.0 s; expected at least 10 s at rest"),
        (lambda t, f, r: (t, f * [1, 0, 1], r), "accelerometer y never changes: a dead axis"),
        (lambda t, f, r: (t[::-1], f, r), "line 3, column 't_s'"),
        (lambda t, f, r: (t, np.where(t[:, None] == 2.0, np.nan, f), r), "accelerometer in row 101 of 6000 is not"),
        (lambda t, f, r: (t, f, r + 0.1 * np.sin(t[:, None] * 0.7)), "the box was not at rest"),
    ],
    ids=["g", "mg", "counts", "deg/s", "short", "dead", "backwards", "nan", "moving"],
)  # fmt: skip
def test_a_recording_that_cannot_be_is_refused_in_one_line(capsys, tmp_path, change, expected):
    path = write(tmp_path / "bad.csv", SI, *change(*samples(120.0)))
    report = tmp_path / "report.html"
    assert expected in refused(capsys, path, "--report", report)
    assert not report.exists()


@pytest.mark.parametrize(
    ("header", "words", "expected"),
    [
        ("t_s,ax,ay,az,gx,gy,gz", (), "column 'ax' says no unit; name it ax_mps2, ax_g, ax_mg, or say --accel-unit"),
        ("t_s,ax_raw,ay_raw,az_raw,gx,gy,gz", (), "column 'ax_raw' is in counts; say so with --counts"),
        (SI, ("--counts",), "column 'ax_mps2' has a unit; with --counts expected columns like ax_raw"),
        ("n,ax_mps2,ay_mps2,az_mps2,gx_radps,gy_radps,gz_radps", (), "no column 't_s' and no line 'Fs,HZ'"),
        ("t_s,gx_radps,gy_radps,gz_radps,b,c,d", (), "line 1: no accelerometer"),
        ("a,b,c,d,e,f,g", (), "no header with ax_mps2"),
        (SI, ("--rate", "-5"), "'-5' is not samples a second, above 0"),
    ],
)
def test_a_header_that_leaves_open_what_it_means_is_refused(capsys, tmp_path, header, words, expected):
    path = write(tmp_path / "header.csv", header, *samples(20.0))
    assert expected in refused(capsys, path, *words)


def test_a_file_that_is_none_is_refused(capsys, tmp_path):
    assert "cannot be read" in refused(capsys, tmp_path / "missing.csv")
    (tmp_path / "folder").mkdir()
    assert "is a folder with no imu.csv" in refused(capsys, tmp_path / "folder")
    (tmp_path / "empty.csv").write_text(SI + "\n")
    assert "has a header and no rows" in refused(capsys, tmp_path / "empty.csv")


def test_a_real_recording_of_counts_tells_its_noise(capsys, tmp_path):
    """The MPU-6050's data sheet has 0.005 deg/s/sqrt(Hz) at 10 Hz as typical; this unit has 1.5 to 2.3 times that."""
    path = recording("data", "calib_mpu6050_arduino", "static_449s.csv.gz")
    known = tmp_path / "calibration.json"
    triads = {"accelerometer": 16384 / 9.80665, "gyroscope": 131 / math.radians(1.0)}
    known.write_text(json.dumps({name: {"scale": [scale] * 3} for name, scale in triads.items()}))
    found, _ = noise_json(capsys, path, "--counts", "--calibration", known)
    for value in found["gyroscope"]["random_walk"]:
        assert 1.0 < math.degrees(value) / 0.005 < 3.0
