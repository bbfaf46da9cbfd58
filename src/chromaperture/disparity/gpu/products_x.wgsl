// Covariances of the views in a window along x, at every layer of a chunk; see `windows_x.wgsl` for the recursion.

@group(0) @binding(0) var<storage, read> samples: array<f32>;  // (h + 2 pad_y, w + 2 pad_x, E)
@group(0) @binding(1) var<storage, read> places: array<i32>;  // (K, C, 4): entry, whole px along x, along y, 0
@group(0) @binding(2) var<storage, read_write> windows: array<Covariances>;  // (h + 2 pad_y, w, C)

struct Moments {
    means: Means,
    covariances: Covariances,
}

fn followed(state: Moments, next: Means) -> Moments {
    let apart = next - state.means;
    let covariances = decay * (state.covariances + (1.0 - decay) * products(apart));
    return Moments(state.means + (1.0 - decay) * apart, covariances);
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    let blocks = (width + block - 1u) / block;
    if (i >= (height + 2u * pad_y) * blocks * layer_count) { return; }
    let layer = i % layer_count;
    let row = i / (blocks * layer_count);
    let first = i32(((i / layer_count) % blocks) * block);
    let end = min(first + i32(block), i32(width));
    let wide = width + 2u * pad_x;
    var starts: array<u32, view_count>;  // of the rows of samples that the layer reads
    var columns: array<i32, view_count>;
    for (var k = 0u; k < view_count; k++) {
        let at = 4u * (k * layer_count + layer);
        starts[k] = inside(i32(row) + places[at + 2u], height + 2u * pad_y) * wide * entry_count + u32(places[at]);
        columns[k] = places[at + 1u] + i32(pad_x);
    }
    var after: array<Moments, block>;
    var state = Moments();
    // Beyond the border of all samples that the views read, all is even.
    let last = min(end + i32(reach), i32(wide) - 1i);
    for (var x = last; x >= first; x--) {
        var here = Means();
        for (var k = 0u; k < view_count; k++) { here[k] = samples[starts[k] + inside(x + columns[k], wide) * entry_count]; }
        if (x == last) { state.means = here; }
        if (x < end) { after[x - first] = state; }
        state = followed(state, here);
    }
    state = Moments();
    let begin = max(first - i32(reach), -2i * i32(pad_x));
    for (var x = begin; x < end; x++) {
        var here = Means();
        for (var k = 0u; k < view_count; k++) { here[k] = samples[starts[k] + inside(x + columns[k], wide) * entry_count]; }
        if (x == begin) { state.means = here; }
        state = followed(state, here);
        if (x >= first) {
            let other = after[x - first];
            windows[(row * width + u32(x)) * layer_count + layer] =
                (state.covariances + decay * other.covariances) / (1.0 + decay)
                + decay / ((1.0 + decay) * (1.0 + decay)) * products(state.means - other.means);
        }
    }
}
