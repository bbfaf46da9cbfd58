// Transfer functions: the transforms of `point_rows.wgsl` along the columns, of frequencies and their negatives at once.
// An invocation has two columns at four frequencies, which share what is read. Rows on both sides of the middle, as far
// from it, share their waves.

@group(0) @binding(0) var<storage, read> factors: array<vec2f>;  // (tile_px,)
@group(0) @binding(1) var<storage, read> layers: array<vec2f>;
@group(0) @binding(2) var<storage, read> round: array<u32>;
@group(0) @binding(3) var<storage, read> rows: array<vec4f>;  // (layers of a round, tiles, channels, side, kept / 2)
@group(0) @binding(4) var<storage, read_write> transfers: array<vec4f>;  // (..., size, kept / 2)

const fours = (kept + 3u) / 4u;
const twos = kept / 2u;

// Sums of a column's numbers times cosines, and times sines and the imaginary unit.
struct Waves { cosines_x: vec4f, cosines_y: vec4f, sines_x: vec4f, sines_y: vec4f }

// The sum of two numbers as far from the middle on either side, and their difference.
fn add(sums: ptr<function, Waves>, even: vec2f, odd: vec2f, cosines: vec4f, sines: vec4f) {
    (*sums).cosines_x += even.x * cosines;
    (*sums).cosines_y += even.y * cosines;
    (*sums).sines_x -= odd.y * sines;
    (*sums).sines_y += odd.x * sines;
}

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    let i = group.x * 64u + local;
    if (i >= twos * fours) { return; }
    let layer = min(round[0] * layers_of_round + group.z, layer_count - 1u);
    let reach = u32(layers[layer].y);
    let x = i % twos;
    let y = 4u * (i / twos) + vec4u(0u, 1u, 2u, 3u);
    let picture = group.z * pictures + group.y;
    // The waves from one row to the next: a few dozen products keep 1e-6 of them.
    let to = y % tile_px;
    let turn_x = vec4f(factors[to.x].x, factors[to.y].x, factors[to.z].x, factors[to.w].x);
    let turn_y = vec4f(factors[to.x].y, factors[to.y].y, factors[to.z].y, factors[to.w].y);
    var cosines = turn_x;
    var sines = turn_y;
    let middle = (picture * side + reach) * twos + x;
    let centre = rows[middle];
    var left = Waves(vec4f(centre.x), vec4f(centre.y), vec4f(), vec4f());
    var right = Waves(vec4f(centre.z), vec4f(centre.w), vec4f(), vec4f());
    for (var row = 1u; row <= reach; row++) {
        let after = rows[middle + row * twos];
        let before = rows[middle - row * twos];
        let even = after + before;
        let odd = after - before;
        add(&left, even.xy, odd.xy, cosines, sines);
        add(&right, even.zw, odd.zw, cosines, sines);
        let next = cosines * turn_x - sines * turn_y;
        sines = cosines * turn_y + sines * turn_x;
        cosines = next;
    }
    let beyond = rows[middle + (reach + 1u) * twos];
    add(&left, beyond.xy, beyond.xy, cosines, sines);
    add(&right, beyond.zw, beyond.zw, cosines, sines);
    let first = picture * size * twos + x;
    for (var n = 0u; n < 4u; n++) {
        if (y[n] < kept) {
            let even = vec4f(left.cosines_x[n], left.cosines_y[n], right.cosines_x[n], right.cosines_y[n]);
            let odd = vec4f(left.sines_x[n], left.sines_y[n], right.sines_x[n], right.sines_y[n]);
            transfers[first + y[n] * twos] = even + odd;
            if (y[n] > 0u) { transfers[first + (size - y[n]) * twos] = even - odd; }
        }
    }
}
