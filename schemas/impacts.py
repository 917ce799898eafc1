"""What was felt of an accident: the same figures in what is read and in what is pushed."""

from __future__ import annotations

from pydantic import BaseModel, Field

NullableFigure = float | None


class Injury(BaseModel):
    """Risk of an injury of MAIS 3 or worse to a front occupant."""

    probability: float = Field(ge=0, le=1)
    low: float = Field(ge=0, le=1, description="Of the 95 % interval.")
    high: float = Field(ge=0, le=1)
    source: str


class SingleImpact(BaseModel):
    """One of an accident's impacts: figures as of the worst, forward and right as the vehicle headed as it began."""

    after_s: float = Field(description="Since the accident's time.")
    duration_s: float
    delta_v_mps: float
    delta_v_interval_mps: tuple[NullableFigure, NullableFigure]
    delta_v_b_mps: tuple[NullableFigure, NullableFigure]
    pdof_deg: float | None
    pdof_sd_deg: float | None
    peak_mps2: float
    clipped: bool


class ImpactFigures(BaseModel):
    """What was felt of an accident."""

    detector: str
    delta_v_mps: float = Field(description="Change of the horizontal velocity by the worst impact.")
    delta_v_sd_mps: float | None
    delta_v_interval_mps: tuple[NullableFigure, NullableFigure] = Field(
        description="95 % interval; wide where the pulse clipped, null where nothing bounds it or it is not known yet."
    )
    delta_v_b_mps: tuple[NullableFigure, NullableFigure] = Field(description="Its forward and right part.")
    pdof_deg: float | None = Field(
        description="Where the force came from, clockwise seen from above; 0 is the front. Null while unknown."
    )
    pdof_sd_deg: float | None = Field(
        description="Its spread, in the end also by which of several impacts may as well have been the worst."
    )
    peak_mps2: float
    duration_s: float
    clipped: bool = Field(description="The accelerometer read its full scale, so the peak is a lower bound.")
    speed_before_mps: float | None
    impacts: int = Field(description="How many impacts belong to it so far.")
    each_impact: list[SingleImpact] = Field(
        description="Of each impact its own figures, in their order; empty where they are not known."
    )
    rollover: bool
    injury: Injury | None = Field(description="Null where the model says nothing of this direction or class.")
    reasons: list[str] = Field(description="What speaks for and against an accident.")
    paper_agrees: bool = Field(description="Whether the published fixed-threshold rule finds this accident too.")
