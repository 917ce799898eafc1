"""What post-processing keeps of a drive while the filter folds it: nodes for a smoother, and records of the aids."""

from __future__ import annotations

from dataclasses import dataclass, field

from core.measurements import FloatArray, TimeArray
from core.navigation.nodes import NODE_WIDTH
from core.navigation.records import RECORD_COLUMNS, AidRecords
from core.navigation.track import TRACK_COLUMNS, Table, Track, joined_tables


@dataclass(slots=True, eq=False)
class Recorder:
    """Tables that grow by each fold. ``cut`` takes back what is folded anew for an aid that came late.

    ``track`` then holds the rows as they were in the end, not as they were told.
    """

    nodes: list[Table] = field(default_factory=list)
    rows: list[Table] = field(default_factory=list)
    records: list[Table] = field(default_factory=list)
    starts_ns: list[int] = field(default_factory=list)
    """When the filter aligned: nothing after flows back to before."""

    def add(self, nodes: tuple[TimeArray, FloatArray], rows: Track, records: AidRecords) -> None:
        """What one fold brought."""
        parts = (nodes[0].copy(), nodes[1].copy()), (rows.t_ns, rows.values), (records.t_ns, records.values)
        for table, part in zip((self.nodes, self.rows, self.records), parts, strict=True):
            if len(part[0]):
                table.append(part)

    def cut(self, t_ns: int) -> None:
        """Take back what came after ``t_ns``."""
        for table in (self.nodes, self.rows, self.records):
            while table and table[-1][0][0] > t_ns:
                table.pop()
            if table:
                times, values = table[-1]
                kept = times <= t_ns
                table[-1] = times[kept], values[kept]

    def track(self) -> Track:
        """Rows of the whole drive."""
        return Track(*joined_tables(self.rows, len(TRACK_COLUMNS)))

    def aid_records(self) -> AidRecords:
        """Records of the whole drive."""
        return AidRecords(*joined_tables(self.records, len(RECORD_COLUMNS)))

    def node_table(self) -> tuple[TimeArray, FloatArray]:
        """Nodes of the whole drive, (k,) and (k, NODE_WIDTH)."""
        return joined_tables(self.nodes, NODE_WIDTH)
