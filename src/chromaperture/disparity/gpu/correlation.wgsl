// The score of every layer of a chunk: covariances joined along y, times the gains. Two views have their correlation;
// three have 1 - sqrt(det) of theirs.

@group(0) @binding(0) var<storage, read> covariances: array<Covariances>;  // (h + 2 pad_y, w, C), along x
@group(0) @binding(1) var<storage, read> places: array<i32>;  // (K, C, 4): entry, whole px along x, along y, 0
@group(0) @binding(2) var<storage, read> along_x: array<vec2f>;  // (h + 2 pad_y, w + 2 pad_x, E): mean, variance
@group(0) @binding(3) var<storage, read> gains: array<f32>;  // (h + 2 pad_y, w + 2 pad_x, E)
@group(0) @binding(4) var<storage, read_write> score: array<f32>;  // (h, w, pitch)

struct Moments {
    means: Means,
    covariances: Covariances,
}

fn followed(state: Moments, next: Moments) -> Moments {
    let apart = next.means - state.means;
    let joined = (1.0 - decay) * next.covariances + decay * (state.covariances + (1.0 - decay) * products(apart));
    return Moments(state.means + (1.0 - decay) * apart, joined);
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    let blocks = (height + block - 1u) / block;
    if (i >= width * blocks * layer_count) { return; }
    let layer = i % layer_count;
    let x = (i / layer_count) % width;
    let first = i32((i / (layer_count * width)) * block);
    let end = min(first + i32(block), i32(height));
    let tall = height + 2u * pad_y;
    let wide = width + 2u * pad_x;
    var starts: array<u32, view_count>;  // of the columns of windows that the layer reads
    var rows: array<i32, view_count>;
    for (var k = 0u; k < view_count; k++) {
        let at = 4u * (k * layer_count + layer);
        starts[k] = inside(i32(x + pad_x) + places[at + 1u], wide) * entry_count + u32(places[at]);
        rows[k] = places[at + 2u] + i32(pad_y);
    }
    var after: array<Moments, block>;
    var state = Moments();
    // Beyond the border of all samples that the views read, all is even.
    let last = min(end + i32(reach), i32(tall) - 1i);
    for (var y = last; y >= first; y--) {
        var here = Moments();
        for (var k = 0u; k < view_count; k++) {
            here.means[k] = along_x[starts[k] + inside(y + rows[k], tall) * wide * entry_count].x;
        }
        here.covariances = covariances[(inside(y + i32(pad_y), tall) * width + x) * layer_count + layer];
        if (y == last) { state = here; }
        if (y < end) { after[y - first] = state; }
        state = followed(state, here);
    }
    let begin = max(first - i32(reach), -2i * i32(pad_y));
    for (var y = begin; y < end; y++) {
        var here = Moments();
        for (var k = 0u; k < view_count; k++) {
            here.means[k] = along_x[starts[k] + inside(y + rows[k], tall) * wide * entry_count].x;
        }
        here.covariances = covariances[(inside(y + i32(pad_y), tall) * width + x) * layer_count + layer];
        if (y == begin) { state = here; }
        state = followed(state, here);
        if (y >= first) {
            let other = after[y - first];
            let joined = (state.covariances + decay * other.covariances) / (1.0 + decay)
                + decay / ((1.0 + decay) * (1.0 + decay)) * products(state.means - other.means);
            var gain = Means();
            for (var k = 0u; k < view_count; k++) {
                gain[k] = gains[starts[k] + inside(y + rows[k], tall) * wide * entry_count];
            }
            score[(u32(y) * width + x) * pitch + first_layer + layer] = score_of(joined * products(gain));
        }
    }
}
