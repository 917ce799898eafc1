"""The command line as a caller sees it: exit status, what it prints, and its figures."""

from __future__ import annotations

import json

from service.cli import main


def call(capsys, *words):
    """Exit status, stdout and stderr of one command."""
    try:
        status = main([str(word) for word in words])
    except SystemExit as end:
        status = int(end.code or 0)
    said = capsys.readouterr()
    return status, said.out, said.err


def figures(capsys, *words):
    """The figures of one ``telefuse fuse`` that goes well."""
    status, out, err = call(capsys, "fuse", *words, "--json")
    assert (status, err) == (0, "")
    return json.loads(out)
