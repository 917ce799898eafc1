"""Calibration runs in the background: begun again, in order, failed, cleaned up."""

from __future__ import annotations

import sys

import pytest
from sqlalchemy import update

from service.calibrations.files import RunFiles
from service.calibrations.worker import CalibrationWorker
from service.storage import calibration_runs, tables
from service.storage.calibration_runs import RunOptions, RunRow
from service.storage.database import read, write
from service.storage.vehicles import VehicleDirectory
from tests.service.stored_rows import NS, T0
from tests.service.webhook_harness import eventually

WAIT_S = 400.0  # a run yields to everything else, and cores may be busy
DAY_NS = 86_400 * NS


class Bench:
    """Runs in a database of their own, computed by a command of the test's."""

    def __init__(self, database, directory):
        self.database, self.files = database, RunFiles(directory)
        self.pk = VehicleDirectory(database, open_registration=False).register("acme", "car").ref.pk
        self.files.directory.mkdir()

    def add(self, run_id, created_ns=T0, content=b"t_s\n"):
        run = RunRow(run_id, self.pk, "queued", 0.0, RunOptions(), len(content), "0" * 64, created_ns)
        (self.files.directory / f"{run_id}.csv").write_bytes(content)
        with write(self.database) as connection:
            calibration_runs.add(connection, run)

    def run(self, run_id):
        with read(self.database) as connection:
            return calibration_runs.find(connection, self.pk, run_id)

    def worker(self, program):
        return CalibrationWorker(self.database, self.files, (sys.executable, "-c", program))


@pytest.fixture
def bench(database, tmp_path):
    return Bench(database, tmp_path)


SLEEPS = "import json, time; print(json.dumps({'progress': 0.4}), flush=True); time.sleep(600)"
FINDS = """
import json, pathlib, sys
pathlib.Path(sys.argv[2]).write_text('<html>')
print(json.dumps({'progress': 0.5}), flush=True)
print(json.dumps({'result': {'accelerometer': {'bias': [1, 2, 3]}}}), flush=True)
"""


def test_a_run_that_a_stop_broke_off_begins_again(bench):
    bench.add("a")
    worker = bench.worker(SLEEPS)
    worker.start()
    eventually(lambda: bench.run("a").status == "running", WAIT_S)
    worker.stop()
    assert bench.run("a").status == "running", "as a process leaves it that is killed"
    again = bench.worker(FINDS)
    again.start()
    eventually(lambda: bench.run("a").status == "done", WAIT_S)
    again.stop()
    found = bench.run("a")
    assert found.result.accelerometer.bias == (1.0, 2.0, 3.0)
    assert found.has_report
    assert bench.files.report("a").read_text() == "<html>"


def test_runs_are_computed_in_the_order_in_which_they_came(bench):
    for number, run_id in enumerate(("c", "a", "b")):
        bench.add(run_id, T0 + number)
    worker = bench.worker(FINDS)
    worker.start()
    eventually(lambda: all(bench.run(one).status == "done" for one in "abc"), WAIT_S)
    worker.stop()
    begun = sorted("abc", key=lambda one: bench.run(one).started_ns)
    assert begun == ["c", "a", "b"]


@pytest.mark.parametrize(
    ("program", "code"),
    [
        ("import os, signal; os.kill(os.getpid(), signal.SIGKILL)", "calculation_failed"),
        ("raise SystemExit('a bug')", "calculation_failed"),
        ('print(\'{"result": {"accelerometer": 3}}\')', "calculation_failed"),
        ('print(\'{"problem": {"code": "bad_recording", "detail": "too few positions"}}\')', "bad_recording"),
    ],
    ids=["killed", "broken", "no result", "said so"],
)
def test_a_calculation_that_fails_is_a_run_that_failed_and_the_next_goes_on(bench, program, code):
    bench.add("a")
    worker = bench.worker(program)
    worker.start()
    eventually(lambda: bench.run("a").status == "failed", WAIT_S)
    worker.stop()
    assert bench.run("a").problem.code == code
    bench.add("gone")
    bench.files.recording("gone").unlink()
    worker = bench.worker(FINDS)
    worker.start()
    eventually(lambda: bench.run("gone").status == "failed", WAIT_S)
    worker.stop()
    assert bench.run("gone").problem.code == "recording_gone"


def test_recordings_go_once_they_were_used_long_ago_and_reports_stay(bench):
    for run_id in ("old", "young", "waiting"):
        bench.add(run_id)
        bench.files.report(run_id).write_text("<html>")
    with write(bench.database) as connection:
        for run_id, days in (("old", 31), ("young", 29)):
            values = {"status": "done", "finished_ns": T0 - days * DAY_NS}
            connection.execute(
                update(tables.calibration_runs).where(tables.calibration_runs.c.id == run_id).values(**values)
            )
    assert bench.files.sweep(bench.database, T0, 0) == 0
    assert bench.files.sweep(bench.database, T0, 30) == 1
    assert bench.files.recording("old") is None
    assert bench.files.recording("young") is not None
    assert bench.files.recording("waiting") is not None
    assert all(bench.files.report(one).exists() for one in ("old", "young", "waiting"))
