"""``telefuse fuse --denoise``: the switch, the denoised drive, and its figures beside those without."""

from __future__ import annotations

from typing import Any

from service.cli.progress import Progress
from service.recordings.denoising import Denoised, denoise
from service.recordings.drive_folder import Drive


def denoise_with_progress(drive: Drive) -> Denoised:
    """Denoise, with a bar on a terminal."""
    with Progress("denoising", 100) as progress:
        return denoise(drive, lambda share: progress.update(int(100 * share)))


def denoise_lines(found: dict[str, Any]) -> list[str]:
    """What ``fuse`` says of the denoising in its figures, if it was asked to."""
    facts: dict[str, Any] | None = found.get("denoise")
    if facts is None:
        return []
    low_hz, high_hz = facts["band_hz"]
    lines = [
        f"denoised with {facts['wavelet']} on {facts['levels']} levels;"
        f" a stream would be {facts['latency_s']:.2f} s late",
        f"  sd from {low_hz:.1f} to {high_hz:.1f} Hz, before and after:",
    ]
    for column, before in facts["sd_before"].items():
        axis, unit = column.split("_")
        removed_db = facts["noise_reduction_db"][axis]
        lines.append(
            f"    {axis} {before:9.5f} {facts['sd_after'][column]:9.5f} {unit.replace('ps', '/s')}"
            + ("" if removed_db is None else f"  {-removed_db:+.1f} dB")
        )
    lines.append("  the same drive with and without denoising:")
    for label, with_it, without in _pairs(found, facts["without"]):
        lines.append(f"    {label}: {with_it:.2f} with, {without:.2f} without")
    return lines


def _pairs(found: dict[str, Any], without: dict[str, Any]) -> list[tuple[str, float, float]]:
    """Label, figure with and figure without, of those that both have."""
    pairs = [
        (label, found[key], without[key])
        for label, key in (
            ("position RMS, m", "position_rms_m"),
            ("against fixes RMS, m", "gnss_rms_m"),
            ("heading RMS, deg", "yaw_rms_deg"),
        )
    ]
    for one, other in zip(found["outages"], without["outages"], strict=True):
        span = f"outage {one['start_s']:g} s + {one['duration_s']:g} s"
        pairs += [(f"{span}, RMS, m", one["rms_m"], other["rms_m"]), (f"{span}, end, m", one["end_m"], other["end_m"])]
    pairs.append(("all outages RMS, m", found["outage_rms_m"], without["outage_rms_m"]))
    return [pair for pair in pairs if pair[1] is not None and pair[2] is not None]
