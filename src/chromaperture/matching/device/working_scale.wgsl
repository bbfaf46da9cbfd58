// To fewer pixels and back.

// ---- reduce: indexing, shared
// Area averages of a picture: pixels that lie in two of the reduced ones count in both by their share. NaN where a pixel
// is saturated or not finite: the mean of what was cut off is not known. See `working_scale.py`, reduced.

in image: array<f32>;  // (H, W, 3)
out small: array<u32>;  // (h, w, 3) float32, as bits

// Length of full pixel p in reduced pixel q, in 1 / count of a full pixel; a thousandth is none, as OpenCV has it.
fn overlap(p: u32, q: u32, full_count: u32, count: u32) -> u32 {
    let length = min((p + 1u) * count, (q + 1u) * full_count) - max(p * count, q * full_count);
    return select(length, 0u, 1000u * length <= count);
}

fn main(i) {
    if (i >= width * height) { return; }
    let x = i % width;
    let y = i / width;
    var sum = vec3f();
    var known = true;
    for (var q = y * full_height / height; q * height < (y + 1u) * full_height; q++) {
        let down = f32(overlap(q, y, full_height, height)) / f32(full_height);
        for (var p = x * full_width / width; p * width < (x + 1u) * full_width; p++) {
            let share = down * f32(overlap(p, x, full_width, width)) / f32(full_width);
            if (share == 0.0) { continue; }
            let at = 3u * (q * full_width + p);
            let rgb = vec3f(image[at], image[at + 1u], image[at + 2u]);
            let finite = is_finite(rgb.x) && is_finite(rgb.y) && is_finite(rgb.z);
            known = known && finite && max(max(rgb.x, rgb.y), rgb.z) < saturation;
            if (known) { sum += share * rgb; }
        }
    }
    for (var c = 0u; c < 3u; c++) { small[3u * i + c] = select(NAN_BITS, bitcast<u32>(sum[c]), known); }
}

// ---- coarse_maps: indexing, shared
// Maps of the working scale and its centre view, 0 where it is not known, in one array: a stage may bind eight.

in small: array<f32>;  // (h, w, 3)
in disparity: array<u32>;  // (h, w), bits of float32
in sigma: array<u32>;
in confidence: array<u32>;
out coarse: array<u32>;  // (4, h, w)

fn main(i) {
    if (i >= pixels) { return; }
    let rgb = vec3f(small[3u * i], small[3u * i + 1u], small[3u * i + 2u]);
    var value = 0.0;
    if (is_finite(rgb.x)) { value = dot(vec3f(guide_rgb[0], guide_rgb[1], guide_rgb[2]), rgb); }
    coarse[i] = disparity[i];
    coarse[pixels + i] = sigma[i];
    coarse[2u * pixels + i] = confidence[i];
    coarse[3u * pixels + i] = bitcast<u32>(value);
}

// ---- upsample: indexing, shared
// Maps of the working scale at every pixel of the photograph: linear within a surface, and over a depth edge the mean of
// the side that is nearer and more like the photograph. See `readable/upsample.py`.

in image: array<f32>;  // (H, W, 3)
in coarse: array<u32>;  // (4, h, w): disparity, NaN unknown; sigma; confidence; guide
in stats: array<f32>;
out disparity: array<u32>;  // (H, W)
out sigma: array<u32>;
out confidence: array<u32>;

const coarse_pixels = width * height;

// The working pixel before a pixel, the share of the one after, and the nearer one of both: 0 or 1. Half-way the one
// after is; divisions of a GPU are not exact enough to tell.
struct Place {
    before: u32,
    share: f32,
    nearer: u32,
}

fn place(at: u32, full_count: u32, count: u32) -> Place {
    let twice = i32((2u * at + 1u) * count) - i32(full_count);  // of it, in 1 / full_count of a working pixel
    let unit = 2i * i32(full_count);
    let before = clamp(select(-1i, twice / unit, twice >= 0i), 0i, max(i32(count) - 2i, 0i));
    let beyond = twice - before * unit;
    return Place(u32(before), clamp(f32(beyond) / f32(unit), 0.0, 1.0), u32(2i * beyond >= unit));
}

fn is_known_at(i: u32) -> bool {
    return coarse[i] != NAN_BITS;
}

// A working pixel that has the maps of (x, y): itself, else the nearest known one beside it. What has none there is not
// read: a pixel of the photograph is known where the nearest of its four working pixels is.
fn source_of(x: u32, y: u32) -> u32 {
    var found = y * width + x;
    if (is_known_at(found)) { return found; }
    for (var reach = 1u; reach <= 2u; reach++) {
        for (var n = 0u; n < 9u; n++) {
            let dx = i32(n % 3u) - 1i;
            let dy = i32(n / 3u) - 1i;
            let at = vec2i(i32(x) + dx, i32(y) + dy);
            if (u32(dx * dx + dy * dy) != reach || any(at < vec2i()) || any(at >= vec2i(i32(width), i32(height)))) {
                continue;
            }
            let i = u32(at.y) * width + u32(at.x);
            if (is_known_at(i)) { return i; }
        }
    }
    return found;
}

fn main(i) {
    let pixels = full_width * full_height;
    if (i >= pixels) { return; }
    let column = place(i % full_width, full_width, width);
    let row = place(i / full_width, full_height, height);
    let columns = vec2u(column.before, min(column.before + 1u, width - 1u));
    let rows = vec2u(row.before, min(row.before + 1u, height - 1u));
    if (!is_known_at(rows[row.nearer] * width + columns[column.nearer])) {
        disparity[i] = NAN_BITS;
        sigma[i] = NAN_BITS;
        confidence[i] = 0u;
        return;
    }
    let rgb = vec3f(image[3u * i], image[3u * i + 1u], image[3u * i + 2u]);
    let is_seen = is_finite(rgb.x) && is_finite(rgb.y) && is_finite(rgb.z);
    let unit = stats[GUIDE_SCALE + 2u];
    let guide = dot(vec3f(guide_rgb[0], guide_rgb[1], guide_rgb[2]), rgb);
    var values: array<vec3f, 4>;
    var near: vec4f;
    var like: vec4f;
    var d: vec4f;
    for (var k = 0u; k < 4u; k++) {
        let x = columns[k % 2u];
        let y = rows[k / 2u];
        let source = source_of(x, y);
        d[k] = bitcast<f32>(coarse[source]);
        let others = vec2u(coarse[coarse_pixels + source], coarse[2u * coarse_pixels + source]);
        values[k] = vec3f(d[k], bitcast<vec2f>(others));
        near[k] = select(1.0 - row.share, row.share, k >= 2u) * select(1.0 - column.share, column.share, k % 2u == 1u);
        let apart = (guide - bitcast<f32>(coarse[3u * coarse_pixels + y * width + x])) * unit;
        like[k] = 1.0 / (1.0 + apart * apart);
    }
    let low = min(min(d.x, d.y), min(d.z, d.w));
    let high = max(max(d.x, d.y), max(d.z, d.w));
    var weight = near;
    if (high - low > jump_px) {
        near += least_weight;
        let nearer = d < vec4f((low + high) / 2.0);
        like *= near;
        let sides = vec2f(dot(like, select(vec4f(), vec4f(1.0), nearer)), dot(like, select(vec4f(1.0), vec4f(), nearer)));
        let first = is_seen && sides.x > sides.y;
        weight = select(vec4f(), near, nearer == vec4<bool>(first));
    }
    weight /= dot(weight, vec4f(1.0));
    let found = weight.x * values[0] + weight.y * values[1] + weight.z * values[2] + weight.w * values[3];
    let factor = f32(full_width) / f32(width);
    disparity[i] = bitcast<u32>(found.x * factor);
    sigma[i] = bitcast<u32>(found.y * factor);
    confidence[i] = bitcast<u32>(found.z);
}
