"""Errors of the service: each class has a stable ``code`` and an HTTP status, said once, here."""

from __future__ import annotations


class ServiceError(Exception):
    """Base: ``detail`` says what was wrong, where, what was expected and what to do."""

    code = "internal_error"
    status = 500

    def __init__(self, detail: str, **extra: object) -> None:
        super().__init__(detail)
        self.detail = detail
        self.extra = extra


class UsageError(ServiceError):
    """A command was given something it cannot work with; the command exits 2 with the detail."""

    code = "bad_usage"
    status = 400


class RecordingError(UsageError):
    """A drive folder or recording cannot be read; says file, line, column and what was expected."""

    code = "bad_recording"
