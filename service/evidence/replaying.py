"""A bundle's packets folded again from the state that it holds: they must give its tables, to the bit."""

from __future__ import annotations

import numpy as np

from core.errors import SnapshotError
from schemas.calibration import Calibration
from schemas.packet import measurements_from_packet
from schemas.vehicles import VehicleConfig
from service.evidence.bundle import CHECKPOINT, Bundle, BundleError
from service.evidence.tape import Tape
from service.ingest.journal_rows import JournalEntry
from service.storage.calibrations import GivenCalibration


def check_replay(bundle: Bundle) -> None:
    """Raise BundleError that names the first table which its packets do not give again."""
    manifest = bundle.manifest
    low_ns, high_ns = manifest["covered"]["asked_ns"]
    tape = Tape(int(manifest["accident"]["t_ns"]), low_ns, high_ns)
    calibrations = [
        GivenCalibration(
            one["version"],
            one["valid_from_ns"],
            one["journal_id"],
            Calibration.model_validate(one["calibration"]),
        )
        for one in manifest["calibrations"]
    ]
    try:
        settings = VehicleConfig.model_validate(manifest["settings"])
        session = tape.open(settings, calibrations, bundle.members[CHECKPOINT])
    except (SnapshotError, KeyError, ValueError) as error:  # its state or settings are of another version's form
        raise BundleError(f"it cannot be replayed by this version: {error}") from error
    for number, packet in enumerate(bundle.packets()):
        outputs = session.step(measurements_from_packet(packet))
        tape.add(outputs, JournalEntry(number, 0, packet.boot_id, packet.sequence, packet.start_time_ns, 0, b""))
    for name, table in tape.tables().items():
        if not np.array_equal(table.view(np.uint8), bundle.table(name).view(np.uint8)):
            made = ", ".join(f"{one} {manifest['versions'][one]}" for one in ("telefuse", "numpy", "numba", "machine"))
            raise BundleError(f"its packets give another table of {name} than it holds, which was made by {made}")
