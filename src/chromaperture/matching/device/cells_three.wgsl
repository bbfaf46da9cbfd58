// Sums of three views for `cell_scores.wgsl`, as `cells_two.wgsl`. Every layer has a phase of its own along x here, at which
// nobody else samples: so the samples, (h + 2 pad_y, w + 2 pad_x, Ey), are those between rows, and are read between their
// columns here.

@group(0) @binding(4) var<storage, read> phases: array<vec4f>;  // (E, 2): four taps along x; the phase along y

struct Reader {
    starts: vec3u,  // of the three views
    taps: mat4x3f,  // each for all views
}

struct Row {
    means: vec3f,
    squares: vec3f,
    products: vec3f,  // 01, 02, 12
}

struct Rows {
    left: Row,
    right: Row,
}

// The first tap of the windows' first samples.
fn start_of(view: u32, layer: u32, x: u32, y: u32) -> u32 {
    let place = places[view * layer_count + layer];
    let column = u32(i32(x + pad_x - reach) + place.y) - 1u;
    let row = u32(i32(y + pad_y - reach) + place.z);
    return (row * wide + column) * phase_count + u32(phases[2i * place.x + 1i].x);
}

fn reader_of(layer: u32, x: u32, y: u32) -> Reader {
    let starts = vec3u(start_of(0u, layer, x, y), start_of(1u, layer, x, y), start_of(2u, layer, x, y));
    let taps = mat3x4f(
        phases[2i * places[layer].x], phases[2i * places[layer_count + layer].x],
        phases[2i * places[2u * layer_count + layer].x]
    );
    return Reader(starts, transpose(taps));
}

fn samples_at(at: vec3u) -> vec3f {
    return vec3f(samples[at.x], samples[at.y], samples[at.z]);
}

fn row_sums(reader: Reader, row: u32) -> Rows {
    let at = reader.starts + row * wide * phase_count;
    let p0 = samples_at(at);
    let p1 = samples_at(at + phase_count);
    let p2 = samples_at(at + 2u * phase_count);
    let p3 = samples_at(at + 3u * phase_count);
    let p4 = samples_at(at + 4u * phase_count);
    let p5 = samples_at(at + 5u * phase_count);
    let p6 = samples_at(at + 6u * phase_count);
    let p7 = samples_at(at + 7u * phase_count);
    let p8 = samples_at(at + 8u * phase_count);
    let p9 = samples_at(at + 9u * phase_count);
    let taps = reader.taps;
    let s0 = between_columns(taps, p0, p1, p2, p3);
    let s1 = between_columns(taps, p1, p2, p3, p4);
    let s2 = between_columns(taps, p2, p3, p4, p5);
    let s3 = between_columns(taps, p3, p4, p5, p6);
    let s4 = between_columns(taps, p4, p5, p6, p7);
    let s5 = between_columns(taps, p5, p6, p7, p8);
    let s6 = between_columns(taps, p6, p7, p8, p9);
    return Rows(row_of(s2, s0 - s2, s1 - s2, s3 - s2, s4 - s2), row_of(s4, s2 - s4, s3 - s4, s5 - s4, s6 - s4));
}

// In whole units, by weights of whole parts: exact but for the rounding.
fn between_columns(taps: mat4x3f, a: vec3f, b: vec3f, c: vec3f, d: vec3f) -> vec3f {
    return round(taps[0] * a + taps[1] * b + taps[2] * c + taps[3] * d);
}

fn row_of(light: vec3f, outer: vec3f, inner: vec3f, beyond: vec3f, last: vec3f) -> Row {
    let sums = outer + last + 2.0 * (inner + beyond);
    let squares = outer * outer + last * last + 2.0 * (inner * inner + beyond * beyond);
    let products = outer.xxy * outer.yzz + last.xxy * last.yzz + 2.0 * (inner.xxy * inner.yzz + beyond.xxy * beyond.yzz);
    return Row(9.0 * light + sums, (8.0 * squares + squares) - sums * sums, (8.0 * products + products) - sums.xxy * sums.yzz);
}

// 1 - sqrt(det) of the correlations of rows that are joined to a window. The determinant is (1 - r01^2) (1 - r02^2)
// - (r12 - r01 r02)^2, not a sum whose parts cancel.
fn score_of(a: Row, b: Row, c: Row, d: Row, e: Row, floors: vec3f) -> f32 {
    let total = (a.means + e.means + c.means) + 2.0 * (b.means + d.means + c.means);
    let middle = round(total * (1.0 / 9.0));
    let left = total - 9.0 * middle;
    let means_a = a.means - middle;
    let means_b = b.means - middle;
    let means_c = c.means - middle;
    let means_d = d.means - middle;
    let means_e = e.means - middle;
    var ends = a.squares + e.squares + means_a * means_a + means_e * means_e;
    var inside = b.squares + d.squares + means_b * means_b + means_d * means_d;
    var inmost = c.squares + means_c * means_c;
    var value = (ends + inmost) + 2.0 * (inside + inmost);
    let variances = max((8.0 * value + value) - left * left, vec3f()) + floors;
    ends = a.products + e.products + means_a.xxy * means_a.yzz + means_e.xxy * means_e.yzz;
    inside = b.products + d.products + means_b.xxy * means_b.yzz + means_d.xxy * means_d.yzz;
    inmost = c.products + means_c.xxy * means_c.yzz;
    value = (ends + inmost) + 2.0 * (inside + inmost);
    let joined = (8.0 * value + value) - left.xxy * left.yzz;
    let rho = clamp(joined / sqrt(max(variances.xxy * variances.yzz, vec3f(1.0e-37))), vec3f(-1.0), vec3f(1.0));
    let apart = rho.z - rho.x * rho.y;
    return 1.0 - sqrt(max((1.0 - rho.x * rho.x) * (1.0 - rho.y * rho.y) - apart * apart, 0.0));
}
