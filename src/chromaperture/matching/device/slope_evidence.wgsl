// What a window says of every slope, whatever the layer: the logarithm of the sum of the likelihoods, over the best of
// all; see `spectral_evidence.py`, over_slopes.

@group(0) @binding(0) var<storage, read> by_slope: array<f32>;  // (layers, slopes, windows)
@group(0) @binding(1) var<storage, read_write> of_slope: array<f32>;  // (slopes, windows)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let window = invocation(group, groups, local);
    if (window >= windows) { return; }
    var best = -1.0e30f;
    for (var slope = 0u; slope < slopes; slope++) {
        var highest = -1.0e30f;
        for (var layer = 0u; layer < layers; layer++) {
            highest = max(highest, by_slope[(layer * slopes + slope) * windows + window]);
        }
        var sum = 0.0;
        for (var layer = 0u; layer < layers; layer++) {
            sum += exp((by_slope[(layer * slopes + slope) * windows + window] - highest) / redundancy);
        }
        of_slope[slope * windows + window] = highest / redundancy + log(sum);
        best = max(best, highest / redundancy);
    }
    for (var slope = 0u; slope < slopes; slope++) { of_slope[slope * windows + window] -= best; }
}
