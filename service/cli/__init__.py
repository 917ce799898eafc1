"""The ``telefuse`` command: a module a command, imported only when it is the one asked for."""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Sequence
from typing import Final, NoReturn

COMMANDS: Final = {
    "demo": "the main job end to end on this machine, with a simulated or a recorded drive",
    "serve": "run the service",
    "simulate": "write a simulated drive folder with truth",
    "fuse": "post-process a drive folder into a trajectory",
    "calibrate": "calibrate a box's sensors from a recording of still positions",
    "noise": "measure a box's noise from a recording at rest: Allan deviation and fits",
    "evidence": "verify what was kept of an accident",
    "detect": "find accidents in a drive folder",
    "risk": "combine masses of belief, or assess the risk of a drive",
    "scores": "score a record, and show the model and the tariff that scores and premiums go by",
    "roads": "prepare an OpenStreetMap extract, and find the roads under a drive",
    "replay": "play a drive folder into a running service as a black box would",
    "bench": "measure throughput, latency and the filter's speed on this machine",
    "openapi": "print the OpenAPI document of the HTTP interface",
    "db": "upgrade the database's schema",
    "keys": "create, list and revoke API keys",
    "vehicles": "import vehicles from a CSV file",
}
"""Command names with their one-line help; each is a module ``service.cli.<name>`` with
``configure(parser)`` and ``run(arguments) -> int``."""

EXIT_BAD_INPUT: Final = 2


class OneLineParser(argparse.ArgumentParser):
    """A parser whose errors are one line on stderr, so that scripts can show them."""

    def error(self, message: str) -> NoReturn:
        sys.stderr.write(f"{self.prog}: {message} (see {self.prog} --help)\n")
        raise SystemExit(EXIT_BAD_INPUT)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit status (0 success, 2 bad usage or input)."""
    from core.errors import CoreError
    from service.errors import ServiceError

    words = list(sys.argv[1:] if arguments is None else arguments)
    parser = OneLineParser(prog="telefuse", description="Streaming telematics for black boxes, insurers and drivers.")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True, parser_class=OneLineParser)
    asked = words[0] if words else ""
    for name, text in COMMANDS.items():
        command = commands.add_parser(name, help=text, description=text)
        if name == asked:
            module = importlib.import_module(f"service.cli.{name}")
            module.configure(command)
            command.set_defaults(run=module.run)
    parsed = parser.parse_args(words)
    try:
        return int(parsed.run(parsed))
    except (ServiceError, CoreError) as error:
        sys.stderr.write(f"telefuse {parsed.command}: {' '.join(str(error).split())}\n")
        return EXIT_BAD_INPUT
    except BrokenPipeError:
        return 0
    except KeyboardInterrupt:
        return 130
