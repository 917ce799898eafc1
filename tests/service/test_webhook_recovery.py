"""Nothing is lost: killed, stopped, with a broken database, with two senders, with an endpoint that goes away."""

from __future__ import annotations

import dataclasses
import os
import signal
import subprocess
import sys
import textwrap
import threading

import pytest
from sqlalchemy import text
from sqlalchemy.exc import OperationalError

from service.storage.database import write
from service.webhooks import sender as sender_module
from service.webhooks.claims import INTERRUPTED
from service.webhooks.client import ClientLimits
from service.webhooks.sender import SenderLimits
from tests.service.webhook_harness import FAST, Clock, Outbox, RunningSender, eventually
from tests.service.webhook_receiver import Answer

on_both_databases = pytest.mark.parametrize("engine", ["sqlite", "postgresql"], indirect=True)


@on_both_databases
def test_two_senders_share_the_work_without_doubling_it(engine, clock, outbox, receiver):
    outbox.add_endpoint(receiver.url())
    with RunningSender(engine, clock) as one, RunningSender(engine, clock) as two:
        # On SQLite one that begins takes what is claimed for a dead one's: both have to have begun.
        eventually(lambda: one.has_begun and two.has_begun)
        for number in range(60):
            outbox.publish(str(number))
            one.notify()
            two.notify()
        eventually(lambda: one.count("delivered") + two.count("delivered") == 60)
    assert sorted(request.id for request in receiver.requests) == sorted(str(number) for number in range(60))


@on_both_databases
def test_database_that_fails_for_a_while_loses_and_doubles_nothing(engine, clock, outbox, receiver, monkeypatch):
    outbox.add_endpoint(receiver.url())
    broken = threading.Event()
    failures = []

    def fail_while_broken(*args):
        if broken.is_set():
            failures.append(1)
            raise OperationalError("statement", {}, Exception("the disk is full"))
        return record(*args)

    record = sender_module.record
    monkeypatch.setattr(sender_module, "record", fail_while_broken)
    release = threading.Event()
    receiver.answers.append(Answer(until=release))
    with RunningSender(engine, clock) as sender:
        outbox.publish("e1")
        sender.notify()
        receiver.wait_for(1)
        broken.set()
        release.set()
        eventually(lambda: len(failures) >= 3)
        assert outbox.delivery("e1").status == "pending"
        broken.clear()
        eventually(lambda: sender.count("delivered") == 1)
    assert outbox.delivery("e1").status == "delivered"
    assert len(receiver.requests) == 1


@on_both_databases
def test_stop_lets_a_request_finish_and_records_it(engine, clock, outbox, receiver):
    release = threading.Event()
    outbox.add_endpoint(receiver.url())
    receiver.answers.append(Answer(until=release))
    with RunningSender(engine, clock) as sender:
        outbox.publish("e1")
        sender.notify()
        receiver.wait_for(1)
        threading.Timer(0.05, release.set).start()
    assert outbox.delivery("e1").status == "delivered"


@on_both_databases
def test_stop_does_not_wait_for_ever_and_the_next_sender_goes_on_at_once(engine, clock, outbox, receiver):
    release = threading.Event()
    outbox.add_endpoint(receiver.url())
    receiver.answers.append(Answer(until=release))
    with RunningSender(engine, clock, limits=dataclasses.replace(FAST, client=ClientLimits(), grace_s=0.05)) as sender:
        outbox.publish("e1")
        sender.notify()
        receiver.wait_for(1)
    release.set()
    row = outbox.delivery("e1")
    assert (row.status, row.next_attempt_ns) == ("pending", clock())
    with RunningSender(engine, clock) as sender:
        eventually(lambda: sender.count("delivered") == 1)
    assert [request.id for request in receiver.requests] == ["e1", "e1"]


KILLED = """
    import asyncio, sys
    from service.observability import Metrics
    from service.settings import Settings
    from service.storage.database import open_database
    from service.webhooks.sender import Sender

    engine = open_database(sys.argv[1])
    settings = Settings(dangerous_allow_private_webhook_targets=True)
    asyncio.run(Sender(engine, settings, Metrics()).run())
"""


@on_both_databases
def test_killed_between_sending_and_recording_it_is_sent_again(engine, receiver):
    outbox = Outbox(engine)
    outbox.add_endpoint(receiver.url())
    release = threading.Event()
    receiver.answers.append(Answer(until=release))
    outbox.publish("e1")
    url = engine.url.render_as_string(hide_password=False)
    with subprocess.Popen([sys.executable, "-c", textwrap.dedent(KILLED), url]) as process:
        receiver.wait_for(1, 30)
        os.kill(process.pid, signal.SIGKILL)
    release.set()
    row = outbox.delivery("e1")
    assert (row.status, row.attempts) == ("pending", 1)
    # SQLite has one sender, so the next one takes over at once; elsewhere it waits for the lease to run out.
    clock = Clock()
    if engine.dialect.name != "sqlite":
        clock.advance(SenderLimits().lease_s + 1)
    with RunningSender(engine, clock) as sender:
        eventually(lambda: sender.count("delivered") == 1)
    assert [request.id for request in receiver.requests] == ["e1", "e1"]
    assert receiver.requests[1].body == receiver.requests[0].body
    first, second = outbox.attempts(row.id)
    assert (first.error, second.status_code) == (INTERRUPTED, 204)


@pytest.mark.parametrize("engine", ["postgresql"], indirect=True)  # SQLite has one sending process
def test_lease_of_a_sender_at_work_is_left_alone(engine, clock, outbox, receiver):
    release = threading.Event()
    outbox.add_endpoint(receiver.url())
    receiver.answers.append(Answer(until=release))
    with RunningSender(engine, clock) as one:
        outbox.publish("e1")
        one.notify()
        receiver.wait_for(1)
        with RunningSender(engine, clock) as two:
            outbox.publish("e2")
            two.notify()
            receiver.wait_for(2)
            eventually(lambda: one.count("delivered") + two.count("delivered") == 1)
        release.set()
        eventually(lambda: one.count("delivered") + two.count("delivered") == 2)
    assert [request.id for request in receiver.requests] == ["e1", "e2"]


@on_both_databases
def test_endpoint_removed_while_a_request_is_under_way(engine, clock, outbox, receiver):
    release = threading.Event()
    endpoint_id, _ = outbox.add_endpoint(receiver.url())
    receiver.answers.append(Answer(until=release))
    with RunningSender(engine, clock) as sender:
        outbox.publish("e1")
        sender.notify()
        receiver.wait_for(1)
        with write(engine) as connection:
            connection.execute(text("DELETE FROM webhook_endpoints WHERE id = :id"), {"id": endpoint_id})
        release.set()
        eventually(lambda: sender.count("delivered") == 1)
        outbox.add_endpoint(receiver.url())
        outbox.publish("e2")
        sender.notify()
        eventually(lambda: sender.count("delivered") == 2)
