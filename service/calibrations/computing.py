"""Computes one calibration run: ``python -m service.calibrations.computing RECORDING REPORT OPTIONS``.

Lines of JSON on stdout: ``{"progress": share}`` on the way, ``{"result": …}`` or ``{"problem": …}`` at the end.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any, Final

from core.errors import CoreError
from schemas.calibration import Calibration, RunOptions
from service.calibrating import CalibrationOptions, calibrate
from service.errors import ServiceError
from service.recordings.calibration_recording import ReadingOptions, read_recording
from service.reports.calibration import calibration_report

NICENESS: Final = 10
"""Packets and requests go first."""
READ_SHARE: Final = 0.3
FITTED_SHARE: Final = 0.9
"""How far it is once the recording is read, and once all sensors are fitted; the report is the rest."""
UPLOADED_AS: Final = "recording"
"""What the file is called in messages: the caller does not know where it is kept."""


def main(recording: str, report: str, options: str) -> int:
    """Compute, and tell how it goes; a recording that cannot be used is a problem that is told, too."""
    os.nice(NICENESS)
    try:
        result = compute(Path(recording), Path(report), RunOptions.model_validate_json(options))
    except ServiceError as error:
        return _end(problem={"code": error.code, "detail": _without_path(error.detail, recording)})
    except CoreError as error:
        return _end(problem={"code": "invalid_input", "detail": _without_path(str(error), recording)})
    return _end(result=result.model_dump(mode="json", exclude_none=True))


def compute(recording: Path, report: Path, options: RunOptions) -> Calibration:
    """The calibration of a recording, as ``telefuse calibrate`` writes it; its report goes to ``report``."""
    reading = ReadingOptions(options.counts, options.rate_hz, options.accel_unit, options.gyro_unit)
    read = read_recording(recording, reading, lambda share: _tell_progress(READ_SHARE * share))
    asked = CalibrationOptions(sensor=options.sensor, gravity_mps2=options.gravity_mps2, level=options.level)
    outcome = calibrate(read, asked, lambda share: _tell_progress(READ_SHARE + (FITTED_SHARE - READ_SHARE) * share))
    found = outcome.calibration()
    report.write_text(calibration_report(outcome), encoding="utf-8")
    return found


def _tell_progress(share: float) -> None:
    print(json.dumps({"progress": round(share, 3)}), flush=True)


def _end(**told: dict[str, Any]) -> int:
    print(json.dumps(told, allow_nan=False), flush=True)
    return 0


def _without_path(text: str, path: str) -> str:
    return text.replace(path, UPLOADED_AS)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
