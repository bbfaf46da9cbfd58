// Correlation of the views in a cell's window, of every layer: of two views, or 1 - sqrt(det) of the correlation matrix
// of three. In whole units of light, in which sums are exact; rounded to 1 / score_parts. One invocation takes two
// columns of `cells_each` cells: their windows overlap in rows and in columns.

@group(0) @binding(0) var<storage, read> samples: array<f32>;  // as `reader_of` reads them
@group(0) @binding(1) var<storage, read> places: array<vec4i>;  // (K, C): entry, whole px along x, along y, 0
@group(0) @binding(2) var<storage, read> stats: array<f32>;
@group(0) @binding(3) var<storage, read_write> score: array<f32>;  // (cells_tall, cells_wide, D), parts of 1 / score_parts

const wide = width + 2u * pad_x;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    let layer = i % layer_count;
    const pairs_wide = (cells_wide + 1u) / 2u;
    let column = 2u * ((i / layer_count) % pairs_wide);
    let first = cells_each * (i / (layer_count * pairs_wide));
    if (first >= cells_tall) { return; }
    let variances = vec3f(stats[VARIANCE], stats[VARIANCE + 1u], stats[VARIANCE + 2u]);
    let added = least_floor + relative_epsilon * stats[UNIT + 1u] * stats[UNIT + 1u] * variances;
    // Of few digits, which are the same whatever the order in which the picture was summed up.
    let floors = bitcast<vec3f>(bitcast<vec3u>(added) & vec3u(0xfff00000u));
    let reader = reader_of(layer, 2u * column, 2u * first);
    var a = row_sums(reader, 0u);
    var b = row_sums(reader, 1u);
    var c = row_sums(reader, 2u);
    for (var n = 0u; n < min(cells_each, cells_tall - first); n++) {
        let d = row_sums(reader, 2u * n + 3u);
        let e = row_sums(reader, 2u * n + 4u);
        let at = ((first + n) * cells_wide + column) * all_layers + first_layer + layer;
        score[at] = round(f32(score_parts) * score_of(a.left, b.left, c.left, d.left, e.left, floors));
        if (column + 1u < cells_wide) {
            let found = score_of(a.right, b.right, c.right, d.right, e.right, floors);
            score[at + all_layers] = round(f32(score_parts) * found);
        }
        a = c;
        b = d;
        c = e;
    }
}
