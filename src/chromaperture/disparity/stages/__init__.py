"""Every stage in readable NumPy: what it computes. ``cpu/`` has the same names compiled; see ``execution.py``."""

from chromaperture.disparity.stages.band_correlation import band_correlation, band_powers
from chromaperture.disparity.stages.bilateral import bilateral_winner
from chromaperture.disparity.stages.correlation import correlate, texture_weights
from chromaperture.disparity.stages.cross_filter import cross_filter
from chromaperture.disparity.stages.enlarge import enlarge
from chromaperture.disparity.stages.four_paths import four_path_winner
from chromaperture.disparity.stages.joining import join_regions
from chromaperture.disparity.stages.paths import aggregate_paths, posterior, read_at_labels
from chromaperture.disparity.stages.place import halved_surface, place_by_correlation
from chromaperture.disparity.stages.planes import agreed_plane, plane_costs
from chromaperture.disparity.stages.smoothing import smooth_along_surface
from chromaperture.disparity.stages.spectral_likelihood import spectral_likelihood
from chromaperture.disparity.stages.upsample import upsample
from chromaperture.disparity.stages.variation import gap_per_px as variation_gap
from chromaperture.disparity.stages.variation import iterate as iterate_variation
from chromaperture.optics.lens_blur import point_transforms

__all__ = [
    "aggregate_paths",
    "agreed_plane",
    "band_correlation",
    "band_powers",
    "bilateral_winner",
    "correlate",
    "cross_filter",
    "enlarge",
    "four_path_winner",
    "halved_surface",
    "iterate_variation",
    "join_regions",
    "place_by_correlation",
    "plane_costs",
    "point_transforms",
    "posterior",
    "read_at_labels",
    "smooth_along_surface",
    "spectral_likelihood",
    "texture_weights",
    "upsample",
    "variation_gap",
]
