// What stages of several files use.

// ---- indexing
// The number of an invocation, and what lies beyond the borders of a picture.

// Of a dispatch whose workgroups of 64 are counted along x and y.
fn invocation(group: vec3u, groups: vec3u, local: u32) -> u32 {
    return (group.x + group.y * groups.x) * 64u + local;
}

// Mirrored at the border, whose pixel is not repeated (BORDER_REFLECT_101 of OpenCV). A loop and no remainder: that takes one division a lane.
fn mirrored(at: i32, count: u32) -> u32 {
    let last = i32(count) - 1i;
    if (last == 0i) { return 0u; }
    var place = abs(at);
    while (place > last) { place = abs(2i * last - place); }
    return u32(place);
}

// ---- shared
// What several stages use: places in `stats`, coordinates inside the picture, unknown values.

const UNKNOWN = 3.0e38f;  // stands for NaN on the device, where arithmetic may assume that there is none
const NAN_BITS = 0x7fc00000u;

// Places in `stats`, the numbers of one picture that later stages need.
const MEAN_RED = 0u;  // of the usable pixels; green and blue follow
const MEAN_ALL = 3u;  // of all their channels
const USABLE = 4u;  // pixels
const UNUSABLE = 5u;
const UNIT = 6u;  // of light, a power of two; its inverse follows
const VARIANCE = 8u;  // of each view
const GUIDE_SCALE = 12u;  // to units of guide_range: of the matched guide, then of the full one

fn inside(at: i32, count: u32) -> u32 {
    return u32(clamp(at, 0i, i32(count) - 1i));
}

fn is_finite(value: f32) -> bool {
    return (bitcast<u32>(value) & 0x7f800000u) != 0x7f800000u;
}

fn is_known(value: f32) -> bool {
    return value < 1.0e38f;
}

// ---- finishing
// The last of a method's own stages: limits of the error bar, the bar where two views are lacking, confidence.

// Disparity, sigma and confidence of a pixel as they are read on the CPU.
fn finished(i: u32, disparity: f32, sigma: f32, peak: f32, least_sigma: f32) -> vec3u {
    if (!is_known(disparity)) { return vec3u(NAN_BITS, NAN_BITS, 0u); }
    let wide = max(min(sigma, max_sigma_px), least_sigma);
    let confidence = exp(-wide / confidence_scale_px) * clamp(peak, 0.0, 1.0);
    return vec3u(bitcast<u32>(disparity), bitcast<u32>(wide), bitcast<u32>(confidence));
}

// ---- between
// A surface between the pixels of one of half its size: more of the neighbour whose guide is like a pixel's own, and one
// of the two where these lie on two surfaces. The guide starts at `guide_start`; `guide_scale` is the place of its unit
// in `stats`.

// Surfaces of two neighbours, and the guide here, before and after.
fn between(before: vec3f, after: vec3f, here_guide: f32, before_guide: f32, after_guide: f32) -> vec3f {
    let unit = stats[guide_scale];
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
    let row = guide_start + y * width;
    let after = guide[row + min(x + 1u, width - 1u)];
    return between(small(x / 2u, y / 2u), small(x / 2u + 1u, y / 2u), guide[row + x], guide[row + x - 1u], after);
}

fn surface_at(x: u32, y: u32) -> vec3f {
    let i = y * width + x;
    if (y % 2u == 0u) { return wide(x, y); }
    let below = select(y - 1u, y + 1u, y + 1u < height);
    let after = guide[guide_start + min(y + 1u, height - 1u) * width + x];
    return between(wide(x, y - 1u), wide(x, below), guide[guide_start + i], guide[guide_start + i - width], after);
}

// ---- layer_polynomial
// Numbers of all layers, `ladder`, from its third on, and the polynomial through six of them.

var<workgroup> ladder: array<f32, layers + 4u>;

// At the part t of the way from a layer to the next one.
fn through_six(low: u32, t: f32) -> f32 {
    let a = t + 2.0;
    let b = t + 1.0;
    let c = t - 1.0;
    let d = t - 2.0;
    let e = t - 3.0;
    let between = a * e * (t * b * d * ladder[low + 3u] - b * c * d * ladder[low + 2u]) / 12.0;
    let beside = t * c * a * e * (d * ladder[low + 1u] - b * ladder[low + 4u]) / 24.0;
    let outer = b * t * c * d * (a * ladder[low + 5u] - e * ladder[low]) / 120.0;
    return between + beside + outer;
}

// ---- fill_zero: indexing, shared
// Sets an array to 0.

out values: array<f32>;

fn main(i) {
    if (i < size) { values[i] = 0.0; }
}
