"""Stages as WGSL compute shaders, under the names of ``stages/``; one chain of them a method, see ``device.py``."""
