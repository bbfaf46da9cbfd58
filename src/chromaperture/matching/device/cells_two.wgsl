// Sums of two views for `cell_scores.wgsl`.

// Where in `samples`, (h + 2 pad_y, w + 2 pad_x, E), the windows of an invocation begin.
alias Reader = vec2u;

// Of a row of a window: nine times the means, 81 times both variances and the covariance.
struct Row {
    means: vec2f,
    products: vec3f,  // 00, 11, 01
}

struct Rows {
    left: Row,
    right: Row,
}

fn start_of(view: u32, layer: u32, x: u32, y: u32) -> u32 {
    let place = places[view * layer_count + layer];
    let column = u32(i32(x + pad_x - reach) + place.y);
    let row = u32(i32(y + pad_y - reach) + place.z);
    return (row * wide + column) * entry_count + u32(place.x);
}

fn reader_of(layer: u32, x: u32, y: u32) -> Reader {
    return Reader(start_of(0u, layer, x, y), start_of(1u, layer, x, y));
}

fn samples_at(at: Reader) -> vec2f {
    return vec2f(samples[at.x], samples[at.y]);
}

// Of a row of both cells, whose windows share three samples.
fn row_sums(reader: Reader, row: u32) -> Rows {
    let at = reader + row * wide * entry_count;
    let s0 = samples_at(at);
    let s1 = samples_at(at + entry_count);
    let s2 = samples_at(at + 2u * entry_count);
    let s3 = samples_at(at + 3u * entry_count);
    let s4 = samples_at(at + 4u * entry_count);
    let s5 = samples_at(at + 5u * entry_count);
    let s6 = samples_at(at + 6u * entry_count);
    return Rows(row_of(s2, s0 - s2, s1 - s2, s3 - s2, s4 - s2), row_of(s4, s2 - s4, s3 - s4, s5 - s4, s6 - s4));
}

// Of differences from the middle, which are small: so their sums are exact.
fn row_of(light: vec2f, outer: vec2f, inner: vec2f, beyond: vec2f, last: vec2f) -> Row {
    let sums = outer + last + 2.0 * (inner + beyond);
    let products = outer.xyx * outer.xyy + last.xyx * last.xyy + 2.0 * (inner.xyx * inner.xyy + beyond.xyx * beyond.xyy);
    return Row(9.0 * light + sums, (8.0 * products + products) - sums.xyx * sums.xyy);
}

// The correlation of rows that are joined to a window. Means count from the whole number next to their mean, so that
// their products are exact; sums above 2^24 are rounded, in the same order as on the CPU.
fn score_of(a: Row, b: Row, c: Row, d: Row, e: Row, floors: vec3f) -> f32 {
    let total = (a.means + e.means + c.means) + 2.0 * (b.means + d.means + c.means);
    let middle = round(total * (1.0 / 9.0));
    let left = total - 9.0 * middle;
    let means_a = a.means - middle;
    let means_b = b.means - middle;
    let means_c = c.means - middle;
    let means_d = d.means - middle;
    let means_e = e.means - middle;
    let ends = a.products + e.products + means_a.xyx * means_a.xyy + means_e.xyx * means_e.xyy;
    let inside = b.products + d.products + means_b.xyx * means_b.xyy + means_d.xyx * means_d.xyy;
    let inmost = c.products + means_c.xyx * means_c.xyy;
    let value = (ends + inmost) + 2.0 * (inside + inmost);
    let joined = (8.0 * value + value) - left.xyx * left.xyy;
    let variances = max(joined.xy, vec2f()) + floors.xy;
    return clamp(joined.z / sqrt(max(variances.x * variances.y, 1.0e-37)), -1.0, 1.0);
}
