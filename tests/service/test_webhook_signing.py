"""Signatures hold by the public Standard Webhooks package, through a rotation, too."""

from __future__ import annotations

import base64
import time

import pytest
from standardwebhooks import Webhook, WebhookVerificationError

from schemas.notifications import message
from service.webhooks.signing import (
    MAX_SECRETS,
    Secret,
    new_secret,
    rotate,
    secrets_from_json,
    secrets_to_json,
    sign,
)

NOW_NS = time.time_ns()
HOUR_NS = 3600 * 10**9
BODY = message("accident.detected", NOW_NS, {"vehicle_id": "vävä €", "lat_deg": 59.334591})


def headers(held, now_ns=None, webhook_id="0b5cd8e4-93f3-5f5a-8f0c-6e9b8f0f2c11"):
    now_ns = time.time_ns() if now_ns is None else now_ns  # the package refuses what is older than five minutes
    timestamp_s = now_ns // 10**9
    return {
        "webhook-id": webhook_id,
        "webhook-timestamp": str(timestamp_s),
        "webhook-signature": sign(held, webhook_id, timestamp_s, BODY, now_ns),
    }


def verifies(secret, sent):
    try:
        Webhook(secret).verify(BODY, sent)
    except WebhookVerificationError:
        return False
    return True


def test_public_package_verifies_what_is_signed():
    secret = new_secret()
    assert Webhook(secret).verify(BODY, headers([Secret(secret)]))["data"]["vehicle_id"] == "vävä €"


def test_other_secret_other_id_or_other_body_does_not_verify():
    secret = new_secret()
    sent = headers([Secret(secret)])
    assert not verifies(new_secret(), sent)
    assert not verifies(secret, sent | {"webhook-id": "another"})
    with pytest.raises(WebhookVerificationError):
        Webhook(secret).verify(BODY + b" ", sent)


def test_new_secrets_have_the_specified_form_and_differ():
    secrets = {new_secret() for _ in range(20)}
    assert len(secrets) == 20
    for secret in secrets:
        assert secret.startswith("whsec_")
        assert 24 <= len(base64.b64decode(secret.removeprefix("whsec_"), validate=True)) <= 64


def test_old_secret_signs_beside_the_new_one_until_it_expires():
    old, fresh = new_secret(), new_secret()
    held = rotate([Secret(old)], fresh, NOW_NS, 24 * HOUR_NS)
    during = headers(held)
    assert verifies(old, during)
    assert verifies(fresh, during)
    assert len(during["webhook-signature"].split(" ")) == 2
    # The package refuses times far from now, so what is signed later is judged by the number of signatures.
    assert len(headers(held, NOW_NS + 24 * HOUR_NS - 1)["webhook-signature"].split(" ")) == 2
    after = headers(held, NOW_NS + 24 * HOUR_NS)["webhook-signature"]
    assert len(after.split(" ")) == 1
    assert held[0] == Secret(fresh, None)


def test_rotation_without_overlap_ends_the_old_secret_at_once():
    old, fresh = new_secret(), new_secret()
    sent = headers(rotate([Secret(old)], fresh, NOW_NS, 0))
    assert verifies(fresh, sent)
    assert not verifies(old, sent)


def test_a_second_rotation_does_not_prolong_the_first_secret():
    first = rotate([Secret("whsec_" + "a" * 32)], new_secret(), NOW_NS, HOUR_NS)
    second = rotate(first, new_secret(), NOW_NS, 24 * HOUR_NS)
    assert [secret.expires_ns for secret in second] == [None, NOW_NS + 24 * HOUR_NS, NOW_NS + HOUR_NS]


def test_many_rotations_keep_the_header_bounded_and_the_newest_secrets():
    held = (Secret(new_secret()),)
    for _ in range(10):
        newest = new_secret()
        held = rotate(held, newest, NOW_NS, 24 * HOUR_NS)
    assert len(held) == MAX_SECRETS
    assert held[0].value == newest


def test_secrets_survive_their_column():
    held = rotate([Secret(new_secret())], new_secret(), NOW_NS, HOUR_NS)
    assert secrets_from_json(secrets_to_json(held)) == held


def test_message_is_the_same_bytes_whatever_the_order_of_its_fields():
    one = message("ping", NOW_NS, {"a": 1.5, "b": {"c": None, "d": [1, 2]}})
    assert one == message("ping", NOW_NS, {"b": {"d": [1, 2], "c": None}, "a": 1.5})


def test_message_times_are_rfc3339_in_utc():
    assert b'"timestamp":"2026-01-31T12:00:00.123456Z"' in message("ping", 1769860800_123456789, {})


@pytest.mark.parametrize("data", [{"text": "x" * 20_000}, {"text": "€" * 7_000}, {"speed_mps": float("nan")}])
def test_message_that_no_receiver_could_take_is_refused(data):
    with pytest.raises(ValueError):
        message("accident.detected", NOW_NS, data)
