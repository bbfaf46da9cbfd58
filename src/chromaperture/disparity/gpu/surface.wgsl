// From the smoothed places between the layers to the surface of the halved picture: its disparity in half px, and
// highest and lowest disparity along x, of which `surface_range.wgsl` makes the range about each pixel.

@group(0) @binding(0) var<storage, read> places: array<vec2f>;  // (h, w): information, place times information
@group(0) @binding(1) var<storage, read> labels: array<f32>;  // (2, H, W): offset, scale; or (2, 1, 1)
@group(0) @binding(2) var<storage, read_write> ranges: array<vec2f>;  // (h, w): lowest, highest

fn disparity_at(x: u32, y: u32) -> f32 {
    let sums = places[y * width + x];
    let label = half_label(x, y);
    return label.x + label.y * (first_px + step_px * sums.y / sums.x);
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
    var low = 1.0e30;
    var high = -1.0e30;
    for (var at = inside(i32(x) - i32(reach), width); at <= inside(i32(x) + i32(reach), width); at++) {
        let here = disparity_at(at, y);
        low = min(low, here);
        high = max(high, here);
    }
    ranges[i] = vec2f(low, high);
}
