// Row of the nearest known pixel in the same column, -1 where there is none: the first half of
// `color/nearest_known.py`. One invocation walks a column.

@group(0) @binding(0) var<storage, read> values: array<u32>;  // (H, W), NaN unknown
@group(0) @binding(1) var<storage, read_write> rows: array<i32>;  // (H, W)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let x = invocation(group, groups, local);
    if (x >= width) { return; }
    var row = -1i;
    for (var y = 0u; y < height; y++) {
        if (values[y * width + x] != NAN_BITS) { row = i32(y); }
        rows[y * width + x] = row;
    }
    row = -1i;
    for (var y = i32(height) - 1i; y >= 0i; y--) {
        let at = u32(y) * width + x;
        let above = rows[at];
        if (above == y) { row = y; }
        if (row >= 0i && (above < 0i || row - y < y - above)) { rows[at] = row; }
    }
}
