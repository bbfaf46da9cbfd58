// The labels that a surface has, to disparity, error bar and confidence of every pixel; see
// `accurate.AccurateMethod.of_labels`.

@group(0) @binding(0) var<storage, read> judged: array<vec4f>;  // (h, w): layer, error bar in layers, peak, whether known
@group(0) @binding(1) var<storage, read> labels: array<f32>;  // (2, h, w) or (2, 1, 1): offset, px, and scale
@group(0) @binding(2) var<storage, read> lacking: array<f32>;  // (cells_y, cells_x): 1 without two views
@group(0) @binding(3) var<storage, read> usable: array<f32>;  // (h, w)
@group(0) @binding(4) var<storage, read_write> disparity: array<u32>;  // (h, w)
@group(0) @binding(5) var<storage, read_write> sigma: array<u32>;
@group(0) @binding(6) var<storage, read_write> confidence: array<u32>;

// Whether the matching window of a pixel holds no usable one.
fn is_without_pixels(x: u32, y: u32) -> bool {
    if (usable[y * width + x] > 0.0) { return false; }
    for (var v = max(y, reach) - reach; v <= min(y + reach, height - 1u); v++) {
        for (var u = max(x, reach) - reach; u <= min(x + reach, width - 1u); u++) {
            if (usable[v * width + u] > 0.0) { return false; }
        }
    }
    return true;
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= width * height) { return; }
    let x = i % width;
    let y = i / width;
    let at = select(0u, i, labelled);
    let scale = labels[select(1u, width * height, labelled) + at];
    let found = judged[i];
    var least_sigma = 0.0;
    if (lacking[(y * cells_y / height) * cells_x + x * cells_x / width] > 0.0 || is_without_pixels(x, y)) {
        least_sigma = min(scale * range_sigma_px, max_sigma_px);
    }
    let value = select(UNKNOWN, labels[at] + scale * (first_px + step_px * found.x), found.w > 0.0);
    let maps = finished(i, value, scale * step_px * found.y, found.z, least_sigma);
    disparity[i] = maps.x;
    sigma[i] = maps.y;
    confidence[i] = maps.z;
}
