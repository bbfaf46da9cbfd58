"""Numbers of frames: each that was sent is accounted for, also where they begin again."""

from hypothesis import given
from hypothesis import strategies as st

from chromaperture.capture.aravis import FrameNumbers

FATES = st.lists(st.sampled_from(["whole", "incomplete", "unnumbered", "lost"]), min_size=1, max_size=200)


@given(FATES, st.integers(1, 70_000), st.booleans())
def test_numbers_account_for_every_frame(fates, first, long_numbers):
    fates = ["whole", *fates, "whole"]
    first = first if long_numbers else 1 + (first - 1) % 65535
    numbers, lost = FrameNumbers(), 0
    for i, fate in enumerate(fates):
        number = first + i if long_numbers else 1 + (first + i - 1) % 65535
        if fate != "lost":
            lost += numbers.lost_before(0 if fate == "unnumbered" else number, whole=fate == "whole")
    assert lost == fates.count("lost")


@given(st.integers(2000, 55_000), st.integers(1, 1000))  # from 55 536 on, it might be the end of 16 bits
def test_a_camera_that_counts_anew_has_lost_nothing(last, first):
    numbers = FrameNumbers()
    numbers.lost_before(last, whole=True)
    assert numbers.lost_before(first, whole=True) == 0
    assert numbers.lost_before(first + 1, whole=True) == 0
