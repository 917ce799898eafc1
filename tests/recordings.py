"""The evaluation recordings beside the checkout, which not every machine has."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import pytest

SHARED: Final = Path(__file__).resolve().parents[2] / "shared"


def recording(*parts: str) -> Path:
    """A file or folder under ``../shared``; the test that asks for one that is missing is skipped, visibly."""
    path = SHARED.joinpath(*parts)
    if not path.exists():
        # They may not be copied into the project: their licences allow evaluation only.
        pytest.skip(f"{'/'.join(parts)} is not in ../shared")
    return path
