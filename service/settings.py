"""Every setting of the service: environment ``TELEFUSE_...``, then ``telefuse.toml``, then flags; the later wins."""

from __future__ import annotations

import argparse
import os
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from ipaddress import ip_address
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

from pydantic import BeforeValidator, Field, ValidationError, model_validator
from pydantic_settings import BaseSettings, NoDecode, PydanticBaseSettingsSource, SettingsConfigDict
from sqlalchemy.engine import make_url
from sqlalchemy.exc import ArgumentError

from service.errors import UsageError

ENV_PREFIX: Final = "TELEFUSE_"
CONFIG_FILE: Final = "telefuse.toml"


def _split(value: object) -> object:
    if isinstance(value, str):
        return [item.strip() for item in value.split(",") if item.strip()]
    return value


Endpoints = Annotated[tuple[str, ...], NoDecode, BeforeValidator(_split)]
"""Zenoh endpoints; separated by commas where they are given as text."""


class Settings(BaseSettings):
    """What an operator decides. A setting's name in the environment is ``TELEFUSE_`` and its name in capitals."""

    model_config = SettingsConfigDict(
        env_prefix=ENV_PREFIX, extra="forbid", frozen=True, validate_default=True, env_ignore_empty=True
    )

    data_dir: Path = Field(default=Path("data"), description="Directory of what the service keeps; made if missing.")
    database_url: str = Field(
        default_factory=lambda known: f"sqlite:///{known['data_dir'] / 'telefuse.db'}",
        description="Where everything is stored: sqlite:///FILE or postgresql+psycopg://USER:PASSWORD@HOST/NAME. "
        "Default: telefuse.db in the data directory.",
    )

    http_host: str = Field(default="127.0.0.1", description="Address on which HTTP is served.")
    http_port: int = Field(
        default=8080, ge=0, le=65535, description="Port on which HTTP is served; 0 takes a free one."
    )

    zenoh_mode: Literal["router", "peer", "client", "off"] = Field(
        default="router", description="Role in the Zenoh network: a router of its own, part of another one, or off."
    )
    zenoh_listen: Endpoints = Field(
        default=("tcp/127.0.0.1:7447",),
        description="Zenoh endpoints to listen on (router and peer), separated by commas.",
    )
    zenoh_connect: Endpoints = Field(default=(), description="Zenoh endpoints to connect to, separated by commas.")
    zenoh_config: Path | None = Field(
        default=None,
        description="A Zenoh configuration file (JSON5): TLS, access control; the other ZENOH settings go on top.",
    )

    auth: Literal["on", "off"] = Field(
        default="on",
        description="Whether callers need an API key; off is for one machine only: every listener on loopback.",
    )
    registration: Literal["closed", "open"] = Field(
        default_factory=lambda known: "open" if known["auth"] == "off" else "closed",
        description="What an unknown vehicle meets: closed refuses it, open registers it with its first packet. "
        "Default: open while auth is off, else closed.",
    )

    workers: int = Field(
        default_factory=lambda: os.cpu_count() or 1,
        ge=1,
        le=256,
        description="Threads that fuse and store; they take turns at the interpreter. Default: one a core.",
    )
    checkpoint_interval_s: float = Field(
        default=30.0,
        ge=1,
        le=3600,
        description="Seconds between two checkpoints of a vehicle; what a restart has to repeat.",
    )
    gap_wait_s: float = Field(
        default=10.0,
        ge=0,
        le=600,
        description="Seconds, in the packets' own time, that a missing packet is waited for.",
    )

    trip_silence_s: float = Field(
        default=900.0,
        ge=1,
        le=86_400,
        description="Seconds without a packet after which a trip that did not end is scored as it is; again when more "
        "comes.",
    )

    retention_journal_days: int = Field(
        default=30,
        ge=0,
        description="Days that packets are kept as they came; 0 is for ever. None goes that is still needed.",
    )
    retention_track_days: int = Field(
        default=365,
        ge=0,
        description="Days that the fused track is kept, and the places of manoeuvres; 0 is for ever. Records of trips "
        "stay: they know no places but H3 cells and districts.",
    )
    retention_events_days: int = Field(
        default=90, ge=0, description="Days that events and their deliveries can be read again; 0 is for ever."
    )
    retention_candidates_days: int = Field(
        default=90,
        ge=0,
        description="Days that shocks which were judged to be no accident can be looked at; 0 is for ever.",
    )
    retention_evidence_days: int = Field(
        default=1095,
        ge=0,
        description="Days that the evidence of an accident is kept, whatever becomes of packets and track; 0 is for "
        "ever. It goes with its vehicle.",
    )

    retention_recordings_days: int = Field(
        default=30,
        ge=0,
        description="Days that an uploaded calibration recording is kept once it was used; 0 is for ever. Results and "
        "reports stay with the vehicle.",
    )
    max_recording_mib: int = Field(
        default=256, ge=1, le=4096, description="Largest calibration recording that is taken, MiB, unpacked."
    )

    log_level: Literal["debug", "info", "warning", "error"] = Field(
        default="info", description="The least important messages that are logged."
    )

    cluster: Literal["none"] = Field(
        default="none", description="Distributed engine; this version has one process only."
    )
    roads: Path | None = Field(
        default=None,
        description="Folder that 'telefuse roads build' made, for street, legal limit and district; without it roads "
        "are unknown.",
    )

    dangerous_allow_private_webhook_targets: bool = Field(
        default=False,
        description="Let webhooks go to private, loopback and link-local addresses. A tenant can then reach "
        "what stands beside this service.",
    )
    dangerous_allow_plain_zenoh: bool = Field(
        default=False,
        description="Let Zenoh listen beyond loopback without a zenoh_config that secures it. Whoever reaches "
        "the port can then speak for every vehicle.",
    )

    @classmethod
    def settings_customise_sources(
        cls,
        settings_cls: type[BaseSettings],
        init_settings: PydanticBaseSettingsSource,
        env_settings: PydanticBaseSettingsSource,
        dotenv_settings: PydanticBaseSettingsSource,
        file_secret_settings: PydanticBaseSettingsSource,
    ) -> tuple[PydanticBaseSettingsSource, ...]:
        """Only arguments and the environment; ``load_settings`` passes file and flags as arguments."""
        return init_settings, env_settings

    @model_validator(mode="after")
    def _check_database(self) -> Self:
        try:
            url = make_url(self.database_url)
        except ArgumentError:
            url = None
        if url is None or url.drivername not in ("sqlite", "postgresql+psycopg"):
            raise ValueError("database_url: expected sqlite:///FILE or postgresql+psycopg://USER:PASSWORD@HOST/NAME")
        if url.drivername == "sqlite" and url.database in (None, "", ":memory:"):
            raise ValueError("database_url: SQLite in memory would keep nothing; expected sqlite:///FILE")
        return self

    @model_validator(mode="after")
    def _check_exposure(self) -> Self:
        listens = self.zenoh_listen if self.zenoh_mode in ("router", "peer") else ()
        exposed = [endpoint for endpoint in listens if not is_loopback(_endpoint_host(endpoint))]
        if self.auth == "off":
            if not is_loopback(self.http_host):
                raise ValueError(f"auth: off is refused while http_host is {self.http_host}; set it to 127.0.0.1")
            if exposed:
                raise ValueError(f"auth: off is refused while zenoh_listen has {exposed[0]}; use tcp/127.0.0.1:PORT")
            if self.zenoh_config is not None and self.zenoh_mode != "off":
                raise ValueError("auth: off is refused with zenoh_config, whose listeners are not known here")
        elif exposed and self.zenoh_config is None and not self.dangerous_allow_plain_zenoh:
            raise ValueError(
                f"zenoh_listen: {exposed[0]} is open to the network; give a zenoh_config with TLS and access control, "
                "or set dangerous_allow_plain_zenoh"
            )
        return self


def is_loopback(host: str) -> bool:
    """Whether a listener on ``host`` can be reached from this machine only."""
    if host == "localhost":
        return True
    try:
        return ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def _endpoint_host(endpoint: str) -> str:
    protocol, _, address = endpoint.partition("/")
    if protocol.startswith("unixsock"):
        return "localhost"
    return address.split("?")[0].split("#")[0].rpartition(":")[0]


@dataclass(frozen=True, slots=True)
class LoadedSettings:
    """Settings with where each was said: default, environment, the file's name, or flag."""

    settings: Settings
    sources: Mapping[str, str]


def load_settings(flags: Mapping[str, Any] | None = None, config_file: Path | None = None) -> LoadedSettings:
    """Read environment, file and flags.

    Without ``config_file`` a ``telefuse.toml`` in the working directory is read if there is one.
    """
    flags = {} if flags is None else flags
    path = Path(CONFIG_FILE) if config_file is None else config_file
    from_file = _read_file(path, required=config_file is not None)
    sources = {}
    for name in Settings.model_fields:
        if name in flags:
            sources[name] = "flag"
        elif name in from_file:
            sources[name] = str(path)
        elif os.environ.get(environment_name(name)):
            sources[name] = "environment"
        else:
            sources[name] = "default"
    try:
        settings = Settings(**{**from_file, **flags})
    except ValidationError as error:
        raise UsageError(_one_line(error, sources)) from error
    return LoadedSettings(settings, sources)


def _read_file(path: Path, *, required: bool) -> dict[str, Any]:
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        if required:
            raise UsageError(f"{path}: no such file; expected a TOML file of settings") from None
        return {}
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"{path}: cannot be read as text: {error}") from error
    try:
        values = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise UsageError(f"{path}: not TOML: {error}") from error
    for name in values:
        if name not in Settings.model_fields:
            raise UsageError(f"{path}: unknown setting '{name}'; telefuse serve --print-settings shows what there is")
    return values


def _one_line(error: ValidationError, sources: Mapping[str, str]) -> str:
    """The first thing that is wrong, without the values, which may be secret."""
    first = error.errors(include_url=False, include_input=False)[0]
    message = first["msg"].removeprefix("Value error, ")
    if not first["loc"]:
        return f"setting {message}"
    name = str(first["loc"][0])
    return f"setting {name} (from {sources.get(name, 'default')}): {message}"


def environment_name(name: str) -> str:
    """A setting's name in the environment."""
    return ENV_PREFIX + name.upper()


def add_arguments(parser: argparse.ArgumentParser, names: Sequence[str] | None = None) -> None:
    """Give a command a flag for each setting, or for those in ``names``, and ``--config``."""
    group = parser.add_argument_group("settings", f"each also in {CONFIG_FILE} or the environment, which are weaker")
    group.add_argument(
        "--config", type=Path, metavar="FILE", help=f"settings file (default {CONFIG_FILE}, if it is there)"
    )
    for name, field in Settings.model_fields.items():
        if names is None or name in names:
            group.add_argument(
                "--" + name.replace("_", "-"),
                dest=f"setting_{name}",
                metavar="VALUE",
                help=f"{field.description} [{environment_name(name)}]".replace("%", "%%"),
            )


def from_arguments(arguments: argparse.Namespace) -> LoadedSettings:
    """The settings for a command whose parser had ``add_arguments``."""
    flags = {
        name: value
        for name in Settings.model_fields
        if (value := getattr(arguments, f"setting_{name}", None)) is not None
    }
    return load_settings(flags, arguments.config)


def describe(loaded: LoadedSettings) -> str:
    """Each setting with its value (no passwords), its source, its name in the environment and what it is for."""
    lines = []
    for name, field in Settings.model_fields.items():
        value = getattr(loaded.settings, name)
        if name == "database_url":
            value = make_url(value).render_as_string(hide_password=True)
        elif isinstance(value, tuple):
            value = ",".join(value)
        shown = "" if value is None else str(value)
        lines.append(
            f"{name} = {shown}\n    from {loaded.sources[name]}; {environment_name(name)}; {field.description}"
        )
    return "\n".join(lines)
