"""When a failed delivery is tried again: a fixed table with jitter, and what the receiver asked for."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import UTC
from email.utils import parsedate_to_datetime
from hashlib import blake2b


@dataclass(frozen=True, slots=True)
class RetrySchedule:
    """Delays after the 1st, 2nd, ... failed attempt; when they are used up the delivery is dead.

    ``delays_s``: seconds; the interface's table, three days in all. Short at first, because most
    failures are a restart of the receiver, and an alert is worth little when it is late.
    ``jitter``: 0..1, the largest share added to a delay, so that what failed together does not come
    back together. Never subtracted: the table's figure is the least.
    ``longest_s``: seconds, 0 or more; bound on a receiver's Retry-After (the table's own longest delay).
    """

    delays_s: tuple[float, ...] = (1, 2, 5, 15, 60, 300, 1800, 7200, 18000, 36000, 50400, 72000, 86400)
    jitter: float = 0.2
    longest_s: float = 86400.0

    def delay_s(self, delivery_id: int, attempts: int, retry_after_s: float | None = None) -> float | None:
        """Seconds to wait after ``attempts`` failed ones, or None when there is no further attempt.

        The jitter is a function of delivery and attempt, so a schedule can be told in advance.
        """
        if attempts > len(self.delays_s):
            return None
        digest = blake2b(f"{delivery_id}:{attempts}".encode(), digest_size=8).digest()
        share = int.from_bytes(digest, "big") / 2**64
        scheduled = self.delays_s[attempts - 1] * (1 + self.jitter * share)
        asked = min(retry_after_s or 0.0, self.longest_s)
        return max(scheduled, asked)


def parse_retry_after(value: str, now_ns: int) -> float | None:
    """Seconds from a Retry-After header (RFC 9110, 10.2.3: seconds or an HTTP date); None if it says nothing usable."""
    text = value.strip()
    if text.isascii() and text.isdigit():
        return min(float(text), 1e9)
    try:
        date = parsedate_to_datetime(text)
    except ValueError:
        return None
    if date.tzinfo is None:
        date = date.replace(tzinfo=UTC)
    seconds = date.timestamp() - now_ns * 1e-9
    return seconds if math.isfinite(seconds) and seconds > 0 else None
