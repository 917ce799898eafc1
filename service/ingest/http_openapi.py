"""What the OpenAPI document says of the telemetry routes, which FastAPI does not see."""

from __future__ import annotations

from typing import Any

from schemas.keys import MAX_BOOT_ID, MAX_VEHICLE_ID
from service.ingest.http import MAX_BATCH_BYTES, SCOPE
from service.ingest.validation import MAX_PACKET_BYTES, MAX_SEQUENCE, REASONS


def ingest_paths() -> dict[str, Any]:
    """The path items, fresh at each call."""
    return {
        "/v1/vehicles/{vehicle_id}/telemetry": {
            "post": {
                "tags": ["telemetry"],
                "summary": "Send a packet of one vehicle",
                "description": _ONE,
                "operationId": "put_telemetry",
                "security": [{"ApiKey": [SCOPE]}],
                "parameters": [
                    {
                        "name": "vehicle_id",
                        "in": "path",
                        "required": True,
                        "description": "The vehicle's id, as in the packet.",
                        "schema": {"type": "string", "maxLength": MAX_VEHICLE_ID},
                    }
                ],
                "requestBody": {
                    "required": True,
                    "content": {
                        "application/x-protobuf": {
                            "schema": _binary("A telefuse.v1.TelemetryPacket.", MAX_PACKET_BYTES)
                        },
                        "application/json": {"schema": _packet()},
                    },
                },
                "responses": _responses(),
            }
        },
        "/v1/telemetry": {
            "post": {
                "tags": ["telemetry"],
                "summary": "Send packets of many vehicles",
                "description": _MANY,
                "operationId": "put_telemetry_batch",
                "security": [{"ApiKey": [SCOPE]}],
                "requestBody": {
                    "required": True,
                    "content": {
                        "application/x-protobuf": {
                            "schema": _binary(
                                "TelemetryPackets one after the other, each after its length as a varint.",
                                MAX_BATCH_BYTES,
                            )
                        }
                    },
                },
                "responses": _responses(),
            }
        },
    }


_CODES = "\n".join(f"- `{code}`: {reason}" for code, reason in REASONS.items())

_ONE = f"""Send a packet of one vehicle

Answers 202 once the packet is on disk, also if it was before (a duplicate changes nothing). The sender may then
forget every packet of the boot up to `durable_sequence`.

A packet that is refused gets a problem with the code: 400 for `malformed`, 413 for `too_large`, 404 for
`unknown_vehicle`, 422 for every other. Where it says a `durable_sequence`, the refusal is for good and sending it
again is of no use. 503 means that nothing was taken: send again after `Retry-After`.

{_CODES}
"""

_MANY = """Send packets of many vehicles

As for one vehicle, but a refused packet is listed in `refused` and does not keep the others from being taken.
`durable` says for each vehicle and boot up to where its packets may be forgotten; `durable_sequence` is the same where
there is only one, else null. After a 503 send all again: what was taken already counts as a duplicate.
"""


def _binary(description: str, most: int) -> dict[str, Any]:
    return {"type": "string", "format": "binary", "maxLength": most, "description": description}


def _whole(description: str, least: int = 0) -> dict[str, Any]:
    return {"type": "integer", "minimum": least, "description": description}


def _responses() -> dict[str, Any]:
    of_packet = {
        "vehicle_id": {"type": "string"},
        "boot_id": {"type": "string"},
        "sequence": _whole("The packet's sequence."),
    }
    refusal = {**of_packet, "code": {"type": "string"}, "detail": {"type": "string"}}
    answer = {
        "accepted": _whole("Packets that are durable now."),
        "duplicates": _whole("Packets that were before."),
        "refused": {
            "type": "array",
            "description": "Packets that were refused, or given up on because these came (gap_stepped_over).",
            "items": {"type": "object", "properties": refusal, "required": list(refusal)},
        },
        "durable_sequence": {
            "type": ["integer", "null"],
            "description": "Everything of the boot up to here is durable or refused for good; null for several boots.",
        },
        "durable": {
            "type": "array",
            "items": {"type": "object", "properties": of_packet, "required": list(of_packet)},
        },
    }
    schema = {"type": "object", "properties": answer, "required": list(answer)}
    return {"202": {"description": "On disk", "content": {"application/json": {"schema": schema}}}}


def _packet() -> dict[str, Any]:
    """The JSON form, roughly: the .proto file is its reference."""
    return {
        "type": "object",
        "description": "The JSON form of telefuse.v1.TelemetryPacket: protobuf's own, with the samples of a block as "
        "plain arrays. Names as in the .proto file or in lowerCamelCase; 64-bit numbers as numbers or as text.",
        "required": ["vehicle_id", "boot_id", "sequence", "start_time_ns"],
        "properties": {
            "vehicle_id": {"type": "string", "maxLength": MAX_VEHICLE_ID},
            "boot_id": {"type": "string", "maxLength": MAX_BOOT_ID},
            "sequence": {"type": "integer", "minimum": 1, "maximum": MAX_SEQUENCE},
            "start_time_ns": {"type": "integer", "description": "UTC, nanoseconds since 1970."},
            "imu": {"type": "object"},
            "gnss": {"type": "array", "items": {"type": "object"}},
            "magnetometer": {"type": "object"},
            "wheel_speed": {"type": "array", "items": {"type": "object"}},
            "barometer": {"type": "array", "items": {"type": "object"}},
            "temperature_c": {"type": "number"},
            "ignition": {"type": "boolean"},
            "flags": {"type": "integer", "minimum": 0, "description": "1 airbag deployed, 2 power loss, 4 tow."},
        },
        "example": {
            "vehicle_id": "car-1",
            "boot_id": "2024-05-01.1",
            "sequence": 1,
            "start_time_ns": 1714550400000000000,
            "imu": {
                "period_ns": 10000000,
                "accel_scale_mps2": 0.0006,
                "gyro_scale_radps": 0.00015,
                "samples": [[12, -3, -16342, 0, 1, -1], [11, -2, -16340, 1, 0, -1]],
            },
            "gnss": [
                {"offset_ns": 0, "lat_1e9deg": 59350000000, "lon_1e9deg": 18070000000, "height_mm": 40000, "fix": 3}
            ],
        },
    }
