"""Times of frames by the camera: right whatever its clock does, or said."""

import numpy as np
import pytest

from chromaperture.capture.device_clock import DeviceClock

START_S = 1.8e9  # seconds since 1970


def follow(clock, device_s, arrived_s, ticks_per_s=1e9):
    """Times of frames and what was reported, a frame each."""
    times, reports = [], []
    for device, arrived in zip(device_s, arrived_s, strict=True):
        times.append(clock.time_s(round(device * ticks_per_s), arrived))
        reports.append(clock.report)
    return np.array(times), reports


@pytest.mark.parametrize("ticks_per_s", [1e9, 125e6])  # of USB3 Vision; of many GigE cameras
@pytest.mark.parametrize("drift", [-1e-4, 0.0, 1e-4])
def test_times_are_steady_where_arrivals_are_not(rng, ticks_per_s, drift):
    sent_s = START_S + np.arange(3000) / 20
    delay_s = 0.01 + rng.exponential(0.02, len(sent_s)).clip(max=0.4)
    device_s = 77 + (sent_s - START_S) * (1 + drift)
    times, reports = follow(DeviceClock(ticks_per_s), device_s, sent_s + delay_s, ticks_per_s)
    assert not any(reports)
    error_s = (times - sent_s - 0.01)[20:]
    # The least of 20 exponential delays of 20 ms is 1 ms in the mean, below 10 ms but for exp(-20 / 2); drift of
    # 100 ppm in 10 s is 1 ms.
    assert np.abs(error_s).max() < 0.012
    assert np.all(times <= sent_s + delay_s + 1e-6)  # float64 holds seconds since 1970 to 0.2 µs


@pytest.mark.parametrize("jump_s", [-3600.0, -0.7, 0.7, 3600.0, 5e8])
def test_a_clock_that_jumps_is_reported_and_times_stay_right(jump_s):
    sent_s = START_S + np.arange(400) / 20
    device_s = 5000 + np.arange(400) / 20 + np.where(np.arange(400) >= 200, jump_s, 0.0)
    times, reports = follow(DeviceClock(), device_s, sent_s + 0.01)
    np.testing.assert_allclose(times, sent_s + 0.01, rtol=0, atol=1e-6)
    assert [i for i, report in enumerate(reports) if report] == [200]
    assert f"{abs(jump_s):.3g} s" in reports[200]


def test_a_clock_that_jumps_at_every_frame_is_reported_now_and_then(rng):
    sent_s = START_S + np.arange(600) / 20
    times, reports = follow(DeviceClock(), rng.uniform(10, 1e6, 600), sent_s)
    np.testing.assert_allclose(times, sent_s, rtol=0, atol=0.5)
    assert sum(map(bool, reports)) == 3  # 30 s


def test_the_wrong_rate_is_reported():
    sent_s = START_S + np.arange(200) / 20
    times, reports = follow(DeviceClock(1e9), np.arange(200) / 20, sent_s, ticks_per_s=125e6)
    assert any(reports)
    np.testing.assert_allclose(times, sent_s, rtol=0, atol=0.5)


@pytest.mark.parametrize("ticks", [0, 12345])
def test_without_a_clock_frames_have_the_time_of_their_arrival(ticks):
    clock = DeviceClock()
    clock.time_s(ticks, START_S)
    for i in range(1, 5):
        assert clock.time_s(ticks, START_S + i) == START_S + i
        assert not clock.is_camera_time
        assert not clock.report
