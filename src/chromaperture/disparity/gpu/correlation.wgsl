// The score of every layer of a chunk: windows of the products along y, less the means, over the deviations. Two views
// have their correlation; three have 1 - sqrt(det) of theirs. `recent` holds a block of columns' backward recursion.

@group(0) @binding(0) var<storage, read> products_01: array<f32>;  // (h + 2 pad_y, w, C)
@group(0) @binding(1) var<storage, read> products_02: array<f32>;  // the same three times for two views
@group(0) @binding(2) var<storage, read> products_12: array<f32>;
@group(0) @binding(3) var<storage, read> places: array<i32>;  // (K, C, 4): entry, whole px along x, along y, 0
@group(0) @binding(4) var<storage, read> windows: array<vec2f>;  // (h + 2 pad_y, w + 2 pad_x, E): mean, gain
@group(0) @binding(5) var<storage, read_write> score: array<f32>;  // (h, w, pitch)

fn window_at(view: u32, layer: u32, x: u32, y: u32) -> vec2f {
    let at = 4u * (view * layer_count + layer);
    let column = inside(i32(x) + places[at + 1u] + i32(pad_x), width + 2u * pad_x);
    let row = inside(i32(y) + places[at + 2u] + i32(pad_y), height + 2u * pad_y);
    return windows[(row * (width + 2u * pad_x) + column) * entry_count + u32(places[at])];
}

fn products(x: u32, y: i32, layer: u32) -> vec3f {
    let at = (inside(y + i32(pad_y), height + 2u * pad_y) * width + x) * layer_count + layer;
    var found = vec3f(products_01[at], 0.0, 0.0);
    if (view_count == 3u) { found = vec3f(found.x, products_02[at], products_12[at]); }
    return found;
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
    let norm = (1.0 - decay) / (1.0 + decay);
    var recent: array<vec3f, block>;
    var state = products(x, end - 1i + i32(reach), layer) / (1.0 - decay);
    for (var y = end - 2i + i32(reach); y >= end; y--) { state = products(x, y, layer) + decay * state; }
    for (var y = end - 1i; y >= first; y--) {
        state = products(x, y, layer) + decay * state;
        recent[y - first] = state;
    }
    state = products(x, first - i32(reach), layer) / (1.0 - decay);
    for (var y = first - i32(reach) + 1i; y < first; y++) { state = products(x, y, layer) + decay * state; }
    for (var y = first; y < end; y++) {
        let own = products(x, y, layer);
        state = own + decay * state;
        let moments = (state + recent[y - first] - own) * norm;
        let v0 = window_at(0u, layer, x, u32(y));
        let v1 = window_at(1u, layer, x, u32(y));
        var found = clamp((moments.x - v0.x * v1.x) * v0.y * v1.y, -1.0, 1.0);
        if (view_count == 3u) {
            let v2 = window_at(2u, layer, x, u32(y));
            let r02 = clamp((moments.y - v0.x * v2.x) * v0.y * v2.y, -1.0, 1.0);
            let r12 = clamp((moments.z - v1.x * v2.x) * v1.y * v2.y, -1.0, 1.0);
            let determinant = 1.0 + 2.0 * found * r02 * r12 - found * found - r02 * r02 - r12 * r12;
            found = 1.0 - sqrt(max(determinant, 0.0));
        }
        score[(u32(y) * width + x) * pitch + first_layer + layer] = found;
    }
}
