"""A bundle of evidence: one zip file of tables (.npy), packets as they came, and a manifest; hashed over all it holds.

The hash is the SHA-256 of the manifest in canonical form (keys sorted, no blanks, UTF-8, without ``sha256`` itself).
The manifest names each member with the SHA-256 of its bytes, so that how a zip file is packed does not matter.
``numpy.load`` opens a bundle, too.
"""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from schemas.packet import PacketError, decode
from schemas.telemetry_pb2 import TelemetryPacket
from service.errors import ServiceError
from service.evidence.tape import Table

FORMAT: Final = "telefuse-evidence/1"
MANIFEST: Final = "manifest.json"
PACKETS: Final = "packets.bin"
CHECKPOINT: Final = "checkpoint.bin"

_LONG_AGO: Final = (1980, 1, 1, 0, 0, 0)
"""The oldest time that a zip file can state: when it was packed is none of its contents."""


class BundleError(ServiceError):
    """A file is no bundle of evidence, or not as it was made."""

    code = "bad_evidence"
    status = 422


@dataclass(frozen=True, slots=True, eq=False)
class Bundle:
    """A bundle that was read and whose hash holds."""

    manifest: Mapping[str, Any]
    members: Mapping[str, bytes]

    @property
    def sha256(self) -> str:
        """Over all that it holds."""
        return str(self.manifest["sha256"])

    def table(self, name: str) -> Table:
        """A table by its name."""
        table: Table = np.load(io.BytesIO(self.members[f"{name}.npy"]), allow_pickle=False)
        return table

    def packets(self) -> Iterator[TelemetryPacket]:
        """The packets as they came, in the order of the session."""
        data, at = self.members[PACKETS], 0
        while at < len(data):
            size, at = _varint(data, at)
            try:
                yield decode(data[at : at + size])
            except PacketError as error:
                raise BundleError(f"{PACKETS} at byte {at}: {error.detail}") from error
            at += size


def pack(tables: Mapping[str, Table], packets: list[bytes], checkpoint: bytes, said: Mapping[str, Any]) -> Bundle:
    """A bundle of these, with what ``said`` says of them in its manifest."""
    members = {f"{name}.npy": _npy(table) for name, table in tables.items()}
    members[PACKETS] = b"".join(_delimited(packet) for packet in packets)
    members[CHECKPOINT] = checkpoint
    listed = {
        name: {"sha256": hashlib.sha256(content).hexdigest(), "bytes": len(content)}
        for name, content in members.items()
    }
    manifest = {**said, "format": FORMAT, "members": listed}
    return Bundle({**manifest, "sha256": _hash(manifest)}, members)


def to_bytes(bundle: Bundle) -> bytes:
    """The bundle as a file."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in [(MANIFEST, _canonical(bundle.manifest)), *sorted(bundle.members.items())]:
            info = zipfile.ZipInfo(name, _LONG_AGO)
            info.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(info, content)
    return file.getvalue()


def from_bytes(data: bytes) -> Bundle:
    """Read a bundle and hold it against its own hashes; raises BundleError, which says what does not fit."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
        manifest = json.loads(members.pop(MANIFEST))
        told, listed = str(manifest["sha256"]), dict(manifest["members"])
    # zipfile raises the last two for a compression that it does not know, and for a member under a password.
    except (zipfile.BadZipFile, ValueError, KeyError, TypeError, NotImplementedError, RuntimeError) as error:
        raise BundleError(f"this is no bundle of evidence, or it is damaged: {error}") from error
    if manifest.get("format") != FORMAT:
        raise BundleError(f"its format is {manifest.get('format')!r}; this version reads {FORMAT}")
    if set(listed) != set(members):
        odd = ", ".join(sorted(set(listed) ^ set(members)))
        raise BundleError(f"what it holds is not what its manifest lists: {odd}")
    for name, content in members.items():
        if hashlib.sha256(content).hexdigest() != listed[name]["sha256"]:
            raise BundleError(f"{name} was changed: its SHA-256 is not the manifest's")
    found = _hash({name: value for name, value in manifest.items() if name != "sha256"})
    if found != told:
        raise BundleError(f"the manifest was changed: it hashes to {found} and says {told}")
    return Bundle(manifest, members)


def _hash(manifest: Mapping[str, Any]) -> str:
    return hashlib.sha256(_canonical(manifest)).hexdigest()


def _canonical(value: Mapping[str, Any]) -> bytes:
    return json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False).encode()


def _npy(table: Table) -> bytes:
    file = io.BytesIO()
    np.lib.format.write_array(file, table, version=(1, 0), allow_pickle=False)
    return file.getvalue()


def _delimited(packet: bytes) -> bytes:
    """A packet after its length as a varint: how ``POST /v1/telemetry`` takes many."""
    size, prefix = len(packet), bytearray()
    while size > 0x7F:
        prefix.append(size & 0x7F | 0x80)
        size >>= 7
    prefix.append(size)
    return bytes(prefix) + packet


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while at < len(data) and shift < 35:
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
        shift += 7
    raise BundleError(f"{PACKETS} ends inside a packet's length")
