// Samples of a channel between pixels, by OpenCV's cubics.

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

fn cubic_at(moved: vec2f, k: u32) -> f32 {
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
