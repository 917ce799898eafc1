"""``telefuse db``: the database's schema."""

from __future__ import annotations

import argparse
import re

from sqlalchemy.exc import SQLAlchemyError

from service import settings
from service.cli import OneLineParser
from service.errors import DatabaseError, UsageError
from service.storage import schema
from service.storage.database import open_database, read


def configure(parser: argparse.ArgumentParser) -> None:
    """upgrade, downgrade or current."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True, parser_class=OneLineParser)
    texts = {
        "upgrade": "bring the schema to this version of telefuse; serve does it by itself",
        "downgrade": "take the schema back; what newer revisions had added is lost",
        "current": "show the schema's revision",
    }
    for name, text in texts.items():
        action = actions.add_parser(name, help=text, description=text)
        settings.add_arguments(action, ["database_url", "data_dir"])
        if name == "downgrade":
            action.add_argument("revision", help="the revision to go back to, or base for an empty database")


def run(arguments: argparse.Namespace) -> int:
    """Do it, and print the revisions before and after."""
    engine = open_database(settings.from_arguments(arguments).settings.database_url)
    try:
        if arguments.action == "current":
            with read(engine) as connection:
                print(f"{schema.current(connection) or 'empty'} (this version works with {schema.newest()})")
            return 0
        if arguments.action == "upgrade":
            before, after = schema.upgrade(engine)
        else:
            if re.fullmatch(r"base|[0-9a-f]{1,32}", arguments.revision) is None:
                raise UsageError(f"revision '{arguments.revision}': expected base or a revision such as 0001")
            before, after = schema.downgrade(engine, arguments.revision)
    except SQLAlchemyError as error:
        raise DatabaseError(f"the database cannot be used: {error}") from error
    finally:
        engine.dispose()
    print(f"{before or 'empty'} -> {after or 'empty'}" if before != after else f"{after or 'empty'}: nothing to do")
    return 0
