// The windows of `windows_x.wgsl` joined along y, and from them the gain, 1 / standard deviation, of every sample.

@group(0) @binding(0) var<storage, read> along_x: array<vec2f>;  // (rows, columns, E): mean, variance
@group(0) @binding(1) var<storage, read> phases: array<f32>;  // (E, 5)
@group(0) @binding(2) var<storage, read> views: array<f32>;  // (Ey, 5): the view of each phase along y is the last
@group(0) @binding(3) var<storage, read> stats: array<f32>;
@group(0) @binding(4) var<storage, read_write> gains: array<f32>;  // (rows, columns, E)

fn value(x: u32, y: i32, e: u32) -> vec2f {
    return along_x[(inside(y, row_count) * columns + x) * entry_count + e];
}

fn followed(state: vec2f, next: vec2f) -> vec2f {
    let apart = next.x - state.x;
    let variance = (1.0 - decay) * next.y + decay * (state.y + (1.0 - decay) * apart * apart);
    return vec2f(state.x + (1.0 - decay) * apart, variance);
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    let blocks = (row_count + block - 1u) / block;
    if (i >= columns * blocks * entry_count) { return; }
    let e = i % entry_count;
    let x = (i / entry_count) % columns;
    let first = i32((i / (entry_count * columns)) * block);
    let end = min(first + i32(block), i32(row_count));
    let view = u32(views[5u * u32(phases[5u * e + 4u]) + 4u]);
    let floor_ = relative_epsilon * stats[VARIANCE + view] + 1.0e-30;
    var after: array<vec2f, block>;
    let last = min(end + i32(reach), i32(row_count) - 1i);
    var state = value(x, last, e);
    for (var y = last - 1i; y >= end; y--) { state = followed(state, value(x, y, e)); }
    for (var y = end - 1i; y >= first; y--) {
        after[y - first] = state;
        state = followed(state, value(x, y, e));
    }
    let begin = max(first - i32(reach), 0i);
    state = value(x, begin, e);
    for (var y = begin + 1i; y < first; y++) { state = followed(state, value(x, y, e)); }
    for (var y = first; y < end; y++) {
        state = followed(state, value(x, y, e));
        let other = after[y - first];
        let apart = state.x - other.x;
        let variance = (state.y + decay * other.y) / (1.0 + decay)
            + decay / ((1.0 + decay) * (1.0 + decay)) * apart * apart;
        gains[(u32(y) * columns + x) * entry_count + e] = inverseSqrt(variance + floor_);
    }
}
