// Correlation of the views in a cell's window, of every layer: of two views, or 1 - sqrt(det) of the correlation matrix
// of three. In whole units of light, in which sums are exact; rounded to 1 / score_parts. One invocation takes
// `cells_each` cells of a column, one below the other, whose rows overlap.

@group(0) @binding(0) var<storage, read> samples: array<f32>;  // (h + 2 pad_y, w + 2 pad_x, E)
@group(0) @binding(1) var<storage, read> places: array<vec4i>;  // (K, C): entry, whole px along x, along y, 0
@group(0) @binding(2) var<storage, read> stats: array<f32>;
@group(0) @binding(3) var<storage, read_write> score: array<f32>;  // (cells_tall, cells_wide, D), parts of 1 / score_parts

const wide = width + 2u * pad_x;

// Where the middles of a window's rows begin.
fn start_of(view: u32, layer: u32, x: u32, y: u32) -> u32 {
    let place = places[view * layer_count + layer];
    let column = u32(i32(x + pad_x) + place.y);
    let row = u32(i32(y + pad_y - reach) + place.z);
    return (row * wide + column) * entry_count + u32(place.x);
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    let layer = i % layer_count;
    let column = (i / layer_count) % cells_wide;
    let first = cells_each * (i / (layer_count * cells_wide));
    if (first >= cells_tall) { return; }
    let starts = starts_of(layer, 2u * column, 2u * first);
    let variances = vec3f(stats[VARIANCE], stats[VARIANCE + 1u], stats[VARIANCE + 2u]);
    let added = least_floor + relative_epsilon * stats[UNIT + 1u] * stats[UNIT + 1u] * variances;
    // Of few digits, which are the same whatever the order in which the picture was summed up.
    let floors = bitcast<vec3f>(bitcast<vec3u>(added) & vec3u(0xfff00000u));
    const pitch = wide * entry_count;
    var a = row_sums(starts);
    var b = row_sums(starts + pitch);
    var c = row_sums(starts + 2u * pitch);
    for (var n = 0u; n < min(cells_each, cells_tall - first); n++) {
        let d = row_sums(starts + (2u * n + 3u) * pitch);
        let e = row_sums(starts + (2u * n + 4u) * pitch);
        let found = score_of(a, b, c, d, e, floors);
        score[((first + n) * cells_wide + column) * all_layers + first_layer + layer] =
            round(f32(score_parts) * found);
        a = c;
        b = d;
        c = e;
    }
}
