// Mean and variance of the samples in a window along x: weights decay^|x|, normalised, the picture continued beyond its
// border. The recursion (West 1979) is of deviations from the mean so far: E[v^2] - E[v]^2 would lose what little
// texture a bright even area has to the rounding of 32 bits. The samples up to a pixel and those after it are two
// groups, whose moments are joined. One invocation takes `block` columns; its recursions start `reach` before them as if
// the picture were even from there on.

@group(0) @binding(0) var<storage, read> samples: array<f32>;  // (rows, columns, E)
@group(0) @binding(1) var<storage, read_write> windows: array<vec2f>;  // (rows, columns, E): mean, variance

fn value(row: u32, x: i32, e: u32) -> f32 {
    return samples[(row * columns + inside(x, columns)) * entry_count + e];
}

fn followed(state: vec2f, next: f32) -> vec2f {
    let apart = next - state.x;
    return vec2f(state.x + (1.0 - decay) * apart, decay * (state.y + (1.0 - decay) * apart * apart));
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    let blocks = (columns + block - 1u) / block;
    if (i >= row_count * blocks * entry_count) { return; }
    let e = i % entry_count;
    let row = i / (blocks * entry_count);
    let first = i32(((i / entry_count) % blocks) * block);
    let end = min(first + i32(block), i32(columns));
    // Beyond the border all is even: nothing is gained by starting there.
    let last = min(end + i32(reach), i32(columns) - 1i);
    var state = vec2f(value(row, last, e), 0.0);
    for (var x = last - 1i; x >= end; x--) { state = followed(state, value(row, x, e)); }
    for (var x = end - 1i; x >= first; x--) {
        windows[(row * columns + u32(x)) * entry_count + e] = state;  // of what comes after the pixel
        state = followed(state, value(row, x, e));
    }
    let begin = max(first - i32(reach), 0i);
    state = vec2f(value(row, begin, e), 0.0);
    for (var x = begin + 1i; x < first; x++) { state = followed(state, value(row, x, e)); }
    for (var x = first; x < end; x++) {
        let at = (row * columns + u32(x)) * entry_count + e;
        state = followed(state, value(row, x, e));
        let after = windows[at];
        let apart = state.x - after.x;
        windows[at] = (state + decay * after) / (1.0 + decay)
            + vec2f(0.0, decay / ((1.0 + decay) * (1.0 + decay)) * apart * apart);
    }
}
