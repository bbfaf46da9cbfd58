// As `products_x.wgsl` for rasterisers in software, where what takes time is to read and write arrays: one invocation
// takes a whole row of four layers that are 1 px apart, of which it reads one new deviation a step (`slides.wgsl`).

@group(0) @binding(0) var<storage, read> deviations: array<vec2f>;  // (h + 2 pad_y, w + 2 pad_x + reach, E)
@group(0) @binding(1) var<storage, read> places: array<vec4i>;  // (K, 4 Q): entry, whole px along x, along y, 0
@group(0) @binding(2) var<storage, read_write> ahead: array<Covariances>;  // (groups, w + pad_x, 8), of one at a time
@group(0) @binding(3) var<storage, read_write> windows: array<Covariances>;  // (h + 2 pad_y, w, Q)

struct Deviations {
    forward: array<vec4f, view_count>,
    backward: array<vec4f, view_count>,
}

fn next_of(before: Deviations, starts: array<vec4i, view_count>, columns: array<vec4i, view_count>, x: i32) -> Deviations {
    var found = before;
    for (var k = 0u; k < view_count; k++) {  // unrolled
        let at = starts[k] + max(columns[k] + x, vec4i()) * i32(entry_count);  // before the first column all is even
        var forward = vec4f();
        var backward = vec4f();
        if (slides_x[k] == 0.0 && slides_y[k] != 0.0) {
            for (var j = 0u; j < 4u; j++) {  // unrolled
                let read = deviations[at[j]];
                forward[j] = read.x;
                backward[j] = read.y;
            }
        } else {
            let read = deviations[select(at.x, at.w, slides_x[k] > 0.0)];
            forward = vec4f(read.x);
            backward = vec4f(read.y);
        }
        found.forward[k] = slid(before.forward[k], forward, slides_x[k]);
        found.backward[k] = slid(before.backward[k], backward, slides_x[k]);
    }
    return found;
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= (height + 2u * pad_y) * quads) { return; }
    let quad = i % quads;
    let row = i / quads;
    let length = width + 2u * pad_x + reach;
    var starts: array<vec4i, view_count>;  // of the rows of deviations that the layers read
    var columns: array<vec4i, view_count>;
    for (var k = 0u; k < view_count; k++) {  // unrolled
        for (var j = 0u; j < 4u; j++) {  // unrolled
            let place = places[4u * (k * quads + quad) + j];
            starts[k][j] = i32(inside(i32(row) + place.z, height + 2u * pad_y) * length * entry_count) + place.x;
            columns[k][j] = place.y + i32(pad_x);
        }
    }
    let own = (i - i % 8u) * (width + pad_x) + i % 8u;
    var state = Covariances();
    var apart = Deviations();
    for (var x = -i32(pad_x); x < 0i; x++) {
        apart = next_of(apart, starts, columns, x);
        state = decay * state + products(apart.forward);
    }
    for (var x = 0i; x < i32(width + pad_x); x++) {
        apart = next_of(apart, starts, columns, x);
        state = decay * state + products(apart.forward);
        ahead[own + 8u * u32(x)] = (1.0 - decay) * state + products(apart.backward);
    }
    apart = next_of(apart, starts, columns, i32(width + pad_x));
    state = of_state * state + of_apart * products(apart.forward);
    for (var x = width + pad_x; x > width; x--) { state = decay * state + ahead[own + 8u * (x - 1u)]; }
    for (var x = width; x > 0u; x--) {
        state = decay * state + ahead[own + 8u * (x - 1u)];
        windows[(row * width + x - 1u) * quads + quad] = state;
    }
}
