"""Defaults of the likelihood of all channels (quality "accurate", cameras whose blur is known); see `stage_config`."""

from __future__ import annotations

from dataclasses import dataclass

from chromaperture.stage_config import all_finite, require

# Of px of half disparity for a px of the pupil edge's displacement, with the samples' real film: the open aperture has
# .09, circles .20, halves .33, three squares .42 (with film that leaks nothing .13, .27, .42, .50). What this evidence
# gains for each is in docs/decisions.md, *All channels at once*.
LEAST_REACH_OF_PAIRS = 0.15
LEAST_REACH_OF_PAIRS_ALONE = 0.37


@dataclass(frozen=True)
class SpectralConfig:
    """Evidence of all channels together: ``disparity/spectral_evidence.py``; docs/decisions.md has what each gains.

    Attributes
    ----------
    gain : float
        Factor on the log-likelihood beside that of the pairs of channels; 0 switches this evidence off.
    cap_nats : float
        The most that it earns a pixel: windows that see a depth edge, or a texture that is not Gaussian, can be wrong.
    taper_px : float
        Sigma of the windows' Gaussian taper.
    stride_px : int
        Distance of two windows.
    slopes : tuple of float
        Slopes of the texture's power spectrum f^(-2 slope) that are tried; the last one is that of shading, which has
        no detail that blur could take.
    channel_error : float
        Fraction of a channel's power that is its own: error of the calibrated blur, and limit of the correlation of
        colours.
    rounds : int
        Of expectation and maximisation for the covariance of the colours, at each layer, from that of the layer before.
    dual_pixel : bool
        Red and blue are the halves of a dual-pixel sensor and green is their mean: noise is partly shared
        (``disparity/half_pixel_likelihood.py``). On the CPU alone.
    """

    gain: float = 3.0
    cap_nats: float = 0.5
    taper_px: float = 8.0
    stride_px: int = 10
    slopes: tuple[float, ...] = (0.75, 1.0, 1.3, 1.7, 3.0)
    channel_error: float = 0.002
    rounds: int = 2
    dual_pixel: bool = False

    def __post_init__(self) -> None:
        numbers = (self.gain, self.cap_nats, self.taper_px, self.channel_error, *self.slopes)
        positive = all_finite(*numbers) and self.gain >= 0 and min(numbers[1:]) > 0
        require(positive and bool(self.slopes), "the numbers of the spectral evidence must be positive, gain >= 0")
        require(min(self.stride_px, self.rounds) >= 1, "stride_px and rounds must be >= 1")

    @classmethod
    def for_blur(cls, reach: float) -> SpectralConfig:
        """Return the settings for a lens; ``reach`` is px of half disparity for a px of the pupil edge's displacement.

        Where views lie close together blur tells more than parallax. Where they lie far apart the pairs alone are
        exact, and their small windows know edges. In between a weak dose finds walls that hardly have texture.
        """
        if reach < LEAST_REACH_OF_PAIRS:
            return cls()
        return cls(gain=1.0, cap_nats=0.15) if reach < LEAST_REACH_OF_PAIRS_ALONE else cls(gain=0.0)
