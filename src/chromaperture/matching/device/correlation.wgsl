// The scores of a chunk of layers: covariances joined along y as `windows_y.wgsl` joins variances, times the gains.
// Two views have their correlation; three have 1 - sqrt(det) of theirs. One invocation takes four layers in `block`
// rows; `keep` leaves the scores.

@group(0) @binding(0) var<storage, read> covariances: array<Covariances>;  // (h + 2 pad_y, w, Q), along x
@group(0) @binding(1) var<storage, read> places: array<vec4i>;  // (K, 4 Q): entry, whole px along x, along y, 0
@group(0) @binding(2) var<storage, read> deviations: array<vec2f>;  // (h + 2 pad_y + reach, w + 2 pad_x, E), along y
@group(0) @binding(3) var<storage, read> gains: array<f32>;  // (h + 2 pad_y + reach, w + 2 pad_x, E)
@group(0) @binding(4) var<storage, read_write> ahead: array<Covariances>;  // (groups, block + reach, 8), of one at a time

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    let blocks = (height + block - 1u) / block;
    if (i >= width * blocks * quads) { return; }
    let column = i % (width * quads);
    let quad = i % quads;
    let x = column / quads;
    let first = i32((i / (width * quads)) * block);
    let end = min(first + i32(block), i32(height));
    let tall = height + 2u * pad_y;
    let wide = width + 2u * pad_x;
    let row_pitch = i32(wide * entry_count);
    var starts: array<vec4i, view_count>;  // of the columns that the layers read
    var rows: array<vec4i, view_count>;
    for (var k = 0u; k < view_count; k++) {
        for (var j = 0u; j < 4u; j++) {
            let place = places[4u * (k * quads + quad) + j];
            starts[k][j] = i32(inside(i32(x + pad_x) + place.y, wide) * entry_count) + place.x;
            rows[k][j] = place.z + i32(pad_y);
        }
    }
    let column_pitch = width * quads;
    let own = (i - i % 8u) * (block + reach) + i % 8u;
    let begin = max(first - i32(reach), -i32(pad_y));  // before that all is even
    var state = covariances[inside(begin + i32(pad_y), tall) * column_pitch + column];
    for (var y = begin; y < end + i32(reach); y++) {
        var forward: array<vec4f, view_count>;
        var backward: array<vec4f, view_count>;
        for (var k = 0u; k < view_count; k++) {
            // Before the first row all is even.
            let at = starts[k] + max(rows[k] + y, vec4i()) * row_pitch;
            let a = deviations[at.x];
            let b = deviations[at.y];
            let c = deviations[at.z];
            let d = deviations[at.w];
            forward[k] = vec4f(a.x, b.x, c.x, d.x);
            backward[k] = vec4f(a.y, b.y, c.y, d.y);
        }
        let here = covariances[inside(y + i32(pad_y), tall) * column_pitch + column];
        state = decay * state + (1.0 - decay) * here + products(forward);
        if (y >= first) { ahead[own + 8u * u32(y - first)] = (1.0 - decay) * state + products(backward); }
    }
    for (var y = end + i32(reach) - 1i; y >= end; y--) { state = decay * state + ahead[own + 8u * u32(y - first)]; }
    for (var y = end - 1i; y >= first; y--) {
        state = decay * state + ahead[own + 8u * u32(y - first)];
        var gain: array<vec4f, view_count>;
        for (var k = 0u; k < view_count; k++) {
            let at = starts[k] + clamp(rows[k] + y, vec4i(), vec4i(i32(tall) - 1i)) * row_pitch;
            gain[k] = vec4f(gains[at.x], gains[at.y], gains[at.z], gains[at.w]);
        }
        keep(u32(y) * width + x, quad, scores_of(state, products(gain)));
    }
}
