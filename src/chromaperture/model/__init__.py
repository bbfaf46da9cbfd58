"""The camera file: what a calibration knows of a camera."""
