"""Numeric CSV tables, plain or gzip: read fast, and when one is bad say where and what was expected."""

from __future__ import annotations

import csv
import gzip
import io
import itertools
import re
import zlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from core.measurements import FloatArray, TimeArray
from service.errors import RecordingError

NS_PER_S: Final = 1_000_000_000
_MAX_ABS_TIME_S: Final = 1e9
"""A drive's own clock may start anywhere, but not 30 years off: that is a wrong unit."""
_BLOCK_ROWS: Final = 50_000
"""Rows read or written at a time, so that a drive of hours shows its progress and needs little memory."""
_EMPTY_CELL: Final = re.compile(r"(?:^|(?<=,))[ \t]*(?=,|$)", re.MULTILINE)


Share = Callable[[float], None]
"""Is told what share of the work is done, 0 to 1."""


def untold(share: float) -> None:
    """Nobody wants to know how far the work is."""


def find_table(folder: Path, name: str) -> Path | None:
    """The file ``name`` or ``name.gz`` of a folder, None if there is neither."""
    found = [path for path in (folder / name, folder / f"{name}.gz") if path.is_file()]
    if len(found) > 1:
        raise RecordingError(f"{folder}: has both {name} and {name}.gz; keep one of them")
    return found[0] if found else None


def read_table(
    path: Path, required: Sequence[str], optional: Sequence[str] = (), progress: Share = untold
) -> dict[str, FloatArray]:
    """Columns of a table by name, each (n,): all of ``required`` and those of ``optional`` that are there.

    Empty cells are NaN, other columns are ignored, ``t_s`` must be there for every row and increase.
    """
    text = read_text(path)
    header = header_cells(text.partition("\n")[0])
    wanted = [*required, *(name for name in optional if name in header)]
    for name in wanted:
        if header.count(name) != 1:
            problem = "is missing" if name not in header else "stands there more than once"
            raise RecordingError(f"{path}: line 1: column '{name}' {problem}; expected columns {', '.join(required)}")
    return table_of(path, text, wanted, progress)


def header_cells(line: str, mark: str = ",") -> list[str]:
    """Names in a header row, parted by ``mark``."""
    return [cell.strip() for cell in next(csv.reader([line], delimiter=mark), [])]


def table_of(path: Path, text: str, wanted: Sequence[str], progress: Share = untold) -> dict[str, FloatArray]:
    """Columns ``wanted`` of a table's text, each (n,), as ``read_table`` gives them.

    Lines that are blank before the header count as lines; every name must stand in the header once.
    """
    lead = len(text) - len(text.lstrip("\n"))
    first_line, _, body = text[lead:].partition("\n")
    header = header_cells(first_line)
    positions = [header.index(name) for name in wanted]
    body = body.strip("\n")
    if not body.strip():
        return {name: np.empty(0) for name in wanted}
    if '"' not in body and (",," in body or ",\n" in body or "\n," in body or body.startswith(",")):
        body = _EMPTY_CELL.sub("nan", body)
    try:
        values = _read_fast(body, positions, progress)
    except ValueError:
        values = _read_slowly(path, text, wanted, positions)
    table = {name: np.ascontiguousarray(values[:, index]) for index, name in enumerate(wanted)}
    _check(path, text, table)
    return table


def times_ns(t_s: FloatArray, start_t_ns: int) -> TimeArray:
    """Seconds of a drive as UTC nanoseconds, rounded to the nearest."""
    whole = np.floor(t_s)
    return start_t_ns + whole.astype(np.int64) * NS_PER_S + np.rint((t_s - whole) * NS_PER_S).astype(np.int64)


def format_table(columns: Mapping[str, tuple[npt.ArrayLike, str]], progress: Share = untold) -> str:
    """A table as CSV text: each column with its ``%`` format; NaN gives an empty cell."""
    template = ",".join(style for _, style in columns.values())
    series = [np.asarray(values) for values, _ in columns.values()]
    lines = [",".join(columns)]
    for first in range(0, len(series[0]), _BLOCK_ROWS):
        rows = zip(*(values[first : first + _BLOCK_ROWS].tolist() for values in series), strict=True)
        lines += [template % row for row in rows]
        progress(min(1.0, (first + _BLOCK_ROWS) / len(series[0])))
    return re.sub(r"(?<=[,\n])nan(?=[,\n])", "", "\n".join(lines) + "\n")


def time_column(t_ns: TimeArray, start_t_ns: int) -> tuple[FloatArray, str]:
    """``t_s`` of a series with the fewest decimals (at least 3) that keep every stamp to the nanosecond."""
    offset_ns = t_ns - start_t_ns
    decimals = next(d for d in range(3, 10) if d == 9 or not np.any(offset_ns % 10 ** (9 - d)))
    return offset_ns / NS_PER_S, f"%.{decimals}f"


def gzip_bytes(text: str) -> bytes:
    """Compressed without a time stamp or name, so that the same text gives the same bytes."""
    return gzip.compress(text.encode(), compresslevel=6, mtime=0)


def read_text(path: Path) -> str:
    """A CSV file's text, plain or gzip, with line feeds alone."""
    try:
        raw = path.read_bytes()
        data = gzip.decompress(raw) if path.suffix == ".gz" else raw
        return data.decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
    except (OSError, EOFError, zlib.error, UnicodeDecodeError) as error:
        raise RecordingError(f"{path}: cannot be read: {error}; expected a CSV file in UTF-8") from error


def _read_fast(body: str, positions: Sequence[int], progress: Share) -> FloatArray:
    """All rows, a block at a time; raises ValueError where one is no row of numbers."""
    lines, blocks, done = io.StringIO(body), [], 0
    while done < len(body):
        blocks.append(
            np.loadtxt(
                itertools.islice(lines, _BLOCK_ROWS),
                delimiter=",", usecols=positions, ndmin=2, comments=None, quotechar='"', dtype=np.float64,
            )
        )  # fmt: skip
        done = lines.tell()
        progress(done / len(body))
    return np.concatenate(blocks)


def _read_slowly(path: Path, text: str, wanted: Sequence[str], positions: Sequence[int]) -> FloatArray:
    """The same by Python's csv reader: takes quoted and empty cells, or names the first bad one."""
    rows: list[list[float]] = []
    reader = csv.reader(io.StringIO(text))
    while not next(reader):
        pass
    for cells in reader:
        if not cells:
            continue
        row = []
        for name, position in zip(wanted, positions, strict=True):
            if position >= len(cells):
                raise RecordingError(
                    f"{path}: line {reader.line_num}: column '{name}' is missing, the row has {len(cells)} cells; "
                    f"expected at least {max(positions) + 1}"
                )
            cell = cells[position].strip()
            try:
                row.append(float(cell) if cell else float("nan"))
            except ValueError:
                raise RecordingError(
                    f"{path}: line {reader.line_num}, column '{name}': '{cell[:40]}' is no number; "
                    "expected a decimal number or an empty cell"
                ) from None
        rows.append(row)
    return np.array(rows, dtype=np.float64).reshape(len(rows), len(wanted))


def _line_number(text: str, row: int) -> int:
    """Line of a data row: blank lines count as lines, not as rows."""
    seen = -2
    for number, line in enumerate(text.split("\n"), start=1):
        if line.strip():
            seen += 1
        if seen == row:
            return number
    return row + 2


def _check(path: Path, text: str, table: Mapping[str, FloatArray]) -> None:
    for name, values in table.items():
        bad = np.isinf(values) | (np.isnan(values) if name == "t_s" else False)
        if bad.any():
            row = int(np.argmax(bad))
            raise RecordingError(
                f"{path}: line {_line_number(text, row)}, column '{name}': {values[row]} is no finite number; "
                f"expected {'a time in seconds' if name == 't_s' else 'a number, or an empty cell where it is missing'}"
            )
    if "t_s" not in table:
        return
    t_s = table["t_s"]
    far = np.abs(t_s) > _MAX_ABS_TIME_S
    if far.any():
        row = int(np.argmax(far))
        raise RecordingError(
            f"{path}: line {_line_number(text, row)}, column 't_s': {t_s[row]:.17g} is too large; "
            "expected seconds since the drive's zero, which is start_utc of drive.toml"
        )
    back = np.diff(t_s) <= 0
    if back.any():
        row = int(np.argmax(back)) + 1
        raise RecordingError(
            f"{path}: line {_line_number(text, row)}, column 't_s': {t_s[row]:.9g} follows {t_s[row - 1]:.9g}; "
            "expected time to increase from row to row"
        )
