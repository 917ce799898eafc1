"""Deliveries as a receiver and an operator see them: signed, retried, never lost, nobody delayed by another."""

from __future__ import annotations

import threading
from datetime import UTC, datetime
from email.utils import format_datetime

import pytest

from service.storage.database import write
from service.webhooks import outbox as outbox_module
from service.webhooks.schedule import RetrySchedule
from service.webhooks.sender import SenderLimits
from tests.service.webhook_harness import FAST, Outbox, RunningSender, S, eventually
from tests.service.webhook_receiver import Answer, WebhookReceiver, closed_port

TABLE_S = RetrySchedule().delays_s


on_both_databases = pytest.mark.parametrize("engine", ["sqlite", "postgresql"], indirect=True)


@on_both_databases
def test_event_reaches_its_endpoint_signed_and_is_recorded(engine, clock, outbox, receiver):
    endpoint_id, secret = outbox.add_endpoint(receiver.url("/hooks?key=1"))
    with RunningSender(engine, clock) as sender:
        event_id = outbox.publish(accident_id="a1", lat_deg=59.25)
        sender.notify()
        (request,) = receiver.wait_for(1)
        eventually(lambda: sender.count("delivered") == 1)
    assert request.verify(secret)["data"] == {"accident_id": "a1", "lat_deg": 59.25}
    assert request.message["type"] == "accident.detected"
    assert request.id == event_id
    assert request.path == "/hooks?key=1"
    assert request.headers["content-type"] == "application/json"
    row = outbox.delivery(event_id, endpoint_id)
    assert (row.status, row.attempts, row.next_attempt_ns, row.last_status_code) == ("delivered", 1, None, 204)
    (attempt,) = outbox.attempts(row.id)
    assert (attempt.started_ns, attempt.status_code, attempt.error) == (clock(), 204, None)


def test_latency_is_from_the_packet_to_the_request(engine, clock, outbox, receiver):
    outbox.add_endpoint(receiver.url())
    with RunningSender(engine, clock) as sender:
        outbox.publish()
        outbox.publish(type="trip.completed")
        sender.notify()
        eventually(lambda: sender.count("delivered") == 2)
    sample = sender.metrics.registry.get_sample_value
    assert sample("telefuse_alert_latency_seconds_count") == 1  # a trip is no alert
    assert sample("telefuse_alert_latency_seconds_sum") == 1.0  # the packet came a second before, by the test's clock


@on_both_databases
def test_event_told_twice_is_sent_once(engine, clock, outbox, receiver):
    outbox.add_endpoint(receiver.url())
    with RunningSender(engine, clock) as sender:
        with write(engine) as connection:
            assert outbox.publish_in(connection, "e1")
            assert not outbox.publish_in(connection, "e1")
        with write(engine) as connection:
            assert not outbox.publish_in(connection, "e1")
        sender.notify()
        eventually(lambda: sender.count("delivered") == 1)
    assert len(receiver.requests) == len(outbox.deliveries()) == 1


@on_both_databases
def test_what_is_rolled_back_is_not_sent(engine, clock, outbox, receiver):
    outbox.add_endpoint(receiver.url())

    def fail_after_publishing():
        with write(engine) as connection:
            outbox.publish_in(connection, "e1")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail_after_publishing()
    assert outbox.deliveries() == []


@on_both_databases
def test_only_the_tenants_enabled_endpoints_that_ask_for_the_type_get_it(engine, clock, outbox, receiver):
    everything, _ = outbox.add_endpoint(receiver.url("/all"))
    accidents, _ = outbox.add_endpoint(receiver.url("/accidents"), ("accident.detected", "accident.updated"))
    outbox.add_endpoint(receiver.url("/trips"), ("trip.completed",))
    outbox.add_endpoint(receiver.url("/off"), status="disabled")
    Outbox(engine, clock, "other").add_endpoint(receiver.url("/other"))
    outbox.publish("e1")
    assert {row.endpoint_id for row in outbox.deliveries(event_id="e1")} == {everything, accidents}


@on_both_databases
def test_failing_delivery_follows_the_schedule_then_is_dead_and_can_be_replayed(engine, clock, outbox, receiver):
    outbox.add_endpoint(receiver.url())
    receiver.default = Answer(500)
    with RunningSender(engine, clock) as sender:
        event_id = outbox.publish()
        for attempt, delay_s in enumerate([*TABLE_S, None], start=1):
            sender.notify()
            receiver.wait_for(attempt)
            eventually(lambda n=attempt: sender.count("retried") + sender.count("dead") == n)
            row = outbox.delivery(event_id)
            assert (row.attempts, row.last_status_code, row.last_error) == (attempt, 500, "HTTP 500")
            if delay_s is None:
                break
            assert row.status == "pending"
            wait_s = (row.next_attempt_ns - clock()) / S
            assert delay_s - 1e-6 <= wait_s <= delay_s * 1.2
            # Not a moment before it is due.
            clock.advance(wait_s - 0.001)
            sender.notify()
            clock.advance(0.002)
        assert (row.status, row.next_attempt_ns, row.finished_ns) == ("dead", None, clock())
        assert len({request.id for request in receiver.requests}) == 1
        assert len({request.body for request in receiver.requests}) == 1
        times = [int(request.headers["webhook-timestamp"]) for request in receiver.requests]
        assert times == sorted(times)
        assert times[-1] - times[0] > sum(TABLE_S)

        receiver.default = Answer()
        with write(engine) as connection:
            outbox_module.replay(connection, row.id, clock())
        sender.notify()
        eventually(lambda: sender.count("delivered") == 1)
    row = outbox.delivery(event_id)
    assert (row.status, row.attempts) == ("delivered", 1)
    assert len(outbox.attempts(row.id)) == len(TABLE_S) + 2
    assert receiver.requests[-1].id == event_id


def test_nothing_is_sent_before_it_is_due(engine, clock, outbox, receiver):
    outbox.add_endpoint(receiver.url())
    receiver.answers.append(Answer(500))
    with RunningSender(engine, clock) as sender:
        outbox.publish("first")
        sender.notify()
        eventually(lambda: sender.count("retried") == 1)
        clock.advance(0.999)
        outbox.publish("second")  # once this one is there, the sender has looked and passed the first one by
        sender.notify()
        eventually(lambda: sender.count("delivered") == 1)
        assert [request.id for request in receiver.requests] == ["first", "second"]
        clock.advance(0.3)
        sender.notify()
        eventually(lambda: sender.count("delivered") == 2)
    assert [request.id for request in receiver.requests] == ["first", "second", "first"]


@pytest.mark.parametrize("status", [200, 201, 202, 204, 299])
def test_any_2xx_is_success(engine, clock, outbox, receiver, status):
    outbox.add_endpoint(receiver.url())
    receiver.default = Answer(status, body=b"" if status == 204 else b"thanks")
    with RunningSender(engine, clock) as sender:
        outbox.publish("e1")
        sender.notify()
        eventually(lambda: sender.count("delivered") == 1)
    assert outbox.delivery("e1").last_status_code == status


@pytest.mark.parametrize("status", [301, 302, 307, 400, 401, 404, 500, 502])
def test_any_other_status_is_retried(engine, clock, outbox, receiver, status):
    outbox.add_endpoint(receiver.url())
    receiver.default = Answer(status, {"Location": receiver.url("/elsewhere")})
    with RunningSender(engine, clock) as sender:
        outbox.publish("e1")
        sender.notify()
        eventually(lambda: sender.count("retried") == 1)
    row = outbox.delivery("e1")
    assert (row.status, row.last_status_code) == ("pending", status)
    assert [request.path for request in receiver.requests] == ["/hook"]


@on_both_databases
def test_410_disables_the_endpoint_and_cancels_what_waits(engine, clock, outbox, receiver):
    gone, _ = outbox.add_endpoint(receiver.url("/gone"))
    with WebhookReceiver() as other:
        fine, _ = outbox.add_endpoint(other.url())
        receiver.answers.extend([Answer(500), Answer(410)])
        with RunningSender(engine, clock) as sender:
            outbox.publish("e1")
            sender.notify()
            eventually(lambda: sender.count("retried") == 1)
            outbox.publish("e2")
            sender.notify()
            eventually(lambda: sender.count("gone") == 1)
            outbox.publish("e3")
            sender.notify()
            eventually(lambda: sender.count("delivered") == 3)
    assert outbox.endpoint_status(gone) == "disabled"
    assert outbox.endpoint_status(fine) == "enabled"
    assert outbox.delivery("e1", gone).status == "cancelled"
    assert (outbox.delivery("e2", gone).status, outbox.delivery("e2", gone).last_status_code) == ("dead", 410)
    assert outbox.deliveries(event_id="e3", endpoint_id=gone) == []
    assert len(receiver.requests) == 2


@pytest.mark.parametrize("status", [429, 503])
@pytest.mark.parametrize("as_date", [False, True], ids=["seconds", "date"])
def test_retry_after_is_honoured(engine, clock, outbox, receiver, status, as_date):
    outbox.add_endpoint(receiver.url())
    moment = datetime.fromtimestamp(clock() // S + 600, UTC)
    receiver.default = Answer(status, {"Retry-After": format_datetime(moment, usegmt=True) if as_date else "600"})
    with RunningSender(engine, clock) as sender:
        outbox.publish("e1")
        sender.notify()
        eventually(lambda: sender.count("retried") == 1)
    # A date has whole seconds.
    assert (outbox.delivery("e1").next_attempt_ns - clock()) / S == pytest.approx(600, abs=1)


def test_retry_after_of_other_failures_is_not_honoured(engine, clock, outbox, receiver):
    outbox.add_endpoint(receiver.url())
    receiver.default = Answer(500, {"Retry-After": "600"})
    with RunningSender(engine, clock) as sender:
        outbox.publish("e1")
        sender.notify()
        eventually(lambda: sender.count("retried") == 1)
    assert outbox.delivery("e1").next_attempt_ns - clock() < 2 * S


def test_receiver_that_never_answers_times_out(engine, clock, outbox, receiver):
    outbox.add_endpoint(receiver.url())
    release = threading.Event()
    receiver.answers.append(Answer(until=release))
    with RunningSender(engine, clock, limits=FAST) as sender:
        outbox.publish("e1")
        sender.notify()
        eventually(lambda: sender.count("retried") == 1)
        release.set()
    assert outbox.delivery("e1").last_error == "timeout: no response within 0.3 s"


def test_headers_that_drip_do_not_defeat_the_time_out(engine, clock, outbox, receiver):
    outbox.add_endpoint(receiver.url())
    receiver.answers.append(Answer(drip_headers=True, drip_s=0.01))
    with RunningSender(engine, clock, limits=FAST) as sender:
        outbox.publish("e1")
        sender.notify()
        eventually(lambda: sender.count("retried") == 1)
        assert receiver.hung_up.wait(10)
    assert outbox.delivery("e1").last_error == "timeout: no response within 0.3 s"


@pytest.mark.parametrize("drip_s", [0.0, 0.02], ids=["endless", "dripping"])
def test_body_without_end_is_dropped_and_its_status_counts(engine, clock, outbox, receiver, drip_s):
    outbox.add_endpoint(receiver.url())
    receiver.answers.append(Answer(200, drip_s=drip_s))
    with RunningSender(engine, clock, limits=FAST) as sender:
        outbox.publish("e1")
        sender.notify()
        eventually(lambda: sender.count("delivered") == 1)
        assert receiver.hung_up.wait(10)
    assert outbox.delivery("e1").last_status_code == 200


def test_connection_is_used_again(engine, clock, outbox, receiver):
    outbox.add_endpoint(receiver.url())
    with RunningSender(engine, clock) as sender:
        for number in range(1, 6):
            outbox.publish()
            sender.notify()
            eventually(lambda n=number: sender.count("delivered") == n)
    assert receiver.connections == 1


def test_private_target_is_refused_by_default(engine, clock, outbox, receiver):
    outbox.add_endpoint(f"https://localhost:{receiver.port}/")
    with RunningSender(engine, clock, private=False) as sender:
        outbox.publish("e1")
        sender.notify()
        eventually(lambda: sender.count("retried") == 1)
    assert outbox.delivery("e1").last_error.startswith("webhook_target_refused: webhooks are not sent to localhost")
    assert receiver.connections == 0


def test_hanging_endpoint_delays_nobody_else(engine, clock, outbox, receiver):
    release = threading.Event()
    with WebhookReceiver() as hanging:
        hanging.default = Answer(until=release)
        outbox.add_endpoint(hanging.url())
        outbox.add_endpoint(receiver.url())
        limits = SenderLimits(poll_s=60.0, concurrency=6, per_endpoint=4)
        with RunningSender(engine, clock, limits=limits) as sender:
            for number in range(1, 21):
                outbox.publish(str(number))
                sender.notify()
            receiver.wait_for(20)
            eventually(lambda: sender.count("delivered") == 20)
            assert len(hanging.requests) == 4  # and no more than its share is under way
            release.set()
            eventually(lambda: sender.count("delivered") == 40)
    assert {request.id for request in hanging.requests} == {str(number) for number in range(1, 21)}


def test_endpoint_that_failed_is_tried_one_at_a_time(engine, clock, outbox, receiver):
    release = threading.Event()
    outbox.add_endpoint(receiver.url())
    receiver.answers.append(Answer(500))
    with RunningSender(engine, clock) as sender:
        outbox.publish("failed")
        sender.notify()
        eventually(lambda: sender.count("retried") == 1)
        receiver.default = Answer(until=release)
        with write(engine) as connection:
            for number in range(5):
                outbox.publish_in(connection, str(number))
        sender.notify()
        receiver.wait_for(2)
        with WebhookReceiver() as other:
            outbox.add_endpoint(other.url())
            outbox.publish("other")
            sender.notify()
            other.wait_for(1)
        assert len(receiver.requests) == 2
        release.set()
        eventually(lambda: sender.count("delivered") == 7)


@on_both_databases
def test_accident_overtakes_a_backlog(engine, clock, outbox, receiver):
    outbox.add_endpoint(receiver.url())
    for number in range(30):
        outbox.publish(f"trip{number}", "trip.completed")
    clock.advance(1)
    outbox.publish("accident")
    with RunningSender(engine, clock, limits=SenderLimits(poll_s=60.0, per_endpoint=1)) as sender:
        eventually(lambda: sender.count("delivered") == 31)
    order = [request.id for request in receiver.requests]
    assert order == ["accident", *(f"trip{number}" for number in range(30))]


def test_wake_up_needs_no_notification_from_this_process(engine, clock, outbox, receiver):
    outbox.add_endpoint(receiver.url())
    with RunningSender(engine, clock, limits=SenderLimits(poll_s=0.05)):
        outbox.publish("e1")
        receiver.wait_for(1)


def test_closed_port_is_retried_until_the_receiver_is_there(engine, clock, outbox):
    port = closed_port()
    outbox.add_endpoint(f"http://127.0.0.1:{port}/hook")
    with RunningSender(engine, clock) as sender:
        outbox.publish("e1")
        sender.notify()
        eventually(lambda: sender.count("retried") == 1)
        with WebhookReceiver(port=port) as receiver:
            clock.advance(2)
            sender.notify()
            assert receiver.wait_for(1)[0].id == "e1"
            eventually(lambda: sender.count("delivered") == 1)


def test_message_too_large_for_a_webhook_is_refused_before_it_is_stored(engine, clock, outbox):
    with pytest.raises(ValueError, match="below 20000"):
        outbox.publish("e1", text="x" * 20_000)
