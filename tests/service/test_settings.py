"""Settings: which source wins, what is refused, and that no secret is shown."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys

import pytest

from service.errors import UsageError
from service.settings import Settings, add_arguments, describe, environment_name, from_arguments, load_settings


@pytest.fixture(autouse=True)
def _in_an_empty_directory(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def test_defaults_suit_one_machine():
    settings = load_settings().settings
    assert settings.database_url == "sqlite:///data/telefuse.db"
    assert (settings.http_host, settings.zenoh_listen) == ("127.0.0.1", ("tcp/127.0.0.1:7447",))
    assert (settings.auth, settings.registration) == ("on", "closed")
    assert Settings(data_dir="/srv/x").database_url == "sqlite:////srv/x/telefuse.db"
    assert Settings(auth="off").registration == "open"
    assert Settings(auth="off", registration="closed").registration == "closed"


def test_environment_then_file_then_flags(tmp_path, monkeypatch):
    def port_and_source(**flags):
        loaded = load_settings(flags)
        return loaded.settings.http_port, loaded.sources["http_port"]

    assert port_and_source() == (8080, "default")
    monkeypatch.setenv("TELEFUSE_HTTP_PORT", "1111")
    assert port_and_source() == (1111, "environment")
    (tmp_path / "telefuse.toml").write_text("http_port = 2222\n")
    assert port_and_source() == (2222, "telefuse.toml")
    assert port_and_source(http_port="3333") == (3333, "flag")


def test_an_empty_variable_says_nothing(monkeypatch):
    monkeypatch.setenv("TELEFUSE_HTTP_PORT", "")
    loaded = load_settings()
    assert (loaded.settings.http_port, loaded.sources["http_port"]) == (8080, "default")


def test_lists_are_separated_by_commas_as_text_and_arrays_in_the_file(tmp_path, monkeypatch):
    monkeypatch.setenv("TELEFUSE_ZENOH_CONNECT", "tcp/10.0.0.1:7447, tcp/10.0.0.2:7447")
    assert load_settings().settings.zenoh_connect == ("tcp/10.0.0.1:7447", "tcp/10.0.0.2:7447")
    (tmp_path / "telefuse.toml").write_text('zenoh_connect = ["tls/router:7447"]\n')
    assert load_settings().settings.zenoh_connect == ("tls/router:7447",)
    assert load_settings({"zenoh_connect": ""}).settings.zenoh_connect == ()


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        ({"http_port": "x"}, r"http_port \(from flag\)"),
        ({"http_port": "70000"}, r"http_port \(from flag\)"),
        ({"auth": "maybe"}, r"auth \(from flag\).*'on' or 'off'"),
        ({"database_url": "mysql://u:secret@h/d"}, r"database_url: expected sqlite"),
        ({"database_url": "sqlite://"}, r"in memory"),
        ({"database_url": "postgresql://u:secret@h/d"}, r"postgresql\+psycopg"),
        ({"zenoh_mode": "mesh"}, r"zenoh_mode \(from flag\)"),
        ({"workers": "0"}, r"workers"),
        ({"cluster": "tcp/10.0.0.1:1"}, r"cluster"),
    ],
)
def test_what_is_wrong_is_said_by_name_and_source_without_the_secret(flags, message):
    with pytest.raises(UsageError, match=message) as caught:
        load_settings(flags)
    assert "secret" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [("http_prot = 1", "unknown setting 'http_prot'"), ("http_port =", "not TOML"), ("[http]\nport = 1", "unknown")],
)
def test_a_wrong_file_is_refused(tmp_path, text, message):
    (tmp_path / "telefuse.toml").write_text(text)
    with pytest.raises(UsageError, match=message):
        load_settings()
    with pytest.raises(UsageError, match="no such file"):
        load_settings(config_file=tmp_path / "other.toml")


@pytest.mark.parametrize(
    "exposed",
    [
        {"http_host": "0.0.0.0"},
        {"http_host": "::"},
        {"http_host": "telefuse.example"},
        {"zenoh_listen": "tcp/0.0.0.0:7447"},
        {"zenoh_listen": "tcp/127.0.0.1:7447,tcp/[::]:7447"},
        {"zenoh_listen": "tcp/192.168.1.5:7447", "zenoh_mode": "peer"},
        {"zenoh_config": "router.json5"},
    ],
)
def test_without_auth_nothing_may_listen_beyond_this_machine(exposed):
    with pytest.raises(UsageError, match="auth: off is refused"):
        load_settings({"auth": "off", **exposed})


@pytest.mark.parametrize(
    "safe",
    [
        {},
        {"http_host": "::1"},
        {"http_host": "localhost"},
        {"zenoh_listen": "tcp/[::1]:7447,tcp/localhost:0,unixsock-stream//tmp/x.sock"},
        {"zenoh_listen": "tcp/0.0.0.0:7447", "zenoh_mode": "off"},
        {"zenoh_mode": "client", "zenoh_connect": "tcp/10.0.0.1:7447"},
    ],
)
def test_without_auth_loopback_is_enough(safe):
    assert load_settings({"auth": "off", **safe}).settings.auth == "off"


def test_an_open_zenoh_port_needs_security_or_a_dangerous_word():
    exposed = {"zenoh_listen": "tcp/0.0.0.0:7447"}
    with pytest.raises(UsageError, match=r"zenoh_listen.*dangerous_allow_plain_zenoh"):
        load_settings(exposed)
    load_settings({**exposed, "dangerous_allow_plain_zenoh": "true"})
    load_settings({**exposed, "zenoh_config": "router.json5"})


def test_every_setting_is_a_flag_and_is_described(tmp_path):
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    (tmp_path / "my.toml").write_text("gap_wait_s = 5\n")
    loaded = from_arguments(parser.parse_args(["--config", "my.toml", "--http-port", "9", "--auth", "off"]))
    assert (loaded.settings.http_port, loaded.settings.gap_wait_s) == (9, 5.0)
    assert loaded.sources["gap_wait_s"] == "my.toml"
    shown = describe(loaded)
    for name, field in Settings.model_fields.items():
        assert field.description, name
        assert f"{name} = " in shown
        assert environment_name(name) in shown
        assert environment_name(name) in parser.format_help()


def test_print_settings_masks_passwords_and_starts_nothing(tmp_path):
    url = "postgresql+psycopg://fuse:hunter2@db.example/telefuse"
    command = [sys.executable, "-c", "import sys; from service.cli import main; sys.exit(main())", "serve"]
    done = subprocess.run(
        [*command, "--print-settings", "--database-url", url], capture_output=True, text=True, check=True
    )
    assert "database_url = postgresql+psycopg://fuse:***@db.example/telefuse\n    from flag" in done.stdout
    assert "hunter2" not in done.stdout + done.stderr
    assert list(tmp_path.iterdir()) == []
    refused = subprocess.run([*command, "--auth", "off", "--http-host", "0.0.0.0"], capture_output=True, text=True)
    assert (refused.returncode, refused.stdout, refused.stderr.count("\n")) == (2, "", 1)


def test_a_log_line_is_json_with_fields(capsys):
    program = (
        "import logging; from service.observability import configure_logging; configure_logging('info');"
        "log = logging.getLogger('x'); log.info('a %s', 'b', extra={'fields': {'n': 1}}); log.debug('no')"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    line = json.loads(done.stderr)
    assert (line["level"], line["message"], line["n"], line["logger"]) == ("info", "a b", 1, "x")
