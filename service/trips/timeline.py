"""A trip's risk second by second, as bytes: some two kilobytes an hour of driving.

The bytes are ``MAGIC`` and a zlib stream (RFC 1950) of: the length of the header (uint32), the header (JSON, UTF-8),
and the columns that it names, each n values, one after the other. All numbers are little-endian. The header says ``n``,
``start_ns`` and ``every_ns`` (the k-th value is of ``start_ns`` + k ``every_ns``), ``entities``, ``coverage``, and of
``columns`` the name, the type (``u1``, ``u2``, as NumPy names them) and the ``unit`` in which it is counted. The
highest value of a type stands for not known, the one below it of ``limit_kmh`` for a road without a limit.

Columns are ``speed_mps``, ``limit_kmh``, ``limit_certainty`` (0 unknown, 1 assumed, 2 tagged), ``conflict``, of
``fused`` and each entity the mass of each proposition but the empty set, such as ``fused.MR|HR``, and of each source
``coverage.`` with its name.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from core.measurements import FloatArray, TimeArray
from core.risk.assessment import Assessment
from core.risk.belief import N_SETS, PROPOSITIONS
from service.risk.instants import EVERY_NS
from service.roads.protocol import MatchedPoints

MAGIC: Final = b"TFT1"
FUSED: Final = "fused"
_UNITS: Final = {"speed_mps": 0.1, "limit_kmh": 1.0, "limit_certainty": 1.0, "mass": 1e-4, "coverage": 0.005}
_NOT_KNOWN: Final = {"u1": 255, "u2": 65535}
_UNLIMITED: Final = 65534


@dataclass(frozen=True, slots=True, eq=False)
class Timeline:
    """n seconds of a trip.

    Parameters
    ----------
    t_ns : (n,)
    speed_mps : (n,) NaN where not known
    limit_kmh : (n,) NaN where not known, infinite where there is none
    limit_certainty : (n,) of ``service.roads.protocol.Certainty``
    conflict : (n,) that was redistributed between the entities
    mass : (n, 8) of ``fused`` and of each entity
    coverage : (n,) of each source
    """

    t_ns: TimeArray
    speed_mps: FloatArray
    limit_kmh: FloatArray
    limit_certainty: npt.NDArray[np.int64]
    conflict: FloatArray
    mass: Mapping[str, FloatArray]
    coverage: Mapping[str, FloatArray]

    @classmethod
    def of(cls, t_ns: TimeArray, speed_mps: FloatArray, roads: MatchedPoints, assessment: Assessment) -> Timeline:
        """What was found of a trip's seconds."""
        return cls(
            t_ns=t_ns,
            speed_mps=speed_mps,
            limit_kmh=roads.limit_kmh,
            limit_certainty=roads.limit_certainty,
            conflict=assessment.conflict,
            mass={FUSED: assessment.fused, **assessment.entities},
            coverage=assessment.coverage,
        )

    def packed(self) -> bytes:
        """As bytes."""
        columns, told = [], []
        for name, kind, unit, values in self._columns():
            highest = _NOT_KNOWN[kind]
            counted = np.clip(np.rint(values / unit), 0, highest - 1)
            counted = np.where(np.isnan(values), highest, np.where(np.isposinf(values), _UNLIMITED, counted))
            columns.append(counted.astype(f"<{kind}").tobytes())
            told.append({"name": name, "type": kind, "unit": unit})
        header = {
            "n": len(self.t_ns),
            "start_ns": int(self.t_ns[0]) if len(self.t_ns) else 0,
            "every_ns": EVERY_NS,
            "entities": [name for name in self.mass if name != FUSED],
            "coverage": list(self.coverage),
            "columns": told,
        }
        head = json.dumps(header, separators=(",", ":")).encode()
        return MAGIC + zlib.compress(b"".join([len(head).to_bytes(4, "little"), head, *columns]), 9)

    @classmethod
    def unpacked(cls, data: bytes) -> Timeline:
        """What ``packed`` made; raises ValueError for anything else."""
        if data[: len(MAGIC)] != MAGIC:
            raise ValueError("no timeline of a trip: expected bytes that begin with TFT1")
        content = zlib.decompress(data[len(MAGIC) :])
        length = int.from_bytes(content[:4], "little")
        header: dict[str, Any] = json.loads(content[4 : 4 + length])
        n, at = header["n"], 4 + length
        found: dict[str, FloatArray] = {}
        for column in header["columns"]:
            kind = np.dtype(f"<{column['type']}")
            counted = np.frombuffer(content, kind, n, at).astype(np.float64)
            at += n * kind.itemsize
            known = np.where(counted == _NOT_KNOWN[column["type"]], np.nan, counted * column["unit"])
            found[column["name"]] = known
        limit = found["limit_kmh"]
        masses = {}
        for name in (FUSED, *header["entities"]):
            masses[name] = np.zeros((n, N_SETS))
            for bits, proposition in _PROPOSITIONS.items():
                masses[name][:, bits] = found[f"{name}.{proposition}"]
        return cls(
            t_ns=header["start_ns"] + header["every_ns"] * np.arange(n, dtype=np.int64),
            speed_mps=found["speed_mps"],
            limit_kmh=np.where(limit == _UNLIMITED, np.inf, limit),
            limit_certainty=found["limit_certainty"].astype(np.int64),
            conflict=found["conflict"],
            mass=masses,
            coverage={name: found[f"coverage.{name}"] for name in header["coverage"]},
        )

    def _columns(self) -> Iterator[tuple[str, str, float, FloatArray]]:
        yield "speed_mps", "u2", _UNITS["speed_mps"], self.speed_mps
        yield "limit_kmh", "u2", _UNITS["limit_kmh"], self.limit_kmh
        yield "limit_certainty", "u1", _UNITS["limit_certainty"], self.limit_certainty.astype(np.float64)
        yield "conflict", "u2", _UNITS["mass"], self.conflict
        for name, mass in self.mass.items():
            for bits, proposition in _PROPOSITIONS.items():
                yield f"{name}.{proposition}", "u2", _UNITS["mass"], mass[:, bits]
        for name, share in self.coverage.items():
            yield f"coverage.{name}", "u1", _UNITS["coverage"], share


_PROPOSITIONS: Final = {bits: proposition for bits, proposition in enumerate(PROPOSITIONS) if bits}
