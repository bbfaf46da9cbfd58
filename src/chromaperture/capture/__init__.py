"""Sources of frames: files, cameras, recordings, and the simulator."""
