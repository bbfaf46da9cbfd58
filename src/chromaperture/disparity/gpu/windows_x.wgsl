// Windows of the samples and of their squares along x: weights decay^|x|, normalised, the picture continued beyond its
// border. One invocation takes `block` columns; its recursions start `reach` before them as if the picture were even
// from there on, which leaves the sum of the weights at 1.

@group(0) @binding(0) var<storage, read> samples: array<f32>;  // (rows, columns, E)
@group(0) @binding(1) var<storage, read_write> windows: array<vec2f>;  // (rows, columns, E): of value and square

fn value(row: u32, x: i32, e: u32) -> vec2f {
    let found = samples[(row * columns + inside(x, columns)) * entry_count + e];
    return vec2f(found, found * found);
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
    var state = value(row, end - 1i + i32(reach), e) / (1.0 - decay);
    for (var x = end - 2i + i32(reach); x >= end; x--) { state = value(row, x, e) + decay * state; }
    for (var x = end - 1i; x >= first; x--) {
        state = value(row, x, e) + decay * state;
        windows[(row * columns + u32(x)) * entry_count + e] = state;
    }
    state = value(row, first - i32(reach), e) / (1.0 - decay);
    for (var x = first - i32(reach) + 1i; x < first; x++) { state = value(row, x, e) + decay * state; }
    for (var x = first; x < end; x++) {
        let own = value(row, x, e);
        let at = (row * columns + u32(x)) * entry_count + e;
        state = own + decay * state;
        windows[at] = (state + windows[at] - own) * ((1.0 - decay) / (1.0 + decay));
    }
}
