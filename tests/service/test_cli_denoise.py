"""``telefuse fuse --denoise`` as a caller sees it: what it took away, and the figures with and without."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from core.simulation.scenarios import simulate
from service.recordings.denoising import denoise
from service.recordings.drive_folder import read_drive, write_drive
from service.recordings.simulated import drive_of
from tests.commands import call

AXES = ["ax", "ay", "az", "gx", "gy", "gz"]
COLUMNS = ["ax_mps2", "ay_mps2", "az_mps2", "gx_radps", "gy_radps", "gz_radps"]


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Drives: shaken by the engine with an outage in it, the same by ten samples a second, and one that clips."""
    root = tmp_path_factory.mktemp("drives")
    shaken = drive_of(simulate("engine_shaken", 1, 260.0, 100.0))
    m = shaken.measurements
    slow = replace(m, imu_t_ns=m.imu_t_ns[::10], f_s=m.f_s[::10].copy(), omega_s=m.omega_s[::10].copy())
    one = replace(m, imu_t_ns=m.imu_t_ns[:1], f_s=m.f_s[:1].copy(), omega_s=m.omega_s[:1].copy())
    write_drive(root / "shaken", shaken)
    write_drive(root / "slow", replace(shaken, measurements=slow))
    write_drive(root / "one", replace(shaken, measurements=one))
    return root


def test_figures_tell_the_denoising_and_stand_beside_those_without(folders, capsys):
    words = ("fuse", folders / "shaken", "--outage", "150:60", "--json")
    status, out, err = call(capsys, *words, "--denoise")
    assert (status, err) == (0, "")
    found = json.loads(out)
    usual = json.loads(call(capsys, *words)[1])
    facts = found["denoise"]
    assert (facts["wavelet"], facts["levels"]) == ("sym4", 3)
    assert facts["latency_s"] == pytest.approx(1.11)
    assert list(facts["noise_reduction_db"]) == AXES
    assert list(facts["sd_before"]) == list(facts["sd_after"]) == COLUMNS
    for axis, column in zip(AXES, COLUMNS, strict=True):
        ratio = facts["sd_before"][column] / facts["sd_after"][column]
        assert facts["noise_reduction_db"][axis] == pytest.approx(20.0 * np.log10(ratio))
        assert facts["noise_reduction_db"][axis] > 15.0  # an engine of 1.5 m/s2 over sensor noise of 0.01
    for figures in (facts["without"], usual):
        figures.pop("ns_per_epoch")
        figures.pop("out", None)
        figures.pop("report", None)
    assert facts["without"] == usual
    assert "denoise" not in usual
    assert found["epochs"] == usual["epochs"]
    assert found["outages"][0]["rms_m"] != usual["outages"][0]["rms_m"]


def test_the_text_says_latency_noise_and_both_figures(folders, capsys):
    status, out, err = call(capsys, "fuse", folders / "shaken", "--outage", "150:60", "--denoise")
    assert (status, err) == (0, "")
    assert "1.11 s late" in out
    assert "  ax " in out
    assert "outage 150 s + 60 s, RMS, m:" in out
    assert " without" in out


def test_the_denoised_track_is_the_one_that_is_written(folders, capsys, tmp_path):
    for name, words in (("raw.csv", ()), ("a.csv", ("--denoise",)), ("b.csv", ("--denoise",))):
        assert call(capsys, "fuse", folders / "shaken", "--every", 1, "--out", tmp_path / name, *words)[0] == 0
    raw, a, b = ((tmp_path / name).read_bytes() for name in ("raw.csv", "a.csv", "b.csv"))
    assert a == b != raw


@pytest.mark.parametrize(("name", "named"), [("slow", "expected 20 Hz"), ("one", "at least two")])
def test_what_cannot_be_denoised_ends_with_two_and_one_line(folders, capsys, tmp_path, monkeypatch, name, named):
    monkeypatch.chdir(tmp_path)
    status, out, err = call(capsys, "fuse", folders / name, "--denoise", "--out", "track.csv")
    assert (status, out) == (2, "")
    assert err.count("\n") == 1
    assert named in err
    assert list(tmp_path.iterdir()) == []


def test_what_is_invalid_or_clipped_stays_as_it_was(folders):
    drive = read_drive(folders / "shaken")
    m = drive.measurements
    f_s, t_ns = m.f_s.copy(), m.imu_t_ns.copy()
    full_scale = m.accel_full_scale_mps2
    f_s[5000, 0] = np.nan
    f_s[6000, 1] = 1e6
    f_s[7000:7003, 0] = -full_scale
    t_ns[8000] = t_ns[7990]
    damaged = replace(drive, measurements=replace(m, f_s=f_s, imu_t_ns=t_ns))
    left = denoise(damaged).drive.measurements
    assert np.isnan(left.f_s[5000, 0])
    assert left.f_s[5000, 1:].tolist() == f_s[5000, 1:].tolist()
    for row in (6000, 8000):
        assert left.f_s[row].tolist() == f_s[row].tolist()
        assert left.omega_s[row].tolist() == m.omega_s[row].tolist()
    assert left.f_s[7000:7003, 0].tolist() == [-full_scale] * 3
    sound = np.ones(len(t_ns), np.bool_)
    sound[[5000, 6000, 8000]] = False
    assert np.isfinite(left.f_s[sound]).all()
    assert left.imu_t_ns.tolist() == t_ns.tolist()
    assert (left.f_s[sound] != m.f_s[sound]).all(axis=1).mean() > 0.99
