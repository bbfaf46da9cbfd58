"""Calibration: a session folder of photographs becomes a camera file (paper section 3.4)."""
