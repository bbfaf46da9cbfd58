// Each channel shifted back by its disparity with OpenCV's cubics, and which channels see the pixel.

@group(0) @binding(0) var<storage, read> image: array<f32>;  // (H, W, 3)
@group(0) @binding(1) var<storage, read> filled: array<f32>;  // (H, W)
@group(0) @binding(2) var<storage, read> nearest: array<u32>;  // (3, H, W): `nearness`
@group(0) @binding(3) var<storage, read_write> shifted: array<f32>;  // (H, W, 3)
@group(0) @binding(4) var<storage, read_write> visible: array<u32>;  // (H, W): a bit a channel

// Weights of the samples at -1, 0, 1, 2 for the point t; OpenCV's slope of -0.75.
fn weights_at(t: f32) -> vec4f {
    let u = 1.0 - t;
    let first = -0.75 * t * u * u;
    let last = -0.75 * u * t * t;
    let here = (1.25 * t - 2.25) * t * t + 1.0;
    return vec4f(first, here, 1.0 - first - here - last, last);
}

fn along_row(x: i32, y: u32, k: u32, weights: vec4f) -> f32 {
    var sum = 0.0;
    var is_seen = true;
    for (var n = 0u; n < 4u; n++) {
        let value = image[3u * (y * width + inside(x + i32(n) - 1i, width)) + k];
        is_seen = is_seen && is_finite(value);
        sum += weights[n] * value;
    }
    return select(UNKNOWN, sum, is_seen);
}

fn sample(x: u32, y: u32, k: u32, disparity: f32) -> f32 {
    let direction = select(direction_of(k), vec2f(), abs(direction_of(k)) < vec2f(still));
    if (direction.y == 0.0) {
        // As `color/shift_kernels.py`: beyond 4 px outside there is only the border; 8 makes truncation round down.
        let place = clamp(f32(x) + disparity * direction.x, -4.0, f32(width + 4u)) + 8.0;
        let first = i32(place);
        return along_row(first - 8i, y, k, weights_at(place - f32(first)));
    }
    let moved = vec2f(f32(x), f32(y)) + disparity * direction;
    let place = clamp(moved, vec2f(-4.0), vec2f(f32(width), f32(height)) + 4.0);
    let first = floor(place);
    let weights = weights_at(place.y - first.y);
    let of_row = weights_at(place.x - first.x);
    var sum = 0.0;
    var is_seen = true;
    for (var n = 0u; n < 4u; n++) {
        let value = along_row(i32(first.x), inside(i32(first.y) + i32(n) - 1i, height), k, of_row);
        is_seen = is_seen && is_known(value);
        sum += weights[n] * value;
    }
    return select(UNKNOWN, sum, is_seen);
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
    let disparity = filled[i];
    var seen = 0u;
    for (var k = 0u; k < 3u; k++) {
        shifted[3u * i + k] = sample(x, y, k, disparity);
        if (is_still(k)) {
            seen |= 1u << k;
            continue;
        }
        let place = place_in(k, x, y, disparity);
        if (place < 0i) { continue; }
        if (disparity_of(nearest[k * width * height + u32(place)]) > disparity - occlusion_px) { seen |= 1u << k; }
    }
    visible[i] = seen;
}
