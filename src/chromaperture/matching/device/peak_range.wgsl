// The error bar of a peak, widened where the disparity varies around it and where the views differ by hue (quality
// "paper"), as `paper.py`.

@group(0) @binding(0) var<storage, read> peaks: array<f32>;  // (3, H, W): disparity, its error bar, score
@group(0) @binding(1) var<storage, read> ranges: array<vec2f>;  // (H, W): lowest and highest disparity along x
@group(0) @binding(2) var<storage, read> unlike: array<f32>;  // (rows, columns): `unlike_share.wgsl`
@group(0) @binding(3) var<storage, read_write> disparity: array<u32>;  // (H, W)
@group(0) @binding(4) var<storage, read_write> sigma: array<u32>;
@group(0) @binding(5) var<storage, read_write> confidence: array<u32>;

// Linear between the cells' centres, as OpenCV's INTER_LINEAR.
fn unlike_at(x: u32, y: u32) -> f32 {
    let size = vec2f(f32(columns), f32(rows));
    let place = (vec2f(f32(x), f32(y)) + 0.5) * size / vec2f(f32(width), f32(height)) - 0.5;
    let held = clamp(place, vec2f(), size - 1.0);
    let before = vec2u(held);
    let after = min(before + 1u, vec2u(columns, rows) - 1u);
    let part = held - vec2f(before);
    let above = mix(unlike[before.y * columns + before.x], unlike[before.y * columns + after.x], part.x);
    let below = mix(unlike[after.y * columns + before.x], unlike[after.y * columns + after.x], part.x);
    return mix(above, below, part.y);
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    let pixels = width * height;
    if (i >= pixels) { return; }
    let x = i % width;
    let y = i32(i / width);
    var low = 1.0e30;
    var high = -1.0e30;
    for (var n = 0u; n < side; n++) {  // unrolled
        let here = ranges[inside(y + i32(n) - i32(reach), height) * width + x];
        low = min(low, here.x);
        high = max(high, here.y);
    }
    let at_edge = edge_share * max(high - low, 0.0);
    let by_hue = hue_px * unlike_at(x, u32(y));
    let wide = min(length(vec4f(peaks[pixels + i], at_edge, by_hue, floor_px)), range_sigma_px);
    let maps = finished(i, peaks[i], wide, peaks[2u * pixels + i], 0.0);
    disparity[i] = maps.x;
    sigma[i] = maps.y;
    confidence[i] = maps.z;
}
