"""Snapshots of numeric state as bytes: the same state gives the same bytes on every run."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from core.errors import SnapshotError

_MAGIC = b"TFS1"


def pack(arrays: Mapping[str, npt.NDArray[np.generic]], version: int) -> bytes:
    """Serialise named arrays (any shape; int64, float64, bool or uint8) with a ``version``."""
    header = {
        "version": version,
        "arrays": [[name, a.dtype.str, list(a.shape)] for name, a in arrays.items()],
    }
    text = json.dumps(header, separators=(",", ":")).encode()
    body = b"".join(np.ascontiguousarray(a).tobytes() for a in arrays.values())
    return _MAGIC + struct.pack("<I", len(text)) + text + body


def unpack(data: bytes, version: int) -> dict[str, npt.NDArray[np.generic]]:
    """Read what ``pack`` wrote, as fresh writable arrays.

    Raises
    ------
    SnapshotError
        If the bytes are no snapshot, cut short, or of another ``version``.
    """
    if data[:4] != _MAGIC or len(data) < 8:
        raise SnapshotError("not a snapshot: the first bytes are not TFS1")
    (length,) = struct.unpack_from("<I", data, 4)
    try:
        header = json.loads(data[8 : 8 + length])
    except ValueError as error:
        raise SnapshotError("snapshot header is damaged") from error
    if header["version"] != version:
        raise SnapshotError(f"snapshot has version {header['version']}, expected {version}")
    arrays: dict[str, npt.NDArray[np.generic]] = {}
    offset = 8 + length
    for name, dtype_text, shape in header["arrays"]:
        dtype = np.dtype(dtype_text)
        count = int(np.prod(shape, dtype=np.int64))
        end = offset + count * dtype.itemsize
        if end > len(data):
            raise SnapshotError(f"snapshot ends inside array '{name}'")
        arrays[name] = np.frombuffer(data[offset:end], dtype=dtype).reshape(shape).copy()
        offset = end
    return arrays
