"""What a box's place in the car does, finely in time, and what a perfect sensor there would feel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from core.earth import STANDARD_GRAVITY_MPS2
from core.measurements import FloatArray
from core.simulation.ride import FINE_HZ
from core.simulation.trajectory import matrices_b_from_n, rotate


@dataclass(frozen=True, slots=True, eq=False)
class BodyMotion:
    """A stretch of motion of the box's place, ``FINE_HZ`` times a second.

    Parameters
    ----------
    accel_n : (n, 3) acceleration in level axes that do not turn (x along the heading at first, y right, z down), m/s2
    shake_b : (n, 3) further acceleration in the box's axes, m/s2
    rpy_rad : (n, 3) roll, pitch, yaw of the box
    v_n : (n, 2) horizontal velocity in the level axes, m/s
    """

    accel_n: FloatArray
    shake_b: FloatArray
    rpy_rad: FloatArray
    v_n: FloatArray

    def felt(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Specific force (m/s2), angular rate (rad/s) and the unit vector down, (n, 3) each in the box's axes."""
        C_b_from_n = matrices_b_from_n(self.rpy_rad)
        down_b = C_b_from_n[:, :, 2].copy()
        f_b = rotate(C_b_from_n, self.accel_n) + self.shake_b - STANDARD_GRAVITY_MPS2 * down_b
        return f_b, rate_b(self.rpy_rad), down_b

    @property
    def speed_mps(self) -> FloatArray:
        """Horizontal speed, (n,)."""
        return np.hypot(self.v_n[:, 0], self.v_n[:, 1])


def rate_b(rpy_rad: FloatArray) -> FloatArray:
    """Angular rate (n, 3), rad/s, of a body whose roll, pitch and yaw are (n, 3) at ``FINE_HZ``."""
    roll, pitch = rpy_rad[:, 0], rpy_rad[:, 1]
    roll_d, pitch_d, yaw_d = (np.gradient(angle) * FINE_HZ for angle in rpy_rad.T)
    return np.column_stack(
        [
            roll_d - yaw_d * np.sin(pitch),
            pitch_d * np.cos(roll) + yaw_d * np.sin(roll) * np.cos(pitch),
            -pitch_d * np.sin(roll) + yaw_d * np.cos(roll) * np.cos(pitch),
        ]
    )


def resonator(signal: FloatArray, centre_hz: float, damping: float) -> FloatArray:
    """What a damped structure adds to what drives it, along axis 0: nothing at 0 Hz, most about its own frequency."""
    w = 2.0 * np.pi * centre_hz / FINE_HZ
    radius = np.exp(-damping * w)
    a = [1.0, -2.0 * radius * np.cos(w * np.sqrt(1.0 - damping**2)), radius**2]
    gain = 0.5 * (1.0 - radius**2)  # about one at the centre
    return np.asarray(lfilter([gain, 0.0, -gain], a, signal, axis=0))


def band_noise(n: int, centre_hz: float, damping: float, rng: np.random.Generator, columns: int = 3) -> FloatArray:
    """Noise of unit sd about a frequency, (n, columns), already under way at the first row."""
    settling = int(4.0 * FINE_HZ / (2.0 * np.pi * centre_hz * damping)) + 1
    noise = resonator(rng.standard_normal((n + settling, columns)), centre_hz, damping)[settling:]
    w = 2.0 * np.pi * centre_hz / FINE_HZ
    radius = np.exp(-damping * w)
    cos = np.cos(w * np.sqrt(1.0 - damping**2))
    # Variance of b (1 - z^-2) / (1 + a1 z^-1 + a2 z^-2) driven by unit white noise.
    a1, a2, b = -2.0 * radius * cos, radius**2, 0.5 * (1.0 - radius**2)
    r0 = (1.0 + a2) / ((1.0 - a2) * ((1.0 + a2) ** 2 - a1**2))
    r1 = -a1 / (1.0 + a2) * r0
    r2 = -a1 * r1 - a2 * r0
    return np.asarray(noise / (b * np.sqrt(2.0 * (r0 - r2))))
