"""A simulated camera: scenes, rays, noise, calibration sessions."""
