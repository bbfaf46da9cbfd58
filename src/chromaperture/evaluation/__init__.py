"""What is found out about a camera: the calibration report, the health check."""
