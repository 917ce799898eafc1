"""Calibration of inertial triads and magnetometers from recordings, and their noise from long ones at rest."""
