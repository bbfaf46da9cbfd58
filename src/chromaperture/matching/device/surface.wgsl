// From the smoothed places between the layers to the surface of the halved picture: its disparity in half px, and
// highest and lowest disparity along x, of which `surface_range.wgsl` makes the range about each pixel.
// One invocation takes four neighbours, whose ranges overlap.

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
    let each = (width + 3u) / 4u;  // invocations of a row
    if (i >= each * height) { return; }
    let first = 4u * (i % each);
    let y = i / each;
    var low = vec4f(1.0e30);
    var high = vec4f(-1.0e30);
    for (var n = 0u; n < 2u * reach + 4u; n++) {
        let here = disparity_at(inside(i32(first + n) - i32(reach), width), y);
        let is_near = (vec4u(n) >= vec4u(0u, 1u, 2u, 3u)) & (vec4u(n) <= 2u * reach + vec4u(0u, 1u, 2u, 3u));
        low = select(low, min(low, vec4f(here)), is_near);
        high = select(high, max(high, vec4f(here)), is_near);
    }
    for (var n = 0u; n < min(4u, width - first); n++) { ranges[y * width + first + n] = vec2f(low[n], high[n]); }
}
