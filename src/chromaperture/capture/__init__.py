"""From photons to linear arrays: files, raw images, video, cameras."""
