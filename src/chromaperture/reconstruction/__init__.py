"""Track a moving camera and fuse its views to a mesh, on Open3D (extra ``reconstruct``)."""
