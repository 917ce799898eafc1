"""Computes calibration runs, one at a time, each in a process of its own beside the service."""

from __future__ import annotations

import json
import logging
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any, Final

import pydantic
from sqlalchemy import Engine
from sqlalchemy.exc import SQLAlchemyError

from schemas.calibration import Calibration, RunProblem
from service.calibrations.files import RunFiles
from service.storage import calibration_runs
from service.storage.calibration_runs import RunRow
from service.storage.database import read, write

logger = logging.getLogger(__name__)

COMPUTE: Final = (sys.executable, "-m", "service.calibrations.computing")
"""The command that computes: it is given recording, report to write and options, and tells lines of JSON."""

MOST_S: Final = 900.0
"""A calculation that takes longer has gone astray: hours of samples take a minute."""
_IDLE_S: Final = 5.0
_TELL_EVERY_S: Final = 0.5
_LOG_CHARACTERS: Final = 2000


class CalibrationWorker:
    """A thread that waits for runs and for the processes that compute them.

    A process, since the arithmetic would hold up packets and requests: it holds the interpreter, and the processor
    where there are few. It is told to be nice. A run that a stop or a crash broke off begins again at the next start;
    its recording is on disk.
    """

    def __init__(self, database: Engine, files: RunFiles, command: Sequence[str] = COMPUTE) -> None:
        self._database = database
        self._files = files
        self._command = tuple(command)
        self._changed = threading.Condition()
        self._stopping = False
        self._process: subprocess.Popen[str] | None = None
        self._thread = threading.Thread(target=self._work, name="calibration-runs", daemon=True)

    def start(self) -> None:
        """Begin, with what was left over first."""
        self._thread.start()

    def notify(self) -> None:
        """Say that there is a new run."""
        with self._changed:
            self._changed.notify_all()

    def stop(self) -> None:
        """Break off what is under way and end."""
        with self._changed:
            self._stopping = True
            if self._process is not None:
                self._process.kill()
            self._changed.notify_all()
        self._thread.join()

    def _work(self) -> None:
        while not self._stopping:
            try:
                with read(self._database) as connection:
                    run = calibration_runs.next_open(connection)
                if run is not None:
                    self._compute(run)
                    continue
            except SQLAlchemyError as error:
                logger.warning("calibration runs wait: the database fails: %s", error)
            with self._changed:
                if not self._stopping:
                    self._changed.wait(_IDLE_S)

    def _compute(self, run: RunRow) -> None:
        with write(self._database) as connection:
            calibration_runs.begin(connection, run.id, time.time_ns())
        recording = self._files.recording(run.id)
        if recording is None:
            self._fail(run, RunProblem(code="recording_gone", detail="the recording is not there any more; upload it"))
            return
        with tempfile.TemporaryDirectory(prefix="telefuse-calibration-") as directory:
            report = Path(directory) / "report.html"
            outcome = self._outcome(run, recording, report)
            if self._stopping:
                return
            if isinstance(outcome, RunProblem):
                self._fail(run, outcome)
                return
            has_report = report.exists()
            if has_report:
                partial = self._files.report(run.id).with_suffix(".html.part")
                partial.write_bytes(report.read_bytes())
                partial.replace(self._files.report(run.id))
        with write(self._database) as connection:
            calibration_runs.succeed(connection, run.id, outcome, has_report, time.time_ns())
        logger.info("calibration run %s is done", run.id)

    def _fail(self, run: RunRow, problem: RunProblem) -> None:
        with write(self._database) as connection:
            calibration_runs.fail(connection, run.id, problem, time.time_ns())
        logger.info("calibration run %s has failed: %s", run.id, problem.detail)

    def _outcome(self, run: RunRow, recording: Path, report: Path) -> Calibration | RunProblem:
        with tempfile.TemporaryFile("w+", encoding="utf-8") as errors:
            with self._changed:
                if self._stopping:
                    return RunProblem(code="stopped", detail="the service stops")
                self._process = process = subprocess.Popen(
                    [*self._command, str(recording), str(report), run.options.model_dump_json()],
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.PIPE,
                    stderr=errors,
                    text=True,
                    env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
                )
            overdue = threading.Timer(MOST_S, process.kill)
            overdue.start()
            try:
                assert process.stdout is not None
                told = self._listen(run, process.stdout)
            finally:
                overdue.cancel()
                with self._changed:
                    self._process = None
                process.kill()
                process.wait()
            if told is None and not self._stopping:
                errors.seek(0)
                text = errors.read()[-_LOG_CHARACTERS:]
                logger.error("calibration run %s ended with %s and no result: %s", run.id, process.returncode, text)
        try:
            if told is not None:
                return RunProblem(**told["problem"]) if "problem" in told else Calibration(**told["result"])
        except pydantic.ValidationError as error:
            logger.error("calibration run %s: its result is none: %s", run.id, error)
        detail = "the calculation ended without a result; the service's log says why"
        return RunProblem(code="calculation_failed", detail=detail)

    def _listen(self, run: RunRow, lines: IO[str]) -> dict[str, Any] | None:
        """Note progress; return the last line, the one that tells the end."""
        noted_s = time.monotonic()
        for line in lines:
            told: dict[str, Any] = json.loads(line)
            if "progress" not in told:
                return told
            if time.monotonic() - noted_s >= _TELL_EVERY_S:
                noted_s = time.monotonic()
                with write(self._database) as connection:
                    calibration_runs.note_progress(connection, run.id, min(max(told["progress"], 0.0), 1.0))
        return None
