"""Drive folders: what is written is read back, real recordings are read, and bad ones are refused by place."""

from __future__ import annotations

import gzip
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from core.measurements import GNSS, Measurements
from schemas.vehicles import AccelerometerNoise, GyroscopeNoise, NoiseIntervals, SensorNoise
from service.cli import main
from service.errors import RecordingError
from service.recordings.drive_folder import AttitudeSeries, Drive, Reference, read_drive, write_drive
from service.recordings.drive_toml import Driver, GnssSetup, ImuSetup
from tests.recordings import recording

TOML = 'name = "n"\nstart_utc = "2024-05-06T08:30:00Z"\nvehicle_id = "v"\n'
IMU = "t_s,ax_mps2,ay_mps2,az_mps2,gx_radps,gy_radps,gz_radps\n0.0,0,0,-9.8,0,0,0\n0.01,0.1,0,-9.8,0,0,0.2\n"
START_NS = 1_714_984_200_000_000_000
NOISE = SensorNoise(
    accelerometer=AccelerometerNoise(random_walk=(1e-3, 1e-3, 2e-3), turn_on_bias_sd=(0.03, 0.03, 0.05)),
    gyroscope=GyroscopeNoise(
        random_walk=(1e-4, 2e-4, 1e-4),
        rate_random_walk=(0.0, 0.0, 1e-6),
        interval95=NoiseIntervals(random_walk=((0.9e-4, 1.1e-4), (1.8e-4, 2.2e-4), (0.9e-4, 1.1e-4))),
    ),
)


def _folder(path: Path, **files: str) -> Path:
    path.mkdir(exist_ok=True)
    for name, text in {"drive_toml": TOML, "imu_csv": IMU, **files}.items():
        (path / name.replace("_", ".")).write_text(text)
    return path


def _drive() -> Drive:
    rng = np.random.default_rng(1)
    n = 50
    t_ns = START_NS + np.cumsum(rng.integers(9_000_000, 11_000_000, n))
    gnss = np.full((3, len(GNSS)), np.nan)
    gnss[:, GNSS["lat_rad"]], gnss[:, GNSS["lon_rad"]], gnss[:, GNSS["alt_m"]] = 0.7, -0.06, 640.0
    gnss[1:, GNSS["speed_mps"]], gnss[1:, GNSS["course_rad"]] = 3.0, 1.0
    gnss[:, GNSS["fix"]] = 3.0
    return Drive(
        name='a "quoted" name, ü',
        start_t_ns=START_NS,
        vehicle_id="v-1",
        measurements=Measurements(
            imu_t_ns=t_ns,
            f_s=rng.normal(0, 10, (n, 3)).astype(np.float32).astype(float),
            omega_s=np.round(rng.normal(0, 1, (n, 3)), 6),
            gnss_t_ns=t_ns[[0, 20, 40]],
            gnss=gnss,
            magnetometer_t_ns=t_ns[::10],
            magnetic_s_ut=np.round(rng.normal(0, 30, (5, 3)), 3),
            speed_t_ns=t_ns[::25],
            speed_mps=np.array([1.25, 1.5]),
            barometer_t_ns=t_ns[::20],
            pressure_pa=np.array([94012.25, 94012.5, 94013.0]),
            accel_full_scale_mps2=19.6133,
        ),
        imu=ImuSetup(100.0, "forward-right-down", (1.0, -2.0, 90.0), (0.1, 0.2, 0.3), 19.6133, NOISE),
        gnss=GnssSetup((0.5, 0.0, -1.2), 0.05),
        driver=Driver(age=32, sex="M"),
        reference=Reference(t_ns, *np.full((3, n), 0.5), rng.normal(0, 1, (n, 3)), rng.normal(0, 0.5, (n, 3))),
        attitude=AttitudeSeries(t_ns[:2], np.array([[1.0, 0.0, 0.0, 0.0], [0.6, 0.8, 0.0, 0.0]])),
        truth={"accidents": [], "outages": []},
    )


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    drive = _drive()
    write_drive(tmp_path / "d", drive)
    read = read_drive(tmp_path / "d")
    for name in ("name", "start_t_ns", "vehicle_id", "imu", "gnss", "driver", "gnss_alt_is_msl", "truth"):
        assert getattr(read, name) == getattr(drive, name), name
    for name in ("imu_t_ns", "omega_s", "gnss_t_ns", "magnetometer_t_ns", "magnetic_s_ut", "speed_t_ns", "speed_mps"):
        assert np.array_equal(getattr(read.measurements, name), getattr(drive.measurements, name)), name
    assert read.measurements.barometer_t_ns.tolist() == drive.measurements.barometer_t_ns.tolist()
    assert read.measurements.pressure_pa == pytest.approx(drive.measurements.pressure_pa, rel=1e-12)  # Pa, hPa and back
    # Nine digits of a value near 10, ten decimals of a degree.
    assert read.measurements.f_s == pytest.approx(drive.measurements.f_s, rel=1e-8)
    assert read.measurements.gnss == pytest.approx(drive.measurements.gnss, rel=1e-7, abs=1e-11, nan_ok=True)
    assert read.measurements.accel_full_scale_mps2 == 19.6133
    assert read.reference is not None
    assert drive.reference is not None
    assert read.reference.v_n_mps == pytest.approx(drive.reference.v_n_mps, abs=1e-5)
    assert read.reference.rpy_rad == pytest.approx(drive.reference.rpy_rad, abs=1e-6)
    assert read.attitude is not None
    assert read.attitude.q_n_from_b[1].tolist() == [0.6, 0.8, 0.0, 0.0]


def test_the_same_drive_gives_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_drive(tmp_path / name, _drive())
    for file in (tmp_path / "a").iterdir():
        assert file.read_bytes() == (tmp_path / "b" / file.name).read_bytes(), file.name


def test_heights_above_the_sea_stay_marked_as_such(tmp_path: Path) -> None:
    write_drive(tmp_path / "d", replace(_drive(), gnss_alt_is_msl=True))
    read = read_drive(tmp_path / "d")
    assert read.gnss_alt_is_msl
    assert read.measurements.gnss[0, GNSS["alt_m"]] == 640.0


def test_plain_and_compressed_tables_extra_columns_quotes_and_empty_cells_are_taken(tmp_path: Path) -> None:
    folder = _folder(
        tmp_path / "d",
        gnss_csv="t_s,note,lat_deg,lon_deg,alt_ellipsoid_m,satellites\r\n"
        '1,"a, b",45.5,-73.5,,7\r\n2,,45.6,-73.5,30,\r\n',
    )
    (folder / "imu.csv").unlink()
    (folder / "imu.csv.gz").write_bytes(gzip.compress(IMU.replace("0.1,0,", "0.1,,").encode()))
    m = read_drive(folder).measurements
    assert math.degrees(m.gnss[1, GNSS["lat_rad"]]) == pytest.approx(45.6)
    assert np.isnan(m.gnss[0, GNSS["alt_m"]])
    assert np.isnan(m.gnss[1, GNSS["satellites"]])
    assert m.gnss[0, GNSS["satellites"]] == 7
    assert np.isnan(m.gnss[:, GNSS["vn_mps"]]).all()
    assert np.isnan(m.f_s[1, 1])
    assert m.imu_t_ns.tolist() == [START_NS, START_NS + 10_000_000]


def test_air_pressure_is_read_in_hectopascal_and_a_missing_one_is_no_sample(tmp_path: Path) -> None:
    folder = _folder(tmp_path / "d", barometer_csv="t_s,pressure_hpa\n0,950.25\n0.1,\n0.2,0\n0.3,950.5\n")
    m = read_drive(folder).measurements
    # One wild value of a sensor does not make the recording unreadable: it goes to the filter, which refuses it.
    assert m.pressure_pa.tolist() == [95_025.0, 0.0, 95_050.0]
    assert (m.barometer_t_ns - START_NS).tolist() == [0, 200_000_000, 300_000_000]


@pytest.mark.parametrize(
    ("file", "text", "expected"),
    [
        ("imu_csv", IMU.replace("0.01,0.1", "0.01,abc"), r"imu\.csv: line 3, column 'ax_mps2': 'abc' is no number"),
        ("imu_csv", IMU + "0.005,0,0,0,0,0,0\n", r"imu\.csv: line 4, column 't_s': 0\.005 follows 0\.01"),
        ("imu_csv", IMU + "0.01,0,0,0,0,0,0\n", "time to increase"),
        ("imu_csv", IMU + "\n0.02,0,0,0\n", r"line 5: column 'gx_radps' is missing, the row has 4 cells"),
        ("imu_csv", IMU + "0.02,0,inf,0,0,0,0\n", r"line 4, column 'ay_mps2': inf is no finite number"),
        ("imu_csv", IMU + ",0,0,0,0,0,0\n", r"line 4, column 't_s'.*a time in seconds"),
        ("imu_csv", IMU + "1714984200000,0,0,0,0,0,0\n", "seconds since the drive's zero"),
        ("imu_csv", IMU.replace("gz_radps", "gz"), r"imu\.csv: line 1: column 'gz_radps' is missing"),
        ("imu_csv", IMU.split("\n")[0] + "\n", "no rows"),
        ("imu_csv", "", "column 't_s' is missing"),
        ("gnss_csv", "t_s,lat_deg,lon_deg\n1,2,3\n", "'alt_ellipsoid_m' or 'alt_msl_m'"),
        ("gnss_csv", "t_s,lat_deg,lon_deg,alt_msl_m,vn_mps\n1,2,3,4,5\n", "'vn_mps' needs 've_mps' beside it"),
        ("drive_toml", "name = ", "cannot be read as TOML"),
        ("drive_toml", 'name = "n"\n', r"start_utc is missing; expected a UTC time"),
        ("drive_toml", TOML.replace("2024-05-06T", "yesterday "), "start_utc is 'yesterday"),
        ("drive_toml", TOML + "[imu]\nmounting_rpy_deg = [1, 2]\n", r"\[imu\] mounting_rpy_deg.*three numbers"),
        ("drive_toml", TOML + "[imu]\nrate_hz = 0\n", r"\[imu\] rate_hz is 0; expected a number above 0"),
        ("drive_toml", TOML + '[driver]\nsex = "x"\n', r"\[driver\] sex"),
        (
            "drive_toml",
            TOML + "[imu.noise.gyroscope]\nrandom_walk = [0.3, 0.3, 0.3]\n",  # deg/sqrt(h)
            r"imu\.noise\.gyroscope\.random_walk\.0 is 0\.3: .*less than or equal to 0\.005; expected .* rad/s",
        ),
        ("drive_toml", TOML + "[imu]\nnoise = 3\n", r"\[imu\] noise is 3; expected a table"),
        ("drive_toml", TOML + "[imu.noise]\ngyro_arw = 1e-4\n", r"imu\.noise\.gyro_arw is 0\.0001: Extra inputs"),
        ("truth_json", "{", "is no JSON"),
        ("barometer_csv", "t_s,pressure_pa\n0,95000\n", r"barometer\.csv: line 1: column 'pressure_hpa' is missing"),
        ("barometer_csv", "t_s,pressure_hpa\n0,95000\n1,95010\n", r"'pressure_hpa' is 95005 .* 300 to 1100 hPa .*Pa"),
        ("barometer_csv", "t_s,pressure_hpa\n1,950\n0,950\n", "time to increase"),
    ],
)
def test_a_bad_file_is_refused_by_place_and_with_what_was_expected(
    tmp_path: Path, file: str, text: str, expected: str
) -> None:
    with pytest.raises(RecordingError, match=expected):
        read_drive(_folder(tmp_path / "d", **{file: text}))


def test_a_folder_that_is_none_or_lacks_a_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="no such folder"):
        read_drive(tmp_path / "nowhere")
    folder = _folder(tmp_path / "d")
    (folder / "imu.csv").unlink()
    with pytest.raises(RecordingError, match=r"imu\.csv is missing"):
        read_drive(folder)
    (folder / "drive.toml").unlink()
    with pytest.raises(RecordingError, match=r"drive\.toml: is missing"):
        read_drive(folder)


def test_compressed_rubbish_is_refused(tmp_path: Path) -> None:
    folder = _folder(tmp_path / "d")
    (folder / "gnss.csv.gz").write_bytes(b"no gzip at all")
    with pytest.raises(RecordingError, match=r"gnss\.csv\.gz: cannot be read"):
        read_drive(folder)


def test_only_an_empty_or_a_drive_folder_is_written_over(tmp_path: Path) -> None:
    other = tmp_path / "photos"
    other.mkdir()
    (other / "dear.jpg").write_bytes(b"x")
    with pytest.raises(RecordingError, match="no drive folder"):
        write_drive(other, _drive())
    assert [file.name for file in other.iterdir()] == ["dear.jpg"]
    target = tmp_path / "d"
    target.mkdir()
    write_drive(target, _drive())
    (target / "magnetometer.csv").write_text("stale")
    write_drive(target, _drive())
    assert not (target / "magnetometer.csv").exists()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["d", "photos"]


@pytest.mark.parametrize(
    ("name", "samples", "fixes", "is_msl"),
    [
        ("kth_stockholm", 29849, 299, False),
        ("comma2k19_segment", 6256, 579, False),
        ("boston_vn100", 30191, 755, True),
    ],
)
def test_real_recordings_are_read_as_they_are(name: str, samples: int, fixes: int, is_msl: bool) -> None:
    drive = read_drive(recording("drives", name))
    assert drive.measurements.imu_t_ns.size == samples
    assert drive.measurements.gnss_t_ns.size == fixes
    assert drive.gnss_alt_is_msl is is_msl
    assert (drive.reference is not None) is (name == "comma2k19_segment")
    assert drive.imu.mounting_rpy_deg is None
    periods = np.unique(np.diff(drive.measurements.imu_t_ns))
    assert periods.size > 1  # jitter and gaps are kept


def test_simulate_writes_a_drive_folder_with_reference_and_truth(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "drive"
    assert main(["simulate", str(out), "--scenario", "parking", "--rate", "50", "--seed", "4", "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)
    drive = read_drive(out)
    assert drive.truth is not None
    assert figures["imu_samples"] == drive.measurements.imu_t_ns.size
    assert drive.truth["accidents"] == figures["accidents"]
    assert len(figures["accidents"]) == 1
    assert drive.reference is not None
    assert drive.reference.t_ns.tolist() == drive.measurements.imu_t_ns.tolist()
    assert drive.imu.rate_hz == 50.0
    assert main(["simulate", "--list"]) == 0
    assert "tunnel_crash" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["{out}", "--scenario", "moon"], "unknown scenario 'moon'"),
        ([], "OUT_DIR is missing"),
        (["{full}"], "no drive folder"),
        (["{out}", "--duration", "nan"], "expected 30 s to 4 h"),
    ],
)
def test_simulate_refuses_bad_usage_with_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], expected: str
) -> None:
    full = tmp_path / "full"
    full.mkdir()
    (full / "x").touch()
    words = [word.format(out=tmp_path / "out", full=full) for word in arguments]
    assert main(["simulate", *words]) == 2
    error = capsys.readouterr().err
    assert expected in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()
