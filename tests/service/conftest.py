"""What tests of the service share."""

from __future__ import annotations

import pytest

from service.storage import schema
from service.storage.database import open_database
from tests.road_map import write_map
from tests.service.engine_bench import Bench
from tests.service.webhook_harness import Clock, Outbox
from tests.service.webhook_receiver import WebhookReceiver


@pytest.fixture
def engine(request):
    """SQLite; where the statements matter, both."""
    kind = getattr(request, "param", "sqlite")
    return request.getfixturevalue("database" if kind == "sqlite" else "postgres_database")


@pytest.fixture
def clock():
    """Time that stands still until a test advances it."""
    return Clock()


@pytest.fixture
def outbox(engine, clock):
    """A tenant's webhooks in the database."""
    return Outbox(engine, clock)


@pytest.fixture
def receiver():
    """A receiver of webhooks on loopback."""
    with WebhookReceiver() as receiver:
        yield receiver


@pytest.fixture(scope="session")
def map_file(tmp_path_factory):
    """The invented map as an extract."""
    for package in ("osmium", "shapely", "valhalla"):
        pytest.importorskip(package, reason="the extra 'roads' is not installed")
    return write_map(tmp_path_factory.mktemp("map") / "nowhere.osm.pbf")


@pytest.fixture(scope="session")
def built_roads(map_file):
    """The invented map, built."""
    from service.roads.build import build

    out = map_file.parent / "roads"
    build(map_file, out, lambda *_: None)
    return out


@pytest.fixture
def bench(database):
    """An engine's database, vehicles and journal."""
    return Bench(database)


@pytest.fixture
def other(tmp_path):
    """A second one, for what must come out the same."""
    database = open_database(f"sqlite:///{tmp_path / 'other.db'}")
    schema.upgrade(database)
    yield Bench(database)
    database.dispose()
