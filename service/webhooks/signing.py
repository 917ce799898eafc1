"""Signatures by the Standard Webhooks scheme (standardwebhooks.com, specification 1.0)."""

from __future__ import annotations

import base64
import hashlib
import hmac
import secrets
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final

SECRET_PREFIX: Final = "whsec_"

SECRET_BYTES: Final = 32
"""Bytes of a new secret; the specification asks for 24 to 64."""

MAX_SECRETS: Final = 4
"""Secrets that sign at the same time; a rotation beyond this drops the oldest at once, to bound the header."""


@dataclass(frozen=True, slots=True)
class Secret:
    """A signing secret as the receiver has it; ``expires_ns`` is None for the current one."""

    value: str
    expires_ns: int | None = None


def new_secret() -> str:
    """A fresh secret, ``whsec_`` and base64."""
    return SECRET_PREFIX + base64.b64encode(secrets.token_bytes(SECRET_BYTES)).decode("ascii")


def rotate(held: Sequence[Secret], fresh: str, now_ns: int, overlap_ns: int) -> tuple[Secret, ...]:
    """``fresh`` as the current secret; those before it sign beside it for ``overlap_ns`` at the longest."""
    end_ns = now_ns + overlap_ns
    old = (Secret(s.value, end_ns if s.expires_ns is None else min(s.expires_ns, end_ns)) for s in held)
    return (Secret(fresh), *_valid(old, now_ns))[:MAX_SECRETS]


def sign(held: Iterable[Secret], webhook_id: str, timestamp_s: int, body: bytes, now_ns: int) -> str:
    """The ``webhook-signature`` header: one ``v1,`` signature for each secret that is valid at ``now_ns``."""
    message = f"{webhook_id}.{timestamp_s}.".encode() + body
    return " ".join(_signature(secret.value, message) for secret in _valid(held, now_ns))


def secrets_from_json(stored: Iterable[dict[str, Any]]) -> tuple[Secret, ...]:
    """Secrets from their column."""
    return tuple(Secret(entry["secret"], entry["expires_ns"]) for entry in stored)


def secrets_to_json(held: Iterable[Secret]) -> list[dict[str, Any]]:
    """Secrets for their column, newest first."""
    return [{"secret": secret.value, "expires_ns": secret.expires_ns} for secret in held]


def _valid(held: Iterable[Secret], now_ns: int) -> Iterable[Secret]:
    return (secret for secret in held if secret.expires_ns is None or secret.expires_ns > now_ns)


def _signature(secret: str, message: bytes) -> str:
    key = base64.b64decode(secret.removeprefix(SECRET_PREFIX))
    return "v1," + base64.b64encode(hmac.digest(key, message, hashlib.sha256)).decode("ascii")
