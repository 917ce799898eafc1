"""Errors of the service: each class has a stable ``code`` and an HTTP status, said once, here."""

from __future__ import annotations

from collections.abc import Mapping


class ServiceError(Exception):
    """Base: ``detail`` says what was wrong, where, what was expected and what to do.

    ``extra`` goes into the problem document as members of its own.
    """

    code = "internal_error"
    status = 500

    def __init__(self, detail: str, **extra: object) -> None:
        super().__init__(detail)
        self.detail = detail
        self.extra = extra

    @property
    def headers(self) -> Mapping[str, str]:
        """HTTP headers that belong to the answer."""
        return {}


class UsageError(ServiceError):
    """A command was given something it cannot work with; the command exits 2 with the detail."""

    code = "bad_usage"
    status = 400


class RecordingError(UsageError):
    """A drive folder or recording cannot be read; says file, line, column and what was expected."""

    code = "bad_recording"


class BadRequestError(ServiceError):
    """A request cannot be understood."""

    code = "bad_request"
    status = 400


class InvalidParameterError(ServiceError):
    """A part of a request has the wrong form or range."""

    code = "invalid_request"
    status = 422


class UnauthenticatedError(ServiceError):
    """The caller did not say who they are, or not so that it could be believed."""

    code = "unauthenticated"
    status = 401

    @property
    def headers(self) -> Mapping[str, str]:
        """The scheme by which a caller can say who they are (RFC 9110)."""
        return {"WWW-Authenticate": "Bearer"}


class ForbiddenError(ServiceError):
    """The caller is known and may not do this."""

    code = "forbidden"
    status = 403


class NotFoundError(ServiceError):
    """There is no such thing, or it is another tenant's, which is the same to the caller."""

    code = "not_found"
    status = 404


class ConflictError(ServiceError):
    """The request collides with what is there or under way."""

    code = "conflict"
    status = 409


class PendingError(ConflictError):
    """It is not there yet."""

    def __init__(self, detail: str, *, retry_after_s: int, **extra: object) -> None:
        super().__init__(detail, **extra)
        self.retry_after_s = retry_after_s

    @property
    def headers(self) -> Mapping[str, str]:
        """When to try again."""
        return {"Retry-After": str(self.retry_after_s)}


class EvidencePendingError(PendingError):
    """The evidence of an accident is not built yet."""

    code = "evidence_pending"


class NotAssessedError(PendingError):
    """A trip is not assessed yet."""

    code = "not_assessed"


class EvidenceFailedError(ConflictError):
    """The evidence of an accident could not be built."""

    code = "evidence_failed"


class PreconditionFailedError(ServiceError):
    """What the caller wants to change is no longer as they knew it."""

    code = "precondition_failed"
    status = 412


class TooLargeError(ServiceError):
    """A request's body is larger than is taken here."""

    code = "body_too_large"
    status = 413


class UnsupportedMediaTypeError(ServiceError):
    """The body is of a kind that is not taken here."""

    code = "unsupported_media_type"
    status = 415


class IdempotencyError(ServiceError):
    """An idempotency key was used again for another request."""

    code = "idempotency_key_reused"
    status = 422


class UnavailableError(ServiceError):
    """The service cannot do this just now; the same request may work in a moment."""

    code = "unavailable"
    status = 503

    def __init__(self, detail: str, *, retry_after_s: int = 1, **extra: object) -> None:
        super().__init__(detail, **extra)
        self.retry_after_s = retry_after_s

    @property
    def headers(self) -> Mapping[str, str]:
        """When to try again."""
        return {"Retry-After": str(self.retry_after_s)}


class DatabaseError(ServiceError):
    """The database cannot be reached, or its schema is not what this version works with."""

    code = "database_unavailable"
    status = 503
