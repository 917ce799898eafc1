"""Names on the wire: which identifiers are allowed, and the Zenoh keys made of them."""

from __future__ import annotations

import re
import zlib
from dataclasses import dataclass
from typing import Final

KEY_ROOT: Final = "telefuse/v1"

MAX_VEHICLE_ID: Final = 128
MAX_BOOT_ID: Final = 64
MAX_TENANT_ID: Final = 64

# A key chunk must not hold / * $ # ? nor begin with @ (Zenoh); an id in a URL must need no escape and not be
# a dot segment; one in a file name must hold no colon. VINs, UUIDs, IMEIs and plain names all pass.
_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*", re.ASCII)

NAME_RULE: Final = "letters, digits and . _ - with a letter or digit first"


def is_name(text: str, longest: int) -> bool:
    """Whether ``text`` may be a tenant, vehicle or boot id of at most ``longest`` characters."""
    return len(text) <= longest and _NAME.fullmatch(text) is not None


def bucket(tenant_id: str, vehicle_id: str) -> str:
    """Two hex digits that spread vehicles over workers: the low byte of the CRC-32 (IEEE) of ``tenant/vehicle``."""
    return f"{zlib.crc32(f'{tenant_id}/{vehicle_id}'.encode()) & 0xFF:02x}"


def zenoh_prefix(tenant_id: str, vehicle_id: str) -> str:
    """The keys of one vehicle start with this; telemetry, ack, alive, state or event follows after a slash."""
    return f"{KEY_ROOT}/{tenant_id}/{bucket(tenant_id, vehicle_id)}/{vehicle_id}"


@dataclass(frozen=True, slots=True)
class VehicleKey:
    """The parts of a vehicle's key; ``bucket`` is what the sender wrote, right or wrong."""

    tenant_id: str
    bucket: str
    vehicle_id: str
    leaf: str

    @property
    def bucket_is_right(self) -> bool:
        return self.bucket == bucket(self.tenant_id, self.vehicle_id)


def parse_key(key: str) -> VehicleKey | None:
    """The parts of ``telefuse/v1/{tenant}/{bucket}/{vehicle}/{leaf}``; None if it is no such key."""
    chunks = key.split("/")
    if len(chunks) != 6 or "/".join(chunks[:2]) != KEY_ROOT:
        return None
    tenant_id, written_bucket, vehicle_id, leaf = chunks[2:]
    if not (is_name(tenant_id, MAX_TENANT_ID) and is_name(vehicle_id, MAX_VEHICLE_ID)):
        return None
    return VehicleKey(tenant_id, written_bucket, vehicle_id, leaf)
