// Scores of shifted views.

// ---- sample_y: indexing, shared
// Views read between their rows, at every sub-pixel phase that the layers use; rows beyond the picture are its border.
// One invocation takes `each` neighbours along y, whose taps overlap. Where `whole`, light counts in whole units. `margin`
// columns beside the picture are its border, too.

in planes: array<f32>;  // (planes, h, w), the views first
in phases: array<vec4f>;  // (Ey, 2): four taps; the view
in stats: array<f32>;
out samples: array<f32>;  // (h + 2 pad_y, w + 2 margin, Ey)

fn main(i) {
    let tall = height + 2u * pad_y;
    let pitch = (width + 2u * margin) * phase_count;
    if (i >= ((tall + each - 1u) / each) * pitch) { return; }
    let e = i % phase_count;
    let first = each * (i / pitch);
    let taps = phases[2u * e];
    let x = inside(i32((i % pitch) / phase_count) - i32(margin), width);
    let column = u32(phases[2u * e + 1u].x) * width * height + x;
    let scale = select(1.0, stats[UNIT + 1u], whole);
    var before = vec4f();
    for (var n = 0u; n < each + 3u; n++) {
        let y = i32(first + n) - i32(pad_y) - 1i;
        before = vec4f(before.yzw, scale * planes[column + inside(y, height) * width]);
        let sum = dot(taps, before);
        if (n >= 3u && first + n - 3u < tall) { samples[(first + n - 3u) * pitch + i % pitch] = select(sum, round(sum), whole); }
    }
}

// ---- sample_x: indexing, shared
// The samples of `sample_y` read between their columns: an entry is a view at one phase along x and one along y. One
// invocation takes `each` neighbours along x, whose taps overlap.

in rows: array<f32>;  // (h + 2 pad_y, w, Ey)
in phases: array<vec4f>;  // (E, 2): four taps; the phase along y
out samples: array<f32>;  // (h + 2 pad_y, w + 2 pad_x, E)

fn main(i) {
    let wide = width + 2u * pad_x;
    let count = (wide + each - 1u) / each;  // invocations of a row
    if (i >= (height + 2u * pad_y) * count * entry_count) { return; }
    let e = i % entry_count;
    let first = each * ((i / entry_count) % count);
    let y = i / (entry_count * count);
    let taps = phases[2u * e];
    let row = y * width * phase_count + u32(phases[2u * e + 1u].x);
    var before = vec4f();
    for (var n = 0u; n < each + 3u; n++) {
        let x = i32(first + n) - i32(pad_x) - 1i;
        before = vec4f(before.yzw, rows[row + inside(x, width) * phase_count]);
        let sum = dot(taps, before);
        if (n >= 3u && first + n - 3u < wide) {
            samples[(y * wide + first + n - 3u) * entry_count + e] = select(sum, round(sum), whole);
        }
    }
}

// ---- windows_x: indexing, shared
// Mean and variance of the samples in a window along x: weights decay^|x|, normalised, the picture continued beyond its
// border. Two recursions one after the other (West 1979), forward over the samples, then backward over what it leaves.
// They are of deviations from the mean so far: E[v^2] - E[v]^2 would lose what little texture a bright even area has to
// the rounding of 32 bits. The deviations go out, times sqrt(decay (1 - decay)): with them a covariance of two views
// needs no means of its own (`products_x`). One invocation takes `block` columns; its recursions start `reach`
// beside them as if the picture were even from there on. Deviations fade `reach` columns beyond the right border.

in samples: array<f32>;  // (rows, columns, E)
out windows: array<vec2f>;  // (rows, columns + reach, E): mean, variance
out deviations: array<vec2f>;  // (rows, columns + reach, E): forward, backward

fn joined(state: vec2f, here: vec2f) -> vec2f {
    let apart = here.x - state.x;
    let variance = decay * (state.y + (1.0 - decay) * apart * apart) + (1.0 - decay) * here.y;
    return vec2f(state.x + (1.0 - decay) * apart, variance);
}

fn main(i) {
    let length = columns + reach;
    let blocks = (length + block - 1u) / block;
    if (i >= row_count * blocks * entry_count) { return; }
    let e = i % entry_count;
    let row = i / (blocks * entry_count);
    let first = ((i / entry_count) % blocks) * block;
    let end = min(first + block, length);
    let last = min(end + reach, length) - 1u;
    let start = row * length * entry_count + e;
    var beyond: array<vec2f, reach>;  // the block, of the forward recursion, whose own part waits in `windows`
    let begin = max(first, reach) - reach;
    var state = vec2f(samples[(row * columns + min(begin, columns - 1u)) * entry_count + e], 0.0);
    for (var x = begin; x <= last; x++) {
        let apart = samples[(row * columns + min(x, columns - 1u)) * entry_count + e] - state.x;
        state.x += (1.0 - decay) * apart;
        state.y = decay * (state.y + (1.0 - decay) * apart * apart);
        if (x >= end) {
            beyond[x - end] = state;
        } else if (x >= first) {
            windows[start + x * entry_count] = state;
            deviations[start + x * entry_count].x = deviation_unit * apart;
        }
    }
    for (var x = last + 1u; x > end; x--) { state = joined(state, beyond[x - 1u - end]); }
    for (var x = end; x > first; x--) {
        let at = start + (x - 1u) * entry_count;
        let here = windows[at];
        deviations[at].y = deviation_unit * (here.x - state.x);
        state = joined(state, here);
        windows[at] = state;
    }
}

// ---- windows_y: indexing, shared
// The windows of `windows_x` joined along y in the same way: deviations of the means, and the gain, 1 / standard
// deviation, of every sample. Deviations fade `reach` rows beyond the lower border.

in along_x: array<vec2f>;  // (rows, columns + reach, E): mean, variance
in phases: array<vec4f>;  // (E, 2): four taps; the phase along y
in views: array<vec4f>;  // (Ey, 2): four taps; the view
in stats: array<f32>;
out deviations: array<vec2f>;  // (rows + reach, columns, E): forward, backward
out gains: array<f32>;  // (rows + reach, columns, E)

fn joined(state: vec2f, here: vec2f) -> vec2f {
    let apart = here.x - state.x;
    let variance = decay * (state.y + (1.0 - decay) * apart * apart) + (1.0 - decay) * here.y;
    return vec2f(state.x + (1.0 - decay) * apart, variance);
}

fn main(i) {
    let length = row_count + reach;
    let blocks = (length + block - 1u) / block;
    let pitch = columns * entry_count;
    if (i >= blocks * pitch) { return; }
    let column = i % pitch;
    let first = (i / pitch) * block;
    let end = min(first + block, length);
    let last = min(end + reach, length) - 1u;
    let view = u32(views[2u * u32(phases[2u * (column % entry_count) + 1u].x) + 1u].x);
    let floor_ = relative_epsilon * stats[VARIANCE + view] + 1.0e-30;
    let source_pitch = (columns + reach) * entry_count;
    var beyond: array<vec2f, reach>;  // the block; its own part waits in `deviations` and `gains`
    let begin = max(first, reach) - reach;
    var state = along_x[min(begin, row_count - 1u) * source_pitch + column];
    for (var y = begin; y <= last; y++) {
        let here = along_x[min(y, row_count - 1u) * source_pitch + column];
        let apart = here.x - state.x;
        state = joined(state, here);
        if (y >= end) {
            beyond[y - end] = state;
        } else if (y >= first) {
            deviations[y * pitch + column] = vec2f(deviation_unit * apart, state.x);
            gains[y * pitch + column] = state.y;
        }
    }
    for (var y = last + 1u; y > end; y--) { state = joined(state, beyond[y - 1u - end]); }
    for (var y = end; y > first; y--) {
        let at = (y - 1u) * pitch + column;
        let here = deviations[at];
        deviations[at].y = deviation_unit * (here.y - state.x);
        state = joined(state, vec2f(here.y, gains[at]));
        gains[at] = inverseSqrt(state.y + floor_);
    }
}

// ---- pairs_two
// Two views, four layers at a time: a value of each view, and the one covariance of the pair.
alias Covariances = vec4f;

fn products(of_views: array<vec4f, 2>) -> Covariances {
    return of_views[0] * of_views[1];
}

fn scores_of(covariances: Covariances, gains: Covariances) -> vec4f {
    return clamp(covariances * gains, vec4f(-1.0), vec4f(1.0));
}

// ---- pairs_three
// Three views, four layers at a time: a value of each view, and the covariances of the pairs 01, 02, 12.
alias Covariances = mat3x4f;

fn products(of_views: array<vec4f, 3>) -> Covariances {
    return mat3x4f(of_views[0] * of_views[1], of_views[0] * of_views[2], of_views[1] * of_views[2]);
}

fn scores_of(covariances: Covariances, gains: Covariances) -> vec4f {
    let x = clamp(covariances[0] * gains[0], vec4f(-1.0), vec4f(1.0));
    let y = clamp(covariances[1] * gains[1], vec4f(-1.0), vec4f(1.0));
    let z = clamp(covariances[2] * gains[2], vec4f(-1.0), vec4f(1.0));
    // The determinant 1 + 2 xyz - xx - yy - zz, without the difference of numbers near 1 where all are alike.
    let rest = z - x * y;
    return 1.0 - sqrt(max((1.0 - x) * (1.0 + x) * (1.0 - y) * (1.0 + y) - rest * rest, vec4f()));
}

// ---- products_x: indexing, shared
// Covariances of the views in a window along x, at every layer of a chunk: the recursions of `windows_x`, over
// products of the deviations that it left. One invocation takes four layers in `block` columns.

in deviations: array<vec2f>;  // (h + 2 pad_y, w + 2 pad_x + reach, E)
in places: array<vec4i>;  // (K, 4 Q): entry, whole px along x, along y, 0
out ahead: array<Covariances>;  // (groups, block + reach, 8), of one at a time
out windows: array<Covariances>;  // (h + 2 pad_y, w, Q)

fn main(i) {
    let blocks = (width + block - 1u) / block;
    if (i >= (height + 2u * pad_y) * blocks * quads) { return; }
    let quad = i % quads;
    let row = i / (blocks * quads);
    let first = i32(((i / quads) % blocks) * block);
    let end = min(first + i32(block), i32(width));
    let length = width + 2u * pad_x + reach;
    var starts: array<vec4i, view_count>;  // of the rows of deviations that the layers read
    var columns: array<vec4i, view_count>;
    for (var k = 0u; k < view_count; k++) {
        for (var j = 0u; j < 4u; j++) {
            let place = places[4u * (k * quads + quad) + j];
            starts[k][j] = i32(inside(i32(row) + place.z, height + 2u * pad_y) * length * entry_count) + place.x;
            columns[k][j] = place.y + i32(pad_x);
        }
    }
    let own = (i - i % 8u) * (block + reach) + i % 8u;  // a private array would be set to 0 first
    var state = Covariances();
    for (var x = max(first - i32(reach), -i32(pad_x)); x < end + i32(reach); x++) {
        var forward: array<vec4f, view_count>;
        var backward: array<vec4f, view_count>;
        for (var k = 0u; k < view_count; k++) {
            // Before the first column all is even.
            let at = starts[k] + max(columns[k] + x, vec4i()) * i32(entry_count);
            let a = deviations[at.x];
            let b = deviations[at.y];
            let c = deviations[at.z];
            let d = deviations[at.w];
            forward[k] = vec4f(a.x, b.x, c.x, d.x);
            backward[k] = vec4f(a.y, b.y, c.y, d.y);
        }
        state = decay * state + products(forward);
        if (x >= first) { ahead[own + 8u * u32(x - first)] = (1.0 - decay) * state + products(backward); }
    }
    for (var x = end + i32(reach) - 1i; x >= end; x--) { state = decay * state + ahead[own + 8u * u32(x - first)]; }
    for (var x = end - 1i; x >= first; x--) {
        state = decay * state + ahead[own + 8u * u32(x - first)];
        windows[(row * width + u32(x)) * quads + quad] = state;
    }
}

// ---- correlation: indexing, shared
// The scores of a chunk of layers: covariances joined along y as `windows_y` joins variances, times the gains.
// Two views have their correlation; three have 1 - sqrt(det) of theirs. One invocation takes four layers in `block`
// rows; `keep` leaves the scores.

in covariances: array<Covariances>;  // (h + 2 pad_y, w, Q), along x
in places: array<vec4i>;  // (K, 4 Q): entry, whole px along x, along y, 0
in deviations: array<vec2f>;  // (h + 2 pad_y + reach, w + 2 pad_x, E), along y
in gains: array<f32>;  // (h + 2 pad_y + reach, w + 2 pad_x, E)
out ahead: array<Covariances>;  // (groups, block + reach, 8), of one at a time

fn main(i) {
    let blocks = (height + block - 1u) / block;
    if (i >= width * blocks * quads) { return; }
    let column = i % (width * quads);
    let quad = i % quads;
    let x = column / quads;
    let first = i32((i / (width * quads)) * block);
    let end = min(first + i32(block), i32(height));
    let tall = height + 2u * pad_y;
    let wide = width + 2u * pad_x;
    let row_pitch = i32(wide * entry_count);
    var starts: array<vec4i, view_count>;  // of the columns that the layers read
    var rows: array<vec4i, view_count>;
    for (var k = 0u; k < view_count; k++) {
        for (var j = 0u; j < 4u; j++) {
            let place = places[4u * (k * quads + quad) + j];
            starts[k][j] = i32(inside(i32(x + pad_x) + place.y, wide) * entry_count) + place.x;
            rows[k][j] = place.z + i32(pad_y);
        }
    }
    let column_pitch = width * quads;
    let own = (i - i % 8u) * (block + reach) + i % 8u;
    let begin = max(first - i32(reach), -i32(pad_y));  // before that all is even
    var state = covariances[inside(begin + i32(pad_y), tall) * column_pitch + column];
    for (var y = begin; y < end + i32(reach); y++) {
        var forward: array<vec4f, view_count>;
        var backward: array<vec4f, view_count>;
        for (var k = 0u; k < view_count; k++) {
            // Before the first row all is even.
            let at = starts[k] + max(rows[k] + y, vec4i()) * row_pitch;
            let a = deviations[at.x];
            let b = deviations[at.y];
            let c = deviations[at.z];
            let d = deviations[at.w];
            forward[k] = vec4f(a.x, b.x, c.x, d.x);
            backward[k] = vec4f(a.y, b.y, c.y, d.y);
        }
        let here = covariances[inside(y + i32(pad_y), tall) * column_pitch + column];
        state = decay * state + (1.0 - decay) * here + products(forward);
        if (y >= first) { ahead[own + 8u * u32(y - first)] = (1.0 - decay) * state + products(backward); }
    }
    for (var y = end + i32(reach) - 1i; y >= end; y--) { state = decay * state + ahead[own + 8u * u32(y - first)]; }
    for (var y = end - 1i; y >= first; y--) {
        state = decay * state + ahead[own + 8u * u32(y - first)];
        var gain: array<vec4f, view_count>;
        for (var k = 0u; k < view_count; k++) {
            let at = starts[k] + clamp(rows[k] + y, vec4i(), vec4i(i32(tall) - 1i)) * row_pitch;
            gain[k] = vec4f(gains[at.x], gains[at.y], gains[at.z], gains[at.w]);
        }
        keep(u32(y) * width + x, quad, scores_of(state, products(gain)));
    }
}

// ---- scores_kept
// `correlation` leaves scores as they are.

@group(0) @binding(kept_at) var<storage, read_write> score: array<f32>;  // (h, w, pitch)

fn keep(pixel: u32, quad: u32, found: vec4f) {
    for (var j = 0u; j < 4u; j++) {
        let layer = 4u * quad + j;
        if (layer < layer_count) { score[pixel * pitch + first_layer + layer] = found[j]; }
    }
}

// ---- scores_nats
// `correlation` leaves log-likelihoods, nats. Chunks begin with a multiple of four layers.

@group(0) @binding(kept_at) var<storage, read_write> likelihood: array<vec4f>;  // (h, w, pitch / 4)
@group(0) @binding(kept_at + 1u) var<storage, read> planes: array<f32>;  // the mask is the one behind K + 1 others

fn keep(pixel: u32, quad: u32, found: vec4f) {
    let mask = planes[(view_count + 1u) * width * height + pixel];
    likelihood[(pixel * pitch + first_layer) / 4u + quad] = mask * nats_of(1.0 - found);
}

// ---- scores_weighted
// `correlation` leaves scores times their pixels' weights, and the weights themselves in the maps that are no layer's.

@group(0) @binding(kept_at) var<storage, read_write> score: array<vec4f>;  // (h, w, pitch / 4)
@group(0) @binding(kept_at + 1u) var<storage, read> planes: array<f32>;  // the mask is the one behind K + 1 others

fn keep(pixel: u32, quad: u32, found: vec4f) {
    let weight = max(planes[(view_count + 1u) * width * height + pixel], least_weight);
    let layers = 4u * quad + vec4u(0u, 1u, 2u, 3u);
    score[pixel * pitch / 4u + quad] = weight * select(vec4f(1.0), found, layers < vec4u(layer_count));
    if (layer_count == 4u * quads && quad == 0u) { score[pixel * pitch / 4u + quads] = vec4f(weight); }
}
