// Windows along x of the product of two views, at every layer of a chunk. See `windows_x.wgsl`.

@group(0) @binding(0) var<storage, read> samples: array<f32>;  // (h + 2 pad_y, w + 2 pad_x, E)
@group(0) @binding(1) var<storage, read> places: array<i32>;  // (K, C, 4): entry, whole px along x, along y, 0
@group(0) @binding(2) var<storage, read_write> windows: array<f32>;  // (h + 2 pad_y, w, C)

fn sample_at(place: vec3i, x: i32, y: i32) -> f32 {
    let column = inside(x + place.y + i32(pad_x), width + 2u * pad_x);
    let row = inside(y + place.z + i32(pad_y), height + 2u * pad_y);
    return samples[(row * (width + 2u * pad_x) + column) * entry_count + u32(place.x)];
}

fn place_of(view: u32, layer: u32) -> vec3i {
    let at = 4u * (view * layer_count + layer);
    return vec3i(places[at], places[at + 1u], places[at + 2u]);
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
    let y = i32(row) - i32(pad_y);
    let first = i32(((i / layer_count) % blocks) * block);
    let end = min(first + i32(block), i32(width));
    let a = place_of(first_view, layer);
    let b = place_of(second_view, layer);
    let after = end - 1i + i32(reach);
    var state = sample_at(a, after, y) * sample_at(b, after, y) / (1.0 - decay);
    for (var x = after - 1i; x >= end; x--) { state = sample_at(a, x, y) * sample_at(b, x, y) + decay * state; }
    for (var x = end - 1i; x >= first; x--) {
        state = sample_at(a, x, y) * sample_at(b, x, y) + decay * state;
        windows[(row * width + u32(x)) * layer_count + layer] = state;
    }
    let before = first - i32(reach);
    state = sample_at(a, before, y) * sample_at(b, before, y) / (1.0 - decay);
    for (var x = before + 1i; x < first; x++) { state = sample_at(a, x, y) * sample_at(b, x, y) + decay * state; }
    for (var x = first; x < end; x++) {
        let own = sample_at(a, x, y) * sample_at(b, x, y);
        let at = (row * width + u32(x)) * layer_count + layer;
        state = own + decay * state;
        windows[at] = (state + windows[at] - own) * ((1.0 - decay) / (1.0 + decay));
    }
}
