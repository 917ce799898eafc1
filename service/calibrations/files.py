"""Uploaded recordings and reports of calibration runs, as files by the run's id in the data directory."""

from __future__ import annotations

import hashlib
import os
import time
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from uuid import uuid4

from sqlalchemy import Engine

from service.errors import BadRequestError, TooLargeError
from service.storage import calibration_runs
from service.storage.database import read

_PLAIN: Final = ".csv"
_GZIPPED: Final = ".csv.gz"
_REPORT: Final = ".html"
_UPLOADING: Final = ".part"
_STALE_S: Final = 3600.0
"""An upload that was not written to for so long was broken off."""
_INFLATED_AT_ONCE: Final = 1 << 20


class RunFiles:
    """Where the files of runs are."""

    def __init__(self, data_dir: Path) -> None:
        self.directory = data_dir / "calibration-runs"

    def recording(self, run_id: str) -> Path | None:
        """The uploaded recording of a run; None once it is gone."""
        paths = [self.directory / f"{run_id}{ending}" for ending in (_PLAIN, _GZIPPED)]
        return next((path for path in paths if path.exists()), None)

    def report(self, run_id: str) -> Path:
        """The report of a run, there or not."""
        return self.directory / f"{run_id}{_REPORT}"

    def upload(self, limit: int, *, gzipped: bool) -> Upload:
        """A new file to be written; of ``limit`` bytes at most, unpacked."""
        self.directory.mkdir(parents=True, exist_ok=True)
        return Upload(self.directory / f"{uuid4()}{_UPLOADING}", limit, gzipped)

    def keep(self, upload: Upload, run_id: str) -> None:
        """Make an upload the recording of a run, durably."""
        upload.path.rename(self.directory / f"{run_id}{_GZIPPED if upload.gzipped else _PLAIN}")
        _sync_directory(self.directory)

    def sweep(self, database: Engine, now_ns: int, recording_days: int) -> int:
        """Remove what belongs to no run, broken uploads, and recordings that were used long ago (0 days: never)."""
        if not self.directory.is_dir():
            return 0
        by_run: dict[str, list[Path]] = {}
        for path in self.directory.iterdir():
            by_run.setdefault(path.name.partition(".")[0], []).append(path)
        with read(database) as connection:
            finished = calibration_runs.finished(connection)
        before_ns = now_ns - recording_days * 86_400 * 1_000_000_000
        removed = 0
        for run_id, paths in by_run.items():
            for path in paths:
                if run_id not in finished:
                    # Younger ones may be of a run that is just being stored.
                    gone = time.time() - path.stat().st_mtime > _STALE_S
                else:
                    done_ns = finished[run_id]
                    used = recording_days > 0 and done_ns is not None and done_ns < before_ns
                    gone = used and path.suffix != _REPORT
                if gone:
                    path.unlink(missing_ok=True)
                    removed += 1
        return removed

    def erase(self, run_ids: list[str]) -> None:
        """Remove the files of runs."""
        for run_id in run_ids:
            for ending in (_PLAIN, _GZIPPED, _REPORT):
                (self.directory / f"{run_id}{ending}").unlink(missing_ok=True)


@dataclass(slots=True)
class _Count:
    packed: int = 0
    unpacked: int = 0


class Upload:
    """A file that grows as its bytes come in, and is refused once it is too large, unpacked, or no gzip."""

    def __init__(self, path: Path, limit: int, gzipped: bool) -> None:
        self.path = path
        self.gzipped = gzipped
        self._limit = limit
        self._count = _Count()
        self._digest = hashlib.sha256()
        self._inflater = zlib.decompressobj(wbits=31) if gzipped else None
        self._file = path.open("xb")

    def write(self, chunk: bytes) -> None:
        """Take the next bytes; raises TooLargeError or BadRequestError."""
        self._count.packed += len(chunk)
        self._digest.update(chunk)
        if self._inflater is None:
            self._count.unpacked += len(chunk)
        else:
            self._inflate(chunk)
        if max(self._count.packed, self._count.unpacked) > self._limit:
            raise TooLargeError(
                f"the recording is larger than {self._limit} bytes, unpacked, the most that is taken here; "
                "24 positions of 5 s each are enough"
            )
        self._file.write(chunk)

    def _inflate(self, chunk: bytes) -> None:
        while chunk and self._count.unpacked <= self._limit:
            assert self._inflater is not None
            try:
                self._count.unpacked += len(self._inflater.decompress(chunk, _INFLATED_AT_ONCE))
            except zlib.error as error:
                raise BadRequestError(f"the recording is no gzip: {error}") from error
            chunk = self._inflater.unconsumed_tail
            if self._inflater.eof:  # gzip files may be several in a row
                chunk, self._inflater = self._inflater.unused_data, zlib.decompressobj(wbits=31)

    @property
    def bytes(self) -> int:
        """How many came in."""
        return self._count.packed

    @property
    def sha256(self) -> str:
        """Of what came in."""
        return self._digest.hexdigest()

    def finish(self) -> None:
        """Make the file durable."""
        self._file.flush()
        os.fsync(self._file.fileno())
        self._file.close()

    def discard(self) -> None:
        """Close the file and remove it, if it was not kept."""
        self._file.close()
        self.path.unlink(missing_ok=True)


def _sync_directory(directory: Path) -> None:
    descriptor = os.open(directory, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
