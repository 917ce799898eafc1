"""``telefuse openapi``: print the OpenAPI document of the HTTP interface."""

from __future__ import annotations

import argparse
import json
import sys

from service.api.openapi import to_yaml
from service.app import create_app
from service.settings import Settings


def configure(parser: argparse.ArgumentParser) -> None:
    """Which form."""
    parser.add_argument("--json", action="store_true", help="JSON in place of YAML")


def run(arguments: argparse.Namespace) -> int:
    """Print it; nothing is started and no database is opened."""
    document = create_app(Settings()).openapi()
    sys.stdout.write(json.dumps(document, indent=2) + "\n" if arguments.json else to_yaml(document))
    return 0
