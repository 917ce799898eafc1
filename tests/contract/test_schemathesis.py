"""Requests that a machine makes up from the OpenAPI document: each answer is one that the document promises."""

from __future__ import annotations

import copy
import time

import pytest
import schemathesis
from hypothesis import HealthCheck, Phase, given, settings
from schemathesis.checks import not_a_server_error
from schemathesis.generation import GenerationMode
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    negative_data_rejection,
    response_schema_conformance,
    status_code_conformance,
)
from sqlalchemy import insert

from service.app import create_app
from service.evidence.bundle import to_bytes
from service.settings import Settings
from service.storage import records, tables
from service.storage.database import read, write
from tests.conftest import run_service
from tests.evidence_inputs import small_bundle
from tests.service.stored_rows import T0, accident_row, candidate_row, manoeuvre_row, point_row, trip_row

CHECKS = [
    not_a_server_error,
    status_code_conformance,
    content_type_conformance,
    response_schema_conformance,
    negative_data_rejection,
]

DOCUMENT = create_app(Settings()).openapi()
OPERATIONS = [(method.upper(), path) for path, methods in DOCUMENT["paths"].items() for method in methods]
TAKES_ANYTHING = {"/livez", "/readyz", "/metrics", "/v1/telemetry", "/v1/rating", "/v1/rating/places:build"}
"""Without parameters, or of a form that the document cannot describe: nothing is against the schema."""

CASES = [
    pytest.param(method, path, mode, id=f"{method} {path} {mode.value}")
    for method, path in OPERATIONS
    for mode in (GenerationMode.POSITIVE, GenerationMode.NEGATIVE)
    if mode is GenerationMode.POSITIVE or path not in TAKES_ANYTHING
]


@schemathesis.serializer("application/x-protobuf")
def protobuf(_context, value):
    """Bytes as they are: that they are seldom a packet is what is tried."""
    return value if isinstance(value, bytes) else str(value).encode()


def without_keys(document):
    """The document for a service with auth off; who gets in is tried elsewhere."""
    document = copy.deepcopy(document)
    for methods in document["paths"].values():
        for operation in methods.values():
            operation.pop("security", None)
    return document


def is_assessed(database):
    with read(database) as connection:
        return records.find(connection, "trip") is not None


@pytest.fixture(scope="module")
def fuzzed(tmp_path_factory):
    """A service with something in it, and its document."""
    chosen = Settings(data_dir=tmp_path_factory.mktemp("fuzzed"), auth="off", zenoh_mode="off", workers=1)
    with run_service(chosen) as running:
        pk = running.runtime.directory.register("default", "car").ref.pk
        with write(running.database) as connection:
            connection.execute(insert(tables.trips), [trip_row(pk, 0, 2, id="trip", due_ns=1)])
            connection.execute(insert(tables.manoeuvres), [manoeuvre_row("default", pk, 1, id="manoeuvre")])
            connection.execute(insert(tables.track_points), [point_row(pk, second) for second in range(3)])
            connection.execute(insert(tables.accidents), [accident_row("default", pk, 1, id="accident")])
            candidate = candidate_row("default", pk, 2, id="candidate")
            connection.execute(insert(tables.accident_candidates), [candidate])
            bundle = small_bundle("accident", "car", T0)
            proof = {"accident_id": "accident", "vehicle_pk": pk, "t_ns": T0, "config": {}, "created_ns": T0}
            built = {"status": "complete", "sha256": bundle.sha256, "bundle": to_bytes(bundle)}
            connection.execute(insert(tables.evidence), [proof | built])
        while not is_assessed(running.database):
            time.sleep(0.05)
        schema = schemathesis.openapi.from_dict(without_keys(DOCUMENT))
        schema.config.base_url = running.url
        yield schema


@pytest.mark.parametrize(("method", "path", "mode"), CASES)
def test_every_answer_is_one_that_the_document_promises(fuzzed, method, path, mode):
    @given(case=fuzzed[path][method].as_strategy(generation_mode=mode))
    @settings(
        max_examples=12,
        derandomize=True,
        deadline=None,
        database=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    def ask(case):
        case.call_and_validate(checks=CHECKS)

    ask()


@pytest.mark.parametrize(
    ("path", "names"),
    [
        ("/v1/vehicles/{vehicle_id}", {"vehicle_id": "car"}),
        ("/v1/vehicles/{vehicle_id}/state", {"vehicle_id": "car"}),
        ("/v1/vehicles/{vehicle_id}/calibration", {"vehicle_id": "car"}),
        ("/v1/vehicles/{vehicle_id}/calibrations", {"vehicle_id": "car"}),
        ("/v1/vehicles/{vehicle_id}/calibration-runs", {"vehicle_id": "car"}),
        ("/v1/vehicles/{vehicle_id}/trips", {"vehicle_id": "car"}),
        ("/v1/trips/{trip_id}", {"trip_id": "trip"}),
        ("/v1/trips/{trip_id}/track", {"trip_id": "trip"}),
        ("/v1/accidents", {}),
        ("/v1/accidents/{accident_id}", {"accident_id": "accident"}),
        ("/v1/accidents/{accident_id}/trace", {"accident_id": "accident"}),
        ("/v1/accidents/{accident_id}/edr", {"accident_id": "accident"}),
        ("/v1/accidents/{accident_id}/msd", {"accident_id": "accident"}),
        ("/v1/accidents/{accident_id}/dossier", {"accident_id": "accident"}),
        ("/v1/accidents/{accident_id}/evidence", {"accident_id": "accident"}),
        ("/v1/accidents/{accident_id}/reviews", {"accident_id": "accident"}),
        ("/v1/accident-candidates", {}),
        ("/v1/accident-candidates/{candidate_id}", {"candidate_id": "candidate"}),
        ("/v1/accident-candidates/{candidate_id}/reviews", {"candidate_id": "candidate"}),
        ("/v1/audit", {}),
    ],
)
def test_what_is_there_is_answered_as_the_document_promises(fuzzed, path, names):
    case = fuzzed[path]["GET"].Case(path_parameters=names)
    response = case.call()
    assert response.status_code == 200
    case.validate_response(response, checks=CHECKS)
