"""Every stage in readable NumPy: what it computes. ``compiled/`` has the same names compiled; see ``execution.py``."""

from chromaperture.matching.readable.band_correlation import band_correlation, band_powers
from chromaperture.matching.readable.bilateral import bilateral_winner
from chromaperture.matching.readable.correlation import correlate, texture_weights
from chromaperture.matching.readable.cross_filter import cross_filter
from chromaperture.matching.readable.enlarge import enlarge
from chromaperture.matching.readable.four_paths import four_path_winner
from chromaperture.matching.readable.joining import join_regions
from chromaperture.matching.readable.pair_evidence import pair_evidence
from chromaperture.matching.readable.paths import aggregate_paths, posterior, read_at_labels
from chromaperture.matching.readable.place import halved_surface, place_by_correlation
from chromaperture.matching.readable.planes import agreed_plane, plane_costs
from chromaperture.matching.readable.smoothing import smooth_along_surface
from chromaperture.matching.readable.spectral_likelihood import spectral_likelihood
from chromaperture.matching.readable.upsample import upsample
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
    "join_regions",
    "pair_evidence",
    "place_by_correlation",
    "plane_costs",
    "point_transforms",
    "posterior",
    "read_at_labels",
    "smooth_along_surface",
    "spectral_likelihood",
    "texture_weights",
    "upsample",
]
