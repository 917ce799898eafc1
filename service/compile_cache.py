"""Where compiled code of the core is kept: a folder for each state of its sources.

numba looks at a function's own file alone, so a constant changed elsewhere, by an edit or an update, would
go on living in what was compiled before.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from pathlib import Path
from typing import Final

VARIABLE: Final = "NUMBA_CACHE_DIR"
_PREFIX: Final = "numba-"


def choose(core: Path | None = None) -> None:
    """Point numba, which is not imported yet, to the folder of the sources as they are; drop the others.

    Leaves the choice to numba where the environment has made it, or where the folder cannot be written.
    """
    if VARIABLE in os.environ:
        return
    core = Path(__file__).parent.parent / "core" if core is None else core
    digest = hashlib.sha256()
    for source in sorted(core.rglob("*.py")):
        digest.update(source.relative_to(core).as_posix().encode() + b"\0" + source.read_bytes() + b"\0")
    home = core / "__pycache__"
    mine = home / f"{_PREFIX}{digest.hexdigest()[:16]}"
    try:
        mine.mkdir(parents=True, exist_ok=True)
    except OSError:
        return
    for other in home.glob(f"{_PREFIX}*"):
        if other != mine:
            shutil.rmtree(other, ignore_errors=True)
    os.environ[VARIABLE] = str(mine)
