"""Packets over HTTP: plain routes beside FastAPI's, so that no model ever looks at a sample."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from typing import Any, Final

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from schemas.packet import PacketError
from service.api.security import Authenticator, Principal
from service.errors import BadRequestError, ServiceError, TooLargeError, UnsupportedMediaTypeError
from service.ingest.receiver import Form, Receipt, Receiver, refused_of
from service.ingest.validation import MAX_PACKET_BYTES, REASONS

MAX_BATCH_BYTES: Final = 16 * 2**20
"""A request with packets of many vehicles: as much as one transaction of the journal takes."""

SCOPE: Final = "telemetry:write"

_FORMS: Final[dict[str, Form]] = {
    "application/x-protobuf": "protobuf",
    "application/protobuf": "protobuf",
    "application/json": "json",
}
_MAX_VARINT_BYTES: Final = 10

# A refusal's status where it is the whole answer; every other code is 422.
_STATUS_OF_CODE: Final = {"malformed": 400, "too_large": 413, "unknown_vehicle": 404}


class PacketRefusedError(ServiceError):
    """The one packet of a request was refused; ``code`` says why."""

    def __init__(self, receipt: Receipt) -> None:
        assert receipt.code is not None
        super().__init__(
            receipt.detail or REASONS[receipt.code],
            refused=_refusals([receipt]),
            **({"durable_sequence": receipt.durable_sequence} if receipt.vehicle else {}),
        )
        self.code = receipt.code
        self.status = _STATUS_OF_CODE.get(receipt.code, 422)


def ingest_routes(receiver: Receiver | None = None) -> list[Route]:
    """The two routes. Without ``receiver`` they take the one of the running service, ``app.state.runtime``'s."""

    def routed(take: Callable[[Request, Receiver], Any]) -> Callable[[Request], Any]:
        async def endpoint(request: Request) -> Response:
            response: Response = await take(request, receiver or request.app.state.runtime.receiver)
            return response

        return endpoint

    return [
        Route("/v1/vehicles/{vehicle_id}/telemetry", routed(_take_one), methods=["POST"], name="put_telemetry"),
        Route("/v1/telemetry", routed(_take_many), methods=["POST"], name="put_telemetry_batch"),
    ]


async def _take_one(request: Request, receiver: Receiver) -> Response:
    """One packet: 202 once it is durable, also if it was before; a refusal is a problem with the packet's code."""
    principal = await _sender(request)
    form = _form(request, _FORMS)
    body = await _body(request, MAX_PACKET_BYTES)
    (receipt,) = await _receipts(receiver, principal, [body], request.path_params["vehicle_id"], form)
    if receipt.status == "refused":
        raise PacketRefusedError(receipt)
    return _answer([receipt])


async def _take_many(request: Request, receiver: Receiver) -> Response:
    """Packets of many vehicles: 202 with the refused ones listed; 503 and all again if any found no room."""
    principal = await _sender(request)
    _form(request, {name: form for name, form in _FORMS.items() if form == "protobuf"})
    body = await _body(request, MAX_BATCH_BYTES)
    try:
        frames = list(split_frames(body))
    except PacketError as error:
        raise BadRequestError(error.detail) from error
    return _answer(await _receipts(receiver, principal, frames, None, "protobuf"))


def split_frames(body: bytes) -> Iterator[bytes]:
    """The messages of a length-delimited body: each a varint length and that many bytes."""
    at = 0
    while at < len(body):
        start, length, shift = at, 0, 0
        while True:
            if at >= len(body) or at - start >= _MAX_VARINT_BYTES:
                raise PacketError("malformed", f"byte {start}: expected the length of a packet as a varint")
            byte = body[at]
            length |= (byte & 0x7F) << shift
            at, shift = at + 1, shift + 7
            if byte < 0x80:
                break
        if length > len(body) - at:
            raise PacketError("malformed", f"byte {start}: a packet of {length} bytes, but {len(body) - at} are left")
        yield body[at : at + length]
        at += length


async def _sender(request: Request) -> Principal:
    authenticator: Authenticator = request.app.state.authenticator
    principal = authenticator.remembered(request)
    if principal is None:
        principal = await run_in_threadpool(authenticator.principal, request)
    principal.check(SCOPE)
    return principal


async def _receipts(
    receiver: Receiver, principal: Principal, frames: list[bytes], vehicle_id: str | None, form: Form
) -> list[Receipt]:
    def receive_all() -> list[Future[Receipt]]:
        return [
            receiver.receive(principal.tenant_id, frame, transport="http", vehicle_id=vehicle_id, form=form)
            for frame in frames
        ]

    futures = await run_in_threadpool(receive_all)
    return [await asyncio.wrap_future(future) for future in futures]


def _form(request: Request, taken: dict[str, Form]) -> Form:
    media_type = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    form = taken.get(media_type)
    if form is None:
        raise UnsupportedMediaTypeError(f"content-type '{media_type}': expected {' or '.join(taken)}")
    return form


async def _body(request: Request, most: int) -> bytes:
    """The body, read no further than it may be long."""
    too_large = TooLargeError(f"the body is larger than {most} bytes, the most that is taken here")
    declared = request.headers.get("content-length", "")
    if declared.isdecimal() and int(declared) > most:
        raise too_large
    chunks: list[bytes] = []
    size = 0
    async for chunk in request.stream():
        size += len(chunk)
        if size > most:
            raise too_large
        chunks.append(chunk)
    return b"".join(chunks)


def _answer(receipts: list[Receipt]) -> Response:
    durable: dict[tuple[str, str], int] = {}
    for receipt in receipts:
        if receipt.vehicle is not None:
            key = (receipt.vehicle_id, receipt.boot_id)
            durable[key] = max(durable.get(key, 0), receipt.durable_sequence)
    content = {
        "accepted": sum(receipt.status == "accepted" for receipt in receipts),
        "duplicates": sum(receipt.status == "duplicate" for receipt in receipts),
        "refused": _refusals(receipts),
        "durable_sequence": next(iter(durable.values())) if len(durable) == 1 else None,
        "durable": [
            {"vehicle_id": vehicle_id, "boot_id": boot_id, "sequence": sequence}
            for (vehicle_id, boot_id), sequence in durable.items()
        ],
    }
    return JSONResponse(content, 202)


def _refusals(receipts: Iterable[Receipt]) -> list[dict[str, Any]]:
    return [
        {
            "vehicle_id": receipt.vehicle_id,
            "boot_id": boot_id,
            "sequence": sequence,
            "code": code,
            "detail": receipt.detail if code == receipt.code and receipt.detail else REASONS[code],
        }
        for receipt in receipts
        for boot_id, sequence, code in refused_of(receipt)
    ]
