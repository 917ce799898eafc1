"""``telefuse evidence verify FILE``: whether a bundle is as it was made, and what its packets give again."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from service.errors import UsageError
from service.evidence.bundle import Bundle, BundleError, from_bytes


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    verify = actions.add_parser("verify", help="hold a bundle against its hashes")
    verify.add_argument("file", type=Path, metavar="FILE", help="what GET /v1/accidents/ID/evidence gave")
    verify.add_argument("--sha256", metavar="HEX", help="the hash that it must have, as the service told it")
    verify.add_argument(
        "--replay", action="store_true", help="fold its packets again, too: they must give its tables to the bit"
    )
    verify.add_argument("--json", action="store_true", help="print what was found as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Verify; 0 where all of it holds, 2 with one line where something does not."""
    try:
        data = arguments.file.read_bytes()
    except OSError as error:
        raise UsageError(f"{arguments.file}: cannot be read: {error.strerror}") from error
    try:
        bundle = from_bytes(data)
    except BundleError as error:
        raise BundleError(f"{arguments.file}: {error.detail}") from error
    if arguments.sha256 is not None and arguments.sha256.lower() != bundle.sha256:
        raise BundleError(f"{arguments.file}: its hash is {bundle.sha256}, not {arguments.sha256.lower()}")
    if arguments.replay:
        # Here, not above: it brings the filter along.
        from service.evidence.replaying import check_replay

        check_replay(bundle)
    sys.stdout.write(_told(bundle, arguments.replay, arguments.json))
    return 0


def _told(bundle: Bundle, replayed: bool, as_json: bool) -> str:
    manifest = bundle.manifest
    if as_json:
        names = ("accident", "covered", "replay", "versions")
        figures = {"sha256": bundle.sha256, "replayed": replayed, **{name: manifest[name] for name in names}}
        return json.dumps(figures, indent=2) + "\n"
    covered = manifest["covered"]
    accident = manifest["accident"]
    lines = [
        f"accident {accident['id']} of {accident['vehicle_id']}, {accident['time']}",
        f"SHA-256  {bundle.sha256}: every member is as it was made",
        f"covers   {'all that is kept' if covered['whole'] else 'not all that is kept'}, "
        f"{len(manifest['packets'])} packets",
    ]
    if replayed:
        lines.append("replay   gives every table again, to the bit")
    return "\n".join(lines) + "\n"
