"""The extra ``roads``: Valhalla, osmium and shapely, without which everything else runs."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Final

from service.errors import UsageError

_PACKAGES: Final = ("valhalla", "osmium", "shapely")


def installed() -> bool:
    """Whether roads can be built and matched here."""
    return all(find_spec(name) is not None for name in _PACKAGES)


def require() -> None:
    """Raise UsageError that says how to get the extra, if it is missing."""
    if missing := [name for name in _PACKAGES if find_spec(name) is None]:
        raise UsageError(
            f"roads need {', '.join(missing)}, not installed here; make setup installs the extra 'roads' where its "
            "packages exist for the machine, and without it roads are unknown"
        )
