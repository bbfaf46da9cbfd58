"""From a moving camera to a mesh: tracking and fusion on Open3D (extra ``reconstruct``)."""
