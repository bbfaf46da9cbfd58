// Where fewer than two of the matched channels hold light: means of squares of the picture, from four pixels of each.

@group(0) @binding(0) var<storage, read> image: array<f32>;  // (H, W, 3)
@group(0) @binding(1) var<storage, read_write> lacking: array<f32>;  // (cells_y, cells_x): 1 or 0

const matched = array<f32, 3>(matched_red, matched_green, matched_blue);

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= cells_x * cells_y) { return; }
    // A cell covers so many of the sparse samples, those at its borders in part.
    let left = f32(i % cells_x) * per_cell_x;
    let top = f32(i / cells_x) * per_cell_y;
    var lit = 0u;
    for (var c = 0u; c < 3u; c++) {
        var sum = 0.0;
        var unknown = false;
        for (var y = u32(top); y < min(u32(ceil(top + per_cell_y)), samples_y); y++) {
            for (var x = u32(left); x < min(u32(ceil(left + per_cell_x)), samples_x); x++) {
                let value = image[3u * ((first_y + y * spacing) * width + first_x + x * spacing) + c];
                let across = min(f32(x) + 1.0, left + per_cell_x) - max(f32(x), left);
                let down = min(f32(y) + 1.0, top + per_cell_y) - max(f32(y), top);
                if (is_finite(value)) { sum += across * down * value; } else { unknown = true; }
            }
        }
        // What is not finite is not known to be dark.
        if (matched[c] > 0.0 && (unknown || sum / (per_cell_x * per_cell_y) >= dark)) { lit++; }
    }
    lacking[i] = select(0.0, 1.0, lit < 2u);
}
