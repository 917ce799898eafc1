"""``telefuse keys``: create, list and revoke API keys."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Final

from sqlalchemy import Engine
from sqlalchemy.exc import SQLAlchemyError

from schemas.keys import MAX_TENANT_ID, NAME_RULE, is_name
from schemas.notifications import rfc3339
from service import settings
from service.api.security import SCOPES
from service.cli import OneLineParser
from service.errors import DatabaseError, UsageError
from service.storage import keys, schema, tenants
from service.storage.database import open_database, read, write
from service.storage.keys import ApiKey
from service.storage.tenants import DEFAULT_TENANT

DAY_NS: Final = 86_400 * 1_000_000_000

WILDCARDS: Final = ("vehicles:*", "accidents:*", "webhooks:*")


def configure(parser: argparse.ArgumentParser) -> None:
    """create, revoke or list."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True, parser_class=OneLineParser)
    create = actions.add_parser("create", help="make a key and print it, this once")
    create.add_argument("--tenant", default=DEFAULT_TENANT, help=f"whose it is, made if new (default {DEFAULT_TENANT})")
    create.add_argument("--name", required=True, help="what it is for, so that it can be told apart later")
    create.add_argument(
        "--scope", action="append", required=True, metavar="SCOPE", help=f"again for each: {', '.join(all_scopes())}"
    )
    create.add_argument(
        "--expires-days", type=int, metavar="N", help="days after which it opens nothing (default never)"
    )
    revoke = actions.add_parser("revoke", help="close a key for good")
    revoke.add_argument("key_id", help="as list shows it")
    listing = actions.add_parser("list", help="show keys, never their secrets")
    listing.add_argument("--tenant", help="of this tenant only")
    for action in (create, revoke, listing):
        action.add_argument("--json", action="store_true", help="print JSON")
        settings.add_arguments(action, ["database_url", "data_dir"])


def run(arguments: argparse.Namespace) -> int:
    """Do it."""
    with database(settings.from_arguments(arguments).settings.database_url) as engine:
        if arguments.action == "create":
            _create(engine, arguments)
        elif arguments.action == "revoke":
            _revoke(engine, arguments)
        else:
            _list(engine, arguments)
    return 0


@contextmanager
def database(url: str) -> Iterator[Engine]:
    """The database with its schema up to date; DatabaseError where it cannot be used."""
    engine = open_database(url)
    try:
        schema.upgrade(engine)
        yield engine
    except SQLAlchemyError as error:
        raise DatabaseError(f"the database cannot be used: {error}") from error
    finally:
        engine.dispose()


def all_scopes() -> Sequence[str]:
    """What a key can be given."""
    return (*SCOPES, *WILDCARDS)


def _create(engine: Engine, arguments: argparse.Namespace) -> None:
    if not is_name(arguments.tenant, MAX_TENANT_ID):
        raise UsageError(f"--tenant '{arguments.tenant}': expected {NAME_RULE}, at most {MAX_TENANT_ID} characters")
    for scope in arguments.scope:
        if scope not in all_scopes():
            raise UsageError(f"--scope '{scope}': expected one of {', '.join(all_scopes())}")
    if arguments.expires_days is not None and not 1 <= arguments.expires_days <= 36_500:
        raise UsageError(f"--expires-days {arguments.expires_days}: expected 1 to 36500")
    if not 1 <= len(arguments.name) <= 200:
        raise UsageError("--name: expected 1 to 200 characters")
    expires_ns = None if arguments.expires_days is None else time.time_ns() + arguments.expires_days * DAY_NS
    with write(engine) as connection:
        tenants.ensure(connection, arguments.tenant)
        key, token = keys.create(connection, arguments.tenant, arguments.name, arguments.scope, expires_ns)
    if arguments.json:
        print(json.dumps({**_shown(key), "key": token}))
        return
    print(token)
    sys.stderr.write(f"key {key.id} of tenant {key.tenant_id}; it is shown this once and stored as a hash only\n")


def _revoke(engine: Engine, arguments: argparse.Namespace) -> None:
    with write(engine) as connection:
        found = keys.revoke(connection, arguments.key_id)
    if not found:
        raise UsageError(f"there is no key '{arguments.key_id}'; telefuse keys list shows those there are")
    print(json.dumps({"id": arguments.key_id}) if arguments.json else f"key {arguments.key_id} is revoked")


def _list(engine: Engine, arguments: argparse.Namespace) -> None:
    with read(engine) as connection:
        found = [_shown(key) for key in keys.of_tenant(connection, arguments.tenant)]
    if arguments.json:
        print(json.dumps(found))
        return
    now_ns = time.time_ns()
    for key in found:
        print(
            f"{key['id']}  {key['tenant']}  {_status(key, now_ns)}  {','.join(key['scopes'])}  {key['name']}",
        )


def _shown(key: ApiKey) -> dict[str, Any]:
    return {
        "id": key.id,
        "tenant": key.tenant_id,
        "name": key.name,
        "scopes": sorted(key.scopes),
        "created_at": rfc3339(key.created_ns),
        "expires_at": None if key.expires_ns is None else rfc3339(key.expires_ns),
        "revoked_at": None if key.revoked_ns is None else rfc3339(key.revoked_ns),
    }


def _status(key: dict[str, Any], now_ns: int) -> str:
    if key["revoked_at"] is not None:
        return f"revoked {key['revoked_at']}"
    if key["expires_at"] is None:
        return "valid"
    return f"{'valid until' if rfc3339(now_ns) < key['expires_at'] else 'expired'} {key['expires_at']}"
