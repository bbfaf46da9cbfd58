// P and Q of the frame: the tiles of the four nodes around a sample, weighted by how near they are.

@group(0) @binding(0) var<storage, read> views: array<vec2f>;  // (layers of a round, tiles, pairs, middle, middle)
// (w, 4) and (h, 4): first node, sample in its tile, its weight, the next one's
@group(0) @binding(1) var<storage, read> across: array<vec4f>;
@group(0) @binding(2) var<storage, read> down: array<vec4f>;
@group(0) @binding(3) var<storage, read> starts: array<f32>;  // (node columns + node rows): first sample of a tile
@group(0) @binding(4) var<storage, read_write> joined: array<vec2f>;  // (layers of a round, pairs, h, w)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= layers_of_round * pair_count * width * height) { return; }
    let x = i % width;
    let y = i / width % height;
    let pair = i / (width * height) % pair_count;
    let layer = i / (width * height * pair_count);
    let u = across[x];
    let v = down[y];
    var sum = vec2f();
    for (var k = 0u; k < 4u; k++) {
        let column = u32(u.x) + (k & 1u);
        let row = u32(v.x) + (k >> 1u);
        let weight = select(u.z, u.w, (k & 1u) == 1u) * select(v.z, v.w, k > 1u);
        if (weight > 0.0) {
            let tile = row * node_columns + column;
            let place = vec2u(u32(f32(x) - starts[column]), u32(f32(y) - starts[node_columns + row]));
            let at = ((layer * tiles + tile) * pair_count + pair) * middle * middle + place.y * middle + place.x;
            sum += weight * views[at];
        }
    }
    joined[i] = sum;
}
