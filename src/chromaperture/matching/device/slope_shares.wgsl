// How often every slope is found in the picture, by expectation and maximisation; see `spectral_evidence.py`,
// over_slopes. One workgroup has all windows.

@group(0) @binding(0) var<storage, read> of_slope: array<f32>;  // (slopes, windows)
@group(0) @binding(1) var<storage, read_write> logs: array<f32>;  // (slopes,): logarithms of the shares

var<workgroup> sums: array<f32, 256>;

@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) local: u32) {
    var log_share: array<f32, slopes>;
    for (var slope = 0u; slope < slopes; slope++) { log_share[slope] = log(1.0 / f32(slopes) + least_share); }
    for (var round = 0u; round < rounds; round++) {
        var own = array<f32, slopes>();
        for (var window = local; window < windows; window += 256u) {
            var best = -1.0e30f;
            for (var slope = 0u; slope < slopes; slope++) {
                best = max(best, log_share[slope] + of_slope[slope * windows + window]);
            }
            var sum = 0.0;
            for (var slope = 0u; slope < slopes; slope++) {
                sum += exp(log_share[slope] + of_slope[slope * windows + window] - best);
            }
            for (var slope = 0u; slope < slopes; slope++) {
                own[slope] += exp(log_share[slope] + of_slope[slope * windows + window] - best) / sum;
            }
        }
        for (var slope = 0u; slope < slopes; slope++) {
            workgroupBarrier();
            sums[local] = own[slope];
            workgroupBarrier();
            for (var half = 128u; half > 0u; half /= 2u) {
                if (local < half) { sums[local] += sums[local + half]; }
                workgroupBarrier();
            }
            log_share[slope] = log(sums[0] / f32(windows) + least_share);
        }
    }
    if (local == 0u) {
        for (var slope = 0u; slope < slopes; slope++) { logs[slope] = log_share[slope]; }
    }
}
