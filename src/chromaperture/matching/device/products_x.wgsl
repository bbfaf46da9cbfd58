// Covariances of the views in a window along x, at every layer of a chunk: the recursions of `windows_x.wgsl`, over
// products of the deviations that it left. One invocation takes four layers in `block` columns.

@group(0) @binding(0) var<storage, read> deviations: array<vec2f>;  // (h + 2 pad_y, w + 2 pad_x + reach, E)
@group(0) @binding(1) var<storage, read> places: array<vec4i>;  // (K, 4 Q): entry, whole px along x, along y, 0
@group(0) @binding(2) var<storage, read_write> ahead: array<Covariances>;  // (groups, block + reach, 8), of one at a time
@group(0) @binding(3) var<storage, read_write> windows: array<Covariances>;  // (h + 2 pad_y, w, Q)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
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
