"""The operator's commands: serve, keys, db and vehicles, as real processes where it matters."""

from __future__ import annotations

import json
import re
import signal
import socket
import subprocess
import sys

import httpx
import pytest

from schemas.keys import zenoh_prefix
from service.api.security import authenticate
from service.cli import main
from service.errors import UnauthenticatedError
from service.storage import schema, vehicles
from service.storage.database import open_database, read
from service.storage.vehicles import VehicleDirectory

SERVE = [sys.executable, "-c", "import sys; from service.cli import main; sys.exit(main())", "serve"]


@pytest.fixture(autouse=True)
def _in_an_empty_directory(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TELEFUSE_DATA_DIR", str(tmp_path / "data"))


@pytest.fixture
def data(tmp_path):
    """The database that the commands work on."""
    engine = open_database(f"sqlite:///{tmp_path / 'data' / 'telefuse.db'}")
    yield engine
    engine.dispose()


@pytest.fixture
def run(capsys):
    """Runs a command: status, what it printed, and its errors."""

    def run(*words):
        try:
            status = main(words)
        except SystemExit as exit_:
            status = exit_.code
        return status, *capsys.readouterr()

    return run


# --- serve ------------------------------------------------------------------------------------------


def test_serve_says_where_works_and_stops_clean(tmp_path):
    command = [*SERVE, "--http-port", "0", "--zenoh-mode", "off", "--auth", "off", "--workers", "1"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            said = [process.stdout.readline() for _ in range(4)]
            url = re.fullmatch(r"telefuse serves (http://127\.0\.0\.1:\d+)/v1\n", said[0])[1]
            assert said[-1].endswith(f"{tmp_path / 'data'}\n")
            assert httpx.get(f"{url}/readyz").status_code == 200
            assert httpx.put(f"{url}/v1/vehicles/a", json={}).status_code == 201
            second = subprocess.run([*command[:-2], "--workers", "1"], capture_output=True, text=True, check=False)
            assert (second.returncode, second.stdout, second.stderr.count("\n")) == (2, "", 1)
            assert "in use by another telefuse service" in second.stderr
        finally:
            process.send_signal(signal.SIGTERM)
        log = process.communicate(timeout=60)[1]
    assert process.returncode == 0, log
    for line in log.splitlines():
        assert json.loads(line)["level"] in ("info", "debug"), line


def test_a_taken_port_is_one_line_and_nothing_else(run, tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        done = subprocess.run([*SERVE, "--http-port", str(port)], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert f"http_port {port}" in done.stderr


# --- keys -------------------------------------------------------------------------------------------


def test_a_key_is_shown_once_works_and_can_be_revoked(run, data):
    status, out, err = run("keys", "create", "--tenant", "acme", "--name", "box", "--scope", "telemetry:write")
    token = out.strip()
    assert (status, err.count("\n")) == (0, 1)
    principal = authenticate(data, token)
    assert (principal.tenant_id, principal.scopes) == ("acme", {"telemetry:write"})
    _, listed, _ = run("keys", "list", "--tenant", "acme")
    assert principal.key_id in listed
    assert token not in listed
    assert run("keys", "revoke", principal.key_id)[0] == 0
    with pytest.raises(UnauthenticatedError):
        authenticate(data, token)
    assert "revoked" in run("keys", "list")[1]


def test_keys_as_json(run, data):
    arguments = ("--name", "x", "--scope", "vehicles:*", "--scope", "positions:read", "--expires-days", "30", "--json")
    made = json.loads(run("keys", "create", *arguments)[1])
    assert authenticate(data, made["key"]).may("vehicles:write")
    (listed,) = json.loads(run("keys", "list", "--json")[1])
    assert listed == {name: value for name, value in made.items() if name != "key"}
    assert listed["expires_at"] > listed["created_at"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("create", "--name", "x", "--scope", "everything"), "--scope 'everything'"),
        (("create", "--name", "x"), "--scope"),
        (("create", "--name", "x", "--scope", "admin", "--tenant", "a/b"), "--tenant 'a/b'"),
        (("create", "--name", "x", "--scope", "admin", "--expires-days", "0"), "--expires-days 0"),
        (("revoke", "none"), "no key 'none'"),
        (("sell",), "sell"),
    ],
)
def test_wrong_words_are_one_line(run, words, message):
    status, out, err = run("keys", *words)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert message in err


# --- db ---------------------------------------------------------------------------------------------


def test_the_schema_goes_up_and_back(run):
    newest = schema.newest()
    assert run("db", "current")[1].startswith("empty")
    assert run("db", "upgrade")[1] == f"empty -> {newest}\n"
    assert run("db", "upgrade")[1] == f"{newest}: nothing to do\n"
    assert run("db", "downgrade", "base")[1] == f"{newest} -> empty\n"


def test_a_database_that_cannot_be_reached_is_one_line_without_its_password(run):
    url = "postgresql+psycopg://fuse:hunter2@127.0.0.1:1/telefuse"
    status, out, err = run("db", "upgrade", "--database-url", url)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert "hunter2" not in err
    assert run("db", "downgrade", "yesterday")[0] == 2


# --- vehicles ---------------------------------------------------------------------------------------


def fleet(data):
    directory = VehicleDirectory(data, open_registration=False)
    with read(data) as connection:
        names = [row.ref.vehicle_id for row in vehicles.page(connection, "acme", None, 100)]
    return {name: directory.resolve("acme", name).config for name in names}


def test_a_fleet_is_imported_with_its_settings(run, data, tmp_path):
    (tmp_path / "fleet.csv").write_text(
        "\ufeffvehicle_id,detector,mounting_roll_deg,mounting_pitch_deg,mounting_yaw_deg,gnss_time_offset_s\n"
        'car-1,paper,0,-1.5,"90",0.12\n'
        "\n"
        "car-2,,,,,\n"
    )
    status, out, _ = run("vehicles", "import", "fleet.csv", "--tenant", "acme")
    assert status == 0
    assert out == "".join(f"{name}\t{zenoh_prefix('acme', name)}\n" for name in ("car-1", "car-2"))
    found = fleet(data)
    assert found["car-1"].mounting_rpy_deg == (0.0, -1.5, 90.0)
    assert (found["car-1"].detector, found["car-1"].gnss_time_offset_s) == ("paper", 0.12)
    assert found["car-2"].mounting_rpy_deg is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "line 1: there is no column 'vehicle_id'"),
        ("id\na\n", "line 1: unknown column 'id'"),
        ("vehicle_id,vehicle_id\na,b\n", "line 1: column 'vehicle_id' is there twice"),
        ("vehicle_id,mounting_yaw_deg\na,1\n", "line 1: mounting_roll_deg, mounting_pitch_deg, mounting_yaw_deg stand"),
        ("vehicle_id\ngood\na/b\n", "line 3: vehicle_id 'a/b'"),
        ("vehicle_id\na\nb\na\n", "line 4: vehicle_id 'a' is in line 2 already"),
        ("vehicle_id,detector\ngood,paper\nbad,magic\n", "line 3: detector 'magic'"),
        ("vehicle_id,detector\ngood,paper\nbad\n", "line 3: 1 cells, expected 2"),
        ("vehicle_id,gnss_forward_m,gnss_right_m,gnss_down_m\na,1,x,0\n", "line 2: gnss_right_m 'x'"),
        ("vehicle_id,gnss_forward_m,gnss_right_m,gnss_down_m\na,1,,0\n", "line 2: gnss_right_m is empty"),
        ('vehicle_id\n"a\n', "not a CSV file"),
    ],
)
def test_one_wrong_line_and_nothing_is_imported(run, data, tmp_path, text, message):
    (tmp_path / "fleet.csv").write_text(text)
    schema.upgrade(data)
    status, out, err = run("vehicles", "import", "fleet.csv", "--tenant", "acme")
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert f"fleet.csv, {message}" in err or message in err
    assert fleet(data) == {}
