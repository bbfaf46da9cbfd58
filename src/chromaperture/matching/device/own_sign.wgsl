// Cells whose strongest score is negative count by that sign: `readable/correlation.py`, `of_own_sign`.

@group(0) @binding(0) var<storage, read_write> score: array<f32>;  // (cells, all_layers), parts of 1 / score_parts

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let cell = invocation(group, groups, local);
    if (cell >= cell_count) { return; }
    let start = cell * all_layers;
    var least = score[start];
    var most = least;
    for (var i = 1u; i < all_layers; i++) {
        least = min(least, score[start + i]);
        most = max(most, score[start + i]);
    }
    if (least < -contrary && least < -most) {
        for (var i = 0u; i < all_layers; i++) { score[start + i] = -score[start + i]; }
    }
}
