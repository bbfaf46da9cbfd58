"""Every stage compiled by Numba, under the names of ``stages/``, which explains what each computes."""

from chromaperture.disparity.cpu.band_correlation import band_correlation, band_powers
from chromaperture.disparity.cpu.bilateral import bilateral_winner
from chromaperture.disparity.cpu.correlation import correlate, texture_weights
from chromaperture.disparity.cpu.cross_filter import cross_filter
from chromaperture.disparity.cpu.enlarge import enlarge
from chromaperture.disparity.cpu.four_paths import four_path_winner
from chromaperture.disparity.cpu.joining import join_regions
from chromaperture.disparity.cpu.paths import aggregate_paths, posterior, read_at_labels
from chromaperture.disparity.cpu.place import halved_surface, place_by_correlation
from chromaperture.disparity.cpu.planes import agreed_plane, plane_costs
from chromaperture.disparity.cpu.smoothing import smooth_along_surface
from chromaperture.disparity.cpu.spectral_likelihood import spectral_likelihood
from chromaperture.disparity.cpu.upsample import upsample
from chromaperture.disparity.cpu.variation import iterate_variation, variation_gap
from chromaperture.optics.splat_kernels import point_transforms

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
