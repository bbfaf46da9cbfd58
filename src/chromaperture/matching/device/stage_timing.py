"""How long the stages of a chain take, by the device's own clock."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from chromaperture.matching.device.device import Chain, DeviceError, Dispatch, device_errors, encode


def stage_times_ms(chain: Chain, inputs: Mapping[str, np.ndarray]) -> list[tuple[str, float]]:
    """Run all stages of a chain, each timed by the device; raises DeviceError where it keeps no time."""
    times = pass_times_ms(chain, inputs, [[one] for one in chain.dispatches])
    return [(one.stage, ms) for one, ms in zip(chain.dispatches, times, strict=True)]


def pass_times_ms(chain: Chain, inputs: Mapping[str, np.ndarray], passes: Sequence[Sequence[Dispatch]]) -> list[float]:
    """Run stages in passes, each timed by the device from its first stage to its last; raises DeviceError."""
    device = chain.device
    if not device.timestamps:
        raise DeviceError(f"{device.info.name} keeps no timestamps")
    import wgpu

    count = 2 * len(passes)
    for name, values in inputs.items():
        chain.write(chain.arrays[name], values)
    with device_errors(device.info.name):
        queries = device.handle.create_query_set(type=wgpu.QueryType.timestamp, count=count)
        usage = wgpu.BufferUsage.QUERY_RESOLVE | wgpu.BufferUsage.COPY_SRC
        resolved = device.handle.create_buffer(size=8 * count, usage=usage)
        encoder = device.handle.create_command_encoder()
        for i, dispatches in enumerate(passes):
            places = {"beginning_of_pass_write_index": 2 * i, "end_of_pass_write_index": 2 * i + 1}
            one_pass = encoder.begin_compute_pass(timestamp_writes={"query_set": queries, **places})
            for dispatch in dispatches:
                encode(one_pass, dispatch)
            one_pass.end()
        encoder.resolve_query_set(queries, 0, count, resolved, 0)
        device.handle.queue.submit([encoder.finish()])
        ticks = np.frombuffer(device.handle.queue.read_buffer(resolved), np.uint64).astype(float)
    return [float(ms) for ms in (ticks[1::2] - ticks[0::2]) / 1e6]
