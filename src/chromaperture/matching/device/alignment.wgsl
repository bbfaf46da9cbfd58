// Aligned colours.

// ---- every_nth: indexing, shared
// Every so many rows and columns of a map, which is smooth in between: see `color/alignment.py`, fill_unknown.

in values: array<u32>;  // (H, W)
out few: array<u32>;  // (few_tall, few_wide)

fn main(i) {
    if (i >= few_tall * few_wide) { return; }
    few[i] = values[(spacing / 2u + spacing * (i / few_wide)) * width + spacing / 2u + spacing * (i % few_wide)];
}

// ---- nearest_rows: indexing, shared
// Row of the nearest known pixel in the same column, -1 where there is none: the first half of
// `color/alignment.py`. One invocation walks a column.

in values: array<u32>;  // (H, W), NaN unknown
out rows: array<i32>;  // (H, W)

fn main(group, groups, local) {
    let x = invocation(group, groups, local);
    if (x >= width) { return; }
    var row = -1i;
    for (var y = 0u; y < height; y++) {
        if (values[y * width + x] != NAN_BITS) { row = i32(y); }
        rows[y * width + x] = row;
    }
    row = -1i;
    for (var y = i32(height) - 1i; y >= 0i; y--) {
        let at = u32(y) * width + x;
        let above = rows[at];
        if (above == y) { row = y; }
        if (row >= 0i && (above < 0i || row - y < y - above)) { rows[at] = row; }
    }
}

// ---- nearest_known: indexing, shared
// Value of the nearest known pixel at every unknown one, 0 where none is known: the second half of
// `color/alignment.py`. Of pixels at one distance the first from the left counts, as there.

in values: array<u32>;  // (H, W), NaN unknown
in rows: array<i32>;  // (H, W): of the nearest known pixel in the column
out filled: array<f32>;  // (H, W)

fn main(i) {
    if (i >= width * height) { return; }
    if (values[i] != NAN_BITS) {
        filled[i] = bitcast<f32>(values[i]);
        return;
    }
    let x = i32(i % width);
    let y = i32(i / width);
    var least = 0x7fffffffi;  // squared distance
    var source = -1i;
    for (var reach = 0i; reach < i32(width) && reach * reach <= least; reach++) {
        for (var side = -1i; side <= 1i; side += 2i) {
            let column = x + side * reach;
            if (column < 0i || column >= i32(width)) { continue; }
            let row = rows[y * i32(width) + column];
            if (row < 0i) { continue; }
            let distance = reach * reach + (row - y) * (row - y);
            if (distance < least || (distance == least && side < 0i)) {
                least = distance;
                source = row * i32(width) + column;
            }
        }
    }
    filled[i] = select(0.0, bitcast<f32>(values[u32(max(source, 0i))]), source >= 0i);
}

// ---- filled_from_few: indexing, shared
// Unknown pixels take what `every_nth` and the search for the nearest known pixel found for their square.

in values: array<u32>;  // (H, W), NaN unknown
in few: array<f32>;  // (few_tall, few_wide)
out filled: array<f32>;  // (H, W)

fn main(i) {
    if (i >= width * height) { return; }
    if (values[i] != NAN_BITS) {
        filled[i] = bitcast<f32>(values[i]);
        return;
    }
    filled[i] = few[min(i / width / spacing, few_tall - 1u) * few_wide + min(i % width / spacing, few_wide - 1u)];
}

// ---- channel_views
// Where each channel sees a pixel of the centre view, and the depth buffer of the channel's view.

// Displacement of a channel per px of disparity.
fn direction_of(k: u32) -> vec2f {
    if (k == 0u) { return vec2f(directions[0], directions[1]); }
    if (k == 1u) { return vec2f(directions[2], directions[3]); }
    return vec2f(directions[4], directions[5]);
}

fn is_still(k: u32) -> bool {
    return length(direction_of(k)) < still;
}

// Place in the channel's view, -1 outside; rounded as `color/row_alignment.py` rounds.
fn place_in(k: u32, x: u32, y: u32, disparity: f32) -> i32 {
    let direction = direction_of(k);
    var at = vec2i(i32(x), i32(y));
    if (abs(direction.y) < still) {
        at.x = i32(clamp(f32(x) + disparity * direction.x, -2.0, f32(width + 1u)) + 4.5) - 4i;
    } else {
        let moved = vec2f(f32(x), f32(y)) + disparity * direction;
        at = vec2i(floor(clamp(moved, vec2f(-2.0), vec2f(f32(width) + 1.0, f32(height) + 1.0)) + 0.5));
    }
    let seen = at.x >= 0i && at.x < i32(width) && at.y >= 0i && at.y < i32(height);
    return select(-1i, at.y * i32(width) + at.x, seen);
}

// Unsigned integers, the larger the nearer (the smaller the disparity), above 0.
fn nearness(disparity: f32) -> u32 {
    let bits = bitcast<u32>(disparity);
    return ~select(bits | 0x80000000u, ~bits, (bits & 0x80000000u) != 0u);
}

fn disparity_of(nearness: u32) -> f32 {
    let ordered = ~nearness;
    return bitcast<f32>(select(~ordered, ordered & 0x7fffffffu, (ordered & 0x80000000u) != 0u));
}

// ---- depth_buffer: indexing, shared, channel_views
// Depth buffers of the channels' views: the nearest of the pixels that fall on one. They are 0 before.

in filled: array<f32>;  // (H, W)
out nearest: array<atomic<u32>>;  // (3, H, W): `nearness`

fn main(i) {
    if (i >= width * height) { return; }
    for (var k = 0u; k < 3u; k++) {
        if (is_still(k)) { continue; }
        let place = place_in(k, i % width, i / width, filled[i]);
        if (place >= 0i) { atomicMax(&nearest[k * width * height + u32(place)], nearness(filled[i])); }
    }
}

// ---- cubic_samples
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

// ---- moved_by_disparity
// For `channels_shifted`: channels are displaced by disparity times direction.

fn sample(x: u32, y: u32, k: u32, disparity: f32) -> f32 {
    let direction = select(direction_of(k), vec2f(), abs(direction_of(k)) < vec2f(still));
    if (direction.y == 0.0) {
        // As `color/row_alignment.py`: beyond 4 px outside there is only the border; 8 makes truncation round down.
        let place = clamp(f32(x) + disparity * direction.x, -4.0, f32(width + 4u)) + 8.0;
        let first = i32(place);
        return along_row(first - 8i, y, k, weights_at(place - f32(first)));
    }
    let moved = vec2f(f32(x), f32(y)) + disparity * direction;
    return cubic_at(moved, k);
}

// ---- moved_by_lens
// For `channels_shifted`: channels are displaced by what a lens does (`color/lens_shift.py`), and sampled by Lanczos'
// filter, as OpenCV does it (at places rounded to 1 / 32 px), or by cubics.

@group(0) @binding(5) var<storage, read> table: array<f32>;  // (table_rows, table_columns, table_radii, 6), px
@group(0) @binding(6) var<storage, read> lanczos: array<f32>;  // (32, 8): weights at -3 to 4, of 32 places between pixels

const PLACES = 32;

// Linear between the entries of the table, constant beyond its radii.
fn displacement(x: u32, y: u32, k: u32, disparity: f32) -> vec2f {
    let v = f32(y) * f32(table_rows - 1u) / f32(max(height - 1u, 1u));
    let u = f32(x) * f32(table_columns - 1u) / f32(max(width - 1u, 1u));
    let radius = at_zero_px + per_px * disparity;
    let t = clamp((radius - first_radius_px) / radius_step_px, 0.0, f32(table_radii - 1u));
    let cell = min(vec2u(u32(u), u32(v)), vec2u(table_columns - 2u, table_rows - 2u));
    let n = min(u32(t), table_radii - 2u);
    let part = vec2f(u, v) - vec2f(cell);
    var total = vec2f();
    for (var corner = 0u; corner < 4u; corner++) {
        let to = vec2u(corner % 2u, corner / 2u);
        let weight = select(1.0 - part, part, to == vec2u(1u));
        let at = (((cell.y + to.y) * table_columns + cell.x + to.x) * table_radii + n) * 6u + 2u * k;
        let a = vec2f(table[at], table[at + 1u]);
        let b = vec2f(table[at + 6u], table[at + 7u]);
        total += weight.x * weight.y * (a + (t - f32(n)) * (b - a));
    }
    return lens_factor * total;
}

fn lanczos_at(moved: vec2f, k: u32) -> f32 {
    let place = vec2i(round(f32(PLACES) * clamp(moved, vec2f(-8.0), vec2f(f32(width), f32(height)) + 8.0)));
    let first = place >> vec2u(5u);
    let between = vec2u(place - PLACES * first);
    var sum = 0.0;
    for (var row = 0u; row < 8u; row++) {
        let line = inside(first.y + i32(row) - 3i, height) * width;
        var of_row = 0.0;
        for (var column = 0u; column < 8u; column++) {
            let value = image[3u * (line + inside(first.x + i32(column) - 3i, width)) + k];
            if (!is_finite(value)) { return UNKNOWN; }
            of_row += lanczos[8u * between.x + column] * value;
        }
        sum += lanczos[8u * between.y + row] * of_row;
    }
    return sum;
}

fn sample(x: u32, y: u32, k: u32, disparity: f32) -> f32 {
    let moved = vec2f(f32(x), f32(y)) + displacement(x, y, k, disparity);
    if (by_lanczos) { return lanczos_at(moved, k); }
    return cubic_at(moved, k);
}

// ---- channels_shifted: indexing, shared, channel_views, cubic_samples
// Each channel shifted back, and which channels see the pixel; `sample` decides by how much and by which filter.

in image: array<f32>;  // (H, W, 3)
in filled: array<f32>;  // (H, W)
in nearest: array<u32>;  // (3, H, W): `nearness`
out shifted: array<f32>;  // (H, W, 3)
out visible: array<u32>;  // (H, W): a bit a channel

fn main(i) {
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

// ---- hidden_filled: indexing, shared
// Samples that are occluded in a channel, predicted from the colour line of their own surface (`color/row_alignment.py`,
// fill_hidden), and all samples white balanced.

in shifted: array<f32>;  // (H, W, 3)
in visible: array<u32>;  // (H, W): a bit a channel
in filled: array<f32>;  // (H, W): disparity
out color: array<u32>;  // (H, W, 3)

fn is_visible(i: u32, k: u32) -> bool {
    return (visible[i] & (1u << k)) != 0u;
}

// The best visible channel but k, 3 where there is none.
fn guide_of(i: u32, k: u32) -> u32 {
    for (var n = 0u; n < 3u; n++) {
        let candidate = u32(order[n]);
        if (candidate != k && is_visible(i, candidate)) { return candidate; }
    }
    return 3u;
}

fn predicted(i: u32, k: u32) -> f32 {
    let x = i32(i % width);
    let y = i32(i / width);
    let guide = guide_of(i, k);
    let guided = guide < 3u;
    var count = 0.0;
    var sums = vec2f();  // of the guide, of the channel
    var products = vec2f();  // of the guide with both
    for (var row = inside(y - i32(radius_px), height); row <= inside(y + i32(radius_px), height); row++) {
        for (var column = inside(x - i32(radius_px), width); column <= inside(x + i32(radius_px), width); column++) {
            let at = row * width + column;
            if (!is_visible(at, k) || abs(filled[at] - filled[i]) > same_surface_px) { continue; }
            if (guided && !is_visible(at, min(guide, 2u))) { continue; }
            let own = shifted[3u * at + k];
            let other = select(0.0, shifted[3u * at + min(guide, 2u)], guided);
            if (!is_known(own) || !is_known(other)) { return UNKNOWN; }
            sums += vec2f(other, own);
            products += other * vec2f(other, own);
            count += 1.0;
        }
    }
    if (count < fewest) { return shifted[3u * i + k]; }
    let mean = sums / count;
    let slope = (products.y / count - mean.x * mean.y) / (products.x / count - mean.x * mean.x + ridge);
    var apart = 0.0;
    if (guided) {
        let here = shifted[3u * i + min(guide, 2u)];
        if (!is_known(here)) { return UNKNOWN; }
        apart = here - mean.x;
    }
    return max(mean.y + slope * apart, 0.0);
}

fn main(i) {
    if (i >= width * height) { return; }
    for (var k = 0u; k < 3u; k++) {
        var value = shifted[3u * i + k];
        if (!is_visible(i, k)) { value = predicted(i, k); }
        color[3u * i + k] = select(NAN_BITS, bitcast<u32>(max(value * gains[k], 0.0)), is_known(value));
    }
}
