// As `correlation.wgsl` for rasterisers in software, where what takes time is to read and write arrays: one invocation
// takes whole columns of four layers that are 1 px apart (`slides.wgsl`), four columns side by side. Where the layers are
// apart along x, seven deviations of a view serve all sixteen scores of a row, in place of 64.

@group(0) @binding(0) var<storage, read> covariances: array<Covariances>;  // (h + 2 pad_y, w, Q), along x
@group(0) @binding(1) var<storage, read> places: array<vec4i>;  // (K, 4 Q): entry, whole px along x, along y, 0
@group(0) @binding(2) var<storage, read> deviations: array<vec2f>;  // (h + 2 pad_y + reach, w + 2 pad_x, E), along y
@group(0) @binding(3) var<storage, read> gains: array<f32>;  // (h + 2 pad_y + reach, w + 2 pad_x, E)
@group(0) @binding(4) var<storage, read_write> ahead: array<Covariances>;  // (groups, h + pad_y, 4, 8), of one at a time

const side = 4u;  // columns, and layers

// What one view has for the columns and layers of an invocation. Views have names, no places in an array: a loop over
// them would be too long to be unrolled.
struct Read {
    forward: array<vec4f, side>,
    backward: array<vec4f, side>,
}

// Where a view is read.
struct Way {
    first: i32,  // by the first column's first layer, in row 0
    row_first: i32,  // of the first and of the last layer, at y = 0
    row_last: i32,
}

fn way_of(view: u32, quad: u32, x: u32) -> Way {
    let first = places[4u * (view * quads + quad)];
    let last = places[4u * (view * quads + quad) + 3u];
    let column = i32(x + pad_x) + min(first.y, last.y);
    return Way(column * i32(entry_count) + first.x, first.z + i32(pad_y), last.z + i32(pad_y));
}

fn place_of(way: Way, y: i32, of_last: bool) -> i32 {
    let row = max(select(way.row_first, way.row_last, of_last) + y, 0i);  // before the first row all is even
    return way.first + row * i32((width + 2u * pad_x) * entry_count);
}

// One row further down.
fn next_of(before: Read, way: Way, y: i32, slide_x: f32, slide_y: f32) -> Read {
    let at = place_of(way, y, slide_y > 0.0);
    var found: Read;
    if (slide_x != 0.0) {
        var read: array<vec2f, 7>;
        for (var n = 0u; n < 7u; n++) {  // unrolled
            read[n] = deviations[at + i32(n * entry_count)];
        }
        for (var p = 0u; p < 4u; p++) {  // unrolled
            let forward = vec4f(read[p].x, read[p + 1u].x, read[p + 2u].x, read[p + 3u].x);
            let backward = vec4f(read[p].y, read[p + 1u].y, read[p + 2u].y, read[p + 3u].y);
            found.forward[p] = select(forward.wzyx, forward, slide_x > 0.0);
            found.backward[p] = select(backward.wzyx, backward, slide_x > 0.0);
        }
        return found;
    }
    for (var p = 0u; p < 4u; p++) {  // unrolled
        let read = deviations[at + i32(p * entry_count)];
        found.forward[p] = slid(before.forward[p], vec4f(read.x), slide_y);
        found.backward[p] = slid(before.backward[p], vec4f(read.y), slide_y);
    }
    return found;
}

// One row further up.
fn gains_of(before: array<vec4f, side>, way: Way, y: i32, slide_x: f32, slide_y: f32) -> array<vec4f, side> {
    let at = place_of(way, y, slide_y < 0.0);
    var found: array<vec4f, side>;
    if (slide_x != 0.0) {
        var read: array<f32, 7>;
        for (var n = 0u; n < 7u; n++) {  // unrolled
            read[n] = gains[at + i32(n * entry_count)];
        }
        for (var p = 0u; p < 4u; p++) {  // unrolled
            let gain = vec4f(read[p], read[p + 1u], read[p + 2u], read[p + 3u]);
            found[p] = select(gain.wzyx, gain, slide_x > 0.0);
        }
        return found;
    }
    for (var p = 0u; p < 4u; p++) {  // unrolled
        found[p] = slid(before[p], vec4f(gains[at + i32(p * entry_count)]), -slide_y);
    }
    return found;
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= (width + side - 1u) / side * quads) { return; }
    let quad = i % quads;
    let x = side * (i / quads);
    let column_pitch = width * quads;
    let column = x * quads + quad;
    let of_a = way_of(0u, quad, x);
    let of_b = way_of(1u, quad, x);
    var of_c = Way();
    if (view_count == 3u) { of_c = way_of(2u, quad, x); }
    let lines = height + pad_y;
    let own = (i - i % 8u) * lines * side + i % 8u;
    var state: array<Covariances, side>;
    for (var p = 0u; p < 4u; p++) {  // unrolled
        state[p] = covariances[column + p * quads];
    }
    var a: Read;
    var b: Read;
    var c: Read;
    for (var y = -i32(pad_y); y < 0i; y++) {
        a = next_of(a, of_a, y, slides_x[0], slides_y[0]);
        b = next_of(b, of_b, y, slides_x[1], slides_y[1]);
        if (view_count == 3u) { c = next_of(c, of_c, y, slides_x[2], slides_y[2]); }
        for (var p = 0u; p < 4u; p++) {  // unrolled
            let here = covariances[u32(y + i32(pad_y)) * column_pitch + column + p * quads];
            state[p] = decay * state[p] + (1.0 - decay) * here + products_of(a.forward[p], b.forward[p], c.forward[p]);
        }
    }
    for (var y = 0u; y < lines; y++) {
        a = next_of(a, of_a, i32(y), slides_x[0], slides_y[0]);
        b = next_of(b, of_b, i32(y), slides_x[1], slides_y[1]);
        if (view_count == 3u) { c = next_of(c, of_c, i32(y), slides_x[2], slides_y[2]); }
        for (var p = 0u; p < 4u; p++) {  // unrolled
            let here = covariances[(y + pad_y) * column_pitch + column + p * quads];
            state[p] = decay * state[p] + (1.0 - decay) * here + products_of(a.forward[p], b.forward[p], c.forward[p]);
            let backward = products_of(a.backward[p], b.backward[p], c.backward[p]);
            ahead[own + 8u * (y * side + p)] = (1.0 - decay) * state[p] + backward;
        }
    }
    a = next_of(a, of_a, i32(lines), slides_x[0], slides_y[0]);
    b = next_of(b, of_b, i32(lines), slides_x[1], slides_y[1]);
    if (view_count == 3u) { c = next_of(c, of_c, i32(lines), slides_x[2], slides_y[2]); }
    for (var p = 0u; p < 4u; p++) {  // unrolled
        let here = covariances[(lines + pad_y - 1u) * column_pitch + column + p * quads];
        let apart = products_of(a.forward[p], b.forward[p], c.forward[p]);
        state[p] = of_state * state[p] + of_own * here + of_apart * apart;
    }
    for (var y = lines; y > height; y--) {
        for (var p = 0u; p < 4u; p++) {  // unrolled
            state[p] = decay * state[p] + ahead[own + 8u * ((y - 1u) * side + p)];
        }
    }
    var gain_a: array<vec4f, side>;
    var gain_b: array<vec4f, side>;
    var gain_c: array<vec4f, side>;
    for (var y = height + 3u; y > height; y--) {  // fills what slides
        gain_a = gains_of(gain_a, of_a, i32(y) - 1i, slides_x[0], slides_y[0]);
        gain_b = gains_of(gain_b, of_b, i32(y) - 1i, slides_x[1], slides_y[1]);
        if (view_count == 3u) { gain_c = gains_of(gain_c, of_c, i32(y) - 1i, slides_x[2], slides_y[2]); }
    }
    for (var y = height; y > 0u; y--) {
        gain_a = gains_of(gain_a, of_a, i32(y) - 1i, slides_x[0], slides_y[0]);
        gain_b = gains_of(gain_b, of_b, i32(y) - 1i, slides_x[1], slides_y[1]);
        if (view_count == 3u) { gain_c = gains_of(gain_c, of_c, i32(y) - 1i, slides_x[2], slides_y[2]); }
        for (var p = 0u; p < 4u; p++) {  // unrolled
            state[p] = decay * state[p] + ahead[own + 8u * ((y - 1u) * side + p)];
            let gain = products_of(gain_a[p], gain_b[p], gain_c[p]);
            if (x + p < width) { keep((y - 1u) * width + x + p, quad, scores_of(state[p], gain)); }
        }
    }
}
