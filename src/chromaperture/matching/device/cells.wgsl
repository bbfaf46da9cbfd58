// Scores and likelihoods in cells of 2 x 2 px.

// ---- cell_planes: indexing, shared
// Views, guide and mask at every second pixel, after which cells are named.

in planes: array<f32>;  // (planes, h, w)
out cells: array<f32>;  // (planes, ceil(h / 2), ceil(w / 2))

fn main(i) {
    if (i >= plane_count * cells_wide * cells_tall) { return; }
    let x = 2u * (i % cells_wide);
    let y = 2u * ((i / cells_wide) % cells_tall);
    cells[i] = planes[(i / (cells_wide * cells_tall)) * width * height + y * width + x];
}

// ---- cells_two
// Sums of two views for `cell_scores`.

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

// ---- cells_three
// Sums of three views for `cell_scores`, as `cells_two`. Every layer has a phase of its own along x here, at which
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

// ---- cell_scores: indexing, shared
// Correlation of the views in a cell's window, of every layer: of two views, or 1 - sqrt(det) of the correlation matrix
// of three. In whole units of light, in which sums are exact; rounded to 1 / score_parts. One invocation takes two
// columns of `cells_each` cells: their windows overlap in rows and in columns.

in samples: array<f32>;  // as `reader_of` reads them
in places: array<vec4i>;  // (K, C): entry, whole px along x, along y, 0
in stats: array<f32>;
out score: array<f32>;  // (cells_tall, cells_wide, D), parts of 1 / score_parts

const wide = width + 2u * pad_x;

fn main(i) {
    let layer = i % layer_count;
    const pairs_wide = (cells_wide + 1u) / 2u;
    let column = 2u * ((i / layer_count) % pairs_wide);
    let first = cells_each * (i / (layer_count * pairs_wide));
    if (first >= cells_tall) { return; }
    let variances = vec3f(stats[VARIANCE], stats[VARIANCE + 1u], stats[VARIANCE + 2u]);
    let added = least_floor + relative_epsilon * stats[UNIT + 1u] * stats[UNIT + 1u] * variances;
    // Of few digits, which are the same whatever the order in which the picture was summed up.
    let floors = bitcast<vec3f>(bitcast<vec3u>(added) & vec3u(0xfff00000u));
    let reader = reader_of(layer, 2u * column, 2u * first);
    var a = row_sums(reader, 0u);
    var b = row_sums(reader, 1u);
    var c = row_sums(reader, 2u);
    for (var n = 0u; n < min(cells_each, cells_tall - first); n++) {
        let d = row_sums(reader, 2u * n + 3u);
        let e = row_sums(reader, 2u * n + 4u);
        let at = ((first + n) * cells_wide + column) * all_layers + first_layer + layer;
        score[at] = round(f32(score_parts) * score_of(a.left, b.left, c.left, d.left, e.left, floors));
        if (column + 1u < cells_wide) {
            let found = score_of(a.right, b.right, c.right, d.right, e.right, floors);
            score[at + all_layers] = round(f32(score_parts) * found);
        }
        a = c;
        b = d;
        c = e;
    }
}

// ---- own_sign: indexing, shared
// Cells whose strongest score is negative count by that sign: `readable/correlation.py`, `of_own_sign`.

out score: array<f32>;  // (cells, all_layers), parts of 1 / score_parts

fn main(group, groups, local) {
    let cell = invocation(group, groups, local);
    if (cell >= cell_count) { return; }
    let start = cell * all_layers;
    var least = score[start];
    var most = least;
    for (var i = 1u; i < all_layers; i++) {
        least = min(least, score[start + i]);
        most = max(most, score[start + i]);
    }
    if (least < -contrary && least < -most) {
        for (var i = 0u; i < all_layers; i++) { score[start + i] = -score[start + i]; }
    }
}

// ---- nats
// The log-likelihood by what scores leave of 1, nats: of 1 - s, -ln(1 - s^2) / 2 of two views, -ln(1 - s) of three;
// rounded to 1 / nat_parts.

// Of normal positive numbers: the exponent, and a polynomial for the mantissa in [1, 2), as the CPU takes it. A device's
// own logarithm may be wrong by more than is rounded off.
fn logarithm(a: vec4f) -> vec4f {
    let bits = bitcast<vec4u>(a);
    let exponent = vec4f(bits >> vec4u(23u)) - 127.0;
    let t = bitcast<vec4f>((bits & vec4u(0x7fffffu)) | vec4u(0x3f800000u)) - 1.5;
    var value = vec4f(logarithm_terms[0]);
    for (var k = 1u; k < logarithm_count; k++) { value = value * t + logarithm_terms[k]; }
    return exponent * 0.6931471805599453 + value;
}

fn nats_of(unexplained: vec4f) -> vec4f {
    let clipped = clamp(unexplained, vec4f(), vec4f(1.0));
    var determinant = clipped * (2.0 - clipped);
    if (view_count == 3u) { determinant = clipped * clipped; }
    let nats = -0.5 * logarithm(max(determinant, vec4f(least_determinant)));
    return round(f32(nat_parts) * nats) / f32(nat_parts);
}

// ---- half_labels
// Labels of equal depth at a pixel of the halved picture or at a cell of it, every `label_spacing` px of the full one:
// offset in px of the halved one, scale; `labels` has those of the full one.

fn half_label(x: u32, y: u32) -> vec2f {
    if (!labelled) { return vec2f(0.0, 1.0); }
    let at = label_spacing * (y * full_width + x);
    return vec2f(labels[at] / 2.0, labels[full_width * full_height + at]);
}

// ---- label_likelihood: indexing, shared, half_labels, nats
// Scores to log-likelihoods, nats, at labels on and between the layers, of equal depth: by polynomials
// through six layers.

in score: array<f32>;  // (cells, all_layers), parts of 1 / score_parts
in labels: array<f32>;  // (2, H, W): offset, scale; or (2, 1, 1)
in planes: array<f32>;  // of the cells; the mask is the one behind K + 1 others
out likelihood: array<vec4f>;  // (cells, pitch / 4)

// What a score leaves of 1: of whole numbers, so that next to a score of 1 nothing is rounded off.
fn unexplained(at: u32) -> f32 {
    return (f32(score_parts) - score[at]) * (1.0 / f32(score_parts));
}

// The same up to two layers beyond either end, on the parabola through the three outermost layers.
fn continued(start: u32, layer: i32) -> f32 {
    let last = i32(all_layers) - 1i;
    if (layer >= 0i && layer <= last) { return unexplained(start + u32(layer)); }
    let end = select(start + u32(last), start, layer < 0i);
    let inwards = select(-1i, 1i, layer < 0i);
    let first = unexplained(end);
    let second = unexplained(u32(i32(end) + inwards));
    let beyond = 3.0 * (first - second) + unexplained(u32(i32(end) + 2i * inwards));
    return select(3.0 * (beyond - first) + second, beyond, layer == -1i || layer == last + 1i);
}

fn main(i) {
    if (i >= width * height * pitch / 4u) { return; }
    let cell = i / (pitch / 4u);
    let start = cell * all_layers;
    let label = half_label(cell % width, cell / width);
    let begin = (fma(label.y, first_px, label.x) - first_px) / layer_step_px;
    let mask = planes[(view_count + 1u) * width * height + cell];
    var values = vec4f(1.0);  // labels that only fill the last vector stay without a likelihood
    for (var j = 0u; j < 4u; j++) {
        let n = 4u * (i % (pitch / 4u)) + j;
        if (n >= label_count) { continue; }
        // In the CPU's order, eight layers at a time: what is rounded off decides between two log-likelihoods.
        let layer = n / parts;
        let start_of_eight = fma(label.y, f32(layer / 8u * 8u), begin + f32(n % parts) * (label.y / f32(parts)));
        let place = start_of_eight + label.y * f32(layer % 8u);
        let below = clamp(i32(floor(place)), 0i, i32(all_layers) - 2i);
        let t = fma(f32(layer % 8u), label.y - 1.0, start_of_eight - (f32(below) - f32(layer % 8u)));
        let low = unexplained(start + u32(below));
        let high = unexplained(start + u32(below) + 1u);
        let inner = fma(t, high - low, low);
        let middle = fma(2.0 - t, continued(start, below - 1i),
            (1.0 + t) * continued(start, below + 2i));
        let outer = fma(3.0 - t, continued(start, below - 2i),
            (2.0 + t) * continued(start, below + 3i));
        let a = t * (t - 1.0);
        let b = a - 2.0;
        let inside_four = fma(-(a * (1.0 / 24.0)), middle, b * (1.0 / 12.0) * inner);
        let value = fma(a - 6.0, inside_four, a * (b * (1.0 / 120.0)) * outer);
        values[j] = select(value, 1.0, place < 0.0 || place > f32(all_layers - 1u));
    }
    likelihood[i] = mask * nats_of(values);
}

// ---- cells_enlarged: indexing, shared, between
// The surface of the cells at every pixel of the halved picture, by `between`.

in surface: array<vec4f>;  // (half_height, half_width)
in guide: array<f32>;  // (h, w)
in stats: array<f32>;
out enlarged: array<vec4f>;  // (h, w): disparity, sigma, peak, nothing

fn main(i) {
    if (i >= width * height) { return; }
    enlarged[i] = vec4f(surface_at(i % width, i / width), 0.0);
}
