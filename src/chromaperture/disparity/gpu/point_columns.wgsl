// Transfer functions: the transforms of `point_rows.wgsl` along the columns, of a frequency and its negative at once.

@group(0) @binding(0) var<storage, read> factors: array<vec2f>;  // (tile_px,)
@group(0) @binding(1) var<storage, read> layers: array<vec2f>;
@group(0) @binding(2) var<storage, read> round: array<u32>;
@group(0) @binding(3) var<storage, read> rows: array<vec2f>;  // (layers of a round, tiles, channels, side, kept)
@group(0) @binding(4) var<storage, read_write> transfers: array<vec2f>;  // (..., size, size / 2 + 1)

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    let i = group.x * 64u + local;
    if (i >= kept * kept) { return; }
    let layer = min(round[0] * layers_of_round + group.z, layer_count - 1u);
    let reach = u32(layers[layer].y);
    let x = i % kept;
    let y = i / kept;
    let picture = group.z * pictures + group.y;
    var at = (tile_px - y * reach % tile_px) % tile_px;
    var even = vec2f();
    var odd = vec2f();
    for (var row = 0u; row < 2u * reach + 2u; row++) {
        let here = rows[(picture * side + row) * kept + x];
        let f = factors[at];
        even += here * f.x;
        odd += vec2f(-here.y, here.x) * f.y;
        at += y;
        at = select(at, at - tile_px, at >= tile_px);
    }
    let first = picture * size * (size / 2u + 1u) + x;
    transfers[first + y * (size / 2u + 1u)] = even + odd;
    if (y > 0u) { transfers[first + (size - y) * (size / 2u + 1u)] = even - odd; }
}
