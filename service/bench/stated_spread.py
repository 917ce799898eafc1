"""Errors of many simulated units over what is stated of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from core.measurements import FloatArray


def over_stated(ratios: Sequence[FloatArray], names: Sequence[str]) -> dict[str, Any]:
    """Of errors in stated standard deviations, one array of ``names`` a unit: shares beyond three, and their RMS."""
    outside = np.abs(np.array(ratios)) > 3.0
    return {
        "outside_3_sd": dict(zip(names, outside.mean(axis=0).tolist(), strict=True)),
        "outside_3_sd_worst": float(outside.mean(axis=0).max()),
        "outside_3_sd_all": float(outside.mean()),
        "rms_over_sd": dict(zip(names, np.sqrt(np.mean(np.square(ratios), axis=0)).tolist(), strict=True)),
    }
