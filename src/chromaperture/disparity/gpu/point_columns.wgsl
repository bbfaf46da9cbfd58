// Transfer functions: the transforms of `point_rows.wgsl` along the columns, of frequencies and their negatives at once.
// An invocation has four frequencies, which share what is read.

@group(0) @binding(0) var<storage, read> factors: array<vec2f>;  // (tile_px,)
@group(0) @binding(1) var<storage, read> layers: array<vec2f>;
@group(0) @binding(2) var<storage, read> round: array<u32>;
@group(0) @binding(3) var<storage, read> rows: array<vec2f>;  // (layers of a round, tiles, channels, side, kept)
@group(0) @binding(4) var<storage, read_write> transfers: array<vec2f>;  // (..., size, size / 2 + 1)

const fours = (kept + 3u) / 4u;

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    let i = group.x * 64u + local;
    if (i >= kept * fours) { return; }
    let layer = min(round[0] * layers_of_round + group.z, layer_count - 1u);
    let reach = u32(layers[layer].y);
    let x = i % kept;
    let y = 4u * (i / kept) + vec4u(0u, 1u, 2u, 3u);
    let picture = group.z * pictures + group.y;
    // The waves at the first row, and from one row to the next: a few dozen products keep 1e-6 of them.
    let at = (tile_px - y * reach % tile_px) % tile_px;
    var cosines = vec4f(factors[at.x].x, factors[at.y].x, factors[at.z].x, factors[at.w].x);
    var sines = vec4f(factors[at.x].y, factors[at.y].y, factors[at.z].y, factors[at.w].y);
    let to = y % tile_px;
    let turn_x = vec4f(factors[to.x].x, factors[to.y].x, factors[to.z].x, factors[to.w].x);
    let turn_y = vec4f(factors[to.x].y, factors[to.y].y, factors[to.z].y, factors[to.w].y);
    var cosines_x = vec4f();
    var cosines_y = vec4f();
    var sines_x = vec4f();
    var sines_y = vec4f();
    for (var row = 0u; row < 2u * reach + 2u; row++) {
        let here = rows[(picture * side + row) * kept + x];
        cosines_x += here.x * cosines;
        cosines_y += here.y * cosines;
        sines_x -= here.y * sines;
        sines_y += here.x * sines;
        let next = cosines * turn_x - sines * turn_y;
        sines = cosines * turn_y + sines * turn_x;
        cosines = next;
    }
    let columns = size / 2u + 1u;
    let first = picture * size * columns + x;
    for (var n = 0u; n < 4u; n++) {
        if (y[n] >= kept) { break; }
        let even = vec2f(cosines_x[n], cosines_y[n]);
        let odd = vec2f(sines_x[n], sines_y[n]);
        transfers[first + y[n] * columns] = even + odd;
        if (y[n] > 0u) { transfers[first + (size - y[n]) * columns] = even - odd; }
    }
}
