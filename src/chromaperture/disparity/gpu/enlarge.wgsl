// The surface of the halved picture at every pixel; pixels in between take more of the neighbour whose guide is like
// theirs, and one of the two where these lie on two surfaces.

@group(0) @binding(0) var<storage, read> surface: array<vec4f>;  // (h, w): disparity, sigma, peak, nothing
@group(0) @binding(1) var<storage, read> guide: array<f32>;  // (H, W)
@group(0) @binding(2) var<storage, read> stats: array<f32>;
@group(0) @binding(3) var<storage, read> labels: array<f32>;  // (2, H, W) or (2, 1, 1)
@group(0) @binding(4) var<storage, read> lacking: array<f32>;  // (cells_y, cells_x)
@group(0) @binding(5) var<storage, read_write> disparity: array<u32>;  // (H, W)
@group(0) @binding(6) var<storage, read_write> sigma: array<u32>;
@group(0) @binding(7) var<storage, read_write> confidence: array<u32>;

// Surfaces of two neighbours, and the guide here, before and after.
fn between(before: vec3f, after: vec3f, here_guide: f32, before_guide: f32, after_guide: f32) -> vec3f {
    let unit = stats[GUIDE_SCALE + 1u];
    let to_before = (here_guide - before_guide) * unit;
    let to_after = (here_guide - after_guide) * unit;
    var weight = (1.0 + to_before * to_before) / (2.0 + to_before * to_before + to_after * to_after);
    if (is_known(before.x) && is_known(after.x) && abs(after.x - before.x) > jump_px) {
        weight = select(0.0, 1.0, weight > 0.5);
    }
    if (!is_known(after.x)) { weight = 0.0; }
    if (!is_known(before.x)) { weight = 1.0; }
    if (weight <= 0.0) { return before; }
    if (weight >= 1.0) { return after; }
    return before + weight * (after - before);
}

fn small(x: u32, y: u32) -> vec3f {
    return surface[y * half_width + min(x, half_width - 1u)].xyz;
}

// At a pixel of an even row.
fn wide(x: u32, y: u32) -> vec3f {
    if (x % 2u == 0u) { return small(x / 2u, y / 2u); }
    let row = y * width;
    let after = guide[row + min(x + 1u, width - 1u)];
    return between(small(x / 2u, y / 2u), small(x / 2u + 1u, y / 2u), guide[row + x], guide[row + x - 1u], after);
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
    var found = vec3f();
    if (y % 2u == 0u) {
        found = wide(x, y);
    } else {
        let below = select(y - 1u, y + 1u, y + 1u < height);
        let after = guide[min(y + 1u, height - 1u) * width + x];
        found = between(wide(x, y - 1u), wide(x, below), guide[i], guide[i - width], after);
    }
    var least_sigma = 0.0;
    if (lacking[(y * cells_y / height) * cells_x + x * cells_x / width] > 0.0) {
        var scale = 1.0;
        if (labelled) { scale = labels[width * height + i]; }
        least_sigma = min(scale * range_sigma_px, max_sigma_px);
    }
    let maps = finished(i, found.x, length(vec2f(found.y, floor_px)), found.z, least_sigma);
    disparity[i] = maps.x;
    sigma[i] = maps.y;
    confidence[i] = maps.z;
}
