"""Numbers of frames: each that was sent is accounted for, also where they begin again."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from chromaperture.capture.device_clock import FrameNumbers

FATES = st.lists(st.sampled_from(["whole", "incomplete", "unnumbered", "lost"]), min_size=1, max_size=200)


@given(FATES, st.integers(1, 70_000), st.booleans())
def test_numbers_account_for_every_frame(fates, first, long_numbers):
    fates = ["whole", *fates, "whole"]
    first = first if long_numbers else 1 + (first - 1) % 65535
    numbers, lost = FrameNumbers(), 0
    for i, fate in enumerate(fates):
        number = first + i if long_numbers else 1 + (first + i - 1) % 65535
        if fate != "lost":
            lost += numbers.missing(0 if fate == "unnumbered" else number, whole=fate == "whole")
    assert lost == fates.count("lost")


@given(st.lists(st.integers(1, 65000), min_size=1, max_size=30), st.integers(0, 2**40))
def test_numbers_tell_what_is_missing(steps, first):
    numbers = FrameNumbers()
    assert numbers.missing(first) == 0
    for number, step in zip(first + np.cumsum(steps), steps, strict=True):
        assert numbers.missing(int(number)) == step - 1


@given(st.lists(st.integers(1, 10_000), min_size=1, max_size=30))
def test_numbers_of_16_bits_go_round_without_0(steps):
    numbers, sent = FrameNumbers(), 65000
    numbers.missing(sent)
    for step in steps:
        sent += step
        assert numbers.missing((sent - 1) % 65535 + 1) == step - 1


# From 55 536 on, it might be the end of 16 bits.
@given(st.one_of(st.integers(900, 55_000), st.integers(65_536, 2**40)), st.integers(0, 900))
def test_a_camera_that_counts_anew_has_lost_nothing(last, first):
    numbers = FrameNumbers()
    numbers.missing(last)
    assert numbers.missing(first) == 0
    assert numbers.missing(first + 3) == 2
