"""The containers' files, as far as they can be held without a container engine."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml

from service.errors import UsageError
from service.settings import ENV_PREFIX, Settings, load_settings

ROOT = Path(__file__).resolve().parents[2]
DOCKER = ROOT / "docker"
PASSWORD = "0123456789abcdef"


def instructions() -> list[tuple[str, str]]:
    """The Dockerfile's instructions with their arguments, continued lines joined."""
    lines = [line for line in (DOCKER / "Dockerfile").read_text().splitlines() if not line.lstrip().startswith("#")]
    text = "\n".join(lines).replace("\\\n", " ")
    return [(word, rest) for word, _, rest in (line.partition(" ") for line in text.splitlines()) if word]


def final_stage() -> list[tuple[str, str]]:
    found = instructions()
    return found[max(index for index, (word, _) in enumerate(found) if word == "FROM") :]


def image_environment() -> dict[str, str]:
    pairs = [pair for word, rest in final_stage() if word == "ENV" for pair in rest.split()]
    return dict(pair.split("=", 1) for pair in pairs)


def compose() -> dict[str, Any]:
    text = (DOCKER / "compose.yaml").read_text()
    content: dict[str, Any] = yaml.safe_load(re.sub(r"\$\{(\w+):\?[^}]*\}", PASSWORD, text))
    return content


def service_environment() -> dict[str, str]:
    """What the service sees of settings when compose runs it."""
    environment = {**image_environment(), **compose()["services"]["telefuse"]["environment"]}
    return {name: value for name, value in environment.items() if name.startswith(ENV_PREFIX)}


def settings_of(environment: dict[str, str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Settings:
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    monkeypatch.chdir(tmp_path)
    return load_settings().settings


def pins(name: str) -> dict[str, tuple[str, frozenset[str]]]:
    """Version and hashes of each package of a file of requirements."""
    text = (ROOT / "requirements" / name).read_text()
    found = re.findall(r"^([a-z0-9._-]+)(?:\[[^]]*\])?==([^ ]+)([^\n]*\\\n(?:    --hash[^\n]*\n)+)", text, re.MULTILINE)
    return {package: (version, frozenset(re.findall(r"sha256:[0-9a-f]{64}", rest))) for package, version, rest in found}


def test_what_compose_sets_the_service_accepts_with_keys_required(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    settings = settings_of(service_environment(), monkeypatch, tmp_path)
    assert settings.auth == "on"
    assert settings.registration == "closed"
    assert settings.database_url == f"postgresql+psycopg://telefuse:{PASSWORD}@database/telefuse"
    assert settings.data_dir == Path("/data")
    known = {ENV_PREFIX + name.upper() for name in Settings.model_fields}
    assert set(service_environment()) <= known, "a name that is no setting would be read by nobody"


def test_plain_zenoh_in_the_container_is_said_to_be_meant(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    environment = service_environment()
    del environment["TELEFUSE_DANGEROUS_ALLOW_PLAIN_ZENOH"]
    with pytest.raises(UsageError, match="open to the network"):
        settings_of(environment, monkeypatch, tmp_path)


def test_the_image_alone_opens_no_plain_zenoh(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    environment = {name: value for name, value in image_environment().items() if name.startswith(ENV_PREFIX)}
    settings = settings_of(environment, monkeypatch, tmp_path)
    assert settings.zenoh_listen == ("tcp/127.0.0.1:7447",)
    assert settings.database_url == "sqlite:////data/telefuse.db"
    assert not settings.dangerous_allow_plain_zenoh


def test_ports_are_published_on_loopback_only() -> None:
    services = compose()["services"]
    published = [port for service in services.values() for port in service.get("ports", ())]
    assert sorted(published) == ["127.0.0.1:7447:7447", "127.0.0.1:8080:8080"]
    assert all(service.get("network_mode") is None for service in services.values())
    assert compose()["networks"][services["database"]["networks"][0]]["internal"] is True


def test_the_service_waits_for_a_healthy_database_and_what_matters_is_on_volumes() -> None:
    content = compose()
    telefuse, database = content["services"]["telefuse"], content["services"]["database"]
    assert telefuse["depends_on"]["database"]["condition"] == "service_healthy"
    assert "pg_isready" in database["healthcheck"]["test"]
    assert database["image"] == "postgres:16"
    mounted = {volume.split(":")[0]: volume.split(":")[1] for s in (telefuse, database) for volume in s["volumes"]}
    assert mounted == {"data": "/data", "database": "/var/lib/postgresql/data"}
    assert set(content["volumes"]) == set(mounted)


def test_secrets_come_from_a_file_that_git_ignores() -> None:
    wanted = set(re.findall(r"\$\{(\w+)", (DOCKER / "compose.yaml").read_text()))
    offered = dict(re.findall(r"^(\w+)=(.*)$", (DOCKER / "env.example").read_text(), re.MULTILINE))
    assert set(offered) == wanted
    assert not any(offered.values()), "an example that works is an example that is kept"
    assert ".env" in (DOCKER / ".gitignore").read_text().split()


def test_the_image_runs_as_nobody_in_particular_and_is_asked_whether_it_lives() -> None:
    stage = final_stage()
    said = dict(stage)
    assert said["USER"] == "telefuse"
    assert "--uid 10001" in said["RUN"]
    assert said["VOLUME"] == "/data"
    assert "/livez" in said["HEALTHCHECK"]
    assert said["ENTRYPOINT"] == '["telefuse"]'  # a list: so that a stop reaches the service, not a shell
    assert said["CMD"] == '["serve"]'
    assert stage.index(("USER", "telefuse")) > max(index for index, (word, _) in enumerate(stage) if word == "RUN")
    assert not re.search(r"\b(pip|uv|apt-get)\b", said["RUN"]), "build tools stay in the builder"


def test_everything_that_is_copied_exists_and_reaches_the_build() -> None:
    ignored = (DOCKER / "Dockerfile.dockerignore").read_text().splitlines()
    allowed = {line.removeprefix("!") for line in ignored if line.startswith("!")}
    assert "*" in ignored
    copied = [rest.split() for word, rest in instructions() if word == "COPY" and not rest.startswith("--from")]
    for *sources, _ in copied:
        for source in sources:
            assert (ROOT / source).exists(), source
            assert Path(source).parts[0] in allowed, source
    assert allowed == {Path(source).parts[0] for *sources, _ in copied for source in sources}


@pytest.mark.parametrize("name", ["runtime.txt", "build.txt"])
def test_the_image_has_the_versions_that_the_tests_run_with(name: str) -> None:
    tested, shipped = pins("lock.txt") | pins("roads.txt"), pins(name)
    assert shipped
    assert all(hashes for _, hashes in shipped.values())
    assert {package: tested.get(package) for package in shipped} == shipped, "make lock"


def test_the_image_has_what_the_project_needs_and_no_tools_for_development() -> None:
    with (ROOT / "pyproject.toml").open("rb") as file:
        project = tomllib.load(file)

    def names(requirements: list[str]) -> set[str]:
        return {re.split(r"[<>=\[;! ]", requirement)[0].lower() for requirement in requirements}

    shipped = set(pins("runtime.txt"))
    extras = project["project"]["optional-dependencies"]
    needed = names(project["project"]["dependencies"] + extras["parquet"] + extras["roads"])
    assert needed <= shipped, "make lock"
    # filterpy brings matplotlib along, which the tests' own list names too
    assert not {"pytest", "mypy", "ruff", "hypothesis", "schemathesis", "import-linter", "setuptools"} & shipped


def test_no_address_of_an_index_is_written_down() -> None:
    for path in [*(ROOT / "requirements").glob("*.txt"), *DOCKER.glob("Dockerfile*")]:
        text = path.read_text()
        for sign in ("index-url", "find-links", "://", "trusted-host"):
            assert sign not in text.replace("http://127.0.0.1:", ""), f"{path.name}: {sign}"
