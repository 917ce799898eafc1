"""``openapi.yaml`` is what the application answers to, and says what a reader needs of each operation."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from service.api.openapi import to_yaml
from service.api.security import SCOPES
from service.app import create_app
from service.settings import Settings

COMMITTED = Path(__file__).parents[2] / "openapi.yaml"


@pytest.fixture(scope="module")
def document():
    return create_app(Settings()).openapi()


def operations(document):
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            yield f"{method.upper()} {path}", operation


def test_the_committed_document_is_the_applications(document):
    assert COMMITTED.read_text(encoding="utf-8") == to_yaml(document), "run: telefuse openapi > openapi.yaml"


def test_the_command_prints_it_without_starting_anything(tmp_path):
    program = "import sys; from service.cli import main; sys.exit(main(['openapi']))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=tmp_path)
    assert done.stdout == COMMITTED.read_text(encoding="utf-8")
    assert list(tmp_path.iterdir()) == []


def test_the_yaml_reads_back_as_the_same_document(document):
    assert yaml.safe_load(to_yaml(document)) == document


def test_every_operation_says_what_it_is_who_may_and_what_an_error_looks_like(document):
    tags = {tag["name"] for tag in document["tags"]}
    seen = set()
    for name, operation in operations(document):
        assert operation["summary"], name
        assert set(operation["tags"]) <= tags, name
        assert operation["operationId"] not in seen, name
        seen.add(operation["operationId"])
        assert "application/problem+json" in operation["responses"]["default"]["content"], name
        if " /v1/" in name:
            (requirement,) = operation["security"]
            assert set(requirement["ApiKey"]) <= set(SCOPES), name


def test_the_routes_of_the_interface_are_there(document):
    there = {name for name, _ in operations(document)}
    assert there >= {
        "POST /v1/vehicles/{vehicle_id}/telemetry",
        "POST /v1/telemetry",
        "PUT /v1/vehicles/{vehicle_id}",
        "GET /v1/vehicles/{vehicle_id}",
        "DELETE /v1/vehicles/{vehicle_id}",
        "GET /v1/vehicles",
        "GET /v1/vehicles/{vehicle_id}/state",
        "GET /v1/vehicles/{vehicle_id}/calibration",
        "PUT /v1/vehicles/{vehicle_id}/calibration",
        "GET /v1/vehicles/{vehicle_id}/calibrations",
        "POST /v1/vehicles/{vehicle_id}/calibration-runs",
        "GET /v1/vehicles/{vehicle_id}/calibration-runs",
        "GET /v1/vehicles/{vehicle_id}/calibration-runs/{run_id}",
        "GET /v1/vehicles/{vehicle_id}/calibration-runs/{run_id}/report",
        "POST /v1/vehicles/{vehicle_id}/calibration-runs/{run_id}:accept",
        "POST /v1/vehicles/{vehicle_id}/calibration-runs/{run_id}:refuse",
        "GET /v1/vehicles/{vehicle_id}/trips",
        "GET /v1/trips/{trip_id}",
        "GET /v1/trips/{trip_id}/track",
        "GET /v1/accidents",
        "GET /v1/accidents/{accident_id}",
        "GET /v1/events",
        "GET /livez",
        "GET /readyz",
        "GET /metrics",
    }
