// The surface of the halved picture: disparity, sigma, peak, in px of the full one. Unknown where the best layer is an
// end of the range, where it is known hardly better than the range, and where no usable pixel is near. One invocation
// takes four neighbours along y, whose ranges overlap.

@group(0) @binding(0) var<storage, read> ranges: array<vec2f>;  // (h, w): lowest and highest disparity along x
@group(0) @binding(1) var<storage, read> places: array<vec2f>;  // (h, w): information, place times information
@group(0) @binding(2) var<storage, read> winner: array<f32>;  // (3, h, w): layer, likelihood there, sigma in layers
@group(0) @binding(3) var<storage, read> labels: array<f32>;  // (2, H, W) or (2, 1, 1)
@group(0) @binding(4) var<storage, read> planes: array<f32>;  // the mask is the one behind K + 1 others
@group(0) @binding(5) var<storage, read_write> surface: array<vec4f>;  // (h, w): disparity, sigma, peak, nothing

fn is_near_usable(x: u32, y: u32) -> bool {
    let far = i32(seen_reach);
    var usable = 0.0;
    for (var row = -far; row <= far; row++) {
        let start = mask_plane + inside(i32(y) + row, height) * width;
        for (var column = -far; column <= far; column++) { usable += planes[start + inside(i32(x) + column, width)]; }
    }
    return usable > 0.0;
}

// A pixel of such a range.
fn finish(x: u32, y: u32, range: f32) {
    let i = y * width + x;
    let label = half_label(x, y);
    let scale = label.y;
    let disparity = label.x + scale * (first_px + step_px * places[i].y / places[i].x);
    let posterior = step_px * winner[2u * width * height + i];
    var known = winner[i] > 0.0 && winner[i] < f32(layer_count - 1u) && posterior < widest_share * widest_px;
    known = known && is_near_usable(x, y);
    let information = places[i].x;
    let own = scale * step_px * sqrt((scatter * scatter + bias * bias / information) / information);
    let sigma = min(length(vec2f(own, edge_share * range)), scale * widest_px);
    let peak = sqrt(max(1.0 - exp(-2.0 * winner[width * height + i]), 0.0));
    surface[i] = vec4f(select(UNKNOWN, 2.0 * disparity, known), 2.0 * sigma, peak, 0.0);
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= ((height + 3u) / 4u) * width) { return; }
    let x = i % width;
    let first = 4u * (i / width);
    var low = vec4f(1.0e30);
    var high = vec4f(-1.0e30);
    for (var n = 0u; n < 2u * reach + 4u; n++) {
        let here = ranges[inside(i32(first + n) - i32(reach), height) * width + x];
        let is_near = (vec4u(n) >= vec4u(0u, 1u, 2u, 3u)) & (vec4u(n) <= 2u * reach + vec4u(0u, 1u, 2u, 3u));
        low = select(low, min(low, vec4f(here.x)), is_near);
        high = select(high, max(high, vec4f(here.y)), is_near);
    }
    for (var n = 0u; n < min(4u, height - first); n++) { finish(x, first + n, high[n] - low[n]); }
}
