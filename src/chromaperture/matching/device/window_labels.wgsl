// What labels earn in every window: its log-likelihoods averaged over slopes, interpolated at the labels and limited;
// see `spectral_evidence.py`, over_slopes, _at_labels and _tempered. A workgroup has one window.

@group(0) @binding(0) var<storage, read> by_slope: array<f32>;  // (layers, slopes, windows)
@group(0) @binding(1) var<storage, read> log_share: array<f32>;  // (slopes,)
@group(0) @binding(2) var<storage, read> label_map: array<vec2f>;  // (windows,) or (1,): offset and scale, in layers
@group(0) @binding(3) var<storage, read_write> earned: array<f32>;  // (windows, count) nats a pixel

var<workgroup> extremes: array<vec2f, 64>;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let window = group.x + group.y * groups.x;
    if (window >= windows) { return; }
    // All are counted from the first layer's first slope: nothing of single precision goes into what they share.
    let origin = by_slope[window];
    for (var layer = local; layer < layers; layer += 64u) {
        var best = -1.0e30f;
        for (var slope = 0u; slope < slopes; slope++) {
            let at = (layer * slopes + slope) * windows + window;
            best = max(best, (by_slope[at] - origin) / redundancy + log_share[slope]);
        }
        var sum = 0.0;
        for (var slope = 0u; slope < slopes; slope++) {
            let at = (layer * slopes + slope) * windows + window;
            sum += exp((by_slope[at] - origin) / redundancy + log_share[slope] - best);
        }
        ladder[layer + 2u] = (best + log(sum)) / area_px2;
    }
    workgroupBarrier();
    if (local < 2u) {  // odd continuations at both ends
        ladder[1u - local] = 2.0 * ladder[2] - ladder[3u + local];
        ladder[layers + 2u + local] = 2.0 * ladder[layers + 1u] - ladder[layers - local];
    }
    workgroupBarrier();
    let map = label_map[select(window, 0u, one_map)];
    var value: array<f32, (count + 63u) / 64u>;
    var most = -1.0e30f;
    var least = 1.0e30f;
    for (var n = local; n < count; n += 64u) {
        let place = clamp(map.x + map.y * (first_label + label_step * f32(n)), 0.0, f32(layers - 1u));
        let low = min(u32(place), layers - 2u);
        value[n / 64u] = through_six(low, place - f32(low));
        most = max(most, value[n / 64u]);
        least = min(least, value[n / 64u]);
    }
    extremes[local] = vec2f(most, -least);
    workgroupBarrier();
    for (var half = 32u; half > 0u; half /= 2u) {
        if (local < half) { extremes[local] = max(extremes[local], extremes[local + half]); }
        workgroupBarrier();
    }
    let range = extremes[0];
    let nothing = cap_nats * exp(-gain / cap_nats * (range.x + range.y));
    for (var n = local; n < count; n += 64u) {
        earned[window * count + n] = cap_nats * exp(gain / cap_nats * (value[n / 64u] - range.x)) - nothing;
    }
}
