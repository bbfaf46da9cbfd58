// Sums the parts that `variance.wgsl` left up, to the views' variances.

@group(0) @binding(0) var<storage, read> parts: array<f32>;  // (groups, 6)
@group(0) @binding(1) var<storage, read_write> stats: array<f32>;

@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) local: u32) {
    var own = Sums();
    for (var i = local; i < part_count; i += 256u) {
        own.values += vec3f(parts[6u * i], parts[6u * i + 1u], parts[6u * i + 2u]);
        own.squares += vec3f(parts[6u * i + 3u], parts[6u * i + 4u], parts[6u * i + 5u]);
    }
    let total = summed(own, local);
    if (local == 0u) {
        let mean = total.values / f32(pixels);
        let variance = max(total.squares / f32(pixels) - mean * mean, vec3f());
        // Half a unit of light is rounding (`views.constant_variance`).
        let least = select(0.0, 0.25 * stats[UNIT] * stats[UNIT], whole);
        for (var k = 0u; k < 3u; k++) { stats[VARIANCE + k] = select(variance[k], 0.0, variance[k] <= least); }
    }
}
