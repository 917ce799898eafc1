"""When deliveries are tried again."""

from __future__ import annotations

import pytest

from service.webhooks.schedule import RetrySchedule, parse_retry_after

SCHEDULE = RetrySchedule()
M, H = 60, 3600
TABLE_S = [1, 2, 5, 15, M, 5 * M, 30 * M, 2 * H, 5 * H, 10 * H, 14 * H, 20 * H, 24 * H]
NOW_NS = 1769860800 * 10**9  # 2026-01-31T12:00:00Z


@pytest.mark.parametrize(("attempts", "delay_s"), list(enumerate(TABLE_S, start=1)))
def test_delays_follow_the_table_and_jitter_only_adds(attempts, delay_s):
    delays = [SCHEDULE.delay_s(delivery_id, attempts) for delivery_id in range(200)]
    assert delay_s <= min(delays)
    assert max(delays) <= delay_s * 1.2
    # 200 of them spread over the whole range of the jitter, as they must to keep a fleet's retries apart.
    assert max(delays) - min(delays) > 0.15 * delay_s


def test_after_the_table_there_is_no_further_attempt():
    assert SCHEDULE.delay_s(1, len(TABLE_S)) is not None
    assert SCHEDULE.delay_s(1, len(TABLE_S) + 1) is None
    assert SCHEDULE.delay_s(1, len(TABLE_S) + 1, retry_after_s=10) is None


def test_jitter_is_told_by_delivery_and_attempt_alone():
    assert SCHEDULE.delay_s(7, 3) == RetrySchedule().delay_s(7, 3)
    assert SCHEDULE.delay_s(7, 3) != SCHEDULE.delay_s(8, 3)


def test_receiver_can_ask_for_more_time_but_not_for_less_nor_for_ever():
    assert SCHEDULE.delay_s(1, 1, retry_after_s=120) == 120
    assert SCHEDULE.delay_s(1, 5, retry_after_s=1) == SCHEDULE.delay_s(1, 5)
    assert SCHEDULE.delay_s(1, 1, retry_after_s=1e9) == 24 * H


@pytest.mark.parametrize(
    ("header", "seconds"),
    [
        ("120", 120),
        (" 0 ", 0),
        ("Sat, 31 Jan 2026 12:02:00 GMT", 120),
        ("Saturday, 31-Jan-26 12:02:00 GMT", 120),
        ("Sat, 31 Jan 2026 11:00:00 GMT", None),
        ("-5", None),
        ("1.5", None),
        ("soon", None),
        ("", None),
        ("٣", None),
        ("9" * 400, 1e9),
        ("Sat, 31 Jan 99999 12:02:00 GMT", None),
    ],
)
def test_retry_after_is_seconds_or_a_date(header, seconds):
    assert parse_retry_after(header, NOW_NS) == seconds
