"""Stages as WGSL compute shaders, under the names of ``readable/``; one chain of them a method, see ``device.py``."""
