// Point-spread functions from traced rays, and the Fourier transforms of their rows. A workgroup adds the rays of one
// tile, channel and layer to the four pixels around each, as whole numbers in shared memory (`cells` pixels: some rows),
// and transforms those rows at the frequencies that the samples of a tile have: an invocation has four of a row. Pixels on
// both sides of the middle, as far from it, share their waves.

@group(0) @binding(0) var<storage, read> factors: array<vec2f>;  // (tile_px,)
@group(0) @binding(1) var<storage, read> rays: array<vec4f>;  // (tiles, channels, points): x, y at infinity, px; light; point
@group(0) @binding(2) var<storage, read> pupil: array<vec2f>;  // (points,)
@group(0) @binding(3) var<storage, read> layers: array<vec2f>;  // (layers,): defocus at the pupil's edge, reach, px
@group(0) @binding(4) var<storage, read> round: array<u32>;
@group(0) @binding(5) var<storage, read_write> rows: array<vec4f>;  // (layers of a round, tiles, channels, side, kept / 2)

const fours = (kept + 3u) / 4u;
const ONE = 1073741824.0f;  // 2^30: all light of a point falls into one pixel at the most

var<workgroup> light: array<atomic<u32>, cells>;

@compute @workgroup_size(128)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    let layer = min(round[0] * layers_of_round + group.z, layer_count - 1u);
    let reach = u32(layers[layer].y);
    let used = 2u * reach + 2u;  // pixels from -reach to reach + 1
    let top = group.y * rows_of_group;
    if (top >= used) { return; }
    let picture = group.x;
    let count = min(rows_of_group, used - top);
    for (var i = local; i < count * side; i += 128u) { atomicStore(&light[i], 0u); }
    workgroupBarrier();
    for (var j = local; j < points; j += 128u) {
        let ray = rays[picture * points + j];
        if (ray.z <= 0.0) { break; }  // nor have those behind it light
        let place = ray.xy - layers[layer].x * pupil[u32(ray.w)];
        let corner = floor(place);
        let share = place - corner;
        let at = vec2i(corner) + i32(reach);
        for (var k = 0u; k < 4u; k++) {
            let pixel = at + vec2i(i32(k & 1u), i32(k >> 1u));
            let row = pixel.y - i32(top);
            if (row >= 0i && row < i32(rows_of_group) && pixel.x >= 0i && pixel.x < i32(used)) {
                let along = select(1.0 - share.x, share.x, (k & 1u) == 1u);
                let down = select(1.0 - share.y, share.y, k > 1u);
                atomicAdd(&light[u32(row) * side + u32(pixel.x)], u32(ray.z * along * down * ONE + 0.5));
            }
        }
    }
    workgroupBarrier();
    for (var i = local; i < count * fours; i += 128u) {
        let frequency = 4u * (i % fours) + vec4u(0u, 1u, 2u, 3u);
        let middle = i / fours * side + reach;
        // The waves from one pixel to the next: a few dozen products keep 1e-6 of them.
        let to = frequency % tile_px;
        let turn_x = vec4f(factors[to.x].x, factors[to.y].x, factors[to.z].x, factors[to.w].x);
        let turn_y = vec4f(factors[to.x].y, factors[to.y].y, factors[to.z].y, factors[to.w].y);
        var cosines = turn_x;
        var sines = turn_y;
        var sums_x = vec4f(f32(atomicLoad(&light[middle])));
        var sums_y = vec4f();
        for (var x = 1u; x <= reach; x++) {
            let right = f32(atomicLoad(&light[middle + x]));
            let left = f32(atomicLoad(&light[middle - x]));
            sums_x += (right + left) * cosines;
            sums_y += (right - left) * sines;
            let next = cosines * turn_x - sines * turn_y;
            sines = cosines * turn_y + sines * turn_x;
            cosines = next;
        }
        let beyond = f32(atomicLoad(&light[middle + reach + 1u]));
        sums_x = (sums_x + beyond * cosines) / ONE;
        sums_y = (sums_y + beyond * sines) / ONE;
        let first = (((group.z * pictures) + picture) * side + top + i / fours) * (kept / 2u) + 2u * (i % fours);
        rows[first] = vec4f(sums_x.x, sums_y.x, sums_x.y, sums_y.y);
        if (frequency.z < kept) { rows[first + 1u] = vec4f(sums_x.z, sums_y.z, sums_x.w, sums_y.w); }
    }
}
