"""Every stage compiled by Numba, under the names of ``readable/``, which explains what each computes."""

from chromaperture.matching.compiled.band_correlation import band_correlation, band_powers
from chromaperture.matching.compiled.bilateral import bilateral_winner
from chromaperture.matching.compiled.correlation import correlate, texture_weights
from chromaperture.matching.compiled.cross_filter import cross_filter
from chromaperture.matching.compiled.enlarge import enlarge
from chromaperture.matching.compiled.four_paths import four_path_winner
from chromaperture.matching.compiled.joining import join_regions
from chromaperture.matching.compiled.pair_evidence import pair_evidence
from chromaperture.matching.compiled.paths import aggregate_paths, posterior, read_at_labels
from chromaperture.matching.compiled.place import halved_surface, place_by_correlation
from chromaperture.matching.compiled.planes import agreed_plane, plane_costs
from chromaperture.matching.compiled.smoothing import smooth_along_surface
from chromaperture.matching.compiled.spectral_likelihood import spectral_likelihood
from chromaperture.matching.compiled.upsample import upsample
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
