"""Errors that the core raises for its caller's mistakes; never for bad measurements in a stream."""


class CoreError(Exception):
    """Base of all errors of the core, with a stable machine-readable ``code``."""

    code = "core_error"


class InvalidInputError(CoreError):
    """An argument has the wrong shape, unit or range; the message says what was expected."""

    code = "invalid_input"


class SnapshotError(CoreError):
    """A snapshot cannot be restored: another version, or damaged."""

    code = "snapshot_unreadable"
